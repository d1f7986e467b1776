"""Stream vectors: bytes in a row with garbage, cuts and raw markers, and what a receiver sees."""

from collections.abc import Iterator
from dataclasses import dataclass
from random import Random

from j2a_spec import constants as c
from j2a_spec.oracle import Frame, encode


@dataclass(frozen=True, slots=True)
class StreamVector:
    """A byte stream that starts between two frames; its meaning is what the oracle says.

    Attributes:
        id: stable name.
        comment: what is special.
        requirements: ids that it exercises.
        stream: the bytes.
    """

    id: str
    comment: str
    requirements: tuple[str, ...]
    stream: bytes


def stream_vectors() -> list[StreamVector]:
    """Return every stream vector, in a fixed order."""
    groups = (_outside(), _cut(), _markers(), _escapes(), _mixed(), _random(), _begun())
    return [
        StreamVector(f"stream-{number:03}", comment, tuple(f"J2A-{i}" for i in ids.split()), stream)
        for number, (comment, ids, stream) in enumerate((r for group in groups for r in group), 1)
    ]


_Row = tuple[str, str, bytes]
_GOOD = Frame(c.SOF, 0x41, 0x05, b"\x12abc")
_NEXT = Frame(c.SOF, 0x42, 0x06, b"\x7d")
_SIF = Frame(c.SOS, 0x00, 0x20, b"\xed\x01")


def _outside() -> Iterator[_Row]:
    good = encode(_GOOD)
    yield "nothing", "FRAME-006", b""
    yield "garbage only", "FRAME-006", bytes(b for b in range(256) if b not in c.MARKERS)
    yield "garbage before a frame", "FRAME-006 FRAME-009", b"\x00\xff\x7d\x11garbage" + good
    yield "ESC before a frame", "FRAME-006 FRAME-007", b"\x7d" + good
    yield "garbage after a frame", "FRAME-006", good + b"\x00\x7d\xff"
    yield "a byte too many between frames", "FRAME-006 FRAME-009", good + b"\x33" + good
    yield "two frames back to back", "FRAME-009", good + encode(_NEXT)
    yield "a reply, a SIF and a reply", "FRAME-003 FRAME-009", good + encode(_SIF) + encode(_NEXT)


def _cut() -> Iterator[_Row]:
    for frame in (_GOOD, _SIF):
        wire = encode(frame)
        for length in range(1, len(wire)):
            comment = f"a frame cut after {length} bytes, then a good one"
            yield comment, "FRAME-007 FRAME-009", wire[:length] + encode(_NEXT)
    wire = encode(_GOOD)
    for length in range(1, len(wire)):
        yield f"the stream ends after {length} bytes of a frame", "FRAME-001", wire[:length]


def _markers() -> Iterator[_Row]:
    good = encode(_NEXT)
    for marker in (c.SOF, c.SOS):
        m = bytes((marker,))
        name = "SOF" if marker == c.SOF else "SOS"
        ids = "FRAME-007 FRAME-009"
        yield f"{name} repeated", ids, m * 5
        yield f"{name} repeated before a frame", ids, m * 5 + good
        for index in range(1, len(good) + 1):
            comment = f"{name} inside a frame, after {index} bytes, then a good frame"
            yield comment, ids, good[:index] + m + good[index:] + good
        yield f"{name} after ESC", ids, b"\x12\x01\x05\x03\x7d" + m + b"\x02\x06\x00\x60" + good


def _escapes() -> Iterator[_Row]:
    good = encode(_NEXT)
    for length in (1, 2, 3, 4):
        wire = encode(_GOOD)[:length] + b"\x7d\xff"
        ids = "STUFF-004 FRAME-009"
        yield f"ESC 0xFF after {length} bytes, then a good frame", ids, wire + good
        yield f"ESC 0xFF after {length} bytes, rest, then a good one", ids, wire + b"ab\x7d" + good
    yield "ESC ESC is 0x7E", "STUFF-003", b"\x12\x01\x05\x02\x7d\x7d\x7d\x7d\x72" + good
    ids = "STUFF-003"
    yield "ESC at the end of the stream", ids, encode(_GOOD)[:5] + b"\x7d"


def _mixed() -> Iterator[_Row]:
    good, sif = encode(_NEXT), encode(_SIF)
    broken = good[:-1] + bytes((good[-1] ^ 1,))
    yield "wrong checksum, then a good frame", "SUM-003 FRAME-009", broken + good
    yield "a SIF with a wrong checksum", "SUM-003 FRAME-009", sif[:-1] + b"\x00" + good
    ids = "FRAME-004 SUM-003 FRAME-009"
    yield "length one too large swallows the next start", ids, b"\x12\x01\x05\x02a\x69" + good
    yield "length one too small", ids, b"\x12\x01\x05\x01ab\x69" + good


def _random() -> Iterator[_Row]:
    random = Random(7)
    alphabet = (c.SOF, c.SOS, c.ESC, 0x11, 0xEC, 0x7C, 0x00, 0x01, 0x02, 0xFF)
    for _ in range(24):
        noise = bytes(random.choices(alphabet, k=random.randrange(1, 60)))
        yield (
            "random bytes with many markers, then a good frame",
            "FRAME-009",
            noise + encode(_GOOD),
        )


def _begun() -> Iterator[_Row]:
    """Whether the seq had come: only when both bytes of a stuffed one are there."""
    good = encode(_NEXT)
    for start in (c.SOF, c.SOS):
        for seq in sorted(c.STUFFED):
            wire = encode(Frame(start, seq, 0x05, b"ab"))
            kind = "a frame" if start == c.SOF else "a SIF"
            for length, part in ((2, "the ESC"), (3, "both bytes")):
                comment = f"{kind} cut behind {part} of its seq 0x{seq:02X}, then a good frame"
                yield comment, "FRAME-007 FRAME-009", wire[:length] + good
            comment = f"the stream ends behind the ESC of the seq 0x{seq:02X} of {kind}"
            yield comment, "FRAME-001 STUFF-005", wire[:2]
    yield (
        "ESC 0xFF in place of seq, then a good frame",
        "STUFF-004 FRAME-009",
        b"\x12\x7d\xff" + good,
    )
    yield "ESC 0xFF behind a stuffed seq", "STUFF-004 FRAME-009", b"\x12\x7d\x11\x7d\xff" + good
