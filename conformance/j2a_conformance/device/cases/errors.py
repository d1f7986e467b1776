"""Error replies (J2A-ERR); those of the checksum are in `sums`, those of time in `timing`."""

from collections.abc import Iterable, Iterator

from j2a_spec import constants as c
from j2a_spec.oracle import Frame, checksum

from j2a_conformance._judge import fail
from j2a_conformance.device._case import Case
from j2a_conformance.device._peer import Expected, Peer, Request, many_payload
from j2a_conformance.wire._dimensions import lengths, payload_of, spread

from .sums import with_sum


def check_payloads(errors: Iterable[Frame]) -> None:
    """Fail unless each error reply has two bytes of payload."""
    for error in errors:
        if len(error.payload) != 2:
            fail(f"error 0x{error.opcode:02X} has {len(error.payload)} payload bytes, not 2")


class OutOfRange(Case):
    """Calls every opcode that names no function, with and without payload, and some of them with
    payloads of every length.
    """

    ID = "error.opcode-out-of-range"
    EXPECTATION = "Error 0xF0 for each."
    REQUIREMENTS = ("J2A-FRAME-005", "J2A-ERR-001", "J2A-ERR-006", "J2A-DISP-001")
    LEVEL = "core"

    def _run(self, peer: Peer) -> None:
        free = peer.out_of_range()
        frames = peer.ask_all(
            peer.request(opcode, payload, c.ERR_OPCODE)
            for opcode in free
            for payload in (b"", b"payload")
        )
        frames += peer.ask_all(
            peer.request(free[length * 37 % len(free)], payload_of(length, length), c.ERR_OPCODE)
            for length in (lengths() if free else ())
        )
        check_payloads(frames)


class ChecksumFirst(Case):
    """Calls every opcode, in range or not, with one bit of the checksum wrong."""

    ID = "error.checksum-before-opcode"
    EXPECTATION = "Error 0xF3, not 0xF0: the opcode of a damaged frame means nothing."
    REQUIREMENTS = ("J2A-ERR-001", "J2A-ERR-002", "J2A-ERR-009", "J2A-SUM-003")
    LEVEL = "core"

    def _run(self, peer: Peer) -> None:
        peer.play_all(self._streams(peer))
        peer.barrier()

    @staticmethod
    def _streams(peer: Peer) -> Iterator[tuple[bytes, list[Expected]]]:
        for opcode in range(256):
            for payload in (b"", b"damaged"[: 1 + opcode % 7]):
                seq = peer.seq()
                wrong = checksum(seq, opcode, payload) ^ (1 << opcode % 8)
                wire = with_sum(seq, opcode, payload, wrong)
                yield wire, [Expected(seq, c.ERR_CHECKSUM)]


class NotEarly(Case):
    """Sends a request with an opcode out of range, and interrupts it before its end."""

    ID = "error.opcode-not-early"
    EXPECTATION = "Error 0xF4 alone: 0xF0 is not due before the checksum was seen."
    REQUIREMENTS = ("J2A-ERR-001", "J2A-ERR-003", "J2A-ERR-009")
    LEVEL = "core"

    def _run(self, peer: Peer) -> None:
        for opcode in peer.out_of_range()[-1:]:
            for cut in range(3, 8):
                broken = peer.request(opcode, b"abc")
                request = peer.probe()
                due = Expected(broken.seq, c.ERR_FRAMING)
                peer.play(broken.wire[:cut] + request.wire, due, request.expected)


class Payload(Case):
    """Causes each kind of error reply, compares its bytes on the wire with the oracle, and looks
    at its payload.
    """

    ID = "error.payload"
    EXPECTATION = "SOF, like any reply, and two bytes of payload, whatever they are."
    REQUIREMENTS = (
        "J2A-FRAME-010",
        "J2A-ERR-006",
        "J2A-FRAME-002",
        "J2A-FRAME-003",
        "J2A-STUFF-002",
    )
    LEVEL = "core"

    def _run(self, peer: Peer) -> None:
        free = peer.out_of_range()[-1:]
        streams = [(seq := peer.seq(), c.ERR_OPCODE, peer.request(o, seq=seq).wire) for o in free]
        seq, echo = peer.seq(), peer.echo_opcode
        streams.append((seq, c.ERR_CHECKSUM, with_sum(seq, echo, b"a", checksum(seq, echo, b"b"))))
        whole = peer.echo(b"abc")
        streams.append((whole.seq, c.ERR_FRAMING, whole.wire[:4] + b"\x7d\xff"))
        whole = peer.echo(b"abc")
        streams.append((whole.seq, c.ERR_FRAMING, whole.wire[:4] + bytes((c.SOS,))))
        whole = peer.echo(b"abc")
        streams.append((whole.seq, c.ERR_TIMEOUT, whole.wire[:4]))
        if peer.has(c.MANY):
            many = peer.many(c.GET_ECHO, code=c.ERR_OPCODE)
            streams.append((many.seq, c.ERR_OPCODE, many.wire))
            many = peer.request(peer.opcode(c.GET_ECHO_MANY))
            streams.append((many.seq, c.ERR_OPCODE, many.wire))
        for seq, code, stream in streams:
            check_payloads([peer.ask_exact(Request(stream, Expected(seq, code)))])


