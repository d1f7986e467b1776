"""The exit codes of `j2a-conform`. Rule: all but HARNESS and INTERRUPTED are judgements."""

from typing import Final

from j2a_conformance._model import STOPPED_BY_USER, Outcome, Run

__all__ = [
    "CONFORMANT",
    "FAILED",
    "HARNESS",
    "INTERRUPTED",
    "NOTHING",
    "UNEXPECTED",
    "UsageError",
    "status",
]

CONFORMANT = 0
"""Nothing failed."""
FAILED = 1
"""A case failed."""
UNEXPECTED = 2
"""Nothing failed, but something that was known to fail passed, so the list is out of date."""
HARNESS = 3
"""The harness, the link or the arguments are wrong: nothing can be said."""
INTERRUPTED = 130
"""Ctrl-C ended it; SIGTERM: 143. What was judged by then is reported."""
NOTHING = 4
"""Nothing was tested: the device claims none of what was asked for."""

_STATUS: Final = {
    Outcome.FAILED: FAILED,
    Outcome.STOPPED: HARNESS,
    Outcome.STALE: UNEXPECTED,
    Outcome.NOTHING: NOTHING,
    Outcome.CONFORMANT: CONFORMANT,
}


class UsageError(Exception):
    """The arguments do not go together; the message says how they do."""


def status(run: Run) -> int:
    """Return the exit code of a run."""
    if run.stopped == STOPPED_BY_USER:
        return INTERRUPTED
    return _STATUS[run.outcome]
