"""Byte stuffing, both ways (J2A-STUFF)."""

from collections.abc import Container, Iterator
from itertools import product

from j2a_spec import constants as c
from j2a_spec.oracle import Frame, checksum, encode, stuff

from j2a_conformance.device._case import Case
from j2a_conformance.device._peer import Expected, Peer, Request, refusal
from j2a_conformance.wire._dimensions import SPECIAL, damaged, misread, payload_of, spread

from .sums import broken

STUFFED = sorted(c.STUFFED)
_PAYLOAD = b"twelve bytes"  # none of which is stuffed


def escapable(value: int) -> bool:
    """Tell whether ESC, value - 1 is a legal way to send `value`."""
    return (value - 1) & 0xFF not in (c.SOF, c.SOS, 0xFF)


def escaped(value: int) -> bytes:
    """Return `value` as an escape pair."""
    return bytes((c.ESC, value - 1))


def with_escapes(
    opcode: int, payload: bytes, seq: int, places: Container[int]
) -> tuple[bytes, Expected]:
    """Return an echo whose bytes at `places` (counted from seq) are escaped where legal."""
    body = bytes((seq, opcode, len(payload))) + payload
    body += bytes((checksum(seq, opcode, payload),))
    wire = bytes((c.SOF,))
    for place, value in enumerate(body):
        forced = place in places and escapable(value)
        wire += escaped(value) if forced or value in c.STUFFED else bytes((value,))
    return wire, Expected(seq, c.ECHO, payload)


class Replies(Case):
    """Echoes each byte value alone, and again directly behind a request with a wrong checksum;
    compares the replies on the wire with the oracle.
    """

    ID = "stuff.replies"
    EXPECTATION = "SOF, SOS and ESC come as ESC and the value minus one, every other value plain."
    REQUIREMENTS = ("J2A-STUFF-001", "J2A-STUFF-002", "J2A-STUFF-005")
    LEVEL = "frame"

    def _run(self, peer: Peer) -> None:
        peer.ask_all(peer.echo(bytes((value, 0x41, value))) for value in range(256))
        peer.play_all(self._behind_errors(peer))

    @staticmethod
    def _behind_errors(peer: Peer) -> Iterator[tuple[bytes, list[Expected]]]:
        for value in range(256):
            request = peer.echo(bytes((value, 0x41, value)))
            first, wrong = damaged(peer.echo_opcode, value)
            yield first, [refusal(wrong, c.ERR_CHECKSUM)]
            yield request.wire, [request.expected]


class Fields(Case):
    """Puts each of SOF, SOS and ESC into seq, length, payload and checksum of requests and of
    replies, and into the opcode of requests where no function is there; and each two of them into
    fields that are side by side, at many lengths.
    """

    ID = "stuff.fields"
    EXPECTATION = "Each request is taken for what it is, each reply is stuffed."
    REQUIREMENTS = ("J2A-STUFF-001", "J2A-STUFF-005", "J2A-SUM-002")
    LEVEL = "frame"

    def _run(self, peer: Peer) -> None:
        opcode = peer.echo_opcode
        for value in STUFFED:
            peer.ask(peer.echo(b"seq", seq=value), peer.echo(b"", seq=value))
            peer.ask(peer.echo(b"l" * value))
            peer.ask(peer.echo(bytes((value,))), peer.echo(bytes((value, value, 0x11, value))))
            if value in peer.out_of_range():
                peer.ask(peer.request(value, b"opcode", c.ERR_OPCODE))
            for code in (opcode, c.ECHO):  # the checksum of the request, then of its reply
                request = peer.echo(b"")
                filler = checksum(request.seq, code, b"\0") ^ value
                peer.ask(peer.echo(bytes((filler,)), seq=request.seq))
                assert checksum(request.seq, code, bytes((filler,))) == value
        peer.ask_all(self._side_by_side(peer))

    @staticmethod
    def _side_by_side(peer: Peer) -> Iterator[Request]:
        """Yield requests with two such values in a row, in each two fields that meet."""
        missing, pairs = peer.out_of_range(), list(product(STUFFED, repeat=2))
        for first, second in pairs:
            if second in missing:
                yield peer.request(second, b"opcode", c.ERR_OPCODE, seq=first)
            if first in missing:
                yield peer.request(first, b"l" * second, c.ERR_OPCODE)
            yield peer.echo(bytes((second,)) + b"l" * (first - 1))
        # The last byte and the checksum: of the request, then of its reply.
        ends = [(pair, code) for code in (peer.echo_opcode, c.ECHO) for pair in pairs]
        few = range(2, 2 + len(ends))
        for length in (*few, *(n for n in spread(step=19) if few.stop <= n <= peer.longest)):
            (last, wanted), code = ends[length % len(ends)]
            payload = bytearray(payload_of(length, length))
            payload[-1], seq = last, peer.seq()
            payload[0] ^= checksum(seq, code, bytes(payload)) ^ wanted
            assert checksum(seq, code, bytes(payload)) == wanted
            yield peer.echo(bytes(payload), seq)


