"""What a host receives in pieces: every split of short frames, splits of every length.

A SIF needs no pause to come in pieces: a host that has made its next call has read what came with
the reply before. Replies are cut by pauses.
"""

import random

from j2a_spec import constants as c

from j2a_conformance.host._case import HostCase
from j2a_conformance.host._dimensions import LENGTHS, SPECIAL, content, escaped, frame
from j2a_conformance.host._host import Host
from j2a_conformance.host._outcomes import Sifs, spell

from .sif import anchor, handed

_ODD = b"\x12a\x7d\x7e\xed"
_BROKEN = (b"\x01\x13\x02", b"\x00ab", b"\xee\x7db", b"\x7dab", b"\x12ab", b"\xedab")


def _cut(wire: bytes, *places: int) -> list[bytes]:
    ends = sorted({*places, len(wire)})
    return [wire[start:end] for start, end in zip([0, *ends], ends, strict=False) if start < end]


class Replies(HostCase):
    """Sends short replies, one with needless escapes, and an error reply, each in two pieces, cut
    behind each of their bytes, and byte by byte.
    """

    ID = "host.pieces.every-split"
    EXPECTATION = "How a link cuts the stream makes no difference."
    REQUIREMENTS = ("J2A-FRAME-005", "J2A-STUFF-003", "J2A-STUFF-005")
    LEVEL = "frame"

    def _run(self, host: Host) -> None:
        for code, is_escaped in ((0x7D, False), (0x21, True), (c.ERR_CHECKSUM, False)):
            end, size = 1, 2
            while end <= size:
                request = host.asked()
                whole = escaped if is_escaped else frame
                wire = whole(c.SOF, request.seq, code, _ODD)
                size = len(wire)
                host.piecemeal(_cut(wire, *(range(size) if end == size else (end,))))
                host.replied(request, code)
                error = f"error {code}"
                host.outcome(error if code in c.ERRORS else f"reply {code} {spell(_ODD)}")
                end += 1


class Lengths(HostCase):
    """Sends replies of every length in three pieces, cut anywhere."""

    ID = "host.pieces.lengths"
    EXPECTATION = "How a link cuts the stream makes no difference."
    REQUIREMENTS = (
        "J2A-FRAME-010",
        "J2A-FRAME-005",
        "J2A-STUFF-003",
        "J2A-STUFF-005",
        "J2A-SUM-001",
    )
    LEVEL = "frame"

    def _run(self, host: Host) -> None:
        rng = random.Random(3)
        for length in LENGTHS:
            request, payload = host.asked(), content(length, 4)
            wire = request.reply(2, payload)
            host.piecemeal(_cut(wire, *(rng.randrange(1, len(wire)) for _ in range(2))))
            host.replied(request)
            host.replied_with(2, payload)


class Long(HostCase):
    """Sends replies of up to 518 bytes on the wire, in pieces of 1 to 300 bytes."""

    ID = "host.pieces.long"
    EXPECTATION = "How a link cuts the stream makes no difference, however long the frame is."
    REQUIREMENTS = ("J2A-FRAME-005", "J2A-STUFF-003", "J2A-STUFF-005")
    LEVEL = "frame"

    def _run(self, host: Host) -> None:
        for size in (300, 255, 64, 63, 20):
            for unit in (b"\x12", b"\x7d\xed", b"\x7e\x11"):
                request, payload = host.asked(), (unit * 255)[:255]
                wire = request.reply(c.SOF, payload)
                host.piecemeal(_cut(wire, *range(size, len(wire), size)))
                host.replied(request)
                host.replied_with(c.SOF, payload)


class Broken(HostCase):
    """Sends broken replies in pieces, cut behind each of their bytes: a wrong checksum, ESC 0xFF, a
    raw start byte, an end too early, an end behind ESC; then the right one, in pieces, too.
    """

    ID = "host.pieces.broken"
    EXPECTATION = "Nothing of the broken frame is handed over; the right reply is taken."
    REQUIREMENTS = ("J2A-FRAME-007", "J2A-FRAME-009", "J2A-STUFF-004", "J2A-SUM-003")
    LEVEL = "frame"

    def _run(self, host: Host) -> None:
        for cut in range(1, 12):
            for broken in _BROKEN:
                request = host.asked()
                wire = request.reply(0x31, broken)
                match broken[0]:
                    case 0x01:
                        wire = frame(c.SOF, request.seq, 0x31, broken, 0x40)
                    case 0x00:
                        wire = wire.replace(b"\x00", b"\x7d\xff", 1)
                    case 0xEE:
                        wire = wire.replace(b"\xee", b"\x7d\xed", 1)
                    case c.ESC:
                        wire = wire[: min(cut, len(wire) - 1)].rstrip(b"\x7d") + b"\x7d"
                    case value:
                        wire = wire.replace(bytes((c.ESC, value - 1)), bytes((value,)), 1)
                host.piecemeal(_cut(wire, min(cut, len(wire) - 1)))
                right = request.reply(1, b"right")
                host.piecemeal(_cut(right, 1 + cut % (len(right) - 1)))
                host.replied(request, 1)
                host.replied_with(1, b"right")


class SifSplits(HostCase):
    """Sends SIFs in two pieces, a reply behind the first one: short ones cut behind each byte, and
    with each special byte in each field; while calls come and go.
    """

    ID = "host.pieces.sif-every-split"
    EXPECTATION = "Each is handed over as it is, and each call gets its reply."
    REQUIREMENTS = ("J2A-FRAME-005", "J2A-STUFF-003", "J2A-STUFF-005", "J2A-SIF-003")
    LEVEL = "sif"

    def _run(self, host: Host) -> None:
        sent: Sifs = [(opcode, _ODD) for opcode in (0x12, 0x7D, 0xF3)]
        wires = [(sif, end) for sif in sent for end in range(1, 18)]
        wires += [((byte, content(byte, 6)), 2 + byte % 5) for byte in SPECIAL]
        in_pieces(host, wires)


class SifLengths(HostCase):
    """Sends SIFs of every length in two pieces, cut anywhere, a reply behind the first one."""

    ID = "host.pieces.sif-lengths"
    EXPECTATION = "Each is handed over as it is, and each call gets its reply."
    REQUIREMENTS = ("J2A-FRAME-005", "J2A-STUFF-003", "J2A-STUFF-005", "J2A-SIF-003", "J2A-SUM-001")
    LEVEL = "sif"

    def _run(self, host: Host) -> None:
        rng = random.Random(8)
        wires = [((255 - n, content(n, 5)), rng.randrange(1, n + 5)) for n in LENGTHS]
        wires += [((0x12, unit * 255), end) for unit in (b"\x12", b"\xed") for end in (500, 511)]
        in_pieces(host, wires)


def in_pieces(host: Host, wires: list[tuple[tuple[int, bytes], int]]) -> None:
    """Send SIFs in two pieces, cut at these places; between them the host takes a reply."""
    anchor(host)
    host.job(f"repeat {len(wires)} call @6 - {host.limit_ms}")
    rest = b""
    for sif, end in wires:
        request = host.request(6, b"")
        wire = host.sif(*sif)
        head, rest_of_it = wire[:end], wire[end:]
        host.send(rest + request.reply(3, b"own") + head)
        host.replied(request)
        rest = rest_of_it
    host.send(rest)
    host.replied_with(3, b"own")
    handed(host, [sif for sif, _ in wires])
