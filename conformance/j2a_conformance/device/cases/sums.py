"""The checksum (J2A-SUM) and what happens when it is wrong."""

from collections.abc import Callable, Iterator
from functools import reduce
from operator import xor

from j2a_spec import constants as c
from j2a_spec.oracle import Frame, checksum, stuff

from j2a_conformance._judge import fail
from j2a_conformance.device._case import Case
from j2a_conformance.device._peer import Expected, Peer, many_payload, refusal
from j2a_conformance.wire._dimensions import lane_offset, lengths, payload_of

_ESCAPED = (*sorted(c.STUFFED), 0x11, 0x13, 0x7C, 0x7E, 0xEC, 0xEE, 0x00, 0xFF, 0x41)


def with_sum(seq: int, opcode: int, payload: bytes, value: int) -> bytes:
    """Return the wire bytes of a request with a checksum of one's own."""
    body = bytes((seq, opcode, len(payload))) + payload + bytes((value & 0xFF,))
    return bytes((c.SOF,)) + stuff(body)


def broken(peer: Peer, name: str, payload: bytes, flip: int = 1) -> None:
    """Call a function with a wrong checksum, and expect error 0xF3."""
    seq, opcode = peer.seq(), peer.opcode(name)
    wire = with_sum(seq, opcode, payload, checksum(seq, opcode, payload) ^ flip)
    peer.play(wire, refusal(seq, c.ERR_CHECKSUM))


class Formula(Case):
    """Sends requests whose parts of the checksum overflow: opcodes from 0xF5, lengths from 159,
    and 64 seqs with payloads of one byte.
    """

    ID = "sum.formula"
    EXPECTATION = "Each is accepted, and each reply has the checksum of the oracle."
    REQUIREMENTS = ("J2A-SUM-001",)
    LEVEL = "frame"

    def _run(self, peer: Peer) -> None:
        for opcode in (0xF4, 0xF5, 0xF6, 0xFF):
            if opcode in peer.out_of_range():
                peer.ask(peer.request(opcode, b"", c.ERR_OPCODE))
        for length in (158, 159, 160, 222, 223, 255):
            peer.ask(peer.echo(bytes(range(length))))
        for seq in range(0, 256, 4):
            peer.ask(peer.echo(bytes((seq ^ 0xA5,)), seq=seq))


_WRONG: dict[str, Callable[[int, int, bytes], int]] = {
    "with the start byte in it": lambda s, o, p: checksum(s, o, p) ^ c.SOF,
    "of the stuffed bytes": lambda s, o, p: (
        checksum(s, o, b"")
        ^ c.CHK_LENGTH
        ^ (len(p) + c.CHK_LENGTH & 0xFF)
        ^ reduce(xor, stuff(p), 0)
    ),
    "without the constants": lambda s, o, p: reduce(xor, p, s ^ o ^ len(p)),
    "with 11 and 97 exchanged": lambda s, o, p: reduce(
        xor, p, s ^ (o + c.CHK_LENGTH) ^ (len(p) + c.CHK_OPCODE)
    ),
    "without the payload": lambda s, o, p: s ^ (o + c.CHK_OPCODE) ^ (len(p) + c.CHK_LENGTH),
    "without the seq": lambda s, o, p: checksum(s, o, p) ^ s,
    "added instead of combined by XOR": lambda s, o, p: s + o + 11 + len(p) + 97 + sum(p),
    "complemented": lambda s, o, p: ~checksum(s, o, p),
    "of zero": lambda s, o, p: 0,
}


class WrongFormula(Case):
    """Sends requests whose checksum is computed by a mistaken formula: with the start byte in it,
    of the stuffed bytes, with other constants, without payload or seq, added, complemented, or
    zero.
    """

    ID = "sum.wrong-formula"
    EXPECTATION = "Error 0xF3 for each."
    REQUIREMENTS = ("J2A-SUM-001", "J2A-SUM-002", "J2A-SUM-003", "J2A-ERR-002")
    LEVEL = "frame"

    def _run(self, peer: Peer) -> None:
        opcode = peer.echo_opcode
        for payload in (b"\x12", b"\x7d\x7d\x7d", b"abc", b"\xed" * 5):
            for name, formula in _WRONG.items():
                seq = peer.seq()
                value = formula(seq, opcode, payload) & 0xFF
                if value == checksum(seq, opcode, payload):
                    continue
                peer.link.note(f"a checksum {name}")
                wire = with_sum(seq, opcode, payload, value)
                peer.play(wire, refusal(seq, c.ERR_CHECKSUM))


