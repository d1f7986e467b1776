"""The host's side of a link, without the link.

What flows in: calls to make, bytes that arrived, the time. What flows out: bytes to send, calls
that were sent or have ended, and SIFs.
Rules: no clock, no thread, no file. `window` calls at most are on the wire, the others wait in
order. Each attempt takes a new seq. A reply answers the call that is on the wire with its seq and
no other; anything else is dropped and counted. Every call ends.
"""

from collections import deque
from dataclasses import dataclass
from typing import Any, Final, Literal

from j2a_spec.constants import ERR_OPCODE, ERRORS, SOF, SOS

from j2a._codec import encode
from j2a._deframer import Deframer
from j2a._trace import Trace, Tracer
from j2a.errors import CallTimeout, J2AError, Outcome, remote_error
from j2a.events import Counters, Frame, FrameError, Reply, Sif

__all__ = ["Call", "Session"]

_SEQS: Final = 256
MAX_WINDOW: Final = 64


@dataclass(slots=True, eq=False)
class Call:
    """One call on its way: queued, then sent, then ended by a reply or an error.

    Attributes:
        what: how messages name it.
        opcode: 0..255.
        payload: 0..255 bytes.
        deadline: when it ends without a reply, in the clock of `now`; None is never.
        timeout_s: the time limit that led to `deadline`, for the message.
        waiter: belongs to the shell, which is told through it.
        reply: set when the device answered.
        error: set when the call failed.
    """

    what: str
    opcode: int
    payload: bytes
    deadline: float | None
    timeout_s: float
    waiter: Any
    reply: Reply | None = None
    error: J2AError | None = None
    _seq: int = -1
    _number: int = -1
    _size: int = 0

    @property
    def has_ended(self) -> bool:
        """A reply or an error is there."""
        return self.reply is not None or self.error is not None

    @property
    def outcome(self) -> Outcome:
        """What the call's failure means without an answer."""
        return Outcome.NOT_SENT if self._number < 0 else Outcome.MAYBE_EXECUTED

    @property
    def fate(self) -> str:
        """The same in words."""
        return "was not sent" if self._number < 0 else "may have been executed"


