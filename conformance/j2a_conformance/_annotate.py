"""Bytes on the wire in words: fields are separated, escapes stay together.

What flows in: raw bytes. What flows out: one `Annotated` for each piece of the stream, for any
report.
"""

from collections.abc import Iterator
from dataclasses import dataclass

from j2a_spec import constants as c
from j2a_spec.oracle import Frame, FrameError, Incomplete

from ._wire import Splitter

__all__ = ["Annotated", "annotate"]

_SHOWN = 12


@dataclass(frozen=True, slots=True)
class Annotated:
    """A piece of a stream.

    Attributes:
        fields: the bytes in hex, one text for each field; long payloads are shortened.
        meaning: what the piece is, with the values after unstuffing.
    """

    fields: tuple[str, ...]
    meaning: str


def annotate(data: bytes) -> list[Annotated]:
    """Take a stream apart that begins between two frames."""
    splitter = Splitter()
    found = [_piece(arrival.raw, arrival.event) for arrival in splitter.feed(data, 0.0)]
    if splitter.tail:
        found.append(_piece(splitter.tail, Incomplete(splitter.tail[0], None)))
    return found


def _piece(raw: bytes, event: object) -> Annotated:
    if raw[0] not in c.MARKERS:
        return Annotated((_short(list(_symbols(raw))),), f"{len(raw)} bytes without a start byte")
    start = "SOF" if raw[0] == c.SOF else "SOS"
    symbols = list(_symbols(raw[1:]))
    values = [symbol[-1] if len(symbol) == 1 else (symbol[1] + 1) & 0xFF for symbol in symbols]
    fields = [raw[:1].hex(), *(symbol.hex(" ") for symbol in symbols[:3])]
    if len(symbols) > 3:
        size = values[2]
        fields += [_short(symbols[3 : 3 + size]), _short(symbols[3 + size :])]
    named = zip(("seq", "opcode", "length"), values, strict=False)
    words = [start, *(f"{name}=0x{value:02X}" for name, value in named)]
    match event:
        case Frame():
            words.append("checksum right")
        case FrameError(reason):
            words.append(
                {
                    "checksum": "CHECKSUM WRONG",
                    "marker": "CUT by the next start byte",
                    "escape": "BROKEN by ESC FF",
                }[reason]
            )
        case _:
            words.append("INCOMPLETE")
    return Annotated(tuple(field for field in fields if field), " ".join(words))


def _symbols(data: bytes) -> Iterator[bytes]:
    """Split into single bytes and escape pairs."""
    index = 0
    while index < len(data):
        size = 2 if data[index] == c.ESC and index + 1 < len(data) else 1
        yield data[index : index + size]
        index += size


def _short(symbols: list[bytes]) -> str:
    if len(symbols) <= _SHOWN:
        return b"".join(symbols).hex(" ")
    head, tail = b"".join(symbols[:8]).hex(" "), b"".join(symbols[-2:]).hex(" ")
    return f"{head} ..{len(symbols) - 10} more.. {tail}"
