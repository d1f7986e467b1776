"""Wire bytes to frames.

What flows in: bytes in any chunks. What flows out: a `Frame` or a `FrameError` for every frame that
ended, in wire order, and `skipped`, the count of bytes that belonged to no frame.
Rules: input never raises; the events do not depend on the chunking; a raw marker always starts a
frame; nothing is kept but the raw bytes of the frame that is still open, at most 518.

A chunk is split at its markers, so each piece is one frame and what was sent after it. A piece that
is exactly one frame, as nearly all of them are, takes the fast way.
"""

from typing import Literal

from j2a_spec.constants import ESC, HEADER, SOF, SOS

from j2a._codec import (
    LENGTH_FOLD,
    OPCODE_FOLD,
    SOF_BYTE,
    SOS_BYTE,
    fold,
    unstuff,
)
from j2a.events import Frame, FrameError

__all__ = ["Deframer"]

_new_frame = tuple.__new__  # half the price of Frame(...); the fields are known to be right
_SPLIT = SOF_BYTE + SOS_BYTE
_OVERHEAD = HEADER + 1


class Deframer:
    """Finds frames in a byte stream; the same one serves a host and a device."""

    __slots__ = ("_open", "skipped")

    def __init__(self) -> None:
        self._open = b""
        self.skipped = 0

    @property
    def in_frame(self) -> bool:
        """A frame has begun and not ended yet."""
        return bool(self._open)

    def feed(self, data: bytes) -> list[Frame | FrameError]:
        """Take the next bytes of the stream and return the events that they complete."""
        events: list[Frame | FrameError] = []
        data = self._open + data
        self._open = b""
        # One kind of marker is left to split at; a piece that begins with SOS is a SIF.
        pieces = data.replace(SOS_BYTE, _SPLIT).split(SOF_BYTE)
        self.skipped += len(pieces[0])
        if len(pieces) == 1:
            return events
        last = pieces.pop()
        for piece in pieces[1:]:
            events.append(_whole_frame(piece) or self._odd_piece(piece))
        event = _whole_frame(last) or self._last_piece(last)
        if event is not None:
            events.append(event)
        return events

    def abandon(self, reason: Literal["timeout", "lost"]) -> FrameError | None:
        """Give up the open frame, if there is one, and wait for the next marker."""
        if not self._open:
            return None
        start = self._open[0]
        _, _, seq = _read(start, self._open[1:])
        self._open = b""
        return FrameError(reason, start, seq)

    def _odd_piece(self, piece: bytes) -> Frame | FrameError:
        """Take a piece that is not exactly one frame and that the marker of the next one ends."""
        start, raw = _split_start(piece)
        event, used, seq = _read(start, raw)
        self.skipped += len(raw) - used
        return event or FrameError("marker", start, seq)

    def _last_piece(self, piece: bytes) -> Frame | FrameError | None:
        """Take a piece that is not exactly one frame and may go on in the next chunk."""
        start, raw = _split_start(piece)
        event, used, _ = _read(start, raw)
        self.skipped += len(raw) - used
        if event is None:
            self._open = bytes((start,)) + raw
        return event


def _split_start(piece: bytes) -> tuple[int, bytes]:
    return (SOS, piece[1:]) if piece.startswith(SOS_BYTE) else (SOF, piece)


def _whole_frame(piece: bytes) -> Frame | FrameError | None:
    """Return the event of a piece that is exactly one frame with plain escapes, else None."""
    start = SOF
    if piece.startswith(SOS_BYTE):
        start = SOS
        piece = piece[1:]
    body = unstuff(piece)
    if body is None or len(body) < _OVERHEAD or len(body) != body[2] + _OVERHEAD:
        return None
    return _judge(start, body)


def _judge(start: int, body: bytes) -> Frame | FrameError:
    """Return the event of a complete frame, unstuffed, checksum included."""
    seq, opcode, length = body[:HEADER]
    if fold(body) ^ OPCODE_FOLD[opcode] ^ LENGTH_FOLD[length]:
        return FrameError("checksum", start, seq)
    return _new_frame(Frame, (start, seq, opcode, body[HEADER:-1]))


def _read(start: int, raw: bytes) -> tuple[Frame | FrameError | None, int, int | None]:
    """Read a frame of which less or more than all may be there.

    Returns: its event, None if it is not complete; how many raw bytes it took; its seq if known.
    """
    body = unstuff(raw)
    if body is None or (len(body) >= _OVERHEAD and len(body) > body[2] + _OVERHEAD):
        return _read_slowly(start, raw)
    return None, len(raw), body[0] if body else None


def _read_slowly(start: int, raw: bytes) -> tuple[Frame | FrameError | None, int, int | None]:
    """Do what `_read` does, byte by byte, which is right for anything."""
    body = bytearray()
    is_escaped = False
    for used, byte in enumerate(raw, start=1):
        if not is_escaped and byte == ESC:
            is_escaped = True
            continue
        if is_escaped and byte == 0xFF:
            seq = body[0] if body else None
            return FrameError("escape", start, seq), used, seq
        body.append(byte + is_escaped)
        is_escaped = False
        if len(body) >= _OVERHEAD and len(body) == body[2] + _OVERHEAD:
            return _judge(start, bytes(body)), used, body[0]
    return None, len(raw), body[0] if body else None
