"""Sequence numbers (J2A-SEQ)."""

import random
from collections.abc import Callable, Iterator
from itertools import product
from typing import Final

from j2a_spec import constants as c

from j2a_conformance._judge import fail, skip
from j2a_conformance.device._case import Case
from j2a_conformance.device._peer import Peer, Request, many_payload
from j2a_conformance.wire._dimensions import payload_of, spread

from .sif import compare

_SEQ: Final = 0x41
_QUICK_BYTE_S: Final = 0.0005  # at which each kind behind each other takes a second or two
_Kind = Callable[[int], Request]


class Every(Case):
    """Sends a request with each seq from 0 to 255, up, down and shuffled."""

    ID = "seq.every-value"
    EXPECTATION = "Each reply carries the seq of its request."
    REQUIREMENTS = ("J2A-SEQ-001", "J2A-SEQ-008", "J2A-DISP-001", "J2A-STUFF-005")
    LEVEL = "core"

    def _run(self, peer: Peer) -> None:
        shuffled = random.Random(3).sample(range(256), 256)
        for order in (range(256), range(255, -1, -1), shuffled):
            peer.ask_all(peer.echo(payload_of(seq % 9, seq), seq=seq) for seq in order)


class Repeated(Case):
    """Sends requests with one and the same seq, different ones and identical ones; also long ones,
    one behind the other.
    """

    ID = "seq.repeated"
    EXPECTATION = "Each is executed and answered."
    REQUIREMENTS = ("J2A-SEQ-008", "J2A-DISP-001")
    LEVEL = "core"

    def _run(self, peer: Peer) -> None:
        for seq in (0x00, 0x41, 0xFF):
            peer.ask(*(peer.echo(bytes((n,)), seq=seq) for n in range(5)))
            peer.ask(*(peer.echo(b"same", seq=seq) for _ in range(5)))
        peer.ask_all(
            peer.echo(payload_of(length, n), seq=n * 13 % 256)
            for n, length in enumerate(spread(step=31))
            for _ in range(2)
        )


class RepeatedEffect(Case):
    """Sends the same request to `sif` three times, byte by byte identical."""

    ID = "seq.repeated-effect"
    EXPECTATION = "Three SIFs and three replies: a repeated request is executed again."
    REQUIREMENTS = ("J2A-SEQ-008",)
    LEVEL = "core"
    NEEDS = ("sif",)

    def _run(self, peer: Peer) -> None:
        peer.carried(lambda: self._thrice(peer))

    @staticmethod
    def _thrice(peer: Peer) -> None:
        before = len(peer.link.sifs)
        request = peer.request(peer.opcode("sif"), b"\x34again", c.RET_OK)
        peer.ask(request, request, request)
        for _ in range(3):
            before = 1 + compare(peer, before, 0x34, b"again")


class OneForAll(Case):
    """Sends requests of every kind with one and the same seq: each behind itself and behind each
    other one, with other data each time; on a slow link behind itself and one other.
    """

    ID = "seq.one-for-all"
    EXPECTATION = "Each is executed and answered as behind any other seq."
    REQUIREMENTS = ("J2A-SEQ-008", "J2A-SEQ-001", "J2A-DISP-001")
    LEVEL = "core"

    def _run(self, peer: Peer) -> None:
        kinds = list(_kinds(peer))
        is_quick = peer.link.byte_s < _QUICK_BYTE_S and not peer.link.lossy
        behind = range(len(kinds)) if is_quick else range(2)
        requests = (
            kind(n + k)
            for n, shift in product(range(len(kinds)), behind)
            for k, kind in enumerate((kinds[n], kinds[(n + shift) % len(kinds)]))
        )
        peer.ask(*requests)  # one by one: a port that polls receives little while a function runs


