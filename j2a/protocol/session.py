"""The host's side of a link, without the link.

What flows in: calls to make, bytes that arrived, the time. What flows out: bytes to send, calls
that were sent or have ended, SIFs and restarts of the device.
Rules: no clock, no thread, no file, no randomness of its own. `window` calls at most are on the
wire, the others wait in order. Each attempt takes a new seq, never one that is outstanding. A reply
answers the call that is on the wire with its seq and no other; anything else is dropped and
counted. Every call ends.
"""

import math
from collections import OrderedDict
from typing import Any, Final, Literal

from j2a_spec.constants import (
    BOOT,
    ERR_CHECKSUM,
    ERR_FRAMING,
    ERR_OPCODE,
    ERR_TIMEOUT,
    RET_FAILED,
    RET_MAX,
    SOF,
    SOS,
)

from j2a.errors import (
    CallTimeout,
    DeviceRestarted,
    J2AError,
    LinkStalled,
    Outcome,
    ProtocolError,
    remote_error,
)
from j2a.events import Counters, Doubt, Frame, FrameError, Reply, Restart, Sif, quick_maker
from j2a.protocol.boot import unpack_boot
from j2a.protocol.calls import Call, Deadlines
from j2a.protocol.codec import encode
from j2a.protocol.deframer import Deframer
from j2a.protocol.trace import Trace, Tracer

__all__ = ["BOOT_EPOCHS", "MAX_WINDOW", "Call", "Event", "Session", "restarts_of"]

