"""The bytes of a2jClock: requests, replies, and the packets of SyncUSB (SPEC.md, section 23).

What flows in and out: payloads, and what they mean.
Rules: bytes that are not what the specification says are refused by one error; what cannot be sent
is cut to what the field holds.
"""

import struct
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

from j2a_spec import constants as c

from j2a.errors import ProtocolError
from j2a.protocol.clock.estimator import Exchange

__all__ = [
    "Adjust",
    "ClockState",
    "Frame",
    "Status",
    "pack_exchange",
    "pack_status",
    "unpack_exchange",
    "unpack_status",
]

_U64: Final = 1 << 64
_EXCHANGE: Final = struct.Struct("<BI")
_EXCHANGED: Final = struct.Struct("<IQH")
_SEEN_FRAME: Final = struct.Struct("<HH")
_MOST_RATE: Final = 2 * c.CLOCK_MAX_RATE
"""Of an adjustment and a correction, in ppb, with something to spare."""
_STATUS: Final = struct.Struct("<QQBBiI")
_ADJUST: Final = struct.Struct("<BBQQiII")
_FRAME: Final = struct.Struct("<BQHI")
_PACKET: Final = struct.Struct("<QH")


class ClockState(IntEnum):
    """What the clock of a device is set by."""

    FREE = c.CLOCK_FREE
    """Nothing: it counts microseconds from the start of the device on."""
    SETTLING = c.CLOCK_SETTLING
    """It was set, and still runs faster or slower until its error is gone."""
    LOCKED = c.CLOCK_LOCKED
    """It is set, and follows the host."""
    HOLDOVER = c.CLOCK_HOLDOVER
    """It was set, and runs on at its last rate since the host has fallen silent."""


@dataclass(frozen=True, slots=True)
class Status:
    """What a device says of its clock.

    Attributes:
        local_us: its counter, which starts with the device and is never set.
        time_us: its clock at the same instant: microseconds since 1970, or the counter while FREE.
        state: what it is set by.
        epoch: 0 while FREE; it changes with each step.
        rate_ppb: by which the clock runs faster than the counter, in parts of 10**9.
        uncertainty_us: bound of the error to the time of the host; None where it is not known.
    """

    local_us: int
    time_us: int
    state: ClockState
    epoch: int
    rate_ppb: int
    uncertainty_us: int | None


@dataclass(frozen=True, slots=True)
class Adjust:
    """Tells a device the time: at `local_us` of its counter it was `time_us`.

    Attributes:
        is_step: set the clock at once; else it runs faster or slower until it is right.
        rate_ppb: by which the time runs faster than the counter.
        uncertainty_us: bound of the error of `time_us`; None where it is not known.
        wander_ppb: by which the uncertainty grows from then on.
    """

    is_step: bool
    local_us: int
    time_us: int
    rate_ppb: int
    uncertainty_us: int | None
    wander_ppb: int

    def pack(self) -> bytes:
        """Return the payload of the request."""
        return _ADJUST.pack(
            c.CLOCK_ADJUST,
            c.CLOCK_STEP if self.is_step else c.CLOCK_SLEW,
            self.local_us % _U64,
            self.time_us % _U64,
            max(-c.CLOCK_MAX_RATE, min(self.rate_ppb, c.CLOCK_MAX_RATE)),
            _limited(self.uncertainty_us),
            max(0, min(self.wander_ppb, c.CLOCK_MAX_RATE)),
        )


@dataclass(frozen=True, slots=True)
class Frame:
    """Tells a device when a USB frame began.

    Attributes:
        time_us: when, in microseconds since 1970.
        frame: its number, 0..2047.
        uncertainty_us: bound of the error of `time_us`; None where it is not known.
    """

    time_us: int
    frame: int
    uncertainty_us: int | None = None

    def pack(self) -> bytes:
        """Return the payload of the request."""
        return _FRAME.pack(
            c.CLOCK_FRAME, self.time_us % _U64, self.frame, _limited(self.uncertainty_us)
        )

    def packet(self) -> bytes:
        """Return the 10 bytes for the interface SyncUSB (thesis, section 6.2)."""
        return _PACKET.pack(self.time_us % _U64, self.frame)


def pack_exchange(nonce: int) -> bytes:
    """Return the payload of the request for the time of the counter."""
    return _EXCHANGE.pack(c.CLOCK_EXCHANGE, nonce)


def pack_status() -> bytes:
    """Return the payload of the request for a status."""
    return bytes([c.CLOCK_STATUS])


def unpack_exchange(
    reply: bytes, nonce: int, sent_us: float, came_us: float, on_wire: tuple[int, int] = (0, 0)
) -> Exchange:
    """Return what a reply to `pack_exchange` says.

    Args:
        reply: its payload.
        nonce: that of the request.
        sent_us, came_us: when the host sent the request and had the reply, on its counter.
        on_wire: bytes of both frames.

    Raises:
        ProtocolError: it is no such reply, or that to another request.
    """
    if len(reply) < _EXCHANGED.size:
        raise ProtocolError(f"{c.CLOCK}: an exchange came as {reply!r:.60}")
    returned, received_us, turnaround_us = _EXCHANGED.unpack_from(reply)
    if returned != nonce:
        raise ProtocolError(f"{c.CLOCK}: the nonce {nonce:#x} came back as {returned:#x}")
    frame, age_us = c.CLOCK_NO_FRAME, 0
    if len(reply) >= _EXCHANGED.size + _SEEN_FRAME.size:
        frame, age_us = _SEEN_FRAME.unpack_from(reply, _EXCHANGED.size)
    is_known = frame < c.CLOCK_FRAME_NUMBERS and age_us < c.CLOCK_MAX_TURNAROUND
    return Exchange(
        sent_us,
        came_us,
        received_us,
        turnaround_us,
        *on_wire,
        frame if is_known else None,
        age_us if is_known else 0,
    )


def unpack_status(reply: bytes) -> Status:
    """Return what a device says of its clock.

    Raises:
        ProtocolError: it is no status.
    """
    if len(reply) < _STATUS.size:
        raise ProtocolError(f"{c.CLOCK}: a status came as {reply!r:.60}")
    local, time, state, epoch, rate, uncertainty = _STATUS.unpack_from(reply)
    try:
        known = ClockState(state)
    except ValueError:
        raise ProtocolError(f"{c.CLOCK}: the state {state} has no meaning") from None
    if abs(rate) > _MOST_RATE:
        raise ProtocolError(f"{c.CLOCK}: no clock runs {rate} ppb faster than its counter")
    return Status(
        local, time, known, epoch, rate, None if uncertainty == c.CLOCK_UNKNOWN else uncertainty
    )


def _limited(value: int | None) -> int:
    return c.CLOCK_UNKNOWN if value is None else max(0, min(value, c.CLOCK_UNKNOWN))
