"""Which function is called, what it returns, and in which order (J2A-DISP)."""

import struct
from collections.abc import Iterator
from typing import Final

from j2a_spec import constants as c
from j2a_spec.oracle import Frame, checksum

from j2a_conformance._judge import fail, inform, skip
from j2a_conformance.device._case import Case
from j2a_conformance.device._peer import MANY_ONLY, Expected, Peer, Request, refusal
from j2a_conformance.wire._dimensions import damaged, payload_of, spread

from .sums import with_sum

_DELAY_MS = 40
_CLOCK = 0.8  # a device may run on an oscillator without a crystal
_HARMLESS: Final = (
    *(name for name in c.BUILTINS if name not in MANY_ONLY),
    *("getTime", "add", "ret", "sif", "overruns", "divide"),
)


class OneReply(Case):
    """Sends single requests of every kind and an echo behind each."""

    ID = "dispatch.one-reply"
    EXPECTATION = "Exactly one reply for each request."
    REQUIREMENTS = ("J2A-DISP-001",)
    LEVEL = "core"

    def _run(self, peer: Peer) -> None:
        requests = [peer.echo(b""), peer.echo(bytes(255)), peer.request(0, b"")]
        requests += [peer.request(o, b"x", c.ERR_OPCODE) for o in peer.out_of_range()[-1:]]
        if peer.has(c.MANY):
            requests += [peer.many(c.GET_ECHO_MANY), peer.request(peer.opcode(c.MANY), b"")]
        for request in requests:
            peer.play(request.wire, request.expected, alone=True)


class OwnReplies(Case):
    """Sends replies back as requests, byte by byte: echoes, refusals, the mapping, and what `ret`
    returns for the opcode of each function that may be called so, and for others.
    """

    ID = "dispatch.own-replies"
    EXPECTATION = "Each is answered like any other request: it is no echo of the line."
    REQUIREMENTS = ("J2A-DISP-001", "J2A-DISP-002", "J2A-SEQ-001")
    LEVEL = "core"

    def _run(self, peer: Peer) -> None:
        if peer.link.lossy:  # what is sent is made of what came
            inform("the link was declared lossy, so replies are not what they were")
        for n, request in enumerate(self._first(peer)):
            reply = peer.ask(request)
            own = self._own(peer, reply)
            if n % 3 == 0:
                peer.ask_all((request, own))
            else:
                peer.ask(own)
            peer.ask(own)
        peer.barrier()

    @staticmethod
    def _first(peer: Peer) -> Iterator[Request]:
        """Yield requests whose replies name no function, or one that takes anything."""
        for n in range(12):
            yield peer.echo(payload_of(n * 3, n), n * 29 % 256)
            yield from (peer.request(o, b"x", c.ERR_OPCODE) for o in peer.out_of_range()[-1:])
        if peer.claims.mapped:
            yield peer.request(0, b"", c.RET_OK)
        if peer.has(c.MANY):
            yield peer.request(peer.opcode(c.MANY), b"", c.RET_FAILED, b"")
        if peer.has("ret"):
            harmless = {peer.opcode(name) for name in _HARMLESS if peer.has(name)}
            last = [opcode for opcode in peer.out_of_range() if opcode <= c.RET_MAX]
            for n, value in enumerate(sorted({0, *harmless, *last[::29], *last[-1:]})):
                yield peer.request(peer.opcode("ret"), bytes((value,)), value, b"", n * 37 % 256)

    @staticmethod
    def _own(peer: Peer, reply: Frame) -> Request:
        """Return a reply as a request, and what is due for it."""
        opcode, payload, seq = reply.opcode, reply.payload, reply.seq
        code: int | None = None
        if opcode in peer.out_of_range() or (not opcode and not peer.claims.mapped):
            code = c.ERR_OPCODE
        elif not opcode:
            code = c.RET_OK
        elif opcode == peer.echo_opcode:
            return peer.echo(payload, seq)
        return peer.request(opcode, payload, code, seq=seq)


class InOrder(Case):
    """Sends requests in one piece, together not longer than j2a.rxbuf."""

    ID = "dispatch.in-order"
    EXPECTATION = "Their replies in the order of the requests."
    REQUIREMENTS = ("J2A-DISP-001", "J2A-LIMIT-001")
    LEVEL = "core"

    def _run(self, peer: Peer) -> None:
        room = peer.room(4096)
        requests: list[Request] = []
        while len((request := peer.echo(b"%d" % (len(requests) % 10))).wire) <= room:
            requests.append(request)
            room -= len(request.wire)
        if len(requests) < 2:
            skip("the device announces no j2a.rxbuf that holds two requests")
        # At most 200 at a time, so that no seq stands for two requests.
        for first in range(0, len(requests), 200):
            part = requests[first : first + 200]
            peer.play(b"".join(r.wire for r in part), *(r.expected for r in part))


