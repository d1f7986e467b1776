"""What a run is, as data: every report is made from a `Run` and from nothing else.

What flows in: the runner fills these classes. What flows out: every report, and the exit code.
Rules: frozen; no report adds a judgement of its own, `Run.outcome` is what all of them say.
"""

from dataclasses import dataclass, field
from enum import Enum
from functools import cache
from importlib import metadata
from typing import Final, Literal, get_args

from j2a_spec import SPEC_VERSION
from j2a_spec.requirements import Level

__all__ = [
    "STOPPED_BY_USER",
    "Claims",
    "Evidence",
    "HarnessError",
    "Kind",
    "Outcome",
    "Result",
    "Run",
    "Verdict",
]

Kind = Literal["sent", "received", "sif", "expected", "note"]

STOPPED_BY_USER: Final = "interrupted"
"""Of a run that Ctrl-C or SIGTERM has ended."""

_NEEDS: Final[dict[Level, Level]] = {"core": "frame"}
"""The level below; what is not named here needs core."""


class HarnessError(Exception):
    """The harness or the link is wrong, so nothing can be said about the device."""


class Verdict(Enum):
    """The outcome of a case."""

    OK = "ok"
    NON_STRICT = "non-strict"
    """The device breaks the letter of this version, as the profile of the run allows."""
    INFORMATIONAL = "informational"
    """What the case is about did not happen on this link; nothing was wrong."""
    UNIMPLEMENTED = "unimplemented"
    """The device does not claim what the case needs; it was not run or not finished."""
    KNOWN_DEVIATION = "known-deviation"
    """The device fails as its list of known deviations says."""
    FAILED = "failed"

    @property
    def passed(self) -> bool:
        """The device was seen to do what the run judges it by."""
        return self in (Verdict.OK, Verdict.NON_STRICT)

    @property
    def judged(self) -> bool:
        """Something was seen of what the case is about."""
        return self not in (Verdict.INFORMATIONAL, Verdict.UNIMPLEMENTED)


class Outcome(Enum):
    """What a run comes to; where several are true, the first one."""

    FAILED = "failed"
    """A case failed."""
    STOPPED = "stopped"
    """The run ended early, so only a part was judged, which is no proof of anything."""
    STALE = "stale"
    """Nothing failed, but the list of known deviations is out of date."""
    NOTHING = "nothing"
    """None of the cases that were asked for was judged."""
    CONFORMANT = "conformant"


@dataclass(frozen=True, slots=True)
class Evidence:
    """One line of what happened in a case.

    Attributes:
        kind: bytes sent, bytes received, a SIF received, what was expected, or a note.
        at_ms: time since the case began.
        data: the bytes on the wire; of what was expected only where all of them are known.
        text: words, for the last two kinds.
    """

    kind: Kind
    at_ms: float
    data: bytes = b""
    text: str = ""


@dataclass(frozen=True, slots=True)
class Claims:
    """What the device says about itself, read from it before the cases.

    Attributes:
        mapped: a2jGetMapping works; without it the built-in functions were found by trying.
        functions: names in opcode order; without a mapping only the built-in ones. A name that the
            suite may not use is "".
        properties: of a2jGetProperties; empty where the device has none or they cannot be read.
        rtt_s: the shortest round trip of a small echo seen, in seconds.
        fresh: the device was reset when the link was opened.
    """

    mapped: bool
    functions: tuple[str, ...]
    properties: dict[str, str] = field(default_factory=dict)
    rtt_s: float = 0.0
    fresh: bool = False


@dataclass(frozen=True, slots=True)
class Result:
    """The outcome of one case.

    Attributes:
        case: id of the case.
        description: what the case does.
        expectation: what a conforming device does.
        requirements: ids of the requirements that the case tests.
        level: level of conformance that the case belongs to.
        verdict: the judgement.
        reason: why, in words; "" where the verdict is OK.
        evidence: what was sent and received; of a long case the last part.
        left_out: number of evidence entries before those in `evidence`.
        attempts: how often the case was run; more than once where the machine may have stalled, or
            where the link is declared lossy.
        repeated: exchanges within the case that were repeated because the link is declared lossy.
        duration_s: of all attempts together.
    """

    case: str
    description: str
    expectation: str
    requirements: tuple[str, ...]
    level: Level
    verdict: Verdict
    reason: str = ""
    evidence: tuple[Evidence, ...] = ()
    left_out: int = 0
    attempts: int = 1
    repeated: int = 0
    duration_s: float = 0.0


