"""The link as a case sees it: raw bytes out, pieces of the stream in, and a record of both.

What flows in: bytes of the transport. What flows out: `Arrival`s, each the bytes of one event of
the oracle. Rules: bytes to send come from the oracle, never from an implementation; SIFs may come
at any time and are kept apart; everything is recorded as evidence.
"""

import re
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

from j2a_spec import constants as c
from j2a_spec.oracle import Event, Frame, FrameError, Incomplete, Skipped, decode
from j2a_transports import Transport, TransportError

from j2a_conformance._model import Evidence, Kind

__all__ = ["Arrival", "Link", "Splitter"]

_BEFORE_MARKER: Final = re.compile(rb"(?=[\x12\xed])")
_EVIDENCE_KEPT: Final = 40
_SENT_KEPT: Final = 256  # writes; enough to find the request of any seq again
_SIFS_KEPT: Final = 8192  # of the cases before; a sensor at 100 Hz sends fewer in a minute
_FRAMES_AT_MOST: Final = 250_000  # kept at a time, of some 500 bytes of memory each
_SEQS: Final = 256
_SOS: Final = bytes((c.SOS,))
_SPIN_S: Final = 0.0015
_REPLY_S: Final = 5.0  # a device in an emulator stands still as long as its machine does
_LOSS_S: Final = 0.05  # more than a device takes to give up a frame (J2A-TIME-002)
_BITS: Final = 10  # of a byte on a serial line; with parity and a second stop bit 12


@dataclass(frozen=True, slots=True)
class Arrival:
    """A piece of the received stream.

    Attributes:
        raw: its bytes on the wire.
        event: what the oracle says that they are.
        at_s: when its last byte was read, on the clock of the link.
    """

    raw: bytes
    event: Event
    at_s: float


class Splitter:
    """Cuts a stream that comes in chunks into arrivals.

    Each raw marker begins a piece, because it begins a frame wherever it stands (J2A-FRAME-007).
    The last piece waits for more bytes while the oracle calls it incomplete.
    """

    def __init__(self) -> None:
        self.tail = b""

    def feed(self, data: bytes, now_s: float) -> list[Arrival]:
        """Take `data`, which was read at `now_s`, and return what it completes."""
        pieces = [piece for piece in _BEFORE_MARKER.split(self.tail + data) if piece]
        self.tail = b""
        found = []
        for index, piece in enumerate(pieces):
            event, *behind = decode(piece)
            if isinstance(event, Incomplete):
                if index == len(pieces) - 1:
                    self.tail = piece
                    break
                event = FrameError("marker", event.start, event.seq)
            size = len(piece) - sum(e.count for e in behind if isinstance(e, Skipped))
            found.append(Arrival(piece[:size], event, now_s))
            if rest := piece[size:]:
                found.append(Arrival(rest, Skipped(len(rest)), now_s))
        return found


