"""The oracle: what any byte stream means, slow and obvious.

What flows in: whole byte strings. What flows out: events in the order in which their last byte
came. Rules: nothing here is fast, nothing is incremental, and no implementation of J2A uses it to
run; tests compare with it and the vectors are made by it.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import construct as cs

from j2a_spec import constants as c
from j2a_spec.grammar import PACKET, checksum

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

# As Python code: to interpret the grammar for each frame takes more than twice the time.
_PACKET = PACKET.compile()

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
    for value in (c.ESC, c.SOF, c.SOS):  # ESC first, or those that are put in would be escaped
        data = data.replace(bytes((value,)), bytes((c.ESC, value - 1)))
    return data


def encode(frame: Frame) -> bytes:
    """Return the wire bytes of a frame, 5 to 518 of them.

    Raises:
        ValueError: start is no marker, or a field is out of range.
    """
    if frame.start not in c.MARKERS:
        raise ValueError(f"start byte 0x{frame.start:02X} is neither SOF nor SOS")
    fields = {"seq": frame.seq, "opcode": frame.opcode, "payload": frame.payload}
    try:
        body = _PACKET.build(fields)
    except (cs.ConstructError, struct.error) as error:
        raise ValueError(f"no such frame: {frame}") from error
    return bytes((frame.start,)) + stuff(body)


def decode(stream: bytes) -> list[Event]:
    """Return what a receiver sees in `stream`, which starts between two frames.

    Runs of bytes outside frames are one `Skipped`. If the stream ends inside a frame the last event
    is `Incomplete`. Time does not exist here: a byte timeout is judged elsewhere.
    """
    events: list[Event] = []
    for event in _decode(stream):
        if isinstance(event, Skipped) and events and isinstance(events[-1], Skipped):
            events[-1] = Skipped(events[-1].count + event.count)
        else:
            events.append(event)
    return events


def _decode(stream: bytes) -> Iterator[Event]:
    markers, esc, header = c.MARKERS, c.ESC, c.HEADER
    start: int | None = None
    body = bytearray()
    escaped = False
    for byte in stream:
        if byte in markers:
            if start is not None:
                yield FrameError("marker", start, body[0] if body else None)
            start, escaped = byte, False
            body.clear()
        elif start is None:
            yield Skipped(1)
        elif byte == esc and not escaped:
            escaped = True
        elif escaped and byte == 0xFF:
            yield FrameError("escape", start, body[0] if body else None)
            start = None
        else:
            body.append(byte + 1 if escaped else byte)
            escaped = False
            if len(body) > header and len(body) == header + body[2] + 1:
                yield _frame(start, bytes(body))
                start = None
    if start is not None:
        yield Incomplete(start, body[0] if body else None)


def _frame(start: int, body: bytes) -> Event:
    try:
        packet = _PACKET.parse(body)
    except cs.ChecksumError:
        return FrameError("checksum", start, body[0])
    return Frame(start, packet.seq, packet.opcode, packet.payload)
