"""Sequence numbers: which the host uses, and which replies it takes (J2A-SEQ)."""

from dataclasses import replace

from j2a_spec import constants as c
from j2a_spec.oracle import Frame, encode
from j2a_spec.requirements import Level

from j2a_conformance._judge import fail, inform
from j2a_conformance.host._case import HostCase
from j2a_conformance.host._device import DEMO
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
    def learn_echo(host: Host) -> None:
        """Have the host call a2jEcho, so that it knows the opcode that barriers need."""
        host.do(f"call {c.GET_ECHO} - {host.limit_ms}", f"reply {c.ECHO} -")

    @staticmethod
    def stall(host: Host, late: int = 0) -> tuple[list[Request], Request | None]:
        """Leave 256 calls unanswered, and some more; return them, and the barrier if one comes.

        After 200 calls the one before number `late` is answered, so that as many seqs are free.
        """
        _Stalled.learn_echo(host)
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
        return given_up, barrier(host, _BARRIER_MS)

    @staticmethod
    def ended(host: Host) -> None:
        """Wait for the end of the calls; if a seq was free before, the last of them are sent."""
        while (request := host.request_or_end()) is not None:
            if (request.opcode, request.payload) != (6, b"s"):
                fail(f"opcode {request.opcode} came, which no job asked for")
        host.outcome("stalled", "timeout")


def barrier(host: Host, wait_ms: float) -> Request | None:
    """Return a barrier if one comes; while no seq is free nothing else may."""
    for request in host.requests(1, wait_ms):
        if not host.device.is_barrier(request.opcode, request.payload):
            fail(f"opcode {request.opcode} came while no seq was free (J2A-SEQ-006)")
        return request
    return None


class Stalled(_Stalled):
    """Leaves 256 calls without an answer and has the host make 20 more; sends the errors 0xF2, 0xF3
    and 0xF4 with each seq; answers the barrier by other bytes, by another code and by a SIF, and
    after more than 1 s by its nonce; and does the first part again.
    """

    ID = "host.seq.stalled"
    EXPECTATION = (
        "256 calls have 256 different seqs, one after the other; the others fail as `stalled`. "
        "Nothing but one barrier is sent until its nonce comes back."
    )
    REQUIREMENTS = ("J2A-SEQ-006", "J2A-SEQ-007", "J2A-SEQ-003", "J2A-TIME-006")

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
            nonce = found.payload
            host.send(found.reply(c.ECHO, bytes((nonce[0] ^ 1,)) + nonce[1:]))
            host.send(found.reply(c.ECHO, nonce[:-1]) + found.reply(c.ECHO, nonce + b"\x00"))
            host.send(found.reply(c.RET_OK, nonce) + found.reply(c.ERR_CHECKSUM, nonce))
            host.send(host.sif(c.ECHO, nonce) + found.reply(c.ECHO, b""))
            # The 1 s of a host is fixed by the protocol, whatever the scale of other times.
            other = barrier(host, BARRIER_AGAIN_MS / min(host.link.scale, 1.0))
            if other is not None:
                if host.link.now_s() - began_s < _REPLACED_S:
                    fail("a second barrier came before 1 s was over (J2A-SEQ-007)")
                if other.payload == nonce:
                    fail("a second barrier has the nonce of the first one (J2A-SEQ-007)")
                found = other
            host.send(found.reply(c.ECHO, found.payload))
            host.replied(found, is_echo=True)
            host.outcome("stalled")
            self._stall_again(host, {nonce, found.payload})
        for payload in (b"next", b"over"):
            host.reply(host.asked(payload), 1, payload)
            host.replied_with(1, payload)

    def _stall_again(self, host: Host, nonces: set[bytes]) -> None:
        given_up, found = self.stall(host)
        if found is None:
            host.reply(given_up[-1], 1, b"late")
        else:
            if found.payload in nonces:
                fail("a barrier has the nonce of an earlier one (J2A-SEQ-007)")
            host.send(found.reply(c.ECHO, found.payload))
            host.replied(found, is_echo=True)
        self.ended(host)


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
        self.learn_echo(host)
        # Only a host that waits on for the replies needs all of this time.
        host.job(f"repeat {_SEQS + 20} call @6 73 {max(host.silence_ms // 12, 1)}")
        for number in range(_SEQS):
            last = host.request(6, b"s")
            # Not by `host.reply`: it leaves all of these requests outstanding.
            host.send(last.reply(sorted(DAMAGE)[number % len(DAMAGE)], b"\x04\x00"))
        found = barrier(host, _BARRIER_MS)
        if found is None:
            host.reply(last, 1, b"late")
        else:
            host.send(found.reply(c.ECHO, found.payload))
            host.replied(found, is_echo=True)
        self.ended(host)
        host.reply(host.asked(b"next"), 1, b"next")
        host.replied_with(1, b"next")


class StalledTogether(_Stalled):
    """Refuses 255 calls that the host makes in two threads by the error 0xF3, and leaves the next
    one without an answer for a while; is a device without j2a.rxbuf, and one whose j2a.rxbuf is
    less than one of these requests.
    """

    ID = "host.seq.stalled-together"
    EXPECTATION = "Nothing is sent while the call waits, not even a barrier."
    REQUIREMENTS = ("J2A-LIMIT-003", "J2A-SEQ-006", "J2A-SEQ-007")

    def _run(self, host: Host) -> None:
        for known in ((), ((c.PROP_RXBUF, "10"),)):
            host.become(replace(DEMO, properties=((c.PROP_SPEC, c.SPEC_VERSION), *known)))
            self.learn_echo(host)
            calls = f"repeat {_SEQS} call @6 8*73 {host.limit_ms}"
            host.job(f"together {calls} ; {calls}")
            last = host.request(6, b"s" * 8)
            for _ in range(_SEQS - 1):
                # Not by `host.reply`: it leaves all of these requests outstanding.
                host.send(last.reply(c.ERR_CHECKSUM, b"\x04\x00"))
                if not host.has_sent(host.limit_ms / 3e3):
                    self._end(host, last)
                    inform("the host does not take an error reply for the end of a call")
                last = host.request(6, b"s" * 8)
            for request in host.requests(1, _BARRIER_MS):
                fail(f"opcode {request.opcode} came while a call waited (J2A-LIMIT-003)")
            self._end(host, last)

    @staticmethod
    def _end(host: Host, request: Request | None) -> None:
        while request is not None:
            host.reply(request, 1, b"end")
            request = host.request_or_end()
        host.outcome()


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
            host.send(found.reply(c.ECHO, found.payload))
            host.replied(found, is_echo=True)
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
