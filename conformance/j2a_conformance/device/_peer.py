"""The device as a case talks to it: exchanges of requests, raw streams and their due replies.

What flows in: requests of `_requests`, raw streams. What flows out: frames that were received, or
`Judged` when they are not what was expected. Rules: the barrier holds no byte that needs stuffing,
so that a fault in stuffing shows only where it is tested.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import TypeVar

from j2a_spec import constants as c
from j2a_spec.oracle import Frame, Skipped, checksum, encode

from j2a_conformance._judge import Judged, fail
from j2a_conformance._model import Claims
from j2a_conformance._retry import Retry
from j2a_conformance.wire._expected import (
    DAMAGE,
    Expected,
    ManyReply,
    Request,
    describe,
    difference,
    first_difference,
    many_payload,
    refusal,
)
from j2a_conformance.wire._link import Arrival, Link

from ._requests import MANY_ONLY, Requests

__all__ = [
    "MANY_ONLY",
    "Expected",
    "ManyReply",
    "Peer",
    "Request",
    "describe",
    "many_payload",
    "refusal",
]

_QUIET_S = 0.025  # longer than the longest byte timeout (J2A-TIME-002)
_ATTEMPTS = 6
_RESYNCS = 3
_PATIENT = 25  # of the attempts on a lossy link, each so-many-th waits for a slow answer
_BATCH = 2048  # bytes of requests in one write, where j2a.rxbuf is not less
_IN_FLIGHT = 100  # exchanges; far fewer than there are seqs
_Result = TypeVar("_Result")


class Peer(Requests):
    """The device, with what it claims.

    Args:
        link: the open link.
        claims: what discovery found out.
        emulated: a stall of this machine may make the device miss a request: one that comes after
            the start byte makes it give up the frame without a word.

    Attributes:
        strict: bytes outside frames are a failure (J2A-FRAME-010); set when the device is known to
            have received requests, because what it prints while it boots is its own affair.
    """

    def __init__(self, link: Link, claims: Claims, emulated: bool = False) -> None:
        super().__init__(link, claims)
        self.strict = False
        self._emulated = emulated
        self._barriers = 0
        lossy = link.lossy
        self._exchanges = Retry(lossy or _ATTEMPTS, every=bool(lossy))
        self._echoes = Retry(lossy or 1)
        self._resyncs = Retry(lossy or _RESYNCS, every=True)

    # Exchanges

    def play(
        self,
        stream: bytes,
        *expected: Expected,
        alone: bool = False,
        wait_s: float = 0.0,
        exact: bool = False,
    ) -> list[Frame]:
        """Send `stream` in one piece and return the replies, which are these and in this order.

        With `alone`, nothing else may come; `wait_s` is time that the device needs; with `exact`
        the replies are the bytes of the oracle. On a lossy link a failure is tried again, so
        `stream` may be sent more than once.
        """

        def body() -> list[Frame]:
            self.link.send(stream)
            frames = self.expect(*expected, wait_s=wait_s, exact=exact)
            if alone:
                self.barrier()
            return frames

        return self.carried(body)

    def play_all(self, exchanges: Iterable[tuple[bytes, Sequence[Expected]]]) -> list[Frame]:
        """Play streams and their due replies, which are the bytes of the oracle; return these.

        As many go out in one piece as j2a.rxbuf holds, so that this is fast; one by one where the
        device announces none, or the link is lossy.
        """
        room = 0 if self.link.lossy else self.room(_BATCH)
        batch: list[tuple[bytes, Sequence[Expected]]] = []
        frames: list[Frame] = []
        size = 0
        for exchange in exchanges:
            size += len(exchange[0])
            if batch and (size > room or len(batch) == _IN_FLIGHT):
                frames += self._play_batch(batch)
                batch.clear()
                size = len(exchange[0])
            batch.append(exchange)
        return frames + (self._play_batch(batch) if batch else [])

    def _play_batch(self, batch: list[tuple[bytes, Sequence[Expected]]]) -> list[Frame]:
        # A long write over a slow link gives a stall of this machine more room than one frame does.
        stream = b"".join(stream for stream, _ in batch)
        due = [one for _, expected in batch for one in expected]
        return self.attempts(lambda: self.play(stream, *due, exact=True))

    def ask_all(self, requests: Iterable[Request]) -> list[Frame]:
        """Send requests and compare their replies with the oracle, byte by byte; see `play_all`."""
        return self.play_all((request.wire, [request.expected]) for request in requests)

    def ask(self, *requests: Request) -> Frame:
        """Send each request, wait for its due reply, and return the last."""
        for request in requests:
            frame = self.play(request.wire, request.expected)[0]
        return frame

    def call(self, name: str, payload: bytes = b"") -> Frame:
        """Call a function by its name and return whatever it replies."""
        return self.ask(self.request(self.opcode(name), payload))

    def ask_many(self, request: Request) -> ManyReply:
        """Send a request to a2jMany and return the payload of its reply, taken apart.

        The bytes are compared, too: most of these replies are content that only the device knows.
        """
        payload = self.ask_exact(request).payload
        if len(payload) < c.MANY_HEADER:
            fail(f"the reply of a2jMany has {len(payload)} payload bytes, its header takes 6")
        return ManyReply(
            payload[0], payload[1], int.from_bytes(payload[2:6], "little"), payload[6:]
        )

    def read_all(self, func: str, at_most: int = 65536) -> bytes:
        """Read all that a function for a2jMany holds, up to `at_most` bytes (J2A-MANY-011)."""
        data = b""
        while True:
            reply = self.ask_many(self.many(func, offset=len(data)))
            if reply.code > c.RET_MAX or reply.offset != len(data):
                fail(f"code 0x{reply.code:02X}, offset {reply.offset} in a read at {len(data)}")
            data += reply.data
            if reply.flags & c.FLAG_LAST:
                return data
            if not reply.data:
                fail("an empty chunk without isLast in a read")
            if len(data) > at_most:
                fail(f"{func} has no end within {at_most} bytes")

    def expect(self, *expected: Expected, wait_s: float = 0.0, exact: bool = False) -> list[Frame]:
        """Receive exactly these replies, SIFs aside; `wait_s` is time that the device needs."""
        timeout_s = self.link.reply_timeout_s + wait_s
        return [self._receive(due, timeout_s, exact) for due in expected]

    def ask_exact(self, request: Request) -> Frame:
        """Send a request and compare its reply with the oracle, byte by byte; return it."""
        return self.play(request.wire, request.expected, exact=True)[0]

    def _receive(self, due: Expected, timeout_s: float, exact: bool) -> Frame:
        arrival = self.next_frame(timeout_s)
        if arrival is None:
            tail = self.link.unfinished()
            self._show(due)
            rest = (
                f", only the unfinished {tail.hex(' ')}; slow? --baud, --timeout-scale"
                if tail
                else ""
            )
            suspect = self._emulated and not tail
            fail(f"no answer within {timeout_s:.1f} s{rest}", suspect=suspect)
        event = arrival.event
        if not isinstance(event, Frame) or not due.matches(event):
            self._show(due, arrival)
            # An unasked 0xF2 may mean that this machine stalled in the middle of a frame.
            stalled = isinstance(event, Frame) and event.opcode == c.ERR_TIMEOUT
            text = f"{describe(event)} came instead of {due}{difference(event, due)}"
            fail(text, suspect=stalled)
        if exact and arrival.raw != (wanted := encode(event)):
            self._show(due, arrival, wanted)
            where = first_difference(arrival.raw, wanted)
            fail(f"the bytes of the reply are not those of the oracle: on the wire {where}")
        return event

    def _show(
        self, due: Expected, arrival: Arrival | None = None, wanted: bytes | None = None
    ) -> None:
        """End the evidence with what matters: the request, what came, and what was due."""
        self.link.remind("the request, as it was sent:", self.link.request_of(due.seq))
        self.link.remind("what came:", arrival)
        if wanted is None:
            self.link.record("expected", due.wire, str(due))
        else:
            self.link.record("expected", wanted)

    def next_frame(self, timeout_s: float) -> Arrival | None:
        """Return the next arrival that is a frame, whole or broken, and no SIF."""
        for arrival in self.link.arrivals(timeout_s):
            if not isinstance(arrival.event, Skipped):
                return arrival
            if self.strict:
                fail(f"{describe(arrival.event)} came (J2A-FRAME-010)")
        return None

    def silence(self, time_s: float, when: str) -> None:
        """Fail when a frame comes within `time_s`; `when` says in words what the time is for."""
        if (arrival := self.next_frame(time_s)) is not None:
            culprit = self._culprit(arrival)
            fail(f"{describe(arrival.event)} came {when}, where silence was due{culprit}")

    def next_sif(self, index: int) -> Frame:
        """Return the SIF number `index` of this link, or fail."""
        arrival = self.link.next_sif(index, self.link.reply_timeout_s)
        if arrival is None or not isinstance(arrival.event, Frame):
            fail("the SIF did not come")
        return arrival.event

    def barrier(self) -> None:
        """Exchange an echo: whatever the device still had to say would come before its reply.

        A device answers in order (J2A-DISP-001), so a barrier proves silence without waiting. On a
        lossy link, one that suffered itself is tried again.
        """
        self._echoes.run(lambda _: self._barrier(), self._count)

    def _barrier(self) -> None:
        request = self.probe()
        self.link.send(request.wire)
        arrival = self.next_frame(self.link.reply_timeout_s)
        suffered = bool(self.link.lossy) and _damaged(request, arrival)
        if arrival is None:
            self.link.record("expected", request.expected.wire, str(request.expected))
            fail("a good request was not answered", suspect=suffered or self._emulated)
        event = arrival.event
        if not isinstance(event, Frame) or not request.expected.matches(event):
            culprit = self._culprit(arrival)
            text = f"nothing, and then {request.expected}"
            self.link.record("expected", request.expected.wire, text)
            stalled = isinstance(event, Frame) and event.opcode == c.ERR_TIMEOUT
            suspect = suffered if self.link.lossy else stalled
            fail(f"{describe(event)} came where silence was due{culprit}", suspect=suspect)

    def _count(self, _: Judged) -> bool:
        self.link.repeated += bool(self.link.lossy)
        return True

    def _culprit(self, arrival: Arrival) -> str:
        """Return what an unwanted frame answers, in words, and put both into the evidence."""
        seq = getattr(arrival.event, "seq", None)
        request = None if seq is None else self.link.request_of(seq)
        if request is None:
            return ""
        self.link.remind("the frame with this seq, as it was sent:", request)
        self.link.remind("what came:", arrival)
        return f"; it has the seq of {describe(request.event)}"

    def probe(self) -> Request:
        """Return a request to a2jEcho like no other before, without a byte that needs stuffing."""
        while True:
            self._barriers += 1
            payload = b"%06d" % self._barriers
            request = self.echo(payload)
            sums = {checksum(request.seq, code, payload) for code in (c.ECHO, request.wire[2])}
            if not sums & c.STUFFED:
                return request

    def settle(self) -> bool:
        """Drop what the device still sends; tell whether it came to an end."""
        return self.link.settle(_QUIET_S * max(self.link.scale, 1.0), self.link.reply_timeout_s)

    def resync(self) -> bool:
        """Bring device and link to rest after a failure; tell whether the device answers again."""
        try:
            self._resyncs.run(lambda _: self._resync())
        except Judged:
            return False
        return True

    def _resync(self) -> None:
        if not self.link.lossy:  # there the probe alone brings rest, and sooner
            self.settle()
        # Before the echo is found, opcode 0 is all that is known to answer.
        request = self.probe() if self.has(c.GET_ECHO) else self.request(0)
        self.link.send(request.wire)
        for arrival in self.link.arrivals(self.link.reply_timeout_s):
            event = arrival.event
            if isinstance(event, Frame) and request.expected.matches(event):
                return
        fail("the device does not answer")

    def carried(self, body: Callable[[], _Result]) -> _Result:
        """Run an exchange; on a lossy link until it is carried unharmed."""
        return self.attempts(body) if self.link.lossy else body()

    def attempts(self, body: Callable[[], _Result]) -> _Result:
        """Run `body` until it passes: a stall of this machine may spoil one attempt, not all.

        Only failures that `body` marks as suspect are tried again; on a lossy link each one. Of
        attempts within attempts the outer ones are made: `body` may change the device's state.
        """

        def attempt(number: int) -> _Result:
            self.link.expect_loss = bool(self.link.lossy and number % _PATIENT)
            return body()

        return self._exchanges.run(attempt, self._rest)

    def _rest(self, judged: Judged) -> bool:
        if not self.resync():
            return False
        self.link.note(f"another attempt: {judged.reason}")
        return self._count(judged)


def _damaged(request: Request, arrival: Arrival | None) -> bool:
    """Tell whether the request or its reply suffered on the way."""
    if arrival is None or not isinstance(arrival.event, Frame):
        return True
    event = arrival.event
    return event.start == c.SOF and event.seq == request.seq and event.opcode in DAMAGE
