"""Payloads as people write and read them.

In: words such as `12 ed`, `u16:500`, `str:hello`, `@file`; and payloads. Out: bytes; and texts.
Rules: numbers are little endian, as J2A's own fields are; a word that cannot be read is a
`UsageError` that says what can be written instead.
"""

import math
import re
import struct
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import BinaryIO, Final

from j2a_spec.plural import counted

from j2a.cli._exit import UsageError
from j2a.types.coding import NUMBER_CODES
from j2a.types.model import integer_range
from j2a.types.transducers import shortest_f32

PAYLOAD_HELP: Final = """\
payload words, put one after the other:
  12 ed  12ed  0x12ed    bytes in hex
  u8: i8: u16: i16: u32: i32: u64: i64: f32: f64:
                         a number, little endian; several with commas: u16:500,0x1f4
  str:hello              text as UTF-8, without a zero at the end
  hex:12ed               bytes in hex
  @FILE                  the content of a file
  -                      standard input, to its end"""

_KINDS: Final = (*NUMBER_CODES, "str", "hex")
_TYPED: Final = re.compile(r"([A-Za-z][A-Za-z0-9]*):(.*)", re.DOTALL)
_MOST: Final = 2**32
"""Bytes of a file; an offset of a2jMany has 32 bits."""
_PIECE: Final = 2**20
_HEX_SEPARATORS: Final = re.compile(r"[\s,:_]+|(?<![0-9A-Za-z])0[xX](?=[0-9A-Fa-f])")
_SHOWN_AS: Final = {0x5C: "\\\\", 0x0A: "\\n", 0x0D: "\\r", 0x09: "\\t", 0x00: "\\0"}


def payload_of(words: Sequence[str]) -> bytes:
    """Return the bytes that payload words stand for; see `PAYLOAD_HELP`.

    Raises:
        UsageError: a word cannot be read, or a number does not fit its type.
    """
    return b"".join(_bytes_of(word) for word in words)


def is_payload_word(word: str) -> bool:
    """Tell whether a word is written with its type, as in u16:5, or names where bytes come from."""
    typed = _TYPED.fullmatch(word)
    is_typed = typed is not None and typed[1].lower() in _KINDS
    return is_typed or word == "-" or word.startswith("@")


def _bytes_of(word: str) -> bytes:
    if word == "-":
        if sys.stdin is None:
            raise UsageError("-: standard input is closed")
        return _content(sys.stdin.buffer, "standard input")
    if word.startswith("@"):
        return file_content(word[1:])
    typed = _TYPED.fullmatch(word)
    if typed is None:
        return _hex(word, word)
    kind, value = typed[1].lower(), typed[2]
    if kind == "str":
        return value.encode("utf-8", "surrogateescape")
    if kind == "hex":
        return _hex(value, word)
    if kind in NUMBER_CODES:
        return b"".join(_number(kind, text, word) for text in value.split(","))
    raise UsageError(f"{word!r}: unknown type {typed[1]!r}; known types: {', '.join(_KINDS)}")


def file_content(name: str) -> bytes:
    """Return the content of a file.

    Raises:
        UsageError: it cannot be read.
    """
    try:
        with Path(name).open("rb") as file:
            return _content(file, repr(name))
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise UsageError(f"cannot read {name!r}: {reason}") from None


def _content(file: BinaryIO, name: str) -> bytes:
    data = bytearray()
    try:
        while True:
            piece = file.read(_PIECE)
            data += piece
            if len(data) > _MOST:
                raise UsageError(f"{name} has more than 4 GiB, more than a transfer can carry")
            if len(piece) < _PIECE:  # the end, which a terminal would have to say again
                return bytes(data)
    except MemoryError:
        raise UsageError(f"{name} does not fit into memory") from None


def _hex(digits: str, word: str) -> bytes:
    try:
        return bytes.fromhex(_HEX_SEPARATORS.sub(" ", digits))
    except ValueError:
        if Path(word).is_file():
            raise UsageError(f"{word!r}: for the content of the file write @{word}") from None
        raise UsageError(
            f"{word!r}: bytes in hex have two digits each, as in 12 ed; for anything else name "
            "the type, as in u16:500, i32:-4, str:hello, @FILE"
        ) from None


