"""Time limits of work that takes several calls (J2A-TIME-008).

What flows in: the limits, the time. What flows out: how long the next call may take.
Rules: no clock; the caller passes the time.
"""

from typing import Final

from j2a.errors import CallTimeout, J2AError, Outcome

__all__ = ["DEVICE_LIMITS", "Limits"]

DEVICE_LIMITS: Final = 10
"""What is read of the device itself, such as its properties, takes at most so many time limits of
a call: a slow link needs more than one, and a device that never comes to an end is left."""

_NEARLY: Final = 0.99
"""Of its limit a first call has so much at least: the clock goes on while it is prepared."""


class Limits:
    """How long a piece of work may take.

    Args:
        step_s: the time limit of each call, in seconds.
        total_s: the time limit of all calls together, in seconds; may be infinite.
        now: when the work begins, in seconds.
    """

    __slots__ = ("_end", "_is_cut", "_step_s", "_total_s")

    def __init__(self, step_s: float, total_s: float, now: float) -> None:
        self._step_s = step_s
        self._total_s = total_s
        self._end = now + total_s
        # The call that was begun last has less than its own limit.
        self._is_cut = False

    def of_step(self, what: str, limit_s: float | None, now: float) -> float:
        """Return the time limit of the next call, in seconds.

        Args:
            what: the call, for the message.
            limit_s: its own time limit, None for that of each call.
            now: the time, in seconds.

        Raises:
            CallTimeout: no time is left for it.
        """
        self._is_cut = False
        left_s = self._end - now
        if left_s <= 0:
            raise CallTimeout(f"{what} was not sent: {self._is_over}", outcome=Outcome.NOT_SENT)
        limit_s = limit_s or self._step_s
        self._is_cut = left_s < _NEARLY * limit_s
        return min(limit_s, left_s)

    def explain(self, error: J2AError) -> J2AError:
        """Return the error of a call; of one that had less than its own limit it says why."""
        if not self._is_cut or not isinstance(error, CallTimeout):
            return error
        told = error.copy(f"{error}; {self._is_over}", error.outcome)
        told.__suppress_context__ = True  # a traceback shows one of them
        return told

    @property
    def _is_over(self) -> str:
        return f"the time limit of {self._total_s:g} s for the whole is over"