class SeqOfErrors(Case):
    """Breaks requests with every seq, by a start byte, by ESC 0xFF and by the checksum, and with
    some seqs by a pause; asks a2jMany for what it refuses with every seq.
    """

    ID = "error.seq"
    EXPECTATION = "The seq of the broken request in each error reply."
    REQUIREMENTS = (
        "J2A-FRAME-010",
        "J2A-STUFF-002",
        "J2A-ERR-002",
        "J2A-ERR-003",
        "J2A-ERR-004",
        "J2A-ERR-005",
        "J2A-ERR-006",
        "J2A-SEQ-001",
        "J2A-STUFF-001",
        "J2A-STUFF-004",
        "J2A-FRAME-002",
    )
    LEVEL = "core"

    def _run(self, peer: Peer) -> None:
        check_payloads(peer.play_all(self._streams(peer)))
        for seq in (0x00, 0x11, 0x12, 0x7C, 0x7D, 0x7E, 0xEC, 0xED, 0xEE, 0xFF):
            wire = peer.echo(b"abc", seq).wire
            peer.play(wire[: len(wire) - 2], Expected(seq, c.ERR_TIMEOUT), exact=True)

    @staticmethod
    def _streams(peer: Peer) -> Iterator[tuple[bytes, list[Expected]]]:
        opcode = peer.echo_opcode
        for seq in range(256):
            good = peer.echo(b"abc", seq)
            known = len(good.wire) - 6  # bytes up to and with seq
            wrong = with_sum(seq, opcode, b"abc", checksum(seq, opcode, b"abc") ^ 0x40)
            yield wrong, [Expected(seq, c.ERR_CHECKSUM)]
            yield good.wire[: known + 2] + b"\x7d\xff", [Expected(seq, c.ERR_FRAMING)]
            yield good.wire[: known + 2] + bytes((c.SOS,)), [Expected(seq, c.ERR_FRAMING)]
            if peer.has(c.MANY):
                request = peer.request(
                    peer.opcode(c.MANY), many_payload(0xFF, seq), c.ERR_OPCODE, seq=seq
                )
                yield request.wire, [request.expected]


class SeqUnknown(Case):
    """Breaks requests before their seq is complete, by start bytes and by ESC 0xFF."""

    ID = "error.seq-unknown"
    EXPECTATION = "No answer at all."
    REQUIREMENTS = ("J2A-ERR-005", "J2A-FRAME-007", "J2A-STUFF-004")
    LEVEL = "core"

    def _run(self, peer: Peer) -> None:
        streams = (b"\x12", b"\x12\x7d", b"\x12\x7d\xff", b"\x12\x7d\xff\x11", b"\x12\xed")
        # A request with a known seq goes before, so that a left over seq could be seen.
        for stream in streams:
            peer.ask(peer.probe())
            peer.play(stream, alone=True)


class OnlyOnce(Case):
    """Breaks a request in several ways at once, and sends what is left of it and more bytes that
    start no frame.
    """

    ID = "error.only-once"
    EXPECTATION = "One error reply, and then silence up to the next frame."
    REQUIREMENTS = ("J2A-ERR-009", "J2A-FRAME-006", "J2A-DISP-001")
    LEVEL = "core"

    def _run(self, peer: Peer) -> None:
        good = peer.echo(b"abcdefgh")
        rest = good.wire[5:]
        tails = (
            (c.ERR_FRAMING, b"\x7d\xff" + rest),
            (c.ERR_FRAMING, b"\x7d\xff\x7d\xff" + rest),
            (c.ERR_FRAMING, bytes((c.SOS,)) + rest),
            (c.ERR_FRAMING, bytes((c.SOS,)) + b"\x7d\xff" + rest),
        )
        for code, tail in tails:
            peer.play(good.wire[:5] + tail, Expected(good.seq, code), alone=True)
        seq, opcode = peer.seq(), peer.opcode(c.MANY if peer.has(c.MANY) else c.GET_ECHO)
        payload = many_payload(0xFF)
        wire = with_sum(seq, opcode, payload, checksum(seq, opcode, payload) ^ 0x10)
        peer.play(wire + b"abc" * 20, Expected(seq, c.ERR_CHECKSUM), alone=True)


class ReservedCodes(Case):
    """Calls the built-in functions with payloads of many lengths and kinds."""

    ID = "error.reserved-codes"
    EXPECTATION = "Replies with any code but 0xF1 and 0xF5 to 0xFE, which are reserved."
    REQUIREMENTS = (
        "J2A-SEQ-001",
        "J2A-ERR-011",
    )
    LEVEL = "core"

    def _run(self, peer: Peer) -> None:
        refused = (c.MANY, c.GET_PROPERTIES)  # where they are called like this
        names = [name for name in c.KNOWN_BUILTINS if peer.has(name) and name not in refused]
        for n, length in enumerate(spread(peer.longest, 31)):
            data = payload_of(length, n)
            for name in names[n % 3 :: 3]:
                if name == c.GET_ECHO_MANY:
                    peer.ask(peer.many(name, n % 4, n, data[: peer.longest_chunk]))
                elif name != c.GET_MAPPING or peer.claims.mapped:
                    peer.ask(peer.request(peer.opcode(name), data))
        for opcode in peer.out_of_range()[::7]:
            peer.ask(peer.request(opcode, b"reserved"))
