"""Frames to wire bytes, and the two sums that both directions share.

What flows in: the fields of one frame. What flows out: its bytes on the wire, 5 to 518 of them.
Rules: pure functions without state; arguments are trusted here, because the public surface has
checked them. Speed comes from whole-string operations: a frame costs a handful of calls into C
however long it is.
"""

from typing import Final

from j2a_spec.constants import CHK_LENGTH, CHK_OPCODE, ESC, SOF, SOS

__all__ = ["LENGTH_FOLD", "OPCODE_FOLD", "encode", "fold", "stuff", "unstuff"]

SOF_BYTE: Final = bytes((SOF,))
SOS_BYTE: Final = bytes((SOS,))
ESC_BYTE: Final = bytes((ESC,))
ESCAPED_SOF: Final = bytes((ESC, SOF - 1))
ESCAPED_SOS: Final = bytes((ESC, SOS - 1))
ESCAPED_ESC: Final = bytes((ESC, ESC - 1))

# What the checksum adds to the plain XOR of all bytes for a given opcode or length.
OPCODE_FOLD: Final = tuple(value ^ (value + CHK_OPCODE) & 0xFF for value in range(256))
LENGTH_FOLD: Final = tuple(value ^ (value + CHK_LENGTH) & 0xFF for value in range(256))

_from_bytes: Final = int.from_bytes
_LOW_128: Final = (1 << 128) - 1
_LOW_512: Final = (1 << 512) - 1
# Up to this many escapes are cheaper one by one than by three replacements.
_FEW: Final = 8


def fold(data: bytes) -> int:
    """Return the XOR of all bytes of `data`, which has at most 384 of them.

    The bytes become one integer that is folded onto itself, half as wide each time. The bits above
    a fold are rubbish that never reaches the lowest byte; they are cut off once, where they would
    make the rest slow.
    """
    bits = _from_bytes(data, "little")
    if len(data) > 8:
        if len(data) > 64:
            bits ^= bits >> 1024 ^ bits >> 2048
            bits = (bits ^ bits >> 512) & _LOW_512
        if len(data) > 16:
            bits ^= bits >> 256
            bits = (bits ^ bits >> 128) & _LOW_128
        bits ^= bits >> 64
    bits ^= bits >> 32
    bits ^= bits >> 16
    return (bits ^ bits >> 8) & 0xFF


def stuff(data: bytes) -> bytes:
    """Return `data` with SOF, SOS and ESC escaped (J2A-STUFF-001); ESC first, it is in the rest."""
    if ESC not in data and SOF not in data and SOS not in data:
        return data  # as for most small frames
    return (
        data.replace(ESC_BYTE, ESCAPED_ESC)
        .replace(SOF_BYTE, ESCAPED_SOF)
        .replace(SOS_BYTE, ESCAPED_SOS)
    )


def unstuff(data: bytes) -> bytes | None:
    """Return `data` with its escapes resolved, or None when one of them is not plain.

    Not plain are ESC 0xFF, ESC ESC and an ESC at the end; the caller takes such data byte by byte.
    """
    parts = data.split(ESC_BYTE)
    escapes = len(parts) - 1
    if not escapes:
        return data
    if escapes <= _FEW:
        body = bytearray().join(parts)
        position = len(parts[0])
        del parts[0]
        if b"" in parts:
            return None
        try:
            for part in parts:
                body[position] += 1
                position += len(part)
        except ValueError:
            return None
        return bytes(body)
    # ESC comes last: resolved earlier it would make escapes that were not sent.
    plain = (
        data.replace(ESCAPED_SOF, SOF_BYTE)
        .replace(ESCAPED_SOS, SOS_BYTE)
        .replace(ESCAPED_ESC, ESC_BYTE)
    )
    # Each replacement takes one byte away; if that is one for every ESC, all of them were in pairs.
    return plain if len(data) - len(plain) == escapes else None


def encode(start: int, seq: int, opcode: int, payload: bytes) -> bytes:
    """Return the wire bytes of a frame (J2A-FRAME-001).

    Args:
        start: SOF or SOS.
        seq: 0..255.
        opcode: 0..255; in a reply the return value.
        payload: 0..255 bytes.
    """
    length = len(payload)
    checksum = seq ^ opcode ^ OPCODE_FOLD[opcode] ^ length ^ LENGTH_FOLD[length] ^ fold(payload)
    return b"%c%b" % (start, stuff(b"%c%c%c%b%c" % (seq, opcode, length, payload, checksum)))