class EveryWrong(Case):
    """Sends a request with each difference from its checksum, and with each wrong checksum."""

    ID = "sum.every-wrong-value"
    EXPECTATION = "Error 0xF3 for each, with the seq of the request, and no echo."
    REQUIREMENTS = ("J2A-SUM-003", "J2A-ERR-002", "J2A-ERR-005", "J2A-ERR-009")
    LEVEL = "frame"

    def _run(self, peer: Peer) -> None:
        for flip in range(1, 256):
            broken(peer, c.GET_ECHO, b"sum", flip)
        for value in range(256):  # the seq is another one each time, so not all came above
            seq = peer.seq()
            if value != checksum(seq, peer.echo_opcode, b"sum"):
                wire = with_sum(seq, peer.echo_opcode, b"sum", value)
                peer.play(wire, refusal(seq, c.ERR_CHECKSUM))
        peer.barrier()


class WrongEscape(Case):
    """Sends requests with ESC and each byte in the place of their checksum, which is one to be
    escaped, one beside those, or another one.
    """

    ID = "sum.wrong-escape"
    EXPECTATION = (
        "The echo for the right byte alone; else error 0xF3, or 0xF4 for 0xFF and a start byte."
    )
    REQUIREMENTS = ("J2A-SUM-003", "J2A-STUFF-003", "J2A-STUFF-004", "J2A-ERR-002", "J2A-ERR-003")
    LEVEL = "frame"

    def _run(self, peer: Peer) -> None:
        peer.play_all(self._escaped(peer))

    @staticmethod
    def _escaped(peer: Peer) -> Iterator[tuple[bytes, list[Expected]]]:
        """Yield requests with an escape pair as their checksum, and good ones behind them."""
        opcode = peer.echo_opcode
        for value in _ESCAPED:
            for byte in range(256):
                seq = peer.seq()
                payload = bytes((checksum(seq, opcode, b"\0") ^ value,))
                body = bytes((seq, opcode, len(payload))) + payload
                wire = bytes((c.SOF,)) + stuff(body) + bytes((c.ESC, byte))
                code = c.ERR_CHECKSUM if byte not in (c.SOF, c.SOS, 0xFF) else c.ERR_FRAMING
                right = code == c.ERR_CHECKSUM and byte + 1 == value
                good = peer.probe()
                due = Expected(seq, c.ECHO, payload) if right else refusal(seq, code)
                yield wire + good.wire, [due, good.expected]


class FlippedBits(Case):
    """Flips each bit of seq, opcode, payload and checksum of a request in turn."""

    ID = "sum.flipped-bits"
    EXPECTATION = (
        "Error 0xF3 for each, with the seq as it was received, and no function is executed."
    )
    REQUIREMENTS = ("J2A-SUM-003", "J2A-ERR-002", "J2A-ERR-005")
    LEVEL = "frame"

    def _run(self, peer: Peer) -> None:
        opcode = peer.echo_opcode
        for place in (0, 1, 3, 4, 5):  # all but the length, which would move the end of the frame
            for bit in range(8):
                seq = peer.seq()
                body = bytearray((seq, opcode, 2, 0x55, 0xAA, checksum(seq, opcode, b"\x55\xaa")))
                body[place] ^= 1 << bit
                peer.play(bytes((c.SOF,)) + stuff(bytes(body)), refusal(body[0], c.ERR_CHECKSUM))


def damaged(peer: Peer, name: str, data: bytes, n: int) -> tuple[bytes, list[Expected]]:
    """Return a request with one wrong bit, and the expected error.

    Which bit it is depends on `n`: of the checksum, of the first, last or another byte of the
    payload, of the opcode, or of the seq. (A wrong length moves the end of the frame.)
    """
    seq, opcode = peer.seq(), peer.opcode(name)
    body = bytearray((seq, opcode, len(data), *data, checksum(seq, opcode, data)))
    last = len(body) - 1
    inside = 3 + n * 5 % len(data) if data else last
    place = (last, inside, 0, last, 3 if data else last, 1, max(last - 1, 3))[n % 7]
    bits = [1 << (n + shift) % 8 for shift in range(8)]
    if place == 1:  # so that it stays one, for a device of 2014 refuses any other at once
        bits = [bit for bit in bits if 0 < opcode ^ bit < len(peer.claims.functions)] or [0]
    body[place] ^= bits[0]
    body[last] ^= not bits[0]
    return bytes((c.SOF,)) + stuff(bytes(body)), [refusal(body[0], c.ERR_CHECKSUM)]


