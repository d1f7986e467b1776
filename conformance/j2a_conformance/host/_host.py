"""The host program as a case talks to it: jobs for it, its requests, and the outcomes it reports.

What flows in: jobs, replies and any other bytes for the host. What flows out: the requests that it
sends, the outcomes that it reports, or `Judged` when they are not as expected. Rules: the program
calls the opcode `CONDUCTOR` with the outcome of its last job and gets the next one as the reply,
so the link is the only way between suite and program. Every frame that comes is compared with the
oracle, whichever case runs.
"""

import math
import re
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Final, NoReturn

from j2a_spec import constants as c
from j2a_spec.oracle import Frame, Incomplete, decode, encode
from j2a_transports import LinkLost

from j2a_conformance._judge import Judged, fail, skip
from j2a_conformance.wire._expected import describe
from j2a_conformance.wire._link import Arrival, Link

from ._device import PING, Device
from ._dimensions import frame as wire_of
from ._outcomes import Outcome, Request, difference, explain, spell
from ._program import Listening
from ._seqs import Seqs

__all__ = ["CONDUCTOR", "Host"]

CONDUCTOR: Final = 0xE0
"""The opcode that the host program calls for its jobs."""

_PATIENCE_S: Final = 5.0
_LIMIT_MS: Final = 3000
_SILENCE_MS: Final = 60
_MOST: Final = 200
_MOST_TOLD: Final = 4500  # of 249 bytes: 1 MiB of properties
_JOB_S: Final = 120.0  # no job has more than a quarter of it for its time limit
_PAUSE_S: Final = 0.0004
_TOGETHER_MS: Final = 500.0  # a stall must not look like a host that makes one call at a time
_LAST_WORDS_S: Final = 0.5


