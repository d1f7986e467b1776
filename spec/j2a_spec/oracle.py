"""The oracle: what any byte stream means, slow and obvious.

What flows in: whole byte strings. What flows out: events in the order in which their last byte
came. Rules: nothing here is incremental, and no implementation of J2A uses it to run; tests compare
with it and the vectors are made by it. It reads and builds frames without the grammar, so that a
test can compare the two.
"""

import re
from dataclasses import dataclass
from typing import Final, Literal

from j2a_spec import constants as c
from j2a_spec.grammar import checksum

__all__ = [
    "ERROR_CODES",
    "Event",
    "Frame",
    "FrameError",
    "Incomplete",
    "Reason",
    "Skipped",
    "checksum",
    "decode",
    "encode",
    "stuff",
]

_ESC: Final = re.escape(bytes((c.ESC,)))
_BEFORE_MARKER: Final = re.compile(rb"(?=[%s])" % re.escape(bytes(sorted(c.MARKERS))))
_ESCAPED: Final = re.compile(rb"%s(.)" % _ESC, re.DOTALL)
# What stands on the wire for one byte, and for as many as there are: ESC 0xFF ends a frame.
_BYTE: Final = re.compile(rb"[^%s]|%s[^\xff]" % (_ESC, _ESC), re.DOTALL)
_BYTES: Final = re.compile(rb"(?:%s)*" % _BYTE.pattern, re.DOTALL)
_FORBIDDEN: Final = bytes((c.ESC, 0xFF))
# ESC comes first, or those that are put in would be escaped.
_STUFFING: Final = tuple((bytes((v,)), bytes((c.ESC, v - 1))) for v in (c.ESC, c.SOF, c.SOS))

Reason = Literal["checksum", "marker", "escape"]

ERROR_CODES: dict[str, int] = {
    "checksum": c.ERR_CHECKSUM,
    "marker": c.ERR_FRAMING,
    "escape": c.ERR_FRAMING,
    "timeout": c.ERR_TIMEOUT,
    "lost": c.ERR_FRAMING,
}
"""The opcode of the error reply that a device owes for each reason (J2A-ERR-002 to 004)."""


@dataclass(frozen=True, slots=True)
class Frame:
    """A frame whose checksum is right: start byte, seq, opcode, payload of 0 to 255 bytes."""

    start: int
    seq: int
    opcode: int
    payload: bytes = b""


@dataclass(frozen=True, slots=True)
class FrameError:
    """A frame that was given up; `seq` is None when the frame broke before it was known."""

    reason: Reason
    start: int
    seq: int | None


@dataclass(frozen=True, slots=True)
class Skipped:
    """`count` bytes in a row that belong to no frame."""

    count: int


@dataclass(frozen=True, slots=True)
class Incomplete:
    """The stream ends inside a frame; `seq` is None when it had not come yet."""

    start: int
    seq: int | None


Event = Frame | FrameError | Skipped | Incomplete


def stuff(data: bytes) -> bytes:
    """Return `data` with SOF, SOS and ESC escaped (J2A-STUFF-001)."""
    for value, escaped in _STUFFING:
        data = data.replace(value, escaped)
    return data


def _unstuff(data: bytes) -> bytes:
    """Return `data` with each escaped byte as it was; ESC 0xFF is not in it."""
    return _ESCAPED.sub(lambda escaped: bytes((escaped[1][0] + 1,)), data)


def encode(frame: Frame) -> bytes:
    """Return the wire bytes of a frame, 5 to 518 of them.

    Raises:
        ValueError: start is no marker, or a field is out of range.
    """
    if frame.start not in c.MARKERS:
        raise ValueError(f"start byte 0x{frame.start:02X} is neither SOF nor SOS")
    seq, opcode, payload = frame.seq, frame.opcode, frame.payload
    try:
        header = bytes((seq, opcode, len(payload)))
        body = header + payload + bytes((checksum(seq, opcode, payload),))
    except (TypeError, ValueError) as error:
        raise ValueError(f"no such frame: {frame}") from error
    return bytes((frame.start,)) + stuff(body)


def decode(stream: bytes) -> list[Event]:
    """Return what a receiver sees in `stream`, which starts between two frames.

    Runs of bytes outside frames are one `Skipped`. If the stream ends inside a frame the last event
    is `Incomplete`. Time does not exist here: a byte timeout is judged elsewhere.
    """
    events: list[Event] = []
    skipped = 0
    pieces = [piece for piece in _BEFORE_MARKER.split(stream) if piece]
    for index, piece in enumerate(pieces):
        if piece[0] not in c.MARKERS:  # what stands before the first marker
            skipped = len(piece)
            continue
        if skipped:
            events.append(Skipped(skipped))
        event, size = _begun(piece)
        if isinstance(event, Incomplete) and index < len(pieces) - 1:
            event = FrameError("marker", event.start, event.seq)
        events.append(event)
        skipped = len(piece) - size
    return [*events, Skipped(skipped)] if skipped else events


def _begun(piece: bytes) -> tuple[Event, int]:
    """Return what begins with the marker `piece[0]`, behind which there is no other one.

    Returns:
        The event, and how many bytes of the piece are its own.
    """
    start = piece[0]
    found = _BYTES.match(piece, 1)
    assert found is not None  # it may be empty
    wire = found[0]
    body = _unstuff(wire)
    seq = body[0] if body else None
    if len(body) > c.HEADER and len(body) >= (size := c.HEADER + body[2] + 1):
        own = wire if len(body) == size else b"".join(_BYTE.findall(wire)[:size])
        return _frame(start, body[:size]), 1 + len(own)
    if piece.startswith(_FORBIDDEN, 1 + len(wire)):
        return FrameError("escape", start, seq), 1 + len(wire) + len(_FORBIDDEN)
    return Incomplete(start, seq), len(piece)


def _frame(start: int, body: bytes) -> Event:
    seq, opcode, payload = body[0], body[1], body[c.HEADER : -1]
    if checksum(seq, opcode, payload) != body[-1]:
        return FrameError("checksum", start, seq)
    return Frame(start, seq, opcode, payload)
