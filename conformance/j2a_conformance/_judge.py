"""How a case ends before its last line: by one of these three calls."""

from typing import NoReturn

from ._model import Verdict

__all__ = ["Judged", "fail", "give_up", "inform", "lack", "skip"]


class Judged(Exception):  # noqa: N818 - a judgement, not always an error
    """Ends a case.

    Args:
        verdict: the judgement.
        reason: why, in words.
        suspect: a stall of this machine could be the cause, so the case deserves another attempt.

    Attributes:
        final: another attempt does not help: all were made, or the cause stays.
        missing: the device lacks a function, without which a level is not reached.
    """

    def __init__(self, verdict: Verdict, reason: str, suspect: bool = False) -> None:
        super().__init__(reason)
        self.verdict = verdict
        self.reason = reason
        self.suspect = suspect
        self.final = False
        self.missing = False


def fail(reason: str, suspect: bool = False) -> NoReturn:
    """The device is wrong; `suspect` when a stall of this machine could look the same."""
    raise Judged(Verdict.FAILED, reason, suspect)


def give_up(reason: str) -> NoReturn:
    """The testee is wrong, and would be in another attempt."""
    judged = Judged(Verdict.FAILED, reason)
    judged.final = True
    raise judged


def skip(reason: str) -> NoReturn:
    """The device does not claim what the case needs."""
    raise Judged(Verdict.UNIMPLEMENTED, reason)


def lack(reason: str) -> NoReturn:
    """The device lacks a function; a failure where it is said to reach the level of the case."""
    judged = Judged(Verdict.UNIMPLEMENTED, reason)
    judged.missing = True
    raise judged


def inform(reason: str) -> NoReturn:
    """Nothing was wrong, but what the case is about did not happen."""
    raise Judged(Verdict.INFORMATIONAL, reason)