class ReplyCodes(Case):
    """Has a function return 0x12, 0x7D, 0xED and their neighbours."""

    ID = "stuff.reply-code"
    EXPECTATION = "The opcode field of the reply is stuffed."
    REQUIREMENTS = ("J2A-STUFF-001", "J2A-DISP-003")
    LEVEL = "frame"
    NEEDS = ("ret",)

    def _run(self, peer: Peer) -> None:
        opcode = peer.opcode("ret")
        values = (0x12, 0x7D, 0xED, 0x11, 0x7C, 0xEC, 0x7E)
        peer.ask_all(peer.request(opcode, bytes((value,)), value, b"") for value in values)


class Needless(Case):
    """Escapes every byte value for which that is legal, needed or not, in the payload, one by one
    and all together, then every byte of seq, opcode, length and checksum; and one, two or three
    bytes of payloads of every length.
    """

    ID = "stuff.needless"
    EXPECTATION = "ESC x is taken as x + 1; ESC ESC as 0x7E."
    REQUIREMENTS = ("J2A-STUFF-003", "J2A-STUFF-005")
    LEVEL = "frame"

    def _run(self, peer: Peer) -> None:
        opcode = peer.echo_opcode
        values = [v for v in range(256) if escapable(v)]
        for value in values:
            self._exchange(peer, opcode, bytes((value,)), peer.seq(), {3})
        for first in range(0, len(values), peer.longest):
            many = bytes(values[first : first + peer.longest])
            self._exchange(peer, opcode, many, peer.seq(), set(range(3, 3 + len(many))))
        for n, length in enumerate(n for n in spread(step=19) if n <= peer.longest):
            payload = payload_of(length, n)
            places = set(range(n % 3, length + 4, 2 + n % 3)) | {0, 1, 2, length + 3}
            self._exchange(peer, opcode, payload, (n * 11) % 256, places)
        for value in (0x00, 0x01, 0x7E, 0x7F, 0x80, 0xFF):  # as the checksum, and in long rows
            seq = peer.seq()
            filler = checksum(seq, opcode, b"\0") ^ value
            self._exchange(peer, opcode, bytes((filler,)), seq, {4})
            for length in (min(60, peer.longest), peer.longest):
                data = bytes((value,)) * length
                self._exchange(peer, opcode, data, peer.seq(), set(range(3, 3 + length)))
        for field in (0, 1, 2, 4):
            self._exchange(peer, opcode, b"x", peer.seq(), {field})
        for field in (0, 2):  # as ESC ESC
            self._exchange(peer, opcode, b"x" * min(c.ESC + 1, peer.longest), c.ESC + 1, {field})
        self._exchange(peer, opcode, b"x", peer.seq(), {0, 1, 2, 3, 4})
        if c.ESC + 1 in peer.out_of_range():
            seq = peer.seq()
            rest = stuff(bytes((0, checksum(seq, c.ESC + 1, b""))))
            wire = bytes((c.SOF,)) + stuff(bytes((seq,))) + bytes((c.ESC, c.ESC)) + rest
            peer.play(wire, refusal(seq, c.ERR_OPCODE))
        peer.play_all(self._few(peer, opcode, values))

    @staticmethod
    def _few(peer: Peer, opcode: int, values: list[int]) -> Iterator[tuple[bytes, list[Expected]]]:
        """Yield echoes of every length in which few bytes are escaped, and no other needs it."""
        for length in range(1, peer.longest + 1):
            for count in (0, 1, 2, 3):  # none: ESC ESC
                # Counted from the start and from the end, in turn.
                ats = {(count * 5 + n * 83) % length for n in range(count or 1)}
                places = {3 + (at if length % 2 else length - 1 - at) for at in ats}
                payload = bytearray(b"x" * length)
                for n, place in enumerate(places):
                    value = values[(length * 3 + count * 67 + n) % len(values)]
                    payload[place - 3] = value if count else c.ESC + 1
                wire, due = with_escapes(opcode, bytes(payload), peer.seq(), places)
                if length % 5 == count:
                    first, wrong = damaged(opcode, length)
                    yield first, [refusal(wrong, c.ERR_CHECKSUM)]
                yield wire, [due]

    @staticmethod
    def _exchange(peer: Peer, opcode: int, payload: bytes, seq: int, places: set[int]) -> None:
        peer.play(*with_escapes(opcode, payload, seq, places))