_SEQS: Final = 256
MAX_WINDOW: Final = 64
BOOT_EPOCHS: Final = 1 << 32
"""A boot SIF ends so many epochs, and a clue to a restart one: the number tells how many came."""
_DAMAGE: Final = frozenset((ERR_TIMEOUT, ERR_CHECKSUM, ERR_FRAMING))
# Another barrier may follow after this time (J2A-SEQ-009).
_BARRIER_S: Final = 1.0
_GET_MAPPING: Final = 0  # on every device (J2A-DISP-005)
Event = Call | Sif | Restart
"""What `Session.receive` returns."""
_new_reply = tuple.__new__  # half the price of Reply(...)
_new_sif = quick_maker(Sif)
_OK: Final = frozenset((*range(RET_MAX + 1), RET_FAILED))


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
        has_boot: the device announces the boot SIF; None until that is known.
        has_samples: SIFs are read by what the device has told; where that is doubted, it must be
            asked anew at once.
        generation: how often the device has said that it began anew.
        epoch: the same, and how often something was seen that a restart would explain. What was
            learnt of the device in another epoch may be wrong.
    """

    def __init__(self, *, first_seq: int, window: int = 1, trace: Trace | None = None) -> None:
        self.rxbuf = 0
        self.has_boot: bool | None = None
        self.has_samples = False
        self.generation = 0
        self.epoch = 0
        self._window = window
        self._now = 0.0
        self._next_seq = first_seq % _SEQS
        self._next_number = 0
        self._deframer = Deframer()
        self._tracer = Tracer(trace)
        self._queue: OrderedDict[Call, None] = OrderedDict()
        self._sent: dict[int, Call] = {}
        self._sent_bytes = 0
        self._waiters: dict[Any, Call] = {}
        self._deadlines = Deadlines()
        # Seqs of attempts that ended while their reply may still come, and the attempts' numbers.
        self._owed: dict[int, int] = {}
        # No reply can come any more to the attempts up to this number ...
        self._proven = -1
        # ... and probably none to those up to this one.
        self._refused = -1
        # Calls with a hint that a true reply may still overrule.
        self._hinted: dict[Call, None] = {}
        # Seqs of barriers, and the numbers of the attempts that had them before.
        self._below: dict[int, int] = {}
        self._barrier_number = -1  # that of the last barrier's seq
        self._barrier_time = 0.0
        self._out: list[bytes] = []
        self._events: list[Event] = []
        self._closed: J2AError | None = None
        self._next_sif: int | None = None
        self._is_lost = False
        self._counts = dict.fromkeys(Counters.__slots__, 0)

    # ------------------------------------------------------------------ calls

    def start_call(  # noqa: PLR0917 - arguments by name cost time with each call
        self,
        what: str,
        opcode: int,
        payload: bytes,
        now: float,
        timeout_s: float,
        waiter: Any,
        generation: int | None = None,
    ) -> Call:
        """Queue a call and, if the window has room, put it on the wire.

        Args:
            what: how messages name the call.
            opcode: 0..255.
            payload: 0..255 bytes.
            now: the time, in seconds.
            timeout_s: when the call ends if no reply has come, from now on; may be infinite.
            waiter: kept in the call for the client, whose other calls have other ones.
            generation: in which the opcode meant what the call is for; None means it always does.

        Raises:
            DeviceRestarted: the generation is over.
            LinkStalled: it is this call's turn, and no seq is free (J2A-SEQ-006).
            LinkError: the session was closed; the reason of that.
        """
        if self._closed is not None:
            raise self._closed.copy(str(self._closed), Outcome.NOT_SENT)
        if generation is not None and generation != self.generation:
            text = f"{what} was not sent: the device has restarted meanwhile; try again"
            raise DeviceRestarted(text, outcome=Outcome.NOT_SENT)
        self._now = now
        deadline = now + timeout_s if timeout_s != math.inf else None
        call = Call(what, opcode, payload, deadline, timeout_s, waiter)
        self._waiters[waiter] = call
        self._deadlines.add(call, len(self._waiters))
        if self._queue or not self._send_call(call):
            self._queue[call] = None
            self._fill_window()
            if call.error is not None:
                raise call.error
        return call

    def cancel(self, waiter: Any) -> list[Call]:
        """Forget the call of a waiter; its reply, should it come, is dropped.

        The waiter names the call because a caller interrupted in `start_call` has nothing else.

        Returns: calls sent instead, or failed because the link is stalled.
        """
        call = self._waiters.get(waiter)
        if call is not None:
            text = f"{call.what} was cancelled; it {call.fate}"
            self._give_up(call, J2AError(text, outcome=call.outcome))
            # It may have been interrupted before its bytes were counted.
            self._sent_bytes = sum(other.size for other in self._sent.values())
        return self._fill_window()

    def close(self, reason: J2AError) -> list[Call]:
        """End every call with a copy of `reason`, refuse new ones with it, return those ended."""
        if self._closed is not None:
            return []
        self._closed = reason
        self._out.clear()
        return self._end_all(reason)

    def _end_all(self, reason: J2AError) -> list[Call]:
        ended = [*self._sent.values(), *self._queue]
        for call in ended:
            text = f"{reason}; {call.what} {call.fate}"
            self._give_up(call, reason.copy(text, call.outcome))
        return ended

    @property
    def end_reason(self) -> J2AError | None:
        """The reason of `close`, None while the session is open."""
        return self._closed

    @property
    def is_closed(self) -> bool:
        """`close` was called."""
        return self._closed is not None

    @property
    def waiting(self) -> int:
        """How many calls have not ended."""
        return len(self._waiters)

    def next_timeout(self) -> float | None:
        """Return when to call `handle_timeout`, or None when nothing waits."""
        return self._deadlines.earliest()

    def handle_timeout(self, now: float) -> list[Call]:
        """End the calls whose time is over; return them and the calls that were sent instead.

        What has arrived by then must have been given to `receive` before.
        """
        self._now = now
        late = self._deadlines.pop_late(now)
        for call in late:
            error = call.hint
            if error is None:
                self._counts["timeouts"] += 1
                reason = (
                    "but no reply came"
                    if call.was_sent
                    else "because earlier calls were not answered"
                )
                error = CallTimeout(
                    f"{call.what} {call.fate}, {reason} within {call.timeout_s:.3g} s; "
                    "see that the board runs and that both ends use one speed, or wait longer",
                    outcome=call.outcome,
                )
            self._give_up(call, error)
        return late + self._fill_window()

    def data_to_send(self) -> bytes:
        """Return the bytes to write next, b"" if there are none; they count as sent."""
        if not self._out:
            return b""
        data = b"".join(self._out)
        self._out.clear()
        self._counts["bytes_sent"] += len(data)
        if self._tracer.is_on:
            self._tracer.note("tx", data)
        return data

    def _fill_window(self) -> list[Call]:
        """Send what may be sent; return the calls sent, and those that failed instead."""
        changed = []
        while self._queue and len(self._sent) < self._window:
            call = next(iter(self._queue))
            if self._send_call(call):
                del self._queue[call]
            elif self._free_seq() is None and not self._is_late(call):
                self._send_barrier()
                self._end(call, error=self._stalled(call))
            else:
                break
            changed.append(call)
        return changed

    def _is_late(self, call: Call) -> bool:
        """Whether it is too late to send a call; `handle_timeout` ends it."""
        return call.deadline is not None and call.deadline <= self._now

    def _send_call(self, call: Call) -> bool:
        """Send a call if time, window, seqs and the device's buffer allow it; say whether."""
        if len(self._sent) >= self._window or self._is_late(call):
            return False
        seq: int | None = self._next_seq
        if seq in self._sent or seq in self._owed:
            seq = self._free_seq()
        if seq is None:
            return False
        wire = encode(SOF, seq, call.opcode, call.payload)
        if self._sent and self._sent_bytes + len(wire) > self.rxbuf:
            return False
        call.seq, call.number, call.size = seq, self._next_number, len(wire)
        self._next_seq = (seq + 1) % _SEQS
        self._sent[seq] = call
        self._sent_bytes += len(wire)
        self._send(wire, seq, call.opcode, call.payload)
        return True

    def _send(self, wire: bytes, seq: int, opcode: int, payload: bytes) -> None:
        self._next_number += 1
        self._out.append(wire)
        if self._tracer.is_on:
            self._tracer.note("tx", Frame(SOF, seq, opcode, payload))

    def _free_seq(self) -> int | None:
        """Return the next seq that no reply can be under way for (J2A-SEQ-003, J2A-SEQ-006)."""
        seq = self._next_seq
        if seq not in self._sent and seq not in self._owed:
            return seq
        if len(self._sent) + len(self._owed) >= _SEQS:
            return None
        while seq in self._sent or seq in self._owed:
            seq = (seq + 1) % _SEQS
        return seq

    def _end(self, call: Call, reply: Reply | None = None, error: J2AError | None = None) -> None:
        call.reply, call.error, call.has_ended = reply, error, True
        self._waiters.pop(call.waiter, None)
        if self._hinted:
            self._hinted.pop(call, None)
        # A caller that was interrupted in `start_call` may be in both, or in neither yet.
        if self._queue:
            self._queue.pop(call, None)
        if self._sent.get(call.seq) is call:
            del self._sent[call.seq]
            self._sent_bytes -= call.size

    def _give_up(self, call: Call, error: J2AError) -> None:
        """End a call whose reply may still come."""
        if call.number > self._proven:
            self._owed[call.seq] = call.number
        self._end(call, error=error)

    # ------------------------------------------------------------------ barriers

    def _stalled(self, call: Call) -> LinkStalled:
        if self._barrier_number > self._proven:
            advice = "the link recovers as soon as it answers"
        else:
            advice = "if it answers no more, open the link anew"
        return LinkStalled(
            f"{call.what} was not sent: the replies to {_SEQS} requests are outstanding, so no seq "
            f"is free; see that the board runs: {advice}"
        )

    def _send_barrier(self) -> None:
        """Send a request whose reply shows which seqs are not outstanding any more (J2A-SEQ-009).

        It has the newest seq of those whose calls have ended. A reply with this seq may be the late
        one to the attempt before, so it proves no more than that one would.
        """
        if self._barrier_number > self._proven and self._now - self._barrier_time < _BARRIER_S:
            return
        numbers = self._owed | self._below
        seq = max(numbers, key=numbers.__getitem__)
        wire = encode(SOF, seq, _GET_MAPPING, b"")
        if self._sent and self._sent_bytes + len(wire) > self.rxbuf:
            return
        self._barrier_number = self._below[seq] = numbers[seq]
        self._barrier_time = self._now
        self._owed[seq] = self._next_number
        self._send(wire, seq, _GET_MAPPING, b"")

    # ------------------------------------------------------------------ input

    def receive(self, data: bytes, now: float | None = None) -> list[Event]:
        """Take bytes that arrived; return what they caused, and calls sent instead, in order.

        Never raises, whatever the bytes are.

        Args:
            data: the bytes.
            now: the time, in seconds; None is that of the last call of any method. A call that
                waits for its turn is not sent after its time.
        """
        if now is not None:
            self._now = now
        self._counts["bytes_received"] += len(data)
        events = self._events
        is_traced = self._tracer.is_on
        if is_traced:
            self._tracer.note("rx", data)
        for event in self._deframer.feed(data):
            if is_traced:
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
                if event.opcode == BOOT:
                    events += self._take_boot(event)
                before = self.epoch
                events.append(self._take_sif(event))
                if self.epoch != before and self.has_samples:
                    events.insert(-1, Doubt())
            else:
                events += self._take_reply(event)
        if self._queue:
            events += self._fill_window()
        self._events = []
        return events

    def recover(self) -> list[Event]:
        """Put the state in order after a signal handler has raised amid any method, Ctrl-C perhaps.

        Bytes may be lost, so the open frame is given up.

        Returns: what the method would have returned, as far as it came, and calls sent instead.
        """
        if self._deframer.abandon("marker") is not None:
            self._is_lost = True
            self._counts["framing_errors"] += 1
        events, self._events = self._events, []
        seen = {id(event) for event in events}
        known = dict.fromkeys((*self._sent.values(), *self._waiters.values(), *self._queue))
        events += [call for call in known if call.has_ended and id(call) not in seen]
        live = [call for call in known if not call.has_ended]
        self._sent = {call.seq: call for call in live if call.was_sent}
        self._sent_bytes = sum(call.size for call in self._sent.values())
        self._queue = OrderedDict.fromkeys(call for call in live if not call.was_sent)
        self._waiters = {call.waiter: call for call in live}
        self._hinted = {call: None for call in self._hinted if not call.has_ended}
        if self._closed is not None:
            return events + self._end_all(self._closed)
        return events + self._fill_window()

    def _take_boot(self, frame: Frame) -> list[Event]:
        """Take a SIF of the opcode of the boot SIF; return what it ends if it is one."""
        if not self.has_boot:
            # What comes first was sent before anything was learnt.
            self.epoch += self.has_boot is None and self._counts["frames_received"] > 1
            return []
        self.epoch += BOOT_EPOCHS
        self.generation += 1
        self.rxbuf = 0
        self._next_sif = None
        self._counts["restarts"] += 1
        restart = unpack_boot(frame.payload)
        cause = f" (cause: {restart.cause.name.lower()})" if restart.cause else ""
        return [*self._end_all(DeviceRestarted(f"the device has restarted{cause}")), restart]

    def _take_sif(self, frame: Frame) -> Sif:
        _, seq, opcode, payload = frame
        counts, missed = self._counts, 0
        if self._next_sif is not None and (missed := (seq - self._next_sif) % _SEQS):
            # Going back is also what the counter of a device does that was reset.
            self.epoch += seq < self._next_sif
            counts["sif_gaps"] += 1
            counts["sifs_missed"] += missed
        self._next_sif = (seq + 1) % _SEQS
        counts["sifs"] += 1
        gone = counts["sifs_missed"] + counts["sifs_dropped"]
        return _new_sif(opcode, payload, seq, missed, None, self.epoch, gone)

    def _take_reply(self, frame: Frame) -> list[Call]:
        """Take a reply; return the calls that it ends."""
        _, seq, code, payload = frame
        call = self._sent.get(seq)
        if call is None:
            number = self._owed.get(seq)
            self._counts["stray_replies" if number is None else "late_replies"] += 1
            if number is None or not _is_proof(code):
                return []
            return self._exclude(self._below.get(seq, number))
        if code in _DAMAGE:
            return self._take_hint(call, code, payload)
        if code in _OK:
            self._end(call, _new_reply(Reply, (code, payload)))
        elif code == ERR_OPCODE:
            self._counts["error_replies"] += 1
            self._end(call, error=remote_error(call.what, code, payload))
        else:
            text = f"{call.what}: the device answered with the reserved code 0x{code:02X}"
            self._give_up(call, ProtocolError(f"{text}; see which version of J2A it speaks"))
            return [call]
        if self._owed or self._hinted:
            return [*self._exclude(call.number), call]
        # `_exclude`, with nothing to exclude.
        if call.number > self._proven:  # noqa: PLR1730 - max() costs more than all of this
            self._proven = call.number
        return [call]

    def _take_hint(self, call: Call, code: int, payload: bytes) -> list[Call]:
        """Take an error reply whose seq no checksum has proved (J2A-ERR-010).

        If nothing older is unanswered, the device has come to this request or beyond, so its true
        reply is not to be expected. Otherwise it is, and the true reply wins.
        """
        self._counts["error_replies"] += 1
        error = remote_error(call.what, code, payload)
        floor = max(self._proven, self._refused)
        numbers = (*(other.number for other in self._sent.values()), *self._owed.values())
        if any(floor < number < call.number for number in numbers):
            call.hint = error
            self._hinted[call] = None
            return []
        self._refused = call.number
        self._give_up(call, error)
        return [call]

    def _exclude(self, number: int) -> list[Call]:
        """Note that no reply can come any more to the attempts up to this one.

        Devices answer in order. Calls that this leaves without an answer wait for their time limit,
        unless a hint says what became of them; those are returned.
        """
        self._proven = max(self._proven, number)
        if self._owed:
            self._owed = {seq: owed for seq, owed in self._owed.items() if owed > number}
            if self._below:
                self._below = {s: below for s, below in self._below.items() if s in self._owed}
        if not self._hinted:
            return []
        ended = [call for call in self._hinted if call.number < number]
        for call in ended:
            self._end(call, error=call.hint)
        return ended

    # ------------------------------------------------------------------ counters

    def note_restart(self) -> None:
        """Count a restart of which the device has not told."""
        self.generation += 1
        self._counts["restarts"] += 1

    def count(self, name: Literal["sifs_dropped", "handler_errors"]) -> None:
        """Count what happened in the client."""
        self._counts[name] += 1

    @property
    def restarts(self) -> int:
        """How often the device has begun anew; that of `counters`, for those who ask very often."""
        return self._counts["restarts"]

    @property
    def counters(self) -> Counters:
        """The counters as they are now."""
        known = {"frames_sent": self._next_number, "bytes_skipped": self._deframer.skipped}
        return Counters(**{**self._counts, **known})


def restarts_of(epoch: int) -> int:
    """Return how many boot SIFs had come when an epoch lasted."""
    return epoch // BOOT_EPOCHS


def _is_proof(code: int) -> bool:
    """Whether a reply with this code shows that its request, and none before it, is under way."""
    return code in _OK or code == ERR_OPCODE