def _number(kind: str, text: str, word: str) -> bytes:
    code = NUMBER_CODES[kind]
    try:
        if kind.startswith("f"):
            return struct.pack("<" + code, finite_or_said(text))
        return struct.pack("<" + code, int(text, 0))
    except (struct.error, OverflowError):
        raise UsageError(f"{word!r}: {text} does not fit {_range(kind)}") from None
    except ValueError:
        what = "a number" if kind.startswith("f") else "a whole number (decimal, 0x, 0b or 0o)"
        raise UsageError(f"{word!r}: {text!r} is not {what}") from None


def finite_or_said(text: str) -> float:
    """Return the number of a text, which is infinite only where the text says so, as in -inf.

    Raises:
        ValueError: it is no number.
        OverflowError: it is larger than any.
    """
    number = float(text)
    if math.isinf(number) and "inf" not in text.lower():
        raise OverflowError(f"{text:.40} is beyond the numbers of an f64")
    return number


class _F32(float):
    """An f32, of which people see the digits that matter; its `repr`, and so JSON, has all."""

    __slots__ = ()

    def __str__(self) -> str:
        return str(shortest_f32(float(self)))


def _range(kind: str) -> str:
    if kind.startswith("f"):
        return kind
    allowed = integer_range(kind)
    return f"{kind}, which goes from {allowed[0]} to {allowed[-1]}"


class Decoder:
    """Reads a payload as a row of typed values.

    Args:
        spec: types with commas, such as `i32,u64`; `str` and `hex` take all that is left; a type
            followed by `*` is repeated to the end.

    Raises:
        UsageError: a type is unknown, or comes after one that takes everything.
    """

    def __init__(self, spec: str) -> None:
        self._spec = spec
        self._kinds = [kind.strip().lower() for kind in spec.split(",")]
        for kind in self._kinds:
            if kind not in _KINDS and kind.removesuffix("*") not in NUMBER_CODES:
                known = ", ".join(_KINDS)
                raise UsageError(f"--as {spec}: unknown type {kind!r}; known types: {known}")
        for kind in self._kinds[:-1]:
            if kind not in NUMBER_CODES:
                raise UsageError(f"--as {spec}: nothing can follow {kind}, which takes the rest")

    def values(self, payload: bytes) -> list[int | float | str]:
        """Return the values; bytes in hex come as text.

        Raises:
            ValueError: the payload does not have the size of these types.
        """
        *kinds, last = self._kinds
        layout = "<" + "".join(NUMBER_CODES[kind] for kind in kinds)
        size = struct.calcsize(layout)
        rest = payload[size:]
        try:
            values: list[int | float | str] = list(struct.unpack(layout, payload[:size]))
            if last == "str":
                values.append(rest.decode("utf-8", "replace"))
            elif last == "hex":
                values.append(rest.hex())
            else:
                values += self._repeated(last, rest)
        except struct.error:
            length = counted(len(payload), "byte")
            raise ValueError(f"{length} cannot be read as {self._spec}") from None
        repeated = [last.rstrip("*")] * (len(values) - len(kinds))
        return [
            _F32(value) if kind == "f32" else value
            for kind, value in zip([*kinds, *repeated], values, strict=True)
        ]

    @staticmethod
    def _repeated(kind: str, rest: bytes) -> Iterable[int | float]:
        item = "<" + NUMBER_CODES[kind.rstrip("*")]
        if kind.endswith("*"):
            return [value for (value,) in struct.iter_unpack(item, rest)]
        return struct.unpack(item, rest)


def text_of(data: bytes) -> str:
    """Return the bytes as a quoted text when they read as one, "" when they do not."""
    # Numbers such as 41 00 00 00 are valid UTF-8 too; texts have single zeros, between or after.
    if not data or data[0] == 0 or b"\0\0" in data:
        return ""
    try:
        shown = data.decode("utf-8").translate(_SHOWN_AS)
    except UnicodeDecodeError:
        return ""
    return f'"{shown}"' if shown.isprintable() else ""


def dump(data: bytes) -> list[str]:
    """Return lines of 16 bytes with offset, hex and ASCII."""
    lines = []
    for offset in range(0, len(data), 16):
        row = data[offset : offset + 16]
        ascii_ = "".join(chr(byte) if 0x20 <= byte < 0x7F else "." for byte in row)
        lines.append(f"{offset:06x}  {row.hex(' '):<47}  |{ascii_}|")
    return lines


def short_hex(data: bytes) -> str:
    """Return the bytes in hex, cut after 16 of them."""
    return data.hex(" ") if len(data) <= 16 else f"{data[:16].hex(' ')} ... ({len(data)} bytes)"
