"""Sequence numbers: which the host uses, and which replies it takes (J2A-SEQ)."""

from dataclasses import replace

from j2a_spec import constants as c
from j2a_spec.oracle import Frame, encode
from j2a_spec.requirements import Level

from j2a_conformance._judge import fail, inform
from j2a_conformance.host._case import HostCase
from j2a_conformance.host._device import DEMO, ROOMY
from j2a_conformance.host._dimensions import content, frame
from j2a_conformance.host._host import Host
from j2a_conformance.host._outcomes import Request
from j2a_conformance.wire._expected import DAMAGE

_SEQS = 256
_EARLY = 200
_FREED = 10
_BARRIER_MS = 200.0
_REPLACED_S = 0.5  # of 1 s; a busy machine may take the first barrier late
BARRIER_AGAIN_MS = 1300.0


def stray(seq: int, payload: bytes = b"stray", start: int = c.SOF) -> bytes:
    """Return a frame with the code 0x11 that answers no request."""
    return encode(Frame(start, seq % 256, 0x11, payload))


class Next(HostCase):
    """Ends calls in every way: by replies, by error replies, by a function that fails, and without
    an answer.
    """

    ID = "host.seq.next"
    EXPECTATION = "Each attempt has the next seq, whatever became of the one before."
    REQUIREMENTS = ("J2A-SEQ-003",)
    LEVEL = "core"

    def _run(self, host: Host) -> None:
        for code in (0, *sorted(c.ERRORS), c.RET_FAILED, 0x11):
            host.reply(host.asked(), code, b"\x01\x00")
            host.outcome("reply", "error")
        host.asked(limit_ms=host.silence_ms)
        host.outcome("timeout", wait_ms=host.silence_ms)
        for code in (c.ERR_CHECKSUM, 0):
            host.reply(host.asked(), code, b"\x01\x00")
            host.outcome("reply", "error")


class Silence(HostCase):
    """Leaves six calls in a row without an answer."""

    ID = "host.seq.silence"
    EXPECTATION = "Each has a new seq, the next one."
    REQUIREMENTS = ("J2A-SEQ-003", "J2A-TIME-006")
    LEVEL = "core"

    def _run(self, host: Host) -> None:
        count, limit_ms = 6, host.silence_ms // 4
        host.job(f"repeat {count} call @6 73 {limit_ms}")
        for _ in range(count):
            host.request(6, b"s")
        host.outcome("timeout", wait_ms=limit_ms)