class ErrorsInOrder(Case):
    """Sends good requests of many lengths with broken ones between them in one piece: cut by a
    start byte, with ESC 0xFF in them, with a wrong checksum or with an opcode out of range.
    """

    ID = "dispatch.errors-in-order"
    EXPECTATION = "Each error reply between the echoes before and behind the broken request."
    REQUIREMENTS = ("J2A-DISP-001", "J2A-ERR-012")
    LEVEL = "core"

    def _run(self, peer: Peer) -> None:
        room = peer.room(1024)
        if room < 40:
            skip("the device announces no j2a.rxbuf that holds three requests")
        exchanges: list[tuple[bytes, list[Expected]]] = []
        for n in range(48):
            first, last = peer.echo(payload_of(n % 5, n)), peer.probe()
            code, broken = self._broken(peer, n)
            seq = broken.seq
            stream = first.wire + broken.wire + last.wire
            if len(stream) <= room:
                due = [first.expected, refusal(seq, code), last.expected]
                exchanges.append((stream, due))
        peer.play_all(exchanges)

    @staticmethod
    def _broken(peer: Peer, n: int) -> tuple[int, Request]:
        """Return a broken request and the expected error."""
        seq, opcode, data = peer.seq(), peer.echo_opcode, payload_of(n % 23, n)
        wrong = with_sum(seq, opcode, data, checksum(seq, opcode, data) ^ 1 << n // 4 % 8)
        free = peer.out_of_range()
        if n % 4 == 0 and free:
            request = peer.request(free[n % len(free)], data, seq=seq)
            return c.ERR_OPCODE, request
        code, wire = (
            (c.ERR_CHECKSUM, wrong),
            (c.ERR_CHECKSUM, wrong),
            (c.ERR_FRAMING, wrong[: 3 + n % 3]),
            (c.ERR_FRAMING, wrong[:4] + b"\x7d\xff"),
        )[n % 4]
        return code, Request(wire, refusal(seq, code))


class AtIndex(Case):
    """Calls the functions whose behaviour is known, each at its index in the mapping."""

    ID = "dispatch.at-index"
    EXPECTATION = "Each behaves as its name says."
    REQUIREMENTS = ("J2A-SEQ-001", "J2A-DISP-002", "J2A-DISP-003", "J2A-MAP-001")
    LEVEL = "core"

    def _run(self, peer: Peer) -> None:
        peer.ask(peer.echo(b"at its index"))
        if peer.has(c.MANY):
            peer.ask_many(peer.many(c.GET_ECHO_MANY))
        if peer.has("add"):
            for a, b in ((2, 3), (-5, 4), (2**31 - 1, 1), (-(2**31), -1), (0x12ED7D, -0x7D)):
                total = (a + b + 2**31) % 2**32 - 2**31
                answer = struct.pack("<i", total)
                payload = struct.pack("<ii", a, b)
                peer.ask(peer.request(peer.opcode("add"), payload, c.RET_OK, answer))
            peer.ask(peer.request(peer.opcode("add"), b"short", c.RET_FAILED, b""))
        if peer.has("getTime"):
            times = [peer.call("getTime") for _ in range(2)]
            if any(t.opcode != c.RET_OK or len(t.payload) != 8 for t in times):
                fail("`getTime` does not return 0x00 and 8 bytes")
            if times[1].payload[::-1] < times[0].payload[::-1]:
                fail("`getTime` goes backwards")
        if peer.has("delay"):
            before_s = peer.link.now_s()
            payload = struct.pack("<H", _DELAY_MS)
            peer.ask(peer.request(peer.opcode("delay"), payload, c.RET_OK, b""))
            if peer.link.now_s() - before_s < _DELAY_MS / 1e3 * _CLOCK:
                fail(f"`delay` did not take the {_DELAY_MS} ms that it was asked for")
        if peer.has("overruns"):
            reply = peer.call("overruns")
            if reply.opcode != c.RET_OK or len(reply.payload) != 2:
                fail("`overruns` does not return 0x00 and 2 bytes")


class ReturnValues(Case):
    """Has a function return each value from 0x00 to 0xEF."""

    ID = "dispatch.return-values"
    EXPECTATION = "The value is the opcode field of the reply."
    REQUIREMENTS = ("J2A-DISP-003", "J2A-SEQ-001", "J2A-FRAME-002")
    LEVEL = "core"
    NEEDS = ("ret",)

    def _run(self, peer: Peer) -> None:
        opcode = peer.opcode("ret")
        peer.ask(*(peer.request(opcode, bytes((v,)), v, b"") for v in range(c.RET_MAX + 1)))


class ReservedValues(Case):
    """Has a function return each value from 0xFE down to 0xF0, and 0xFF; again behind what is
    refused in each way, and behind what is not.
    """

    ID = "dispatch.reserved-values"
    EXPECTATION = "0xFF in each reply, so that no function can imitate an error of the protocol."
    REQUIREMENTS = ("J2A-SEQ-001", "J2A-FRAME-002", "J2A-DISP-004", "J2A-ERR-011")
    LEVEL = "core"
    NEEDS = ("ret",)

    def _run(self, peer: Peer) -> None:
        opcode = peer.opcode("ret")
        for value in (*range(c.RET_FAILED - 1, c.RET_MAX, -1), c.RET_FAILED):
            peer.ask(peer.request(opcode, bytes((value,)), c.RET_FAILED, b""))
        peer.ask(peer.request(opcode, b"", c.RET_FAILED, b""))
        values = range(c.RET_MAX + 1, c.RET_FAILED + 1)
        for n, (stream, due) in enumerate(self._ahead(peer)):
            first = n * 5 % len(values)
            requests = [
                peer.request(opcode, bytes((value,)), c.RET_FAILED, b"")
                for value in (*values[first:], *values[:first])
            ]
            peer.play(stream, *due)
            peer.ask(*requests)  # one by one: a port that polls receives little meanwhile

    @staticmethod
    def _ahead(peer: Peer) -> Iterator[tuple[bytes, list[Expected]]]:
        """Yield exchanges that end in different ways."""
        requests = [peer.echo(b""), peer.request(0), peer.request(peer.opcode("ret"), b"\x01", 1)]
        requests += [peer.request(o, b"x", c.ERR_OPCODE) for o in peer.out_of_range()[-1:]]
        requests += [peer.direct(name) for name in sorted(MANY_ONLY) if peer.has(name)]
        if peer.longest < c.MAX_PAYLOAD:
            requests.append(peer.echo(bytes(peer.longest + 1)))
        if peer.has(c.MANY):
            funcs = {0, peer.opcode("ret"), peer.opcode(c.MANY), *peer.out_of_range()[-1:]}
            requests += [peer.many(func, code=c.ERR_OPCODE) for func in sorted(funcs)]
            requests += [peer.many(c.GET_ECHO_MANY), peer.request(peer.opcode(c.MANY), b"")]
        yield from ((request.wire, [request.expected]) for request in requests)
        wrong, seq = damaged(peer.echo_opcode, 3)
        yield wrong, [refusal(seq, c.ERR_CHECKSUM)]
        yield wrong[:-1] + b"\x7d\xff", [refusal(seq, c.ERR_FRAMING)]


class OpcodeZero(Case):
    """Calls opcode 0, without a payload and with payloads of several lengths."""

    ID = "dispatch.opcode-0"
    EXPECTATION = "The mapping with the code 0x00, or error 0xF0 where it is built out; always so."
    REQUIREMENTS = ("J2A-DISP-005",)
    LEVEL = "core"

    def _run(self, peer: Peer) -> None:
        code = c.RET_OK if peer.claims.mapped else c.ERR_OPCODE
        replies = [peer.ask(peer.request(0, b"", code)).payload for _ in range(3)]
        if len(set(replies)) > 1:
            fail("opcode 0 does not return the same thing each time")
        if not peer.claims.mapped:  # else it is mapping.request-payload
            payloads = (payload_of(length, n) for n, length in enumerate(spread(step=61)))
            peer.ask_all(peer.request(0, payload, code) for payload in payloads)
        if peer.claims.mapped and not replies[0].startswith(f"{c.GET_MAPPING}\0".encode()):
            fail("opcode 0 returned the mapping before, and does not any more")


class TableOrder(Case):
    """Compares the order of the function table with the specification."""

    ID = "dispatch.table-order"
    EXPECTATION = (
        "a2jGetMapping, then a2jMany, a2jGetProperties and a2jDebug if built in, a2jEcho, "
        "a2jEchoMany if a2jMany is built in, then the functions of the application."
    )
    REQUIREMENTS = ("J2A-DISP-009", "J2A-DISP-002")
    LEVEL = "core"

    def _run(self, peer: Peer) -> None:
        names = peer.claims.functions
        wanted = tuple(n for n in c.KNOWN_BUILTINS if n in names)
        if names[: len(wanted)] != wanted:
            peer.link.record("expected", text=", ".join(wanted))
            fail(f"the table begins with {', '.join(names[: len(wanted)])}")
        peer.ask(peer.request(names.index(c.GET_ECHO), b"order", c.ECHO, b"order"))
