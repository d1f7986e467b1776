"""Frames in pieces, as links deliver them (J2A-FRAME)."""

import random
from collections.abc import Iterator

from j2a_spec import constants as c
from j2a_spec.oracle import Frame, FrameError, decode, encode

from j2a_conformance._judge import inform
from j2a_conformance.device._case import Case
from j2a_conformance.device._paused import passes_in_pieces
from j2a_conformance.device._peer import Expected, Peer, refusal
from j2a_conformance.wire._dimensions import SPECIAL, misread, payload_of, pieces, places, spread

from .frame import CLEAN, answers
from .stuffing import with_escapes

_PAUSE_S = 0.001
_EVERYWHERE = range(c.HEADER + c.MAX_PAYLOAD + 1)  # in a frame
_BATCH = 600  # bytes: few enough pieces that a busy machine makes no long pause among them


class Pieces(Case):
    """Sends good, damaged and interrupted frames, and frames with ESC 0xFF, of many lengths in two
    to four pieces with a short pause between them, short ones and such as are full of escapes cut
    everywhere, and some byte by byte; noise and a start byte in one piece, and the rest of the
    frame in another; and all of these mixed in one stream, in pieces of up to 40 bytes that end
    behind each ESC.
    """

    ID = "frame.pieces"
    EXPECTATION = "The same replies as for the whole, wherever it was cut."
    REQUIREMENTS = (
        "J2A-SEQ-001",
        "J2A-DISP-001",
        "J2A-FRAME-004",
        "J2A-FRAME-005",
        "J2A-FRAME-006",
        "J2A-FRAME-007",
        "J2A-FRAME-008",
        "J2A-FRAME-009",
        "J2A-FRAME-010",
        "J2A-STUFF-001",
        "J2A-STUFF-002",
        "J2A-STUFF-003",
        "J2A-STUFF-004",
        "J2A-STUFF-005",
        "J2A-SUM-001",
        "J2A-SUM-003",
        "J2A-ERR-002",
        "J2A-ERR-003",
        "J2A-ERR-004",
        "J2A-ERR-005",
        "J2A-ERR-009",
        "J2A-ECHO-001",
    )
    LEVEL = "frame"

    def _run(self, peer: Peer) -> None:
        if peer.link.lossy:
            inform("a lossy link does not show what a cut did")
        for n, length in enumerate(spread(step=43)):
            seq = SPECIAL[n * 4 % len(SPECIAL)] if n % 2 else None
            request = peer.echo(payload_of(length, n), seq)
            self._in_pieces(peer, pieces(request.wire, n), request.expected)
            good = peer.probe()
            wrong = bytearray(request.wire)
            wrong[-1] ^= 0x02 if wrong[-1] ^ 0x02 not in c.STUFFED else 0x08
            if decode(bytes(wrong)) == [FrameError("checksum", c.SOF, request.seq)]:
                due = [refusal(request.seq, c.ERR_CHECKSUM), good.expected]
                self._in_pieces(peer, pieces(bytes(wrong) + good.wire, n + 1), *due)
            cut = request.wire[: 2 + n * 37 % (len(request.wire) - 2)]
            cut += b"\x7d\xff" if n % 3 == 0 and cut[-1] != c.ESC else b""
            due = [*answers(cut + b"\x12"), good.expected]
            self._in_pieces(peer, pieces(cut + good.wire, n + 2), *due)
            before = peer.echo(payload_of(n, n))
            if len(before.wire + cut + good.wire) <= peer.room(_BATCH):
                parts = [before.wire[: 1 + n % 4], before.wire[1 + n % 4 :] + cut + good.wire]
                self._in_pieces(peer, parts, before.expected, *due)
        for noise in (b"\x00", b"\x11\xec", b"\x7d", CLEAN, CLEAN * 3):
            request = peer.probe()
            self._in_pieces(peer, [noise + request.wire[:1], request.wire[1:]], request.expected)
            self._in_pieces(peer, [noise, request.wire], request.expected)
        for seq in (0x41, c.SOF, c.ESC):
            for length in range(3):
                request = peer.echo(b"\x12a"[:length], seq)
                for at in places(request.wire):
                    parts = [request.wire[:at], request.wire[at:]]
                    self._in_pieces(peer, parts, request.expected)
        for payload in (b"\x7e\x12\x7e\x7e\xed\x01", b"\x7d\x7e\x7d"):  # each with ESC ESC
            wire, echoed = with_escapes(peer.echo_opcode, payload, 0x7E, _EVERYWHERE)
            for at in places(wire):
                self._in_pieces(peer, [wire[:at], wire[at:]], echoed)
        for length in (0, 20, 60):
            request = peer.echo(payload_of(length, 1))
            single = [bytes((byte,)) for byte in request.wire]
            self._in_pieces(peer, single, request.expected)
        kinds = [(b"\x7d\xff", value) for value in (0x00, 0xFF, None)]
        for n, (stream, (seq, ahead)) in enumerate(misread(peer.echo_opcode, kinds)):
            if ahead > c.HEADER and n % 37 == 0:
                good = peer.probe()
                owed = (refusal(seq, c.ERR_FRAMING), good.expected)
                # The second piece begins behind some of the payload, or in the escape pair.
                at = stream.rindex(b"\x7d\xff") + n % 2
                self._in_pieces(peer, [stream[:at], stream[at:] + good.wire], *owed)
        for n, batch in enumerate(self._batches(peer)):
            stream = b"".join(part for part, _ in batch)
            due = [expected for _, some in batch for expected in some]
            self._in_pieces(peer, _small(stream, n), *due)

    @classmethod
    def _batches(cls, peer: Peer) -> Iterator[list[tuple[bytes, list[Expected]]]]:
        """Yield exchanges that go out without waiting, as many as j2a.rxbuf holds."""
        batch: list[tuple[bytes, list[Expected]]] = []
        for exchange in cls._mixed(peer):
            size = sum(len(part) for part, _ in batch)
            if batch and size + len(exchange[0]) > peer.room(_BATCH):
                yield batch
                batch = []
            batch.append(exchange)
        yield batch

    @staticmethod
    def _mixed(peer: Peer) -> Iterator[tuple[bytes, list[Expected]]]:
        """Yield frames that each leave another state behind, and good ones behind them."""
        opcode = peer.echo_opcode
        for n, length in enumerate(spread(peer.longest, 37)[::4]):
            request = peer.echo(payload_of(length, n), n * 29 % 256)
            wire, sos = request.wire, bytes((c.SOS,))
            cut = wire[: 2 + n * 11 % (len(wire) - 2)]
            begun = cut if cut[-1] == c.ESC else cut + bytes((c.ESC,))
            needless, _ = with_escapes(opcode, payload_of(length, n), request.seq, _EVERYWHERE)
            whole = [(needless, [request.expected]), (wire, [request.expected])][n % 2]
            foreign = encode(Frame(c.SOS, request.seq, opcode, payload_of(length % 40, n)))
            for broken in (
                begun,
                sos + begun[1:],
                begun + b"\xff",
                sos + wire[1:-1],
                cut + foreign,
            ):
                good = peer.probe()  # in one exchange, for it is what interrupts the broken one
                yield broken + good.wire, [*answers(broken + sos), good.expected]
            yield whole

    @staticmethod
    def _in_pieces(peer: Peer, parts: list[bytes], *due: Expected) -> None:
        """Send the parts until the replies are right; a pause that a stall made does not count."""
        if not passes_in_pieces(peer, parts, _PAUSE_S, *due, exact=True, is_strict=True):
            peer.link.note("this machine is too busy to make a pause of less than 9 ms")


def _small(stream: bytes, n: int) -> list[bytes]:
    """Return `stream` in pieces of up to 40 bytes, which end behind each ESC."""
    rng, found = random.Random(n), []
    while stream:
        size = rng.randint(1, 40)
        end = stream.find(c.ESC, 0, size) + 1 or size
        found.append(stream[:end])
        stream = stream[end:]
    return found
