"""What host and suite say to each other, and where two of these differ, in words.

What flows in: requests, texts of outcomes, bytes. What flows out: a sentence that names the first
byte or the SIF that is wrong. Rules: a host reports long data by length and CRC-32, so that what
it got is found by trying: one byte, one SIF, a cut.
"""

import re
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from j2a_spec import constants as c
from j2a_spec.plural import counted

from ._dimensions import frame

__all__ = ["Outcome", "Request", "Sifs", "difference", "explain", "explain_sifs", "spell"]

Sifs = list[tuple[int, bytes]]
"""Opcode and payload of SIFs, in the order in which they are sent."""

_SPELT: Final = 100
_NEAR: Final = 4
_LONG: Final = re.compile(r"(\d+)#([0-9a-f]{8})")
_FATES: Final = ("not-sent", "maybe-executed", "answered")


def spell(data: bytes) -> str:
    """Return data as a host program reports it: in hex, or its length and CRC-32, or "-"."""
    if len(data) > _SPELT:
        return f"{len(data)}#{zlib.crc32(data):08x}"
    return data.hex() or "-"


@dataclass(frozen=True, slots=True)
class Request:
    """A request of the host: seq, opcode, payload, its size on the wire in bytes."""

    seq: int
    opcode: int
    payload: bytes
    size: int
    is_barrier: bool = False

    def reply(self, code: int = c.RET_OK, payload: bytes = b"") -> bytes:
        """Return the wire bytes of a reply to it."""
        return frame(c.SOF, self.seq, code, payload)


@dataclass(frozen=True, slots=True)
class Outcome:
    """The report of the host program on its last job.

    Attributes:
        whole: as it was reported.
        text: the same, but for `fate`.
        word: the first word of it.
        rest: what follows the first word.
        fate: what the library says of a request that failed; "" where it says nothing.
    """

    whole: str
    text: str
    word: str
    rest: str
    fate: str

    @classmethod
    def parse(cls, whole: str) -> "Outcome":
        """Take a report apart."""
        before, _, last = whole.rpartition(" ")
        fate = last if last in _FATES else ""
        text = before if fate else whole
        word, _, rest = text.partition(" ")
        return cls(whole, text, word, rest, fate)


def difference(came: bytes, due: bytes) -> str:
    """Return where `came` begins to differ from `due`: the first byte, or where one ends."""
    for index, (one, other) in enumerate(zip(came, due, strict=False)):
        if one != other:
            near = slice(max(0, index - _NEAR), index + _NEAR + 1)
            return (
                f"byte {index} is 0x{one:02X}, not 0x{other:02X} "
                f"(… {came[near].hex(' ')} …, due … {due[near].hex(' ')} …)"
            )
    return f"it has {counted(len(came), 'byte')}, not {len(due)}" if len(came) != len(due) else ""


def explain(reported: str, due: bytes) -> str:
    """Return where reported data differ from the expected data, or "" if that is unknown."""
    if (match := _LONG.fullmatch(reported)) is None:
        try:
            return difference(bytes.fromhex(reported.replace("-", "")), due)
        except ValueError:
            return ""
    size, crc = int(match[1]), int(match[2], 16)
    if size != len(due):
        for cut, where in ((due[:size], "the end"), (due[-size:], "the beginning")):
            if zlib.crc32(cut) == crc and size < len(due):
                return f"it has {counted(size, 'byte')}, not {len(due)}: {where} is missing"
        return f"it has {counted(size, 'byte')}, not {len(due)}"
    for index, byte in enumerate(due if size <= 2 * c.MAX_PAYLOAD else b""):
        head = zlib.crc32(due[:index])
        for other in range(256):
            if (
                other != byte
                and zlib.crc32(due[index + 1 :], zlib.crc32(bytes((other,)), head)) == crc
            ):
                return f"byte {index} is 0x{other:02X}, not 0x{byte:02X}"
    return "more than one byte is another"


def _joined(sifs: Sequence[tuple[int, bytes]]) -> bytes:
    return b"".join(bytes((opcode, len(payload))) + payload for opcode, payload in sifs)


def explain_sifs(reported: str, due: Sifs, never: Sequence[tuple[int, tuple[int, bytes]]]) -> str:
    """Return which SIF is missing, comes twice, too early or damaged; "" if that is unknown.

    Args:
        reported: the joined SIFs, as a host program spells them.
        due: what it should have reported.
        never: those that it must not report, each with how many of `due` came before it.
    """
    for what, found in _guesses(due, never):
        if spell(_joined(found)) == reported:
            return what
    if _LONG.fullmatch(reported) is None:
        return explain(reported, _joined(due))
    more = int(reported.partition("#")[0]) - len(_joined(due))
    if not more:
        return "as many bytes as are due, but others, or in another order"
    return f"{abs(more)} bytes {'more' if more > 0 else 'less'} than are due"


def _guesses(
    due: Sifs, never: Sequence[tuple[int, tuple[int, bytes]]]
) -> Iterator[tuple[str, Sifs]]:
    yield "none was handed over", []
    for index, sif in enumerate(due):
        named = f"SIF {index} of {len(due)} (opcode 0x{sif[0]:02X}, {len(sif[1])} bytes)"
        before, behind = due[:index], due[index + 1 :]
        yield f"{named} is missing", before + behind
        yield f"{named} came twice", [*before, sif, sif, *behind]
        yield f"{named} and all behind it are missing", before
        if behind:
            yield f"{named} came behind the next one", [*before, behind[0], sif, *behind[1:]]
            yield f"{named} and all before it are missing", behind
    for index, sif in never:
        text = f"a broken SIF was handed over: opcode 0x{sif[0]:02X}, {len(sif[1])} bytes"
        yield text, [*due[:index], sif, *due[index:]]
    opcodes = [(o, p) for o, p in due if o < c.ERR_OPCODE]
    yield "those with opcodes from 0xF0 are missing", opcodes
