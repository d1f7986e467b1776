"""The report for people at a terminal.

What flows in: a `Run`, or its results one by one. What flows out: text lines without colour.
"""

from collections.abc import Iterator

from j2a_spec import constants as c
from j2a_spec import requirements
from j2a_spec.capabilities import LEVELS
from j2a_spec.plural import counted
from j2a_spec.printable import printable

from j2a_conformance._model import Evidence, Outcome, Result, Run, Verdict
from j2a_conformance.device._deviations import STRICT

from ._annotate import annotate
from ._summary import judgement

__all__ = ["evidence_lines", "line", "report"]

_EVIDENCE_SHOWN = 12
_WIDEST = max(len(verdict.value) for verdict in Verdict)
_EXPLAINED = (
    Verdict.UNIMPLEMENTED,
    Verdict.INFORMATIONAL,
    Verdict.NON_STRICT,
    Verdict.KNOWN_DEVIATION,
)
_ARROWS = {"sent": "->", "received": "<-", "sif": "<~", "expected": "expected", "note": "note"}


def line(result: Result) -> str:
    """Return one line for a result."""
    again = f" ({result.attempts} attempts)" if result.attempts > 1 else ""
    again += f" ({counted(result.repeated, 'exchange')} repeated)" if result.repeated else ""
    reason = f": {result.reason}" if result.reason else ""
    return printable(
        f"{result.verdict.value:{_WIDEST}} {result.case}  {result.duration_s:.2f} s{again}{reason}"
    )


def report(run: Run) -> str:
    """Return the whole report: what the device claims, each failure, the table, the judgement."""
    lines = (*_claims(run), *_failures(run), *_others(run), *_table(run), *_end(run))
    return "\n".join(printable(line) for line in lines)


def _claims(run: Run) -> Iterator[str]:
    title = f"{run.title}, " if run.title else ""
    yield f"J2A conformance of {title}{run.url}, {run.started}, profile {run.profile}"
    if run.lossy:
        repeated = sum(result.repeated for result in run.results)
        yield (
            f"The link was declared lossy: each exchange had up to "
            f"{counted(run.lossy, 'attempt')}, and {counted(repeated, 'was', 'were')} repeated. A "
            "fault that the device shows only now and then cannot be told from one of the link."
        )
    if run.claims is None:
        return
    names = ", ".join(name or "(not used)" for name in run.claims.functions)
    mapped = "mapping" if run.claims.mapped else "no mapping; found by trying"
    yield f"functions ({mapped}): {names}"
    for key, value in run.claims.properties.items():
        yield f"property {key} = {value}"
    yield f"shortest round trip {run.claims.rtt_s * 1e3:.2f} ms"
    if c.PROP_SPEC not in run.claims.properties and run.profile == STRICT:
        yield (
            f"The device does not claim version {c.SPEC_VERSION}: it has no property "
            f"{c.PROP_SPEC}. As a device of 2014 it is judged by --profile legacy-2014."
        )
    yield ""


def _failures(run: Run) -> Iterator[str]:
    texts = requirements.load()
    for result in run.with_verdict(Verdict.FAILED):
        yield f"FAILED {result.case} ({result.level})"
        yield f"  does      {result.description}"
        yield f"  expects   {result.expectation}"
        yield f"  but       {result.reason}"
        for name in result.requirements:
            yield f"  {name}  {texts[name].text}"
        yield from evidence_lines(result)
        yield ""


def evidence_lines(result: Result, at_most: int = _EVIDENCE_SHOWN) -> Iterator[str]:
    """Return the last `at_most` entries of evidence, bytes annotated."""
    shown = result.evidence[-at_most:]
    if left_out := result.left_out + len(result.evidence) - len(shown):
        yield f"  ({left_out} earlier lines left out)"
    for entry in shown:
        yield from _entry(entry)


def _entry(entry: Evidence) -> Iterator[str]:
    prefix = f"  {entry.at_ms:9.2f} ms {_ARROWS[entry.kind]} "
    if entry.text:
        yield prefix + entry.text
    for piece in annotate(entry.data) if entry.data else ():
        yield f"{prefix}{' | '.join(piece.fields)}   {piece.meaning}"
        prefix = " " * len(prefix)


def _others(run: Run) -> Iterator[str]:
    """Return what was neither right nor wrong; many cases can have the same reason."""
    for verdict in _EXPLAINED:
        reasons: dict[str, list[str]] = {}
        for result in run.with_verdict(verdict):
            reasons.setdefault(result.reason, []).append(result.case)
        for reason, cases in reasons.items():
            yield f"{verdict.value}: {', '.join(cases)}: {reason}"
    for sentence in run.stale:
        yield f"STALE: {sentence}"


def _table(run: Run) -> Iterator[str]:
    verdicts = list(Verdict)
    yield ""
    yield f"{'level':12}" + "".join(f"{verdict.value:>17}" for verdict in verdicts)
    for level in LEVELS:
        results = [r for r in run.results if r.level == level]
        counts = [sum(r.verdict is verdict for r in results) for verdict in verdicts]
        if results:
            yield f"{level:12}" + "".join(f"{count or '-':>17}" for count in counts)
    counts = [len(run.with_verdict(verdict)) for verdict in verdicts]
    yield f"{'all':12}" + "".join(f"{count or '-':>17}" for count in counts)


def _end(run: Run) -> Iterator[str]:
    yield ""
    if run.stopped:
        yield f"The run ended early: {run.stopped}."
    reached = [level for level, is_so in run.levels().items() if is_so]
    missed = [level for level, is_so in run.levels().items() if is_so is False]
    if reached or missed:
        but = f"; not {', '.join(missed)}" if missed else ""
        yield f"Levels: reaches {', '.join(reached) or 'none'}{but}."
    unseen = ", ".join(result.case for result in run.with_verdict(Verdict.INFORMATIONAL))
    but = f"; not seen on this link: {unseen}" if unseen else ""
    yield f"{_sentence(run)}{but}; {run.duration_s:.1f} s."


def _sentence(run: Run) -> str:
    words = judgement(run)
    if not run.tested and run.outcome is not Outcome.FAILED:
        return words.capitalize()
    if run.outcome is Outcome.FAILED:
        words = f"NOT{words.removeprefix('not')}"  # what has no colour needs capitals
    return f"The {run.role} is {words}"
