"""Bytes on the wire in words: fields are separated, escapes stay together.

What flows in: raw bytes. What flows out: one `Annotated` for each piece of the stream, for any
report.
"""

import re
from dataclasses import dataclass
from typing import Final

from j2a_spec import constants as c
from j2a_spec.oracle import Frame, FrameError, Incomplete

from j2a_conformance.wire._link import Splitter

__all__ = ["Annotated", "Field", "annotate"]

_SHOWN: Final = 12
_HEADER: Final = ("seq", "opcode", "length")
_SYMBOL: Final = re.compile(rb"%s.|." % re.escape(bytes((c.ESC,))), re.DOTALL)
_ESCAPE_FF: Final = bytes((c.ESC, 0xFF))


@dataclass(frozen=True, slots=True)
class Field:
    """A field of a frame as it is on the wire, or bytes that are in no frame.

    Attributes:
        name: start, seq, opcode, length, payload or checksum; "" outside a frame.
        symbols: single bytes, and escape pairs.
    """

    name: str
    symbols: tuple[bytes, ...]

    def __str__(self) -> str:
        """Return the bytes in hex, shortened where there are many."""
        if len(self.symbols) <= _SHOWN:
            return b"".join(self.symbols).hex(" ")
        head, tail = b"".join(self.symbols[:8]).hex(" "), b"".join(self.symbols[-2:]).hex(" ")
        return f"{head} ..{len(self.symbols) - 10} more.. {tail}"


@dataclass(frozen=True, slots=True)
class Annotated:
    """A piece of a stream.

    Attributes:
        parts: its fields, those that have a byte.
        meaning: what the piece is, with the values after unstuffing.
    """

    parts: tuple[Field, ...]
    meaning: str

    @property
    def fields(self) -> tuple[str, ...]:
        """The bytes in hex, one text for each field; long payloads are shortened."""
        return tuple(str(part) for part in self.parts)


def annotate(data: bytes) -> list[Annotated]:
    """Take a stream apart that begins between two frames."""
    splitter = Splitter()
    found = [_piece(arrival.raw, arrival.event) for arrival in splitter.feed(data, 0.0)]
    if splitter.tail:
        found.append(_piece(splitter.tail, Incomplete(splitter.tail[0], None)))
    return found


def _piece(raw: bytes, event: object) -> Annotated:
    if raw[0] not in c.MARKERS:
        return Annotated((Field("", _symbols(raw)),), f"{len(raw)} bytes without a start byte")
    start = "SOF" if raw[0] == c.SOF else "SOS"
    symbols = _symbols(raw[1:])
    # Of an ESC that ends the piece the value has not come; ESC 0xFF has none.
    ends_in_escape = bool(symbols) and symbols[-1] == bytes((c.ESC,))
    values = [
        symbol[-1] if len(symbol) == 1 else (symbol[1] + 1) & 0xFF
        for symbol in (symbols[:-1] if ends_in_escape else symbols)
        if symbol != _ESCAPE_FF
    ]
    fields = [Field("start", (raw[:1],))]
    fields += [Field(name, (symbol,)) for name, symbol in zip(_HEADER, symbols, strict=False)]
    if len(symbols) > 3:
        end = 3 + (values[2] if len(values) > 2 else 0)
        fields += [Field("payload", symbols[3:end]), Field("checksum", symbols[end:])]
    named = zip(_HEADER, values, strict=False)
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
    if ends_in_escape and not isinstance(event, Frame):
        words.append("behind ESC")
    return Annotated(tuple(field for field in fields if field.symbols), " ".join(words))


def _symbols(data: bytes) -> tuple[bytes, ...]:
    """Split into single bytes and escape pairs."""
    return tuple(_SYMBOL.findall(data))