class Host:
    """The host program behind a link.

    Args:
        place: where the host connects.
        device: what the scripted device has.
        scale: factor for every wait and for every time limit in a job.

    Attributes:
        title: what the program says that it is, when it reports that it is ready.
        link: the link to the host.
        device: what the scripted device has; a host learns of another one over a new link.
        limit_ms: a time limit for calls that are answered.
        silence_ms: a time limit for calls that are not.
        slow_s: how long the device takes to answer requests about itself.
        answers: how many of these it still answers.
        behind: returns what comes in one piece with the last of these answers.
    """

    def __init__(self, place: Listening, device: Device, scale: float = 1.0) -> None:
        self.title = ""
        self.device = self._first_device = device
        self.limit_ms = int(_LIMIT_MS * scale)
        self.silence_ms = int(_SILENCE_MS * scale)
        self._patience_s = _PATIENCE_S * scale
        self._job_s = _JOB_S * scale
        self._place = place
        self._sif_seq = 0
        self.slow_s = 0.0
        self.answers = math.inf
        self.behind: Callable[[], bytes] = bytes
        self._told = 0
        self._verb = ""
        self._held: list[Arrival] = []
        self.link = Link(place.first(), scale)
        self._begin()

    def _begin(self) -> None:
        self._ends_s = self.link.now_s() + self._job_s
        self._seqs = Seqs()
        self._is_met = False
        self._pending: Frame | None = None
        self._held.clear()

    # The link

    def close(self) -> None:
        """End the link."""
        self.link.transport.close()

    def hang_up(self, greeting: bytes = b"") -> None:
        """End the link, as a cable that is pulled, and wait until the host has connected again.

        Args:
            greeting: what the device sends at once on the new link.
        """
        self.link.note("the link is closed; the host connects anew")
        self.close()
        self.link.replace(self._place.again(self._patience_s))
        self._begin()
        if greeting:
            self.send(greeting)

    def restart(self) -> None:
        """Bring the host to rest after a failure: a new program where it is started from here.

        It meets the device that the first one met.

        Raises:
            Judged: the host does not come back.
            HarnessError: the program does not start.
        """
        self.close()
        self.device = self._first_device
        self.slow_s, self.answers, self.behind = 0.0, math.inf, bytes
        if self._place.has_runner:
            self.link.replace(self._place.first())
        else:
            self.link.replace(self._place.again(self._patience_s))
        self._begin()
        self._await_conductor()

    def become_shy(self, device: Device) -> None:
        """Be another device, which refuses its properties until the host has its next job.

        A host that reads them while it connects does without them, or reads them later on.
        """
        self.device = replace(device, properties=None)
        self.hang_up()
        try:
            self._await_conductor()
        except Judged:
            if self._place.ended() or self.link.unfinished():
                raise
            self.link.note("the host has closed the link; it connects anew")
            self.link.replace(self._place.again(self._patience_s))
            self._begin()
            self._await_conductor()
        self.device = device

    def become(self, device: Device) -> None:
        """Be another device from now on, which a host sees over a new link."""
        if device != self.device:
            self.device = device
            self.hang_up()
            self._await_conductor()

    def barrier(self) -> None:
        """Give a job that needs no request, so that one too many is seen; forget the SIFs."""
        self.job("sifs all 0 0")
        self._await_conductor()
        assert self._pending is not None
        if not self._pending.payload.startswith((b"sifs ", b"unsupported")):
            self._reported(("sifs",))

    # Jobs and outcomes

    def job(self, text: str, more_s: float = 0.0) -> None:
        """Give the host, which waits for it, its next job, and `more_s` than others have for it."""
        self.send(self.job_frame(text))
        self._ends_s += more_s

    def job_frame(self, text: str) -> bytes:
        """Return the wire bytes that give the next job; they must be sent."""
        seq, self._pending, self._told = self.resting_seq, None, 0
        self._verb = text.partition(" ")[0]
        self._ends_s = self.link.now_s() + self._job_s
        self.link.note(f"job: {text}")
        self._seqs.reply(seq, is_error=False)
        return wire_of(c.SOF, seq, c.RET_OK, text.encode())

    def outcome(self, *accepted: str, wait_ms: float = 0.0, due: bytes = b"") -> Outcome:
        """Wait for the report of the host and return it.

        Args:
            accepted: the reports that are right, each whole or only its first word.
            wait_ms: how long the host needs, beside the patience that each step has.
            due: the data that the report must hold at its end, to tell where others differ.
        """
        self._await_conductor(wait_ms)
        return self._reported(accepted, due)

    def outcomes(self, count: int, wait_ms: float = 0.0) -> list[Outcome]:
        """Wait for the report on so many calls that were made together; return the parts of it."""
        whole = self.outcome(wait_ms=wait_ms).whole
        parts = [Outcome.parse(part) for part in whole.split(" ; ")]
        if len(parts) != count:
            fail(f"the host reports `{whole}`; expected {count} outcomes")
        return parts

    def replied_with(self, code: int, payload: bytes) -> None:
        """Judge that the host reports a reply with this code and payload."""
        self.outcome(f"reply {code} {spell(payload)}", due=payload)

    @property
    def resting_seq(self) -> int:
        """The seq of the call for the next job, which waits."""
        if self._pending is None:
            self._await_conductor()
        assert self._pending is not None
        return self._pending.seq

    def do(self, text: str, *accepted: str) -> tuple[Outcome, list[Request]]:
        """Give a job, let the device answer every request; return the outcome and the requests."""
        self.job(text)
        seen = self.serve()
        return self._reported(accepted), seen

    def number(self, job: str) -> int:
        """Have the host report a number by a job of this name, and return it."""
        rest = self.do(job, job)[0].rest
        if not re.fullmatch("[0-9]{1,10}", rest):
            fail(f"the host reports `{job} {rest}`; expected `{job}` and a number")
        return int(rest)

    def serve(self) -> list[Request]:
        """Let the device answer every request until the host reports; return the requests."""
        seen: list[Request] = []
        while self._pending is None:
            if (request := self._next_request(0.0)) is not None:
                seen.append(request)
                self.reply(request, *self.device.answer(request.opcode, request.payload))
            if len(seen) > _MOST:
                fail(f"the host sent {_MOST} requests and does not stop")
        return seen

    def _reported(self, accepted: tuple[str, ...], due: bytes = b"") -> Outcome:
        assert self._pending is not None
        text = self._pending.payload.decode("utf-8", "replace")
        self.link.note(f"outcome: {text}")
        outcome = Outcome.parse(text)
        if outcome.word == "unsupported" and self._verb != "call":
            skip(f"the host program does not know the job {self._verb}")
        if accepted and not {outcome.text, outcome.word} & set(accepted):
            self.link.record("expected", text=" or ".join(accepted))
            where = explain(outcome.text.rpartition(" ")[2], due) if due else ""
            fail(
                f"the host reports `{text}`; expected {' or '.join(f'`{a}`' for a in accepted)}"
                + (f"; {where}" if where else "")
            )
        return outcome

    def _await_conductor(self, wait_ms: float = 0.0) -> None:
        """Wait for the report; what the host asks about the device is answered meanwhile."""
        while self._pending is None:
            if (request := self._next_request(wait_ms)) is not None:
                self._strange(request, "the report of the host")

    # Requests and what is sent to the host

    def request(self, opcode: int | None = None, payload: bytes | None = None) -> Request:
        """Wait for a request of the host, one about the device itself aside.

        Args:
            opcode: what it must call; None leaves it open.
            payload: what it must carry; None leaves it open.
        """
        request = self._next_request(0.0)
        if request is None:
            self._too_early()
        if opcode not in (None, request.opcode):
            self._strange(request, self._due(opcode, payload))
        if payload is not None and payload != request.payload:
            self._strange(
                request, self._due(opcode, payload), "; " + difference(request.payload, payload)
            )
        return request

    def request_or_end(self) -> Request | None:
        """Wait for a request of the host, or for its report; return None when that has come."""
        return self._next_request(0.0) if self._pending is None else None

    def requests(self, at_most: int, quiet_ms: float) -> list[Request]:
        """Return the requests that come until there are `at_most`, or none came for `quiet_ms`."""
        found: list[Request] = []
        quiet_s = quiet_ms / 1e3 * self.link.scale
        while len(found) < at_most and (arrival := self._next_arrival(quiet_s)) is not None:
            request = self._judge(arrival)
            if request is None:
                self._too_early()
            if self._asks_about_it(request):
                self._tell(request)
            else:
                found.append(request)
        return found

    def waiting(self, at_most: int, quiet_ms: float = _TOGETHER_MS) -> list[Request]:
        """Return the next request, which must come, and those behind it as `requests` does."""
        return [self.request(), *self.requests(at_most - 1, quiet_ms)]

    def asked(self, payload: bytes = b"", limit_ms: int = 0) -> Request:
        """Have the host call `ping` by its opcode, and return its request."""
        opcode = self.device.opcode(PING)
        self.job(f"call @{opcode} {payload.hex() or '-'} {limit_ms or self.limit_ms}")
        return self.request(opcode, payload)

    def early_request(self) -> int:
        """Return the seq of the next request as soon as it is known, before its other bytes."""
        deadline_s = self.link.now_s() + self._patience_s
        while True:
            if self.link.now_s() > deadline_s:
                fail("no request came")
            self.has_sent(0.001)
            for data in (self.link.unfinished(), *(held.raw for held in self._held)):
                match decode(data)[-1:]:
                    case [Incomplete(c.SOF, int(seq)) | Frame(c.SOF, seq)]:
                        return seq

    def has_sent(self, timeout_s: float) -> bool:
        """Tell whether something that was not looked at yet has come, at most after this time."""
        if not self._held and (arrival := self._next_arrival(timeout_s)) is not None:
            self._held.append(arrival)
        return bool(self._held)

    def reply(self, request: Request, code: int = c.RET_OK, payload: bytes = b"") -> None:
        """Send the reply to a request."""
        self.send(request.reply(code, payload))
        self.replied(request, code)

    def hold(self, requests: Iterable[Request]) -> None:
        """Expect that no call has a seq of these, which wait though later ones are answered."""
        self._seqs.held = frozenset(request.seq for request in requests)

    def replied(self, request: Request, code: int = c.RET_OK) -> None:
        """Note that a request was answered by other means than `reply`."""
        self._seqs.reply(request.seq, code in c.ERRORS)

    def sif(self, opcode: int, payload: bytes = b"", skipped: int = 0) -> bytes:
        """Return the wire bytes of the next SIF; `skipped` are missing before it."""
        self._sif_seq = (self._sif_seq + skipped) % 256
        return wire_of(c.SOS, self.next_sif_seq(), opcode, payload)

    def next_sif_seq(self) -> int:
        """Return the seq of the next SIF, which is sent by other means than `sif`."""
        seq, self._sif_seq = self._sif_seq, (self._sif_seq + 1) % 256
        return seq

    def reset_sifs(self, seq: int = 0) -> None:
        """Have the next SIF carry `seq`, 0 as after a reset."""
        self._sif_seq = seq

    def send(self, data: bytes) -> None:
        """Send any bytes in one piece."""
        self.link.send(data)

    def flood(self, what: str, data: bytes) -> None:
        """Send more bytes than evidence should hold, in one piece."""
        self.link.note(f"{what}: {len(data)} bytes")
        self.link.transport.write(data)

    def piecemeal(self, pieces: Iterable[bytes]) -> None:
        """Send pieces, with a pause behind each so that the host reads them one by one."""
        for piece in pieces:
            self.send(piece)
            time.sleep(_PAUSE_S)

    # What comes

    def _next_request(self, wait_ms: float) -> Request | None:
        """Return the next request that no standing answer is for, None when the host reports."""
        while True:
            arrival = self._next_arrival(self._patience_s + wait_ms / 1e3)
            if arrival is None:
                tail = self.link.unfinished()
                rest = f"; {tail.hex(' ')} has no end" if tail else ""
                fail(
                    f"nothing came from the host for {self._patience_s + wait_ms / 1e3:.1f} s{rest}"
                )
            request = self._judge(arrival)
            # Before its first call for a job a host may ask for what it likes.
            if request is None or (self._is_met and not self._asks_about_it(request)):
                return request
            self._tell(request)

    def _asks_about_it(self, request: Request) -> bool:
        asks = self.device.asks_about_it(request.opcode, request.payload)
        return asks and not request.is_barrier

    def _tell(self, request: Request) -> None:
        """Answer a request about the device."""
        self._told += 1
        if self._told > _MOST_TOLD:
            fail(
                f"the host sent {_MOST_TOLD} requests about the device and does not stop "
                "(J2A-LIMIT-008)"
            )
        is_many = c.MANY in self.device.names and request.opcode == self.device.opcode(c.MANY)
        if is_many and request.payload[1:2] not in (b"\x00", bytes((c.FLAG_LAST,))):
            flags = request.payload[1:2].hex()
            fail(f"the host reads the properties with the flags {flags} (J2A-MANY-009)")
        if not self.answers:
            return
        self.answers -= 1
        if self.slow_s:
            self.link.wait_until(self.link.now_s() + self.slow_s)
        code, payload = self.device.answer(request.opcode, request.payload)
        self.send(request.reply(code, payload) + (b"" if self.answers else self.behind()))
        self.replied(request, code)

    def _next_arrival(self, timeout_s: float) -> Arrival | None:
        if self._held:
            return self._held.pop(0)
        # Requests that the device answers each put off the end of a wait, so they need an end, too.
        if self.link.now_s() > self._ends_s:
            fail(f"the host goes on for {self._job_s:.0f} s, and does not report")
        try:
            arrival = self.link.next(timeout_s)
        except LinkLost as error:
            fail(self._place.ended(_LAST_WORDS_S) or f"the host closed the link: {error}")
        if self.link.sifs:
            del self.link.sifs[:]
            fail("the host sent a frame that starts with SOS (J2A-FRAME-002)")
        return arrival

    def _judge(self, arrival: Arrival) -> Request | None:
        """Return the request that came; None when it is the report of the host."""
        frame = arrival.event
        if not isinstance(frame, Frame):
            fail(f"the host sent {describe(frame)}")
        if arrival.raw != encode(frame):
            self.link.record("expected", encode(frame))
            where = difference(arrival.raw, encode(frame))
            fail(f"the frame of the host is not that of the oracle: {where} (J2A-STUFF-002)")
        is_barrier = self._seqs.none_is_free and (frame.opcode, frame.payload) == (0, b"")
        if is_barrier:
            self._seqs.barrier(frame.seq)
        elif wrong := self._seqs.request(frame.seq):
            fail(wrong)
        if frame.opcode == CONDUCTOR:
            if self._pending is not None:
                fail("the host called the conductor while it waited for a job")
            self._pending, self._is_met = frame, True
            return None
        return Request(frame.seq, frame.opcode, frame.payload, len(arrival.raw), is_barrier)

    # What is wrong

    def _too_early(self) -> NoReturn:
        text = self._reported(()).text
        fail(f"the host reports `{text}` where a request was due")

    def _strange(self, request: Request, due: str, where: str = "") -> NoReturn:
        event = Frame(c.SOF, request.seq, request.opcode, request.payload)
        self.link.record("expected", text=due)
        fail(f"{describe(event)} came where {due} was due{where}")

    @staticmethod
    def _due(opcode: int | None, payload: bytes | None) -> str:
        carried = "" if payload is None else f" and the payload {spell(payload)}"
        return f"a request with the opcode {opcode}{carried}"