class _Stalled(HostCase):
    """A device that leaves so many calls without an answer that no seq is free."""

    LEVEL: Level = "core"

    @staticmethod
    def stall(host: Host, late: int = 0) -> tuple[list[Request], Request | None]:
        """Leave 256 calls unanswered, and some more; return them, and the barrier if one comes.

        After 200 calls the one before number `late` is answered, so that as many seqs are free.
        """
        limit_ms = max(host.silence_ms // 60, 1)
        host.job(f"repeat {_SEQS + 20} call @6 73 {limit_ms}")
        given_up = [host.request(6, b"s") for _ in range(_EARLY)]
        if late:
            host.reply(given_up[late - 1], 5, b"sifs all 0 0")
        while len(given_up) < _SEQS + late:
            some = host.requests(1, _BARRIER_MS)
            if late and not (some and some[0].opcode == 6):  # the reply came too late for the host
                return given_up, some[0] if some else None
            given_up += some or [host.request(6, b"s")]
        return given_up, barrier(host, given_up[-1], _BARRIER_MS)

    @staticmethod
    def ended(host: Host) -> None:
        """Wait for the end of the calls; if a seq was free before, the last of them are sent."""
        while (request := host.request_or_end()) is not None:
            if (request.opcode, request.payload) != (6, b"s"):
                fail(f"opcode {request.opcode} came, which no job asked for")
        host.outcome("stalled", "timeout")


def barrier(host: Host, newest: Request, wait_ms: float) -> Request | None:
    """Return a barrier if one comes; while no seq is free nothing else may.

    Args:
        host: the host.
        newest: the newest request whose call has ended.
        wait_ms: how long one may take.
    """
    for request in host.requests(1, wait_ms):
        if not request.is_barrier:
            fail(f"opcode {request.opcode} came while no seq was free (J2A-SEQ-006)")
        if request.seq != newest.seq:
            fail(f"the barrier has seq 0x{request.seq:02X}, that of the newest request whose call "
                 f"has ended is 0x{newest.seq:02X} (J2A-SEQ-009)")  # fmt: skip
        return request
    return None


class Stalled(_Stalled):
    """Leaves 256 calls without an answer and has the host make 20 more; sends the errors 0xF2, 0xF3
    and 0xF4 with each seq, and a SIF with that of the barrier; answers the barrier after more than
    1 s, and does the first part again.
    """

    ID = "host.seq.stalled"
    EXPECTATION = (
        "256 calls have 256 different seqs, one after the other; the others fail as `stalled`. "
        "Nothing but one barrier in a second is sent until a reply comes."
    )
    REQUIREMENTS = ("J2A-SEQ-006", "J2A-SEQ-009", "J2A-SEQ-003", "J2A-TIME-006")

    def _run(self, host: Host) -> None:
        given_up, found = self.stall(host)
        began_s = host.link.now_s()
        errors = [
            frame(c.SOF, one.seq, code, b"\x01\x00") for one in given_up for code in sorted(DAMAGE)
        ]
        host.flood("error replies with each seq", b"".join(errors))
        if found is None:  # a host may do without barriers
            host.reply(given_up[-1], 1, b"late")
            host.outcome("stalled")
        else:
            host.send(stray(found.seq, b"SIF", c.SOS))
            host.reset_sifs(found.seq + 1)
            # The 1 s of a host is fixed by the protocol, whatever the scale of other times.
            other = barrier(host, given_up[-1], BARRIER_AGAIN_MS / min(host.link.scale, 1.0))
            if other is not None and host.link.now_s() - began_s < _REPLACED_S:
                fail("a second barrier came before 1 s was over (J2A-SEQ-009)")
            host.reply(found, *host.device.answer(0, b""))
            host.outcome("stalled")
        self._stall_again(host)
        for payload in (b"next", b"over"):
            host.reply(host.asked(payload), 1, payload)
            host.replied_with(1, payload)

    def _stall_again(self, host: Host) -> None:
        given_up, found = self.stall(host)
        if found is None:
            host.reply(given_up[-1], 1, b"late")
        else:
            host.reply(found, c.ERR_OPCODE, b"\x01\x00")  # a device without a function map
        self.ended(host)


class StalledTwice(_Stalled):
    """Leaves 256 calls without an answer, and sends two replies with the seq of the barrier, the
    second one while the first of 300 more calls waits, which it leaves without an answer, too.
    """

    ID = "host.seq.stalled-twice"
    EXPECTATION = (
        "Neither reply answers another call, and none of the 255 calls that are sent then has the "
        "seq of the barrier. The next barrier has the seq of the last of them."
    )
    REQUIREMENTS = ("J2A-SEQ-009", "J2A-SEQ-005", "J2A-SEQ-003")

    def _run(self, host: Host) -> None:
        # A SIF ends each half: between them no call for a job is answered, which would free all.
        calls = f"repeat {_SEQS + 44} call @6 73 {max(host.silence_ms // 10, 1)}"
        host.job(f"repeat 2 together {calls} ; sifs all 1 {20 * host.limit_ms}")
        given_up = [host.request(6, b"s") for _ in range(_SEQS)]
        found = barrier(host, given_up[-1], _BARRIER_MS)
        if found is None:
            host.reply(given_up[-1], 1, b"late")
        else:
            host.reply(found, 5, b"sifs all 0 0")
        # What was left of the first half may be sent now; only a stall ends both.
        host.send(host.sif(0x30))
        given_up = []
        while not (given_up and given_up[-1].is_barrier):
            some = host.requests(1, _BARRIER_MS if found is None else host.limit_ms)
            if not some:
                break
            if found is not None and not given_up:
                host.reply(found, *host.device.answer(0, b""))
            given_up += some
        if found is not None:
            *sent, again = given_up
            if len(sent) != _SEQS - 1 or not again.is_barrier:
                fail(f"{len(sent)} calls were sent after the barrier, 255 were due (J2A-SEQ-003)")
            if again.seq != sent[-1].seq:
                fail("the next barrier does not have the newest seq (J2A-SEQ-009)")
        host.reply(given_up[-1], c.RET_OK, b"late")
        host.send(host.sif(0x30))
        while host.request_or_end() is not None:
            pass
        outcome = host.outcome().whole.partition(" ; ")[0]
        if outcome not in ("stalled", "timeout maybe-executed", "timeout"):
            fail(f"the host reports `{outcome}` of a call that got no reply (J2A-SEQ-005)")


class StalledRefused(_Stalled):
    """Refuses 256 calls by the errors 0xF2, 0xF3 and 0xF4, in turn, and has the host make 20 more;
    answers the barrier, or the last call where none comes.
    """

    ID = "host.seq.stalled-refused"
    EXPECTATION = (
        "256 calls have 256 different seqs, for the seq of an error reply may be wrong; the others "
        "fail as `stalled`, and nothing but a barrier is sent."
    )
    REQUIREMENTS = ("J2A-SEQ-006", "J2A-SEQ-003")

    def _run(self, host: Host) -> None:
        # Only a host that waits on for the replies needs all of this time.
        host.job(f"repeat {_SEQS + 20} call @6 73 {max(host.silence_ms // 12, 1)}")
        for number in range(_SEQS):
            last = host.request(6, b"s")
            # Not by `host.reply`: it leaves all of these requests outstanding.
            host.send(last.reply(sorted(DAMAGE)[number % len(DAMAGE)], b"\x04\x00"))
        host.reply(barrier(host, last, _BARRIER_MS) or last, 1, b"late")
        self.ended(host)
        host.reply(host.asked(b"next"), 1, b"next")
        host.replied_with(1, b"next")


class StalledTogether(_Stalled):
    """Refuses 255 calls that the host makes in two threads by the error 0xF3, and leaves the next
    one without an answer for a while; is a device without j2a.rxbuf, one whose j2a.rxbuf is less
    than one of these requests, one where it is more, but less than a barrier beside it, and one
    with room for both. Where a barrier comes, answers the last of the 255 calls before.
    """

    ID = "host.seq.stalled-together"
    EXPECTATION = (
        "While the call waits, those of the other thread fail, and nothing is sent but a barrier, "
        "this only if j2a.rxbuf has room for both."
    )
    REQUIREMENTS = ("J2A-LIMIT-003", "J2A-SEQ-006", "J2A-SEQ-009")

    def _run(self, host: Host) -> None:
        for rxbuf in ("", "10", "17", "24"):
            known = ((c.PROP_RXBUF, rxbuf),) if rxbuf else ()
            host.become(replace(DEMO, properties=((c.PROP_SPEC, c.SPEC_VERSION), *known)))
            calls = [f"repeat {_SEQS} call @6 8*{one} {host.limit_ms}" for one in ("73", "74")]
            host.job(" ; ".join([f"together {calls[0]}", calls[1]]))
            sent = [host.request(6)]
            for _ in range(_SEQS - 1):
                # Not by `host.reply`: it leaves all of these requests outstanding.
                host.send(sent[-1].reply(c.ERR_CHECKSUM, b"\x04\x00"))
                if not host.has_sent(host.limit_ms / 3e3):
                    self._end(host, sent)
                    inform("the host does not take an error reply for the end of a call")
                sent.append(host.request(6))
            last = sent[-1]
            found = barrier(host, sent[-2], _BARRIER_MS)
            if found is not None:
                if last.size + found.size > host.device.rxbuf:
                    fail("a barrier came while a call waited, for which j2a.rxbuf has no room "
                         "(J2A-LIMIT-003)")  # fmt: skip
                host.reply(found, 1, b"late")
            began = {one.payload for one in sent}
            self._end(host, sent)
            others = [one.payload for one in sent if one.payload != last.payload]
            if len(began) == 2 and len(others) == _SEQS:
                fail("no call failed while another one waited and no seq was free", suspect=True)

    @staticmethod
    def _end(host: Host, sent: list[Request]) -> None:
        """Answer the last request, and all that come then, which are added to those before."""
        request: Request | None = sent[-1]
        while request is not None:
            host.reply(request, 1, b"end")
            if (request := host.request_or_end()) is not None:
                sent.append(request)
        host.outcome()


class StalledWaiting(_Stalled):
    """Leaves 256 calls without an answer, two of the first of which go on waiting, and has the host
    make 20 more; then answers these two, and what comes behind them.
    """

    ID = "host.seq.stalled-waiting"
    EXPECTATION = "No request has the seq of a call that waits; both get their replies."
    REQUIREMENTS = ("J2A-SEQ-006", "J2A-SEQ-003", "J2A-SEQ-009")

    def _run(self, host: Host) -> None:
        host.become(ROOMY)
        brief_ms = max(host.silence_ms // 60, 1)
        calls = [f"call @6 {data} {20 * host.limit_ms}" for data in ("fe", "ff")]
        calls.append(f"repeat {_SEQS + 20} call @6 73 {brief_ms}")
        host.job("together " + " ; ".join(calls))
        sent = host.requests(3, _BARRIER_MS)
        is_together = len(sent) == 3
        while is_together and len(sent) < _SEQS:
            sent += host.requests(1, _BARRIER_MS) or [host.request(6)]
        if is_together:
            barrier(host, sent[-1], _BARRIER_MS)
        for request in [one for one in sent if one.payload != b"s"]:
            host.reply(request, 1, request.payload)
        while (next_ := host.request_or_end()) is not None:
            host.reply(next_, 1, next_.payload)
        waited = [outcome.whole for outcome in host.outcomes(3)[:2]]
        if waited != ["reply 1 fe", "reply 1 ff"]:
            fail(f"the host reports {waited} of the calls that waited (J2A-SEQ-004)")
        if not is_together:
            inform("the host makes one call at a time")


class Skipped(_Stalled):
    """Leaves two calls without an answer that have been sent one after the other, and answers 300
    others meanwhile.
    """

    ID = "host.seq.skipped"
    EXPECTATION = "None of these has the seq of a call that waits."
    REQUIREMENTS = ("J2A-SEQ-003",)

    def _run(self, host: Host) -> None:
        host.become(ROOMY)
        calls = [f"call @6 {data} {20 * host.limit_ms}" for data in ("fe", "ff")]
        calls.append(f"repeat 300 call @6 73 {host.limit_ms}")
        host.job("together " + " ; ".join(calls))
        first = host.waiting(3)
        held = [one for one in first if one.payload != b"s"]
        if is_together := len(first) == 3:
            host.hold(held)
            host.reply(next(one for one in first if one not in held), 1, b"s")
            for _ in range(299):
                request = host.request(6, b"s")
                if request.seq in {one.seq for one in held}:
                    fail(f"a call has the seq 0x{request.seq:02X} of one that waits")
                host.reply(request, 1, b"s")
            host.hold(())
        for request in held:
            host.reply(request, 1, b"held")
        while (late := host.request_or_end()) is not None:
            host.reply(late, 1, late.payload)
        host.outcomes(3)
        if not is_together:
            inform("the host does not make three calls at once")


class StalledLate(_Stalled):
    """Leaves calls without an answer until no seq is free, but for the tenth, which it answers when
    it has 200; then answers all after that, and the barrier at last.
    """

    ID = "host.seq.stalled-late"
    EXPECTATION = "No late reply answers another call; calls go on as soon as a seq is free."
    REQUIREMENTS = ("J2A-SEQ-006", "J2A-SEQ-005", "J2A-SEQ-003")

    def _run(self, host: Host) -> None:
        given_up, found = self.stall(host, _FREED)
        # Not those before the tenth: a device answers in order, and their seqs are in use again.
        for late in given_up[_FREED:100]:
            host.reply(late, 5, b"sifs all 0 0")  # a host that takes it for a job reports
        self.ended(host)
        for late in given_up[100:]:
            host.reply(late, 5, b"sifs all 0 0")
        if found is not None:
            host.reply(found, *host.device.answer(0, b""))
        for payload in (b"next", b"over"):
            host.reply(host.asked(payload), 1, payload)
            host.replied_with(1, payload)


class Others(HostCase):
    """Sends replies with each of the 255 other seqs before the reply, of every length and with
    every code, those that differ in one bit of the seq with more.
    """

    ID = "host.seq.others"
    EXPECTATION = "They are dropped, and the reply with the seq of the call is taken."
    REQUIREMENTS = ("J2A-SEQ-004", "J2A-SEQ-005")
    LEVEL = "core"

    def _run(self, host: Host) -> None:
        request = host.asked(limit_ms=10 * host.limit_ms)
        others = [stray(request.seq + n) for n in range(1, 256)]
        for n in range(1, 256):
            for seq in (request.seq + n, request.seq ^ (1 << n % 8), request.seq ^ 0x80):
                others.append(frame(c.SOF, seq % 256, n - 1, content(n, 1)))
                others.append(frame(c.SOF, seq % 256, n * 7 % 256, content(n * 5 % 256, 2)))
        host.flood("replies with other seqs", b"".join(others))
        host.reply(request, 2, b"mine")
        host.replied_with(2, b"mine")


class OnlyOthers(HostCase):
    """Sends replies with other seqs, and none to the call."""

    ID = "host.seq.only-others"
    EXPECTATION = "The call ends by its time limit."
    REQUIREMENTS = ("J2A-SEQ-004", "J2A-SEQ-005", "J2A-TIME-006")
    LEVEL = "core"

    def _run(self, host: Host) -> None:
        request = host.asked(limit_ms=host.silence_ms)
        for n in (1, 2, 128, 254, 255):
            host.send(stray(request.seq + n))
        host.outcome("timeout", wait_ms=host.silence_ms)


class Sos(HostCase):
    """Sends a SIF that carries the seq of the call and looks like its reply."""

    ID = "host.seq.sif-is-no-reply"
    EXPECTATION = "Only a frame that starts with SOF is a reply."
    REQUIREMENTS = ("J2A-SEQ-004", "J2A-SIF-003")
    LEVEL = "core"

    def _run(self, host: Host) -> None:
        request = host.asked()
        host.send(stray(request.seq, b"SIF", c.SOS))
        host.reply(request, 2, b"reply")
        host.replied_with(2, b"reply")
        host.reset_sifs(request.seq + 1)


class Late(HostCase):
    """Answers a call only after its time limit, while the next call waits."""

    ID = "host.seq.late"
    EXPECTATION = "The late reply is dropped; the next call gets its own."
    REQUIREMENTS = ("J2A-SEQ-005", "J2A-SEQ-004", "J2A-TIME-006")
    LEVEL = "core"

    def _run(self, host: Host) -> None:
        for payload in (b"late", b""):
            late = host.asked(b"one", limit_ms=host.silence_ms)
            host.outcome("timeout", wait_ms=host.silence_ms)
            request = host.asked(b"two")
            host.send(late.reply(5, payload))
            host.reply(request, 6, b"own")
            host.replied_with(6, b"own")


class LateAtRest(HostCase):
    """Answers a call only after its time limit, while no other call but that for the next job
    waits.
    """

    ID = "host.seq.late-at-rest"
    EXPECTATION = "The late reply is dropped, and the next call gets its own."
    REQUIREMENTS = ("J2A-SEQ-005",)
    LEVEL = "core"

    def _run(self, host: Host) -> None:
        late = host.asked(b"one", limit_ms=host.silence_ms)
        host.outcome("timeout", wait_ms=host.silence_ms)
        host.send(late.reply(5, b"sifs all 0 0"))  # a host that takes it for a job reports
        host.reply(host.asked(b"two"), 6, b"own")
        host.replied_with(6, b"own")


class LateError(HostCase):
    """Sends an error reply to a call that has ended, while the next call waits."""

    ID = "host.seq.late-error"
    EXPECTATION = "It is dropped; the next call gets its own reply."
    REQUIREMENTS = ("J2A-SEQ-005", "J2A-SEQ-004")
    LEVEL = "core"

    def _run(self, host: Host) -> None:
        late = host.asked(b"one", limit_ms=host.silence_ms)
        host.outcome("timeout", wait_ms=host.silence_ms)
        request = host.asked(b"two")
        host.send(late.reply(c.ERR_TIMEOUT, b"\x03\x00"))
        host.reply(request, 6, b"own")
        host.replied_with(6, b"own")


class Twice(HostCase):
    """Sends a reply twice, the second time while the next call waits, and both at once."""

    ID = "host.seq.twice"
    EXPECTATION = "The repeated reply is dropped."
    REQUIREMENTS = ("J2A-SEQ-005", "J2A-SEQ-004")
    LEVEL = "core"

    def _run(self, host: Host) -> None:
        first = host.asked(b"one")
        host.reply(first, 5, b"once")
        host.replied_with(5, b"once")
        request = host.asked(b"two")
        host.send(first.reply(5, b"twice"))
        host.reply(request, 6, b"own")
        host.replied_with(6, b"own")
        request = host.asked(b"three")
        host.send(2 * request.reply(7, b"three"))
        host.replied(request)
        host.replied_with(7, b"three")


class Unasked(HostCase):
    """Sends replies that nobody asked for, with the seqs of the calls to come, while only the call
    for the next job waits.
    """

    ID = "host.seq.unasked"
    EXPECTATION = "They are dropped, and each call gets its own reply."
    REQUIREMENTS = ("J2A-SEQ-005",)
    LEVEL = "core"

    def _run(self, host: Host) -> None:
        host.send(b"".join(stray(host.resting_seq + n) for n in range(1, 256)))
        for payload in (b"one", b"two", b"three"):
            host.reply(host.asked(payload), 6, payload)
            host.replied_with(6, payload)
