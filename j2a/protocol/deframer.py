"""Wire bytes to frames.

What flows in: bytes in any chunks. What flows out: a `Frame` or a `FrameError` for every frame that
ended, in wire order, and `skipped`, the count of bytes that belonged to no frame.
Rules: input never raises; the events do not depend on the chunking; a raw marker always starts a
frame; nothing is kept but the fields of the frame that is still open, at most 258 bytes. Each byte
is looked at once, however small the chunks are.

A chunk is split at its markers, so each piece is one frame and what was sent after it. A piece that
is exactly one frame, as nearly all of them are, takes the fast way.
"""

from typing import Final

from j2a_spec.constants import ESC, HEADER, SOF, SOS

from j2a.events import Frame, FrameError, Reason
from j2a.protocol.codec import (
    ESC_BYTE,
    LENGTH_FOLD,
    OPCODE_FOLD,
    SOF_BYTE,
    SOS_BYTE,
    fold,
    unstuff,
)

__all__ = ["Deframer"]

_new_frame = tuple.__new__  # half the price of Frame(...); the fields are known to be right
_SPLIT: Final = SOF_BYTE + SOS_BYTE
_LENGTH_AT: Final = HEADER - 1
_OVERHEAD: Final = HEADER + 1
# Most frames that a marker cuts off have come to nothing: noise full of markers makes many.
_CUT_OFF: Final = {
    b"": FrameError("marker", SOF, None),
    SOS_BYTE: FrameError("marker", SOS, None),
}


