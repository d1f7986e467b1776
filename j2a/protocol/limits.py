"""Time limits of work that takes several calls (J2A-TIME-008).

What flows in: the limits, the time. What flows out: how long the next call may take.
Rules: no clock; the caller passes the time.
"""

from typing import Final

from j2a.errors import CallTimeout, Outcome

__all__ = ["DEVICE_LIMITS", "Limits"]

DEVICE_LIMITS: Final = 10
"""What is read of the device itself, such as its properties, takes at most so many time limits of
a call: a slow link needs more than one, and a device that never comes to an end is left."""


class Limits:
    """How long a piece of work may take.

    Args:
        step_s: the time limit of each call, in seconds.
        total_s: the time limit of all calls together, in seconds; may be infinite.
        now: when the work begins, in seconds.
    """

    __slots__ = ("_end", "_step_s", "_total_s")

    def __init__(self, step_s: float, total_s: float, now: float) -> None:
        self._step_s = step_s
        self._total_s = total_s
        self._end = now + total_s

    def of_step(self, what: str, limit_s: float | None, now: float) -> float:
        """Return the time limit of the next call, in seconds.

        Args:
            what: the call, for the message.
            limit_s: its own time limit, None for that of each call.
            now: the time, in seconds.

        Raises:
            CallTimeout: no time is left for it.
        """
        left_s = self._end - now
        if left_s <= 0:
            raise CallTimeout(
                f"{what} was not sent: the time limit of {self._total_s:g} s for the whole is over",
                outcome=Outcome.NOT_SENT,
            )
        return min(limit_s or self._step_s, left_s)
