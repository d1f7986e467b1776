"""Frame vectors: one frame each, valid, acceptable or invalid, for both directions of a codec."""

from collections.abc import Iterator
from dataclasses import dataclass
from random import Random
from typing import Literal

from j2a_spec import constants as c
from j2a_spec.oracle import Frame, checksum, encode, stuff

Result = Literal["valid", "acceptable", "invalid"]

SPECIAL = (c.SOF, c.SOS, c.ESC, c.SOF - 1, c.SOS - 1, c.ESC - 1, 0x00, 0xFF)
"""Marker values, their neighbours (which look like the second half of an escape) and the ends."""


@dataclass(frozen=True, slots=True)
class FrameVector:
    """A frame and its bytes.

    Attributes:
        id: stable name.
        comment: what is special.
        requirements: ids that it exercises.
        result: "valid": an encoder gives exactly `wire` and a decoder takes it; "acceptable": a
            decoder takes it, an encoder never gives it; "invalid": a decoder refuses it.
        flags: what kind of oddity, for selecting.
        wire: the bytes, start byte included.
        frame: what it means, None when invalid.
    """

    id: str
    comment: str
    requirements: tuple[str, ...]
    result: Result
    flags: tuple[str, ...]
    wire: bytes
    frame: Frame | None


def frame_vectors() -> list[FrameVector]:
    """Return every frame vector, in a fixed order."""
    groups = (
        *(_thesis(), _fields(), _lengths(), _patterns()),
        *(_needless(), _wrong_shape(), _not_stuffed(), _wrong_checksum(), _bad_escape()),
    )
    return [
        FrameVector(f"frame-{number:03}", *rest)
        for number, rest in enumerate((row for group in groups for row in group), 1)
    ]


_Row = tuple[str, tuple[str, ...], Result, tuple[str, ...], bytes, Frame | None]


def _ids(text: str) -> tuple[str, ...]:
    return tuple(f"J2A-{name}" for name in text.split())


def _valid(comment: str, ids: str, frame: Frame, *flags: str) -> _Row:
    return comment, _ids(ids), "valid", flags, encode(frame), frame


def _thesis() -> Iterator[_Row]:
    frame = Frame(c.SOF, 0x02, 0x11, bytes.fromhex("1212137d"))
    yield _valid(
        "the stuffing example of the thesis; its checksum is 0x15, not 0xD5 as printed",
        "FRAME-001 FRAME-002 STUFF-001 STUFF-002 SUM-001 SUM-002",
        frame,
        "thesis",
    )
    yield _valid("the empty request to opcode 0", "FRAME-001 SUM-001", Frame(c.SOF, 0, 0))
    yield _valid("the empty SIF", "FRAME-003 SUM-001", Frame(c.SOS, 0, 0), "sif")
    yield _valid(
        "the largest frame on the wire: 518 bytes, every byte stuffed but start and length",
        "FRAME-005 STUFF-001 STUFF-005",
        Frame(c.SOF, 0x12, 0x12, b"\x12" * 255),
        "largest",
    )


def _fields() -> Iterator[_Row]:
    for start, flags in ((c.SOF, ()), (c.SOS, ("sif",))):
        for value in SPECIAL:
            name = f"0x{value:02X}"
            stuffed = "STUFF-001" if value in c.STUFFED else "STUFF-002"
            ids = f"{stuffed} STUFF-005"
            frames = {
                "seq": Frame(start, value, 0x05, b"\x01"),
                "opcode": Frame(start, 0x01, value, b"\x02"),
                "length": Frame(start, 0x02, 0x05, bytes(i & 0x0F for i in range(value))),
                "payload": Frame(start, 0x03, 0x05, bytes((1, value, 2, value))),
                "checksum": _with_checksum(start, value),
            }
            for field, frame in frames.items():
                extra = " FRAME-004" if field == "length" else ""
                yield _valid(f"{field} is {name}", ids + extra, frame, *flags, field)


def _with_checksum(start: int, value: int) -> Frame:
    wanted = checksum(4, 5, b"\x00") ^ value
    return Frame(start, 4, 5, bytes((wanted,)))


def _lengths() -> Iterator[_Row]:
    for length in (1, 2, 3, 4, 63, 64, 65, 127, 128, 129, 249, 250, 254, 255):
        payload = bytes((i * 7 + length) & 0xFF for i in range(length))
        yield _valid(
            f"payload of {length} bytes", "FRAME-004 FRAME-005", Frame(c.SOF, length, 0x21, payload)
        )


def _patterns() -> Iterator[_Row]:
    for value in (0x12, 0xED, 0x7D, 0x11, 0xEC, 0x7C):
        for length in (1, 17, 255):
            yield _valid(
                f"{length} times 0x{value:02X}",
                "STUFF-001 STUFF-002 SUM-001",
                Frame(c.SOF, 9, 0x22, bytes((value,)) * length),
            )
    random = Random(2014)
    for number in range(8):
        payload = random.randbytes(random.randrange(256))
        start = c.SOS if number % 2 else c.SOF
        frame = Frame(start, random.randrange(256), random.randrange(256), payload)
        yield _valid("random bytes", "FRAME-001 SUM-001", frame, "random")


