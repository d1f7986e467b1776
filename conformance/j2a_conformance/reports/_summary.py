"""The summary of a run, in words and numbers that every report shows.

What flows in: a `Run`. What flows out: a line for each level, and the judgement in a few words.
Rules: nothing is judged here that the run does not judge; what was not run is called so.
"""

from collections import Counter
from dataclasses import dataclass
from enum import Enum
from typing import Final

from j2a_spec.plural import counted
from j2a_spec.requirements import Level

from j2a_conformance._model import Outcome, Run, Verdict

__all__ = ["WORST_FIRST", "LevelSummary", "Standing", "judgement", "levels", "name", "tone"]

WORST_FIRST: Final = (
    Verdict.FAILED,
    Verdict.KNOWN_DEVIATION,
    Verdict.NON_STRICT,
    Verdict.UNIMPLEMENTED,
    Verdict.INFORMATIONAL,
    Verdict.OK,
)
"""The verdicts, what needs attention first."""


class Standing(Enum):
    """How a device stands at a level."""

    REACHED = "reached"
    FAILED = "failed"
    """A case of it failed, if only as the list of known deviations says."""
    NOT_REACHED = "not reached"
    """A level that it rests on failed."""
    INCOMPLETE = "incomplete"
    """Cases of it, or of a level that it rests on, were not run or saw nothing."""
    NOT_CLAIMED = "not claimed"
    """The device has nothing that the cases need."""
    NOT_RUN = "not run"


@dataclass(frozen=True, slots=True)
class LevelSummary:
    """The results of a level.

    Attributes:
        level: the level.
        standing: what they come to.
        counts: number of results with each verdict that there is.
        not_run: number of cases that were not run.
    """

    level: Level
    standing: Standing
    counts: dict[Verdict, int]
    not_run: int

    @property
    def total(self) -> int:
        """The number of cases that were run."""
        return sum(self.counts.values())


def levels(run: Run) -> tuple[LevelSummary, ...]:
    """Return a summary for each level that has cases, in the order of the specification."""
    return tuple(_level(run, level, reached) for level, reached in run.levels().items())


def _level(run: Run, level: Level, reached: bool | None) -> LevelSummary:
    counts = Counter(result.verdict for result in run.results if result.level == level)
    if reached:
        standing = Standing.REACHED
    elif counts[Verdict.FAILED] or counts[Verdict.KNOWN_DEVIATION]:
        standing = Standing.FAILED
    elif not counts:
        standing = Standing.NOT_RUN
    elif set(counts) == {Verdict.UNIMPLEMENTED}:
        standing = Standing.NOT_CLAIMED
    elif reached is False:
        standing = Standing.NOT_REACHED
    else:
        standing = Standing.INCOMPLETE
    found = {verdict: counts[verdict] for verdict in WORST_FIRST if counts[verdict]}
    return LevelSummary(level, standing, found, sum(v == level for v in run.not_run.values()))


def judgement(run: Run) -> str:
    """Return what the run says about the device, in a few words that every report shows."""
    stale = "; the list of known deviations is out of date" if run.stale else ""
    return _words(run) + stale


def _words(run: Run) -> str:
    if run.outcome is Outcome.FAILED:
        failed = len(run.with_verdict(Verdict.FAILED))
        return f"not conformant: {failed} of {counted(len(run.results), 'case')} failed"
    early = ": the run ended early" if run.stopped else ""
    if not run.tested:
        return f"nothing was tested{early}"
    if run.stopped:
        return f"not judged{early}"
    judge = "" if run.profile == "strict" else f" by the profile {run.profile}"
    known = " but for known deviations" if run.with_verdict(Verdict.KNOWN_DEVIATION) else ""
    part = " in what was run" if run.not_run else ""
    return f"conformant{judge}{known}{part}"


def tone(run: Run) -> str:
    """Return the verdict whose colour fits the judgement, or "not-run"."""
    if run.outcome is Outcome.FAILED:
        return "failed"
    if not run.conformant:
        return "not-run"
    known = run.stale or run.with_verdict(Verdict.KNOWN_DEVIATION)
    return "known-deviation" if known else "ok"


def name(run: Run) -> str:
    """Return what to call the device."""
    properties = run.claims.properties if run.claims else {}
    return run.title or properties.get("name", "") or run.url or f"a {run.role}"