class Session:
    """The state of one link as the host sees it.

    Args:
        first_seq: seq of the first call, 0..255. A random one keeps a reply that is still under
            way from an earlier program from answering the first call.
        window: how many calls may be on the wire at once. More than one needs `rxbuf`.
        trace: called with every frame; see `j2a.Trace`.

    Attributes:
        rxbuf: wire bytes that the device can hold while it is busy (property j2a.rxbuf); until it
            is known there is one call on the wire at a time (J2A-LIMIT-003).
    """

    def __init__(self, *, first_seq: int, window: int = 1, trace: Trace | None = None) -> None:
        self.rxbuf = 0
        self._window = window
        self._next_seq = first_seq % _SEQS
        self._next_number = 0
        self._deframer = Deframer()
        self._tracer = Tracer(trace)
        self._queue: deque[Call] = deque()
        self._sent: dict[int, Call] = {}
        # Seqs of calls that ended while their reply may still come, and the number of the attempt.
        self._owed: dict[int, int] = {}
        self._out: list[bytes] = []
        self._closed: J2AError | None = None
        self._next_sif: int | None = None
        self._is_lost = False
        self._counts = dict.fromkeys(Counters.__slots__, 0)

    # ------------------------------------------------------------------ calls

    def start_call(
        self, what: str, opcode: int, payload: bytes, *, now: float, timeout_s: float, waiter: Any
    ) -> Call:
        """Queue a call and, if the window has room, put it on the wire.

        Args:
            what: how messages name the call.
            opcode: 0..255.
            payload: 0..255 bytes.
            now: the time, in seconds.
            timeout_s: when the call ends if no reply has come, from now on; may be infinite.
            waiter: kept in the call for the shell.

        Raises:
            LinkError: the session was closed; the reason of that.
        """
        if self._closed is not None:
            raise self._closed.copy(str(self._closed), Outcome.NOT_SENT)
        deadline = now + timeout_s if timeout_s != float("inf") else None
        call = Call(what, opcode, payload, deadline, timeout_s, waiter)
        self._queue.append(call)
        self._fill_window()
        return call

    def cancel(self, waiter: Any) -> list[Call]:
        """Forget the call of a waiter; its reply, should it come, is dropped.

        The waiter names the call because whoever is interrupted in `start_call` has nothing else.

        Returns: calls sent instead.
        """
        for call in (*self._sent.values(), *self._queue):
            if call.waiter is waiter:
                text = f"{call.what} was cancelled; it {call.fate}"
                self._end(call, error=J2AError(text, outcome=call.outcome))
        return self._fill_window()

    def close(self, reason: J2AError) -> list[Call]:
        """End every call with a copy of `reason`, refuse new ones with it, return those ended."""
        if self._closed is not None:
            return []
        self._closed = reason
        self._out.clear()
        ended = [*self._sent.values(), *self._queue]
        self._sent.clear()
        self._queue.clear()
        for call in ended:
            call.error = reason.copy(f"{reason}; {call.what} {call.fate}", call.outcome)
        return ended

    @property
    def is_closed(self) -> bool:
        """`close` was called."""
        return self._closed is not None

    def next_timeout(self) -> float | None:
        """Return when `handle_timeout` is due, or None when nothing waits."""
        calls = (*self._sent.values(), *self._queue)
        return min((call.deadline for call in calls if call.deadline is not None), default=None)

    def handle_timeout(self, now: float) -> list[Call]:
        """End the calls whose time is over; return them and the calls that were sent instead.

        What has arrived by then must have been given to `receive` before.
        """
        calls = (*self._sent.values(), *self._queue)
        late = [call for call in calls if call.deadline is not None and call.deadline <= now]
        for call in late:
            self._counts["timeouts"] += 1
            if call._number < 0:
                text = "was not sent because earlier calls were not answered"
            else:
                text = "may have been executed, but no reply came"
            advice = "see that the board runs and that both ends use one speed, or wait longer"
            limit = f"within {call.timeout_s:g} s"
            text = f"{call.what} {text} {limit}; {advice}"
            self._end(call, error=CallTimeout(text, outcome=call.outcome))
        return late + self._fill_window()

    def data_to_send(self) -> bytes:
        """Return the bytes to write next, b"" if there are none; they count as sent."""
        data = b"".join(self._out)
        self._out.clear()
        if data:
            self._counts["bytes_sent"] += len(data)
            self._tracer.note("tx", data)
        return data

    def _fill_window(self) -> list[Call]:
        started = []
        while self._queue:
            call = self._queue[0]
            if len(self._sent) >= self._window:
                break
            seq = self._free_seq()
            wire = encode(SOF, seq, call.opcode, call.payload)
            if self._sent and sum(c._size for c in self._sent.values()) + len(wire) > self.rxbuf:
                break
            self._queue.popleft()
            call._seq, call._number, call._size = seq, self._next_number, len(wire)
            self._next_seq = (seq + 1) % _SEQS
            self._next_number += 1
            self._sent[seq] = call
            self._out.append(wire)
            self._counts["frames_sent"] += 1
            if self._tracer.is_on:
                self._tracer.note("tx", Frame(SOF, seq, call.opcode, call.payload))
            started.append(call)
        return started

    def _free_seq(self) -> int:
        """Return the next seq that no reply can be under way for (J2A-SEQ-003)."""
        if len(self._sent) + len(self._owed) >= _SEQS:
            # Hundreds of calls in a row without one reply: whatever is owed is not coming.
            del self._owed[min(self._owed, key=self._owed.__getitem__)]
        seq = self._next_seq
        while seq in self._sent or seq in self._owed:
            seq = (seq + 1) % _SEQS
        return seq

    def _end(self, call: Call, *, error: J2AError) -> None:
        call.error = error
        if call._number < 0:
            self._queue.remove(call)
        else:
            del self._sent[call._seq]
            self._owed[call._seq] = call._number

    # ------------------------------------------------------------------ input

    def receive(self, data: bytes) -> list[Call | Sif]:
        """Take bytes that arrived; return SIFs, calls that ended and calls sent, in this order.

        Never raises, whatever the bytes are.
        """
        self._counts["bytes_received"] += len(data)
        self._tracer.note("rx", data)
        events: list[Call | Sif] = []
        for event in self._deframer.feed(data):
            self._tracer.note("rx", event)
            if isinstance(event, FrameError):
                self._is_lost = True
                kind = "checksum_errors" if event.reason == "checksum" else "framing_errors"
                self._counts[kind] += 1
                continue
            self._counts["frames_received"] += 1
            if self._is_lost:
                self._is_lost = False
                self._counts["resyncs"] += 1
            if event.start == SOS:
                events.append(self._take_sif(event))
            elif (call := self._take_reply(event)) is not None:
                events.append(call)
        events += self._fill_window()
        return events

    def _take_sif(self, frame: Frame) -> Sif:
        missed = 0 if self._next_sif is None else (frame.seq - self._next_sif) % _SEQS
        self._next_sif = (frame.seq + 1) % _SEQS
        self._counts["sifs"] += 1
        self._counts["sif_gaps"] += missed > 0
        self._counts["sifs_missed"] += missed
        return Sif(frame.opcode, frame.payload, frame.seq, missed)

    def _take_reply(self, frame: Frame) -> Call | None:
        _, seq, code, payload = frame
        call = self._sent.pop(seq, None)
        # These three are also the answer to a request whose seq was damaged on the way, so they
        # prove nothing about the order: the true reply may still come.
        is_doubtful = code in ERRORS and code != ERR_OPCODE
        if call is None:
            number = self._owed.pop(seq, None)
            if number is None:
                self._counts["stray_replies"] += 1
                return None
            self._counts["late_replies"] += 1
        else:
            number = call._number
            if code in ERRORS:
                self._counts["error_replies"] += 1
                call.error = remote_error(call.what, code, payload)
            else:
                call.reply = Reply(code, payload)
        if is_doubtful:
            self._owed[seq] = number
        elif self._owed:
            # Devices answer in order: what was asked for earlier is not owed any more.
            self._owed = {seq: owed for seq, owed in self._owed.items() if owed > number}
        return call

    # ------------------------------------------------------------------ counters

    def count(self, name: Literal["sifs_dropped", "handler_errors"]) -> None:
        """Count what happened in the shell."""
        self._counts[name] += 1

    @property
    def counters(self) -> Counters:
        """The counters as they are now."""
        return Counters(**{**self._counts, "bytes_skipped": self._deframer.skipped})