def _needless() -> Iterator[_Row]:
    frame = Frame(c.SOF, 0x20, 0x30, b"\x41\x01\xff")
    body = encode(frame)[1:]
    ids = _ids("STUFF-002 STUFF-003")
    for index, byte in enumerate(body):
        if byte:
            wire = bytes((c.SOF, *body[:index], c.ESC, byte - 1, *body[index + 1 :]))
            comment = f"needless escape of byte {index + 1}, 0x{byte:02X}"
            yield comment, ids, "acceptable", ("needless-escape",), wire, frame
    every = b"".join(bytes((c.ESC, byte - 1)) for byte in body)
    wire = bytes((c.SOF,)) + every
    yield "every byte escaped", ids, "acceptable", ("needless-escape",), wire, frame
    # ESC followed by ESC is the value 0x7E: the second ESC escapes nothing.
    frame = Frame(c.SOF, 0x21, 0x30, b"\x7e")
    wire = encode(frame).replace(b"\x7e", b"\x7d\x7d")
    yield "ESC ESC is 0x7E", ids, "acceptable", ("needless-escape",), wire, frame


_GOOD = Frame(c.SOF, 0x31, 0x05, b"\x01\x02\x03")
_BODY = encode(_GOOD)[1:]
"""The frame that the invalid vectors spoil; none of its bytes is stuffed."""


def _invalid(comment: str, ids: str, flag: str, wire: bytes) -> _Row:
    return comment, _ids(ids), "invalid", (flag,), wire, None


def _wrong_shape() -> Iterator[_Row]:
    for start in (0x00, 0x11, 0x13, 0x7D, 0x7E, 0xEC, 0xEE, 0xFF):
        comment = f"starts with 0x{start:02X}"
        yield _invalid(comment, "FRAME-002 FRAME-003 FRAME-006", "start", bytes((start,)) + _BODY)
    sof = bytes((c.SOF,))
    swapped = bytes((_BODY[1], _BODY[0])) + _BODY[2:]
    yield _invalid("opcode before seq", "FRAME-001", "opcode", sof + swapped)
    swapped = bytes((_BODY[0], _BODY[2], _BODY[1])) + _BODY[3:]
    yield _invalid("length before opcode", "FRAME-001", "length", sof + swapped)
    yield _invalid("no checksum", "FRAME-001", "checksum", sof + _BODY[:-1])
    yield _invalid("checksum first", "FRAME-001", "checksum", sof + _BODY[-1:] + _BODY[:-1])
    for length in (2, 4):
        body = _BODY[:2] + bytes((length,)) + _BODY[3:-1]
        body += bytes((checksum(_GOOD.seq, _GOOD.opcode, bytes(length)) ^ 1 ^ 2 ^ 3,))
        yield _invalid(f"length {length} for 3 bytes", "FRAME-004", "length", sof + body)
    length_with_start = _BODY[:2] + bytes((len(_BODY) + 1,)) + _BODY[3:]
    yield _invalid("length of the whole frame", "FRAME-004", "length", sof + length_with_start)


def _not_stuffed() -> Iterator[_Row]:
    """A value that has to be stuffed and is not, or whose stuffing the sum covers."""
    for value in sorted(c.STUFFED):
        frames = {
            "seq": Frame(c.SOF, value, 0x05, b"\x01"),
            "opcode": Frame(c.SOF, 0x01, value, b"\x02"),
            "length": Frame(c.SOF, 0x02, 0x05, bytes(value)),
            "payload": Frame(c.SOF, 0x03, 0x05, bytes((1, value, 2))),
            "checksum": _with_checksum(c.SOF, value),
        }
        pair = bytes((c.ESC, value - 1))
        for field, frame in frames.items():
            wire = encode(frame)
            raw = wire.replace(pair, bytes((value,)))
            yield _invalid(f"raw 0x{value:02X} as {field}", "STUFF-001", field, raw)
            if field != "checksum":
                total = wire[-1] ^ value ^ c.ESC ^ (value - 1)
                wire = wire[:-1] + stuff(bytes((total,)))
                comment = f"0x{value:02X} as {field}, the checksum covers the stuffed bytes"
                yield _invalid(comment, "STUFF-005 SUM-002 SUM-003", field, wire)
            if (field, value) != ("checksum", c.ESC):  # that is right, with a byte too many
                twice = wire.replace(pair, bytes((c.ESC, c.ESC - 1, value - 1)))
                comment = f"0x{value:02X} as {field}, stuffed twice"
                yield _invalid(comment, "STUFF-005", field, twice)


def _wrong_checksum() -> Iterator[_Row]:
    for bit in range(8):
        wire = bytes((c.SOF,)) + stuff(_BODY[:-1] + bytes((_BODY[-1] ^ 1 << bit,)))
        yield _invalid(f"bit {bit} is wrong", "SUM-001 SUM-003", "checksum", wire)
    wrong = {
        "without the 11 of the opcode": 0x05 ^ (0x05 + c.CHK_OPCODE),
        "without the 97 of the length": 3 ^ (3 + c.CHK_LENGTH),
        "covers the start byte": c.SOF,
        "without the seq": _GOOD.seq,
    }
    for comment, difference in wrong.items():
        wire = bytes((c.SOF,)) + stuff(_BODY[:-1] + bytes((_BODY[-1] ^ difference,)))
        yield _invalid(comment, "SUM-001 SUM-002 SUM-003", "checksum", wire)


def _bad_escape() -> Iterator[_Row]:
    whole = encode(_GOOD)
    for index in range(1, len(whole)):
        wire = whole[:index] + bytes((c.ESC, 0xFF)) + whole[index:]
        yield _invalid(f"ESC 0xFF after {index} bytes", "STUFF-003 STUFF-004", "escape", wire)
