"""A decoder and an encoder that handle one byte at a time: the yardstick of the fast ones.

What flows in and out: as in `j2a.protocol.deframer` and `codec`, the same events included. This is
what one writes first, and what a microcontroller does; nobody has tried to make it slow.
"""

from typing import Literal

from j2a_spec.constants import CHK_LENGTH, CHK_OPCODE, ESC, SOF, SOS

from j2a.events import Frame, FrameError

IDLE, SEQ, OPCODE, LENGTH, PAYLOAD, CHECKSUM = range(6)


class NaiveDeframer:
    """A state machine that is fed byte by byte."""

    def __init__(self) -> None:
        self.skipped = 0
        self._state = IDLE
        self._start = 0
        self._is_escaped = False
        self._seq = 0
        self._opcode = 0
        self._length = 0
        self._payload = bytearray()
        self._checksum = 0

    def feed(self, data: bytes) -> list[Frame | FrameError]:
        """Take the next bytes of the stream and return the events that they complete."""
        events: list[Frame | FrameError] = []
        for byte in data:
            if byte == SOF or byte == SOS:  # noqa: SIM109 - faster than a search
                if self._state != IDLE:
                    events.append(self._fail("marker"))
                self._start = byte
                self._state = SEQ
                self._is_escaped = False
                continue
            if self._state == IDLE:
                self.skipped += 1
                continue
            if self._is_escaped:
                self._is_escaped = False
                if byte == 0xFF:
                    events.append(self._fail("escape"))
                    self._state = IDLE
                    continue
                byte += 1  # noqa: PLW2901 - this is what unstuffing is
            elif byte == ESC:
                self._is_escaped = True
                continue
            if self._state == PAYLOAD:
                self._payload.append(byte)
                self._checksum ^= byte
                if len(self._payload) == self._length:
                    self._state = CHECKSUM
            elif self._state == SEQ:
                self._seq = self._checksum = byte
                self._state = OPCODE
            elif self._state == OPCODE:
                self._opcode = byte
                self._checksum ^= (byte + CHK_OPCODE) & 0xFF
                self._state = LENGTH
            elif self._state == LENGTH:
                self._length = byte
                self._checksum ^= (byte + CHK_LENGTH) & 0xFF
                self._payload = bytearray()
                self._state = PAYLOAD if byte else CHECKSUM
            else:
                self._state = IDLE
                events.append(self._end(byte))
        return events

    def _end(self, checksum: int) -> Frame | FrameError:
        if checksum != self._checksum:
            return FrameError("checksum", self._start, self._seq)
        return Frame(self._start, self._seq, self._opcode, bytes(self._payload))

    def _fail(self, reason: Literal["marker", "escape"]) -> FrameError:
        return FrameError(reason, self._start, None if self._state == SEQ else self._seq)


def naive_encode(start: int, seq: int, opcode: int, payload: bytes) -> bytes:
    """Return the wire bytes of a frame."""
    wire = bytearray((start,))
    checksum = seq ^ ((opcode + CHK_OPCODE) & 0xFF) ^ ((len(payload) + CHK_LENGTH) & 0xFF)
    for byte in payload:
        checksum ^= byte
    for byte in (seq, opcode, len(payload), *payload, checksum):
        if byte in (SOF, SOS, ESC):
            wire.append(ESC)
            wire.append(byte - 1)
        else:
            wire.append(byte)
    return bytes(wire)
