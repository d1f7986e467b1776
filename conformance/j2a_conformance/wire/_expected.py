"""Requests, the replies that they are due, and what came instead, in words.

What flows in: the fields of frames. What flows out: wire bytes of the oracle, and texts.
"""

import re
from dataclasses import dataclass, field

from j2a_spec import constants as c
from j2a_spec.oracle import Event, Frame, FrameError, Skipped, encode
from j2a_spec.plural import counted

__all__ = [
    "DAMAGE",
    "Expected",
    "ManyReply",
    "Request",
    "describe",
    "difference",
    "first_difference",
    "many_payload",
    "number",
    "refusal",
]

DAMAGE = frozenset({c.ERR_TIMEOUT, c.ERR_CHECKSUM, c.ERR_FRAMING})
"""Codes that say that the request was damaged on its way."""


RESERVED = frozenset(range(c.RET_MAX + 1, c.RET_FAILED)) - c.ERRORS
"""Codes that no device sends (J2A-ERR-011)."""

_NEVER = DAMAGE | RESERVED


@dataclass(frozen=True, slots=True)
class Expected:
    """An expected reply.

    None leaves a field open; even then the code says neither that the request was damaged, nor is
    it reserved (J2A-ERR-011).
    """

    seq: int
    code: int | None = None
    payload: bytes | None = None

    def matches(self, frame: Frame) -> bool:
        """Tell whether `frame` is this reply."""
        return (
            frame.start == c.SOF
            and frame.seq == self.seq
            and (frame.opcode not in _NEVER if self.code is None else frame.opcode == self.code)
            and self.payload in (None, frame.payload)
        )

    @property
    def wire(self) -> bytes:
        """Its bytes on the wire, or b"" where a field is open."""
        if self.code is None or self.payload is None:
            return b""
        return encode(Frame(c.SOF, self.seq, self.code, self.payload))

    def __str__(self) -> str:
        code = "any code" if self.code is None else f"code 0x{self.code:02X}"
        payload = "any payload" if self.payload is None else _payload(self.payload)
        return f"a reply with seq 0x{self.seq:02X}, {code}, {payload}"


def refusal(seq: int, code: int) -> Expected:
    """The error reply `code` to the request `seq`; its payload is left open."""
    return Expected(seq, code)


@dataclass(frozen=True, slots=True)
class Request:
    """Wire bytes of a request and its expected reply."""

    wire: bytes
    expected: Expected
    seq: int = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "seq", self.expected.seq)


@dataclass(frozen=True, slots=True)
class ManyReply:
    """The payload of a reply of a2jMany, taken apart; offset in bytes."""

    code: int
    flags: int
    offset: int
    data: bytes


def many_payload(func: int, flags: int = 0, offset: int = 0, data: bytes = b"") -> bytes:
    """Return the payload of a request to a2jMany; `flags` may hold any bits."""
    return bytes((func, flags)) + offset.to_bytes(4, "little") + data


def number(value: str) -> int:
    """Return the number of a property such as j2a.room, or 0 where a host takes it as absent.

    More than 10 digits are no number (J2A-LIMIT-009), and could be more than `int` takes.
    """
    return int(value) if re.fullmatch(r"[1-9][0-9]{0,9}", value) else 0


def first_difference(came: bytes, due: bytes) -> str:
    """Return where two byte strings part, in words; places count from 1."""
    for place, (here, there) in enumerate(zip(came, due, strict=False), 1):
        if here != there:
            return f"byte {place} of {len(due)} is 0x{here:02X} and not 0x{there:02X}"
    return f"{counted(len(came), 'byte')} and not {len(due)}"


def difference(came: Event, due: Expected) -> str:
    """Return where the payload of a frame parts from the due one, or "" where it does not."""
    if not isinstance(came, Frame) or due.payload in (None, came.payload):
        return ""
    return f"; payload: {first_difference(came.payload, due.payload or b'')}"


def describe(event: Event) -> str:
    """Return what an event is, in words."""
    match event:
        case Frame(start, seq, opcode, payload):
            name = "SOF" if start == c.SOF else "SOS"
            return f"a {name} frame with seq 0x{seq:02X}, code 0x{opcode:02X}, {_payload(payload)}"
        case FrameError("checksum"):
            return "a frame whose checksum is wrong"
        case FrameError("marker"):
            return "a frame that a raw start byte cuts short"
        case FrameError():
            return "a frame with ESC 0xFF in it"
        case Skipped(count):
            return f"{counted(count, 'byte')} outside a frame"
        case _:
            return "a frame without its end"


def _payload(payload: bytes) -> str:
    shown = payload[:16].hex(" ") + (" ..." if len(payload) > 16 else "")
    return f"{len(payload)} payload bytes [{shown}]" if payload else "no payload"