class Link:
    """A transport with evidence.

    Args:
        transport: an open byte stream to the device.
        scale: factor for every wait; above 1 for slow links.
        baud: rate of the link in bits a second, or 0 where it is not known.
        lossy: attempts for each exchange on a link that loses or damages bytes; 0 on any other.

    Attributes:
        sifs: every SIF since the link was opened, in order; but when a case begins, at most
            some thousands of those before it: the first one, and the newest.
        first: the first frame since then, whole or broken; None before.
        byte_s: time that a byte on the wire takes, as far as it is known.
        expect_loss: do not wait long for an answer: it is lost rather than late.
        repeated: exchanges that were repeated since `begin`, because the link is lossy.
    """

    def __init__(
        self, transport: Transport, scale: float = 1.0, baud: int = 0, lossy: int = 0
    ) -> None:
        self.scale = scale
        self.lossy = lossy
        self.byte_s = _BITS / baud if baud else 0.0
        self.expect_loss = bool(lossy)
        self.repeated = 0
        self.sifs: list[Arrival] = []
        self.first: Arrival | None = None
        self._splitter = Splitter()
        self._waiting: deque[Arrival] = deque()
        # As the arguments of Evidence: nearly all of it is dropped, and nobody looks at it.
        self._evidence: deque[tuple[Kind, float, bytes, str]] = deque(maxlen=_EVIDENCE_KEPT)
        self._entries = 0
        self._sent: deque[bytes] = deque(maxlen=_SENT_KEPT)
        self._adopt(transport)
        self._began_s = self.now_s()

    # Time

    def _adopt(self, transport: Transport) -> None:
        """Take the transport, and its time."""
        self.transport = transport
        self._clock = transport.clock

    def now_s(self) -> float:
        """Return the time in seconds; of a simulated device it is the simulated time."""
        return self._clock()

    def pause(self, time_s: float) -> None:
        """Let so much time pass; a little more where the machine is slow to wake up."""
        (self.transport.sleep if self.transport.is_simulated else time.sleep)(time_s)

    def wait_until(self, moment_s: float) -> None:
        """Return at `moment_s` of `now_s`, more exactly than a sleep alone does."""
        rest_s = moment_s - self.now_s()
        if self.transport.is_simulated:
            self.transport.sleep(max(rest_s, 0.0))
            return
        # A short pause is allowed to be longer by a part of it, so it need not be spun away whole.
        if rest_s > 0:
            time.sleep(rest_s - min(_SPIN_S, rest_s / 4))
        while self.now_s() < moment_s:
            pass

    def measured(self, size: int, time_s: float) -> None:
        """Make the waits fit a link that took `time_s` for `size` bytes there and back."""
        self.byte_s = max(self.byte_s, time_s / size)

    @property
    def reply_timeout_s(self) -> float:
        """How long an answer may take.

        The largest request and the largest reply must fit, twice: the rate is not known exactly.
        """
        least_s = (_LOSS_S if self.expect_loss else _REPLY_S) * self.scale
        return max(least_s, 2 * 2 * c.MAX_WIRE * self.byte_s)

    # Evidence

    def begin(self) -> None:
        """Start the evidence of a new case."""
        self._evidence.clear()
        self._sent.clear()
        self._entries = 0
        self.repeated = 0
        self.expect_loss = bool(self.lossy)
        self._forget_sifs()
        self._began_s = self.now_s()

    def _forget_sifs(self) -> None:
        """Forget SIFs of finished cases: a device that floods would fill the memory.

        The seqs of those that stay count up by one: so many are left out as there are seqs, or a
        multiple of that.
        """
        count = len(self.sifs) - _SIFS_KEPT
        if count > 0:
            del self.sifs[1 : 1 + count + -count % _SEQS]

    def record(
        self, kind: Kind, data: bytes = b"", text: str = "", at_s: float | None = None
    ) -> None:
        """Add a line to the evidence; `at_s` is its time, None: now."""
        self._entries += 1
        at_ms = ((self.now_s() if at_s is None else at_s) - self._began_s) * 1e3
        self._evidence.append((kind, at_ms, data, text))

    def note(self, text: str) -> None:
        """Add a note to the evidence."""
        self.record("note", text=text)

    def remind(self, text: str, arrival: Arrival | None) -> None:
        """Note bytes that matter for a failure once more, unless they are the last that is seen."""
        last = list(self._evidence)[-2:]
        if arrival is not None and all(data != arrival.raw for _, _, data, _ in last):
            self.record("note", arrival.raw, text)

    def evidence(self) -> tuple[tuple[Evidence, ...], int]:
        """Return the last lines of evidence, and the number of those before them."""
        lines = tuple(Evidence(*entry) for entry in self._evidence)
        return lines, self._entries - len(lines)

    # Bytes

    def send(self, data: bytes) -> None:
        """Write `data` to the link in one piece."""
        self.record("sent", data)
        self._sent.append(data)
        self.transport.write(data)

    def request_of(self, seq: int) -> Arrival | None:
        """Return the newest frame that was sent with this seq, whole or broken, or None."""
        for data in reversed(self._sent):
            splitter = Splitter()
            found = splitter.feed(data, 0.0)
            if splitter.tail:
                found.append(Arrival(splitter.tail, decode(splitter.tail)[0], 0.0))
            for arrival in reversed(found):
                if getattr(arrival.event, "seq", None) == seq:
                    return arrival
        return None

    def _read(self, timeout_s: float) -> None:
        data = self.transport.read(timeout_s)
        if not data:
            return
        now_s = self.now_s()
        for arrival in self._splitter.feed(data, now_s):
            event = arrival.event
            # A broken frame that begins with SOS is not kept apart: it is a fault of the device.
            is_sif = isinstance(event, Frame) and event.start == c.SOS
            if self.first is None and not isinstance(event, Skipped):
                self.first = arrival
            self.record("sif" if is_sif else "received", arrival.raw, at_s=now_s)
            (self.sifs if is_sif else self._waiting).append(arrival)
        if len(self.sifs) + len(self._waiting) > _FRAMES_AT_MOST:
            raise TransportError(f"more than {_FRAMES_AT_MOST} frames came unasked: a flood")

    def next(self, timeout_s: float) -> Arrival | None:
        """Return the next arrival that is no SIF, or None when none came in `timeout_s`."""
        return self._take() or self._until(self.now_s() + timeout_s, self._take)

    def arrivals(self, timeout_s: float) -> Iterator[Arrival]:
        """Yield arrivals that are no SIFs for `timeout_s`, however many there are.

        What was read by then is yielded to its end: a stall of this machine loses nothing.
        """
        deadline_s = self.now_s() + timeout_s
        arrival = self._until(deadline_s, self._take)
        while arrival is not None:
            yield arrival
            arrival = self._take()
            if arrival is None and self.now_s() < deadline_s:
                arrival = self._until(deadline_s, self._take)

    def next_sif(self, index: int, timeout_s: float) -> Arrival | None:
        """Return `sifs[index]`, or None when it did not come in `timeout_s`."""
        if index < len(self.sifs):
            return self.sifs[index]
        deadline_s = self.now_s() + timeout_s
        return self._until(deadline_s, lambda: self.sifs[index] if index < len(self.sifs) else None)

    def _take(self) -> Arrival | None:
        return self._waiting.popleft() if self._waiting else None

    def _until(self, deadline_s: float, ready: Callable[[], Arrival | None]) -> Arrival | None:
        while True:
            if (found := ready()) is not None:
                return found
            left_s = deadline_s - self.now_s()
            self._read(max(left_s, 0.0))
            if left_s <= 0:
                return ready()

    def unfinished(self) -> bytes:
        """Return the bytes of a frame that has not come to its end."""
        return self._splitter.tail

    def settle(self, quiet_s: float, at_most_s: float) -> bool:
        """Drop what comes until nothing but SIFs came for `quiet_s`; tell whether that was so.

        The beginning of a SIF stays: its rest is on its way from a device that sends SIFs all the
        time, or that stalls amid one.
        """
        deadline_s = self.now_s() + at_most_s
        while not (quiet := self.next(quiet_s) is None) and self.now_s() < deadline_s:
            pass
        if not self._splitter.tail.startswith(_SOS):
            self._splitter.tail = b""
        return quiet

    def replace(self, transport: Transport) -> None:
        """Go on with a new transport to a device that starts anew."""
        try:
            self.transport.close()
        except TransportError as error:
            self.note(f"closing the old link: {error}")
        self._adopt(transport)
        self.sifs.clear()
        self.first = None
        self._waiting.clear()
        self._splitter = Splitter()