class EveryLength(Case):
    """Damages one bit of requests of every length from 0 to 255: of seq, opcode, payload, checksum;
    of a2jEcho, and in turn of writes and reads through a2jMany, of `ret` and of `sif`.
    """

    ID = "sum.every-length"
    EXPECTATION = "Error 0xF3 for each with the seq as it was received, and nothing is executed."
    REQUIREMENTS = ("J2A-SUM-001", "J2A-SUM-003", "J2A-ERR-002", "J2A-ERR-005", "J2A-FRAME-005")
    LEVEL = "frame"

    def _run(self, peer: Peer) -> None:
        before = len(peer.link.sifs)
        flags = c.FLAG_WRITE | c.FLAG_LAST
        if stores := peer.has("store"):
            peer.ask(peer.many("store", flags, 0, b"good"))
        peer.play_all(
            damaged(peer, c.GET_ECHO, payload_of(length, length), length) for length in lengths()
        )
        peer.play_all(self._others(peer))
        peer.barrier()
        for sif in peer.link.sifs[before:]:
            if isinstance(sif.event, Frame) and self._is_asked(sif.event):
                peer.link.record("sif", sif.raw, "not asked for by any good request:")
                fail("a SIF was sent for a request with a wrong checksum")
        if stores and (data := peer.read_all("store")) != b"good":
            fail(f"`store` holds {data[:16].hex(' ')} after writes with a wrong checksum")

    @classmethod
    def _is_asked(cls, sif: Frame) -> bool:
        """Tell whether it is what a damaged request asked for; others are the application's."""
        came = int.from_bytes(bytes((sif.opcode,)) + sif.payload, "big")
        asked = int.from_bytes(cls._data(1 + len(sif.payload)), "big")
        return (came ^ asked).bit_count() <= 1

    @staticmethod
    def _data(length: int) -> bytes:
        return payload_of(length, length + 3)

    @classmethod
    def _others(cls, peer: Peer) -> Iterator[tuple[bytes, list[Expected]]]:
        """Yield damaged requests to functions that would do something."""
        named = (c.GET_ECHO_MANY, "store", "ret", "sif", "store", c.GET_MAPPING, c.GET_PROPERTIES)
        names = [n for n in named if peer.has(n) and (n != c.GET_MAPPING or peer.claims.mapped)]
        for length in lengths() if names else ():
            name = names[length % len(names)]
            data = cls._data(length)
            if name in (c.GET_ECHO_MANY, "store", c.GET_PROPERTIES):
                offset = 0 if length % 2 else lane_offset(length)
                header = many_payload(peer.opcode(name), length * 3 % 4, offset)
                name, data = c.MANY, header + data[: c.MANY_DATA]
            yield damaged(peer, name, data, length * 3)


class NotStored(Case):
    """Writes to `store`, writes something else with a wrong checksum, and reads."""

    ID = "sum.write-not-executed"
    EXPECTATION = "The content of the good write."
    REQUIREMENTS = ("J2A-SUM-003",)
    LEVEL = "frame"
    NEEDS = ("store",)

    def _run(self, peer: Peer) -> None:
        flags = c.FLAG_WRITE | c.FLAG_LAST
        peer.ask(peer.many("store", flags, 0, b"good"))
        broken(peer, c.MANY, many_payload(peer.opcode("store"), flags, 0, b"evil"))
        if (data := peer.read_all("store")) != b"good":
            fail(f"`store` holds {data[:16].hex(' ')} after a write with a wrong checksum")


class NoSif(Case):
    """Asks for a SIF by a request with a wrong checksum."""

    ID = "sum.sif-not-sent"
    EXPECTATION = "Error 0xF3, and no SIF."
    REQUIREMENTS = ("J2A-SUM-003",)
    LEVEL = "frame"
    NEEDS = ("sif",)

    def _run(self, peer: Peer) -> None:
        before = len(peer.link.sifs)
        broken(peer, "sif", b"\x33evil")
        peer.barrier()
        if any(sif.event.opcode == 0x33 for sif in peer.link.sifs[before:]):  # type: ignore[union-attr]
            fail("a SIF was sent for a request with a wrong checksum")


class ShortLength(Case):
    """Sends frames whose length field is smaller than the payload that follows."""

    ID = "sum.short-length"
    EXPECTATION = "Error 0xF3 once; the bytes too many are skipped."
    REQUIREMENTS = ("J2A-FRAME-004", "J2A-FRAME-006", "J2A-SUM-003", "J2A-ERR-002", "J2A-ERR-009")
    LEVEL = "frame"

    def _run(self, peer: Peer) -> None:
        opcode = peer.echo_opcode
        payload = b"0123456789"
        for length in range(len(payload)):
            seq = peer.seq()
            body = bytes((seq, opcode, length)) + payload
            if payload[length] == checksum(seq, opcode, payload[:length]):
                continue
            due = refusal(seq, c.ERR_CHECKSUM)
            peer.play(bytes((c.SOF,)) + stuff(body), due, alone=True)