class Deframer:
    """Finds frames in a byte stream; the same one serves a host and a device."""

    __slots__ = ("_body", "_is_escaped", "_start", "skipped")

    def __init__(self) -> None:
        self.skipped = 0
        # The open frame: its start byte or None, its fields so far, and whether ESC came last.
        self._start: int | None = None
        self._body = bytearray()
        self._is_escaped = False

    @property
    def in_frame(self) -> bool:
        """A frame has begun and not ended yet."""
        return self._start is not None

    def feed(self, data: bytes) -> list[Frame | FrameError]:
        """Take the next bytes of the stream and return the events that they complete."""
        if self._start is None and data.rfind(SOF_BYTE) == 0 and SOS not in data:
            # One frame or its beginning, as after a request: the same as below without splitting.
            piece = data[1:]
            if (event := _whole_frame(piece) or self._begin(piece)) is not None:
                return [event]
            return []
        if SOF not in data and SOS not in data:  # a part of a frame, as USB delivers long ones
            event = self._go_on(data)
            return [] if event is None else [event]
        # One kind of marker is left to split at; a piece that begins with SOS is a SIF.
        pieces = data.replace(SOS_BYTE, _SPLIT).split(SOF_BYTE)
        events: list[Frame | FrameError] = []
        if pieces[0] and (event := self._go_on(pieces[0])) is not None:
            events.append(event)
        if len(pieces) == 1:
            return events
        if self._start is not None and (event := self.abandon("marker")) is not None:
            events.append(event)
        last = pieces.pop()
        if len(pieces) > 1:
            del pieces[0]
            for piece in pieces:
                events.append(_CUT_OFF.get(piece) or _whole_frame(piece) or self._cut_off(piece))
        if (event := _whole_frame(last) or self._begin(last)) is not None:
            events.append(event)
        return events

    def abandon(self, reason: Reason) -> FrameError | None:
        """Give up the open frame, if there is one, and wait for the next marker."""
        if self._start is None:
            return None
        event = FrameError(reason, self._start, self._body[0] if self._body else None)
        self._start = None
        return event

    def _cut_off(self, piece: bytes) -> Frame | FrameError:
        """Take a piece that is not exactly one frame and that the marker of the next one ends."""
        if ESC not in piece:
            start, body = (SOS, piece[1:]) if piece[:1] == SOS_BYTE else (SOF, piece)
            size = body[_LENGTH_AT] + _OVERHEAD if len(body) >= _OVERHEAD else _OVERHEAD
            if len(body) < size:
                return _new_frame(FrameError, ("marker", start, body[0] if body else None))
            self.skipped += len(body) - size
            return _judge(start, body[:size])
        event = self._begin(piece) or self.abandon("marker")
        assert event is not None
        return event

    def _begin(self, piece: bytes) -> Frame | FrameError | None:
        """Begin a frame with a piece that may go on in the next chunk."""
        is_sif = piece[:1] == SOS_BYTE
        self._start = SOS if is_sif else SOF
        self._body.clear()
        self._is_escaped = False
        return self._go_on(piece[1:] if is_sif else piece)

    def _go_on(self, raw: bytes) -> Frame | FrameError | None:
        """Take bytes without a marker; return the event of the open frame if they end it."""
        if self._start is None:
            self.skipped += len(raw)
            return None
        if self._is_escaped or ESC in raw:
            return self._go_on_escaped(ESC_BYTE + raw if self._is_escaped else raw)
        body = self._body
        body += raw
        excess = len(body) - body[_LENGTH_AT] - _OVERHEAD if len(body) >= _OVERHEAD else -1
        if excess < 0:
            return None
        self.skipped += excess
        return self._end(len(body) - excess)

    def _go_on_escaped(self, raw: bytes) -> Frame | FrameError | None:
        """Do what `_go_on` does with bytes that have escapes, at most the first one open."""
        self._is_escaped = False
        plain = unstuff(raw)
        if plain is None and raw.endswith(ESC_BYTE):
            plain = unstuff(raw[:-1])
            self._is_escaped = plain is not None
        if plain is None:
            return self._go_on_slowly(raw)
        body = self._body
        known = len(body)
        body += plain
        excess = len(body) - body[_LENGTH_AT] - _OVERHEAD if len(body) >= _OVERHEAD else -1
        if excess < 0:
            return None
        if excess or self._is_escaped:
            # What follows the frame is counted as it was sent.
            del body[known:]
            return self._go_on_slowly(raw)
        return self._end(len(body))

    def _go_on_slowly(self, raw: bytes) -> Frame | FrameError | None:
        """Do the same byte by byte, which is right for anything."""
        body = self._body
        is_escaped = False
        event: Frame | FrameError | None = None
        for used, byte in enumerate(raw, start=1):
            if not is_escaped and byte == ESC:
                is_escaped = True
                continue
            if is_escaped and byte == 0xFF:
                event = self.abandon("escape")
            else:
                body.append(byte + is_escaped)
                is_escaped = False
                if len(body) >= _OVERHEAD and len(body) == body[_LENGTH_AT] + _OVERHEAD:
                    event = self._end(len(body))
            if event is not None:
                self.skipped += len(raw) - used
                return event
        self._is_escaped = is_escaped
        return None

    def _end(self, size: int) -> Frame | FrameError:
        """Return the event of the open frame, which has come to its end."""
        start = self._start
        assert start is not None
        self._start = None
        del self._body[size:]
        return _judge(start, bytes(self._body))


def _whole_frame(piece: bytes) -> Frame | FrameError | None:
    """Return the event of a piece that is exactly one frame with plain escapes, else None."""
    start = SOF
    if piece[:1] == SOS_BYTE:
        start = SOS
        piece = piece[1:]
    body = unstuff(piece) if ESC in piece else piece
    if body is None or len(body) < _OVERHEAD or len(body) != body[_LENGTH_AT] + _OVERHEAD:
        return None
    return _judge(start, body)


def _judge(start: int, body: bytes) -> Frame | FrameError:
    """Return the event of a complete frame, unstuffed, checksum included."""
    seq, opcode, length = body[:HEADER]
    if fold(body) ^ OPCODE_FOLD[opcode] ^ LENGTH_FOLD[length]:
        return FrameError("checksum", start, seq)
    return _new_frame(Frame, (start, seq, opcode, body[HEADER:-1]))