def _kinds(peer: Peer) -> Iterator[_Kind]:
    """Yield what returns requests of each kind, all with one seq; its number chooses the data."""

    def asks(
        opcode: int, code: int | None, answer: bytes | None = None, payload: bytes = b""
    ) -> _Kind:
        return lambda _: peer.request(opcode, payload, code, answer, _SEQ)

    yield lambda n: peer.echo(payload_of(n % 9, n), _SEQ)
    yield lambda _: peer.echo(b"", _SEQ)
    if peer.claims.mapped:
        yield asks(0, c.RET_OK, peer.ask(peer.request(0)).payload)
    if free := peer.out_of_range()[-1:]:
        yield asks(free[0], c.ERR_OPCODE)
    for name in (c.GET_DEBUG, "getTime", "overruns"):
        if peer.has(name):
            yield asks(peer.opcode(name), None)
    for name in ("delay", "sifPeriod"):
        if peer.has(name):
            yield asks(peer.opcode(name), c.RET_OK, b"", bytes(2))
    if peer.has("ret"):
        codes = [lambda n: n * 29 % (c.RET_MAX + 1), lambda _: c.RET_OK]
        for code in codes:
            yield lambda n, code=code: peer.request(  # type: ignore[misc]
                peer.opcode("ret"), bytes((code(n),)), code(n), b"", _SEQ
            )
    if peer.has(c.MANY):
        yield from _many_kinds(peer, peer.opcode(c.MANY))


def _many_kinds(peer: Peer, opcode: int) -> Iterator[_Kind]:
    def exchange(n: int, flags: int) -> Request:
        data = payload_of(n % 7, n)
        payload = many_payload(peer.opcode(c.GET_ECHO_MANY), flags, 7, data)
        answer = many_payload(c.ECHO_MANY, flags & c.FLAG_LAST, 7, data)
        return peer.request(opcode, payload, c.RET_OK, answer, _SEQ)

    for flags in (0, c.FLAG_WRITE, c.FLAG_WRITE | c.FLAG_LAST):
        yield lambda n, flags=flags: exchange(n, flags)  # type: ignore[misc]
    yield lambda _: peer.request(opcode, b"", c.RET_FAILED, b"", _SEQ)
    for name in (c.GET_PROPERTIES, c.GET_INTERFACE, c.GET_TRANSDS):
        if peer.has(name):
            read = many_payload(peer.opcode(name), 0, 0, b"")
            answer = peer.ask(peer.many(name)).payload
            yield lambda _, p=read, a=answer: peer.request(opcode, p, c.RET_OK, a, _SEQ)  # type: ignore[misc]


class RepeatedWrites(Case):
    """Writes to `store` twice at the same offset with one and the same seq: the same bytes, others,
    fewer and more, with and without isLast; directly one behind the other, and with an echo or a
    refused request between. Then reads it with that seq.
    """

    ID = "seq.repeated-writes"
    EXPECTATION = "The bytes of the second write: it is executed, too."
    REQUIREMENTS = ("J2A-SEQ-008", "J2A-MANY-002")
    LEVEL = "many"
    NEEDS = (c.MANY, "store")

    def _run(self, peer: Peer) -> None:
        datas = (b"first", b"other", b"fir", b"first and more")
        flags = (c.FLAG_WRITE, c.FLAG_WRITE | c.FLAG_LAST)
        for n, (data, flag) in enumerate(product(datas, flags)):
            seq = (0x41, 0x12, 0x00, 0xFF)[n % 4]
            between = [
                (),
                (peer.echo(b"between", seq),),
                (peer.request(peer.opcode(c.MANY), b"", c.RET_FAILED, b"", seq),),
            ]
            for some in between:
                peer.carried(lambda d=data, f=flag, s=seq, b=some: self._twice(peer, d, f, s, b))  # type: ignore[misc]

    @staticmethod
    def _twice(peer: Peer, data: bytes, flags: int, seq: int, between: tuple[Request, ...]) -> None:
        func = peer.opcode("store")

        def many(flags: int, data: bytes) -> Request:
            payload = many_payload(func, flags, 0, data)
            return peer.request(peer.opcode(c.MANY), payload, c.RET_OK, seq=seq)

        peer.ask(many(flags, b"first"), *between, many(flags, data))
        if (found := peer.ask_many(many(0, b"")).data) != data:
            fail(
                f"`store` holds {found!r}, though {data!r} was written with the seq of the write "
                "before"
            )


class OfErrors(Case):
    """Calls an opcode out of range with every seq."""

    ID = "seq.of-errors"
    EXPECTATION = "Each error reply carries the seq of its request."
    REQUIREMENTS = ("J2A-SEQ-001", "J2A-ERR-001", "J2A-ERR-005")
    LEVEL = "core"

    def _run(self, peer: Peer) -> None:
        if not (free := peer.out_of_range()):
            skip("the device has 256 functions, so no opcode is out of range")
        peer.ask_all(
            peer.request(free[seq % len(free)], b"", c.ERR_OPCODE, seq=seq) for seq in range(256)
        )
