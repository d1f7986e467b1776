"""Calls on their way, and when their time is over.

What flows in: calls. What flows out: the earliest deadline, and the calls that have missed theirs.
Rules: no clock; the caller passes the time.
"""

import heapq
from dataclasses import dataclass, field
from typing import Any, Final

from j2a.errors import J2AError, Outcome
from j2a.events import Reply

__all__ = ["Call", "Deadlines"]

_SPARE: Final = 64


@dataclass(eq=False)
class Call:
    """One call: queued, then sent, then ended by a reply or an error.

    Attributes:
        what: how messages name it.
        opcode: 0..255.
        payload: 0..255 bytes.
        deadline: when it ends without a reply, in the clock of `now`; None is never.
        timeout_s: the time limit that led to `deadline`, for the message.
        waiter: an object of the client, through which the session notifies it.
        reply: set when the device answered.
        error: set when the call failed.
        has_ended: a reply or an error is there.
        number: of the attempt, counted over the link; -1 until it is sent.
        seq: of the attempt.
        size: bytes on the wire.
        hint: what an error reply says that may be about this call (J2A-ERR-010).
    """

    what: str
    opcode: int
    payload: bytes
    deadline: float | None
    timeout_s: float
    waiter: Any
    # What is not given stays in the class until it is set: that halves the price of a call.
    reply: Reply | None = field(default=None, init=False)
    error: J2AError | None = field(default=None, init=False)
    has_ended: bool = field(default=False, init=False)
    number: int = field(default=-1, init=False)
    seq: int = field(default=-1, init=False)
    size: int = field(default=0, init=False)
    hint: J2AError | None = field(default=None, init=False)

    @property
    def was_sent(self) -> bool:
        """It has left the queue for the wire."""
        return self.number >= 0

    @property
    def outcome(self) -> Outcome:
        """What it means for the request when the call fails without an answer."""
        return Outcome.MAYBE_EXECUTED if self.was_sent else Outcome.NOT_SENT

    @property
    def fate(self) -> str:
        """The same in words."""
        return "may have been executed" if self.was_sent else "was not sent"


class Deadlines:
    """The deadlines of calls in a heap; calls that have ended are dropped when they are met."""

    def __init__(self) -> None:
        self._heap: list[tuple[float, int, Call]] = []
        self._order = 0

    def add(self, call: Call, live: int) -> None:
        """Watch a call that has a deadline; `live` is how many calls have not ended."""
        if call.deadline is None:
            return
        if live == 1:
            self._heap = []  # all others have ended
        elif len(self._heap) > 2 * live + _SPARE:
            self._heap = [entry for entry in self._heap if not entry[2].has_ended]
            heapq.heapify(self._heap)
        self._order += 1
        heapq.heappush(self._heap, (call.deadline, self._order, call))

    def earliest(self) -> float | None:
        """Return the next deadline, None without one."""
        while self._heap and self._heap[0][2].has_ended:
            heapq.heappop(self._heap)
        return self._heap[0][0] if self._heap else None

    def pop_late(self, now: float) -> list[Call]:
        """Return the calls whose deadline has come, and watch them no more."""
        late = []
        while self._heap and self._heap[0][0] <= now:
            call = heapq.heappop(self._heap)[2]
            if not call.has_ended:
                late.append(call)
        return late
