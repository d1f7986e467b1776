"""What changed from one run to another.

What flows in: two runs, the older one first. What flows out: `Comparison`, and it as text. Rules: a
regression is a case that both runs have and that has a worse verdict now; a case that one of them
lacks is named, and is no regression. Every run begins with the same steps, so these are compared,
but two runs that have nothing else in common do not count as compared.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from j2a_conformance._model import Claims, Result, Run, Verdict
from j2a_conformance.device._smoke import SMOKE
from j2a_conformance.host import START

from ._summary import judgement, levels, name

__all__ = ["Comparison", "compare", "report"]

_BADNESS: Final = {
    Verdict.OK: 0,
    Verdict.INFORMATIONAL: 0,  # depends on the link, not on the device
    Verdict.UNIMPLEMENTED: 1,
    Verdict.NON_STRICT: 2,
    Verdict.KNOWN_DEVIATION: 3,
    Verdict.FAILED: 4,
}
_FIRST: Final = frozenset(case.ID for case in (*SMOKE, START))
"""What every run begins with, whatever is asked for."""


@dataclass(frozen=True, slots=True)
class Change:
    """A case whose verdict or reason differs."""

    before: Result
    after: Result

    @property
    def worse(self) -> int:
        """Above 0 where the verdict is worse now, below 0 where it is better."""
        return _BADNESS[self.after.verdict] - _BADNESS[self.before.verdict]

    def __str__(self) -> str:
        verdicts = [result.verdict.value for result in (self.before, self.after)]
        what = " -> ".join(verdicts) if len(set(verdicts)) > 1 else f"still {verdicts[0]}"
        return f"{self.after.case}  {what}{_because(self.after)}"


@dataclass(frozen=True, slots=True)
class Comparison:
    """What changed.

    Attributes:
        before: the older run.
        after: the newer run.
        compared: number of cases that both have, beside those that every run begins with.
        changes: the cases whose verdict differs, or the reason of a failure.
        added: results of cases that only the newer run has.
        gone: results of cases that only the older run has, or that were not run again.
    """

    before: Run
    after: Run
    compared: int
    changes: tuple[Change, ...]
    added: tuple[Result, ...]
    gone: tuple[Result, ...]

    @property
    def regressions(self) -> tuple[Change, ...]:
        """The cases that are worse now."""
        return tuple(change for change in self.changes if change.worse > 0)

    @property
    def lost(self) -> tuple[Result, ...]:
        """The results of the older run that the newer one lacks because it ended early."""
        left = self.gone if self.after.stopped else ()
        return tuple(result for result in left if result.case in self.after.not_run)


def compare(before: Run, after: Run) -> Comparison:
    """Return what changed from `before` to `after`."""
    old = {result.case: result for result in before.results}
    new = {result.case: result for result in after.results}
    both = [Change(old[case], new[case]) for case in new if case in old]
    return Comparison(
        before,
        after,
        sum(change.after.case not in _FIRST for change in both),
        tuple(change for change in both if _differs(change)),
        tuple(new[case] for case in new if case not in old),
        tuple(old[case] for case in old if case not in new),
    )


def _differs(change: Change) -> bool:
    if change.before.verdict is not change.after.verdict:
        return True
    return change.after.verdict is Verdict.FAILED and change.before.reason != change.after.reason


def report(found: Comparison) -> str:
    """Return the comparison as text, regressions first."""
    return "\n".join((*_heads(found), *_cases(found), *_others(found), *_end(found)))


def _heads(found: Comparison) -> Iterator[str]:
    for label, run in (("before", found.before), ("after", found.after)):
        yield f"{label:7} {name(run)}, {run.started}: {judgement(run)}"
    for what, before, after in (
        ("role", found.before.role, found.after.role),
        ("link", found.before.url, found.after.url),
        ("profile", found.before.profile, found.after.profile),
        ("attempts on a lossy link", found.before.lossy, found.after.lossy),
        ("J2A", found.before.j2a_version, found.after.j2a_version),
        ("specification", found.before.spec_version, found.after.spec_version),
    ):
        if before != after:
            yield f"{what}: {before} -> {after}"


def _cases(found: Comparison) -> Iterator[str]:
    better = [change for change in found.changes if change.worse < 0]
    other = [change for change in found.changes if not change.worse]
    for title, changes in (("WORSE", found.regressions), ("better", better), ("different", other)):
        yield from _part(title, [str(change) for change in changes])
    yield from _part("new", [f"{r.case}  {r.verdict.value}{_because(r)}" for r in found.added])
    for title, known in (("not run", True), ("gone", False)):
        yield from _part(
            title,
            [
                f"{result.case}  was {result.verdict.value}"
                for result in found.gone
                if (result.case in found.after.not_run) is known
            ],
        )


def _others(found: Comparison) -> Iterator[str]:
    after = {entry.level: entry.standing for entry in levels(found.after)}
    changed = [
        f"{old.level}  {old.standing.value} -> {after[old.level].value}"
        for old in levels(found.before)
        if after.get(old.level, old.standing) is not old.standing
    ]
    yield from _part("levels", changed)
    yield from _part("claims", list(_claims(found.before.claims, found.after.claims)))


def _claims(before: Claims | None, after: Claims | None) -> Iterator[str]:
    if before is None or after is None:
        if before is not after:
            yield "could not be read " + ("before" if before is None else "this time")
        return
    if before.mapped != after.mapped:
        yield "the mapping is " + ("new" if after.mapped else "gone")
    for function in after.functions:
        if function not in before.functions:
            yield f"function {function} is new"
    for function in before.functions:
        if function not in after.functions:
            yield f"function {function} is gone"
    if sorted(before.functions) == sorted(after.functions) and before.functions != after.functions:
        yield "the functions are in another order"
    for key in {**before.properties, **after.properties}:
        old, new = before.properties.get(key), after.properties.get(key)
        if old != new:
            texts = ["none" if value is None else repr(value) for value in (old, new)]
            yield f"property {key}: {' -> '.join(texts)}"


def _end(found: Comparison) -> Iterator[str]:
    yield ""
    if found.lost:
        left = _number(len(found.lost), "case")
        yield f"The newer run ended early: {found.after.stopped}; {left} unjudged."
    worse = _number(len(found.regressions), "regression")
    if found.compared:
        yield f"{_number(found.compared, 'case')} compared: {worse}."
    else:
        yield f"no case in common beside those that every run begins with: {worse} in these."


def _part(title: str, lines: list[str]) -> Iterator[str]:
    if lines:
        yield ""
        yield f"{title} ({len(lines)})"
        yield from (f"  {line}" for line in lines)


def _number(count: int, what: str) -> str:
    return f"{count or 'no'} {what}{'s' if count > 1 else ''}"


def _because(result: Result) -> str:
    return f": {result.reason}" if result.reason else ""