@cache
def _j2a_version() -> str:
    try:
        return metadata.version("j2a")
    except metadata.PackageNotFoundError:  # run from a checkout that is not installed
        return "unknown"


@dataclass(frozen=True, slots=True)
class Run:
    """A whole run against one device or one host.

    Attributes:
        url: the link.
        started: date and time, ISO 8601 with time zone.
        duration_s: in seconds.
        claims: what the device says about itself; None when it could not be read.
        results: in the order in which the cases ran, the smoke step first.
        stopped: why cases were left out at the end, or "".
        title: what the device or the host is, or "".
        role: what was judged.
        profile: what the device was judged by: "strict", or a name of an older base.
        stale: entries of the list of known deviations that did not come true, as sentences that
            name the case and say why: it passed, or it was not judged.
        asked: ids of the cases that were asked for; () where that is all of the results.
        lossy: attempts that each exchange had because the link was declared lossy; 0 when not.
        not_run: the cases of the suite that are not among the results, because they were not
            asked for or the run ended before them, each with its level.
        j2a_version: of the package that judged.
        spec_version: of the specification that it judged by.
    """

    url: str
    started: str
    duration_s: float
    claims: Claims | None
    results: tuple[Result, ...]
    stopped: str = ""
    title: str = ""
    role: Literal["device", "host"] = "device"
    profile: str = "strict"
    stale: tuple[str, ...] = ()
    asked: tuple[str, ...] = ()
    lossy: int = 0
    not_run: dict[str, Level] = field(default_factory=dict)
    j2a_version: str = field(default_factory=_j2a_version)
    spec_version: str = SPEC_VERSION

    def with_verdict(self, verdict: Verdict) -> tuple[Result, ...]:
        """Return the results that have this verdict."""
        return tuple(result for result in self.results if result.verdict is verdict)

    @property
    def outcome(self) -> Outcome:
        """What the run comes to."""
        if self.with_verdict(Verdict.FAILED):
            return Outcome.FAILED
        if self.stopped:
            return Outcome.STOPPED
        if self.stale:
            return Outcome.STALE
        return Outcome.CONFORMANT if self.tested else Outcome.NOTHING

    @property
    def conformant(self) -> bool:
        """Something was tested, no case failed, and the run did not end early.

        A list of known deviations that is out of date is no fault of the device.
        """
        return self.tested and self.outcome in (Outcome.CONFORMANT, Outcome.STALE)

    @property
    def tested(self) -> bool:
        """At least one of the cases that were asked for was judged."""
        asked = [r for r in self.results if not self.asked or r.case in self.asked]
        return any(result.verdict.judged for result in asked)

    def levels(self) -> dict[Level, bool | None]:
        """Return for each level whether the device reaches it; None where that is not known.

        Only levels that the suite has a case of are among them; that for hosts has none of debug.
        A level is reached when the one below it is (frame, then core, then any other), no case of
        it failed, known deviation or not, and at least one passed. It is not known of a level that
        the device does not claim, or of which not every case was run.
        """
        found: dict[Level, bool | None] = {}
        for level in get_args(Level):
            verdicts = {r.verdict for r in self.results if r.level == level}
            whole = level not in self.not_run.values()
            if whole and not verdicts:
                continue
            below = found.get(_NEEDS.get(level, "core"), True)
            if below is False or verdicts & {Verdict.FAILED, Verdict.KNOWN_DEVIATION}:
                found[level] = False
            else:
                found[level] = (below and whole and any(v.passed for v in verdicts)) or None
        return found