class EscapeFf(Case):
    """Puts ESC 0xFF into each place of a frame, waits for the answer before the rest of the frame
    is sent, and then sends the rest; for every other place after an error.
    """

    ID = "stuff.escape-ff"
    EXPECTATION = (
        "Error 0xF4 at once if the seq was complete, else nothing; the rest is skipped in silence."
    )
    REQUIREMENTS = ("J2A-STUFF-004", "J2A-ERR-004", "J2A-ERR-005", "J2A-ERR-009")
    LEVEL = "frame"

    def _run(self, peer: Peer) -> None:
        for place in range(1, len(_PAYLOAD) + 5):
            peer.attempts(lambda place=place: self._at(peer, place))  # type: ignore[misc]

    @staticmethod
    def _at(peer: Peer, place: int) -> None:
        if place % 2:
            broken(peer, c.GET_ECHO, b"before")
        request = peer.echo(_PAYLOAD, 0x20 + place)
        frame = request.wire
        due = [refusal(request.seq, c.ERR_FRAMING)] if place > 1 else []
        peer.play(frame[:place] + bytes((c.ESC, 0xFF)), *due)
        peer.link.send(frame[place:])
        peer.barrier()


class EscapeFfAnywhere(Case):
    """Puts ESC 0xFF behind each byte of long frames, then some of the rest of the frame, and a good
    frame behind that; and into frames of every length, such that one taken for 0x00, for 0xFF or
    for nothing would make the frame whole.
    """

    ID = "stuff.escape-ff-anywhere"
    EXPECTATION = (
        "Error 0xF4 if the seq was complete, else nothing; then the reply to the good frame."
    )
    REQUIREMENTS = ("J2A-STUFF-004", "J2A-ERR-004", "J2A-ERR-005", "J2A-ERR-009", "J2A-FRAME-009")
    LEVEL = "frame"

    def _run(self, peer: Peer) -> None:
        peer.play_all(self._streams(peer))

    @staticmethod
    def _streams(peer: Peer) -> Iterator[tuple[bytes, list[Expected]]]:
        many = peer.opcode(c.MANY if peer.has(c.MANY) else c.GET_ECHO)
        for n, (opcode, length) in enumerate(((peer.echo_opcode, 255), (many, 150))):
            frame = encode(Frame(c.SOF, 0x56 + n, opcode, payload_of(length, 3 * n)))
            for cut in range(1, len(frame), 1 + 3 * n):
                if frame[cut - 1] == c.ESC:  # ESC ESC would be a value of its own
                    continue
                request = peer.probe()
                due = [refusal(0x56 + n, c.ERR_FRAMING)] if cut > 1 else []
                rest = frame[cut : cut + cut % 6]
                yield frame[:cut] + b"\x7d\xff" + rest + request.wire, [*due, request.expected]
        kinds = [(b"\x7d\xff", value) for value in (0x00, 0xFF, None)]
        for n, (stream, (seq, before)) in enumerate(misread(peer.echo_opcode, kinds)):
            request = peer.probe()
            due = [refusal(seq, c.ERR_FRAMING)] if before else []
            if n % 3 == 0:  # no good frame between two broken ones
                first, wrong = damaged(peer.echo_opcode, n)
                yield first, [refusal(wrong, c.ERR_CHECKSUM)]
            yield stream + request.wire, [*due, request.expected]
        for n, seq in enumerate(SPECIAL):
            frame = encode(Frame(c.SOF, seq, peer.echo_opcode, b"abc"[: n % 4]))
            known = 3 if frame[1] == c.ESC else 2
            for cut in range(known, len(frame)):
                if frame[cut - 1] == c.ESC:
                    continue
                request = peer.probe()
                due = [refusal(seq, c.ERR_FRAMING)]
                yield frame[:cut] + b"\x7d\xff" + request.wire, [*due, request.expected]
