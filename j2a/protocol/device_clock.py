"""The clock of a device, which a host disciplines (SPEC.md, section 23).

What flows in: requests to a2jClock and the local time, both as arguments. What flows out: replies,
the time, and by how much a step moved it.
Rules: integers only. A line is kept in parts of 10**-9 us, so that a rate in ppb loses nothing; the
distance from the target is removed at 1000 ppm from the adjustment on, so the time is a function of
the last adjustment alone.
"""

import struct
from typing import Final, NamedTuple

from j2a_spec import constants as c

__all__ = ["DeviceClock"]

_NANO: Final = 10**9
_SLEW: Final = c.CLOCK_MAX_SLEW_PPM * 1000
_HOLDOVER_US: Final = c.CLOCK_HOLDOVER_S * 10**6
_EXCHANGE: Final = struct.Struct("<I")
_EXCHANGED: Final = struct.Struct("<IQH")
_ADJUST: Final = struct.Struct("<BQQiII")
_STATUS: Final = struct.Struct("<QQBBiI")
_SIZES: Final = {
    c.CLOCK_EXCHANGE: _EXCHANGE.size,
    c.CLOCK_STATUS: 0,
    c.CLOCK_ADJUST: _ADJUST.size,
}


class _Adjustment(NamedTuple):
    """The target has `time` at `local`, both in microseconds; `at` is when the host said so."""

    at: int
    local: int
    time: int
    rate: int
    uncertainty: int
    wander: int
    is_step: bool
    off: int
    """Target less time at `at`, in 10**-9 us."""

    def target(self, local: int) -> int:
        """Return the target in 10**-9 us."""
        return self.time * _NANO + (local - self.local) * (_NANO + self.rate)

    def distance(self, local: int) -> int:
        """Return target less time in 10**-9 us."""
        left = max(abs(self.off) - (local - self.at) * _SLEW, 0)
        return left if self.off > 0 else -left


class DeviceClock:
    """The clock of a device without USB frames."""

    def __init__(self) -> None:
        self._last: _Adjustment | None = None
        self._epoch = 0

    def time_us(self, local_us: int) -> int:
        """Return the time at a local time, in microseconds; the local time while FREE."""
        return self._time(local_us) // _NANO

    def _time(self, local_us: int) -> int:
        if self._last is None:
            return local_us * _NANO
        return self._last.target(local_us) - self._last.distance(local_us)

    def request(self, payload: bytes, received_us: int, local_us: int) -> tuple[int, bytes, int]:
        """Execute a2jClock (J2A-CLOCK-003).

        Args:
            payload: of the request.
            received_us: the local time at which it came.
            local_us: the local time now.

        Returns: the code and the payload of the reply, and the microseconds by which the time was
            stepped, which what waits for a time has to be moved by (J2A-CLOCK-020).
        """
        if not payload:
            return c.CLOCK_BAD_LENGTH, b"", 0
        item, data = payload[0], payload[1:]
        if item not in _SIZES:
            return c.CLOCK_NO_ITEM, b"", 0
        if len(data) != _SIZES[item]:
            return c.CLOCK_BAD_LENGTH, b"", 0
        if item == c.CLOCK_EXCHANGE:
            turnaround = min(local_us - received_us, c.CLOCK_MAX_TURNAROUND)
            return c.RET_OK, _EXCHANGED.pack(*_EXCHANGE.unpack(data), received_us, turnaround), 0
        moved = 0
        if item == c.CLOCK_ADJUST:
            stepped = self._adjust(data, local_us)
            if stepped is None:
                return c.CLOCK_BAD_VALUE, b"", 0
            moved = stepped
        return c.RET_OK, self._status(local_us), moved

    def _adjust(self, data: bytes, now: int) -> int | None:
        """Take an adjustment; return the step in microseconds, None where it is out of range."""
        mode, local, time, rate, uncertainty, wander = _ADJUST.unpack(data)
        if (
            mode > c.CLOCK_STEP
            or not now - c.CLOCK_MAX_BEHIND <= local <= now
            or time >> 63
            or abs(rate) > c.CLOCK_MAX_RATE
            or wander > c.CLOCK_MAX_RATE
        ):
            return None
        before = self._time(now)
        is_step = self._last is None or mode == c.CLOCK_STEP
        new = _Adjustment(now, local, time, rate, uncertainty, wander, is_step, off=0)
        if is_step:
            self._epoch = self._epoch % 255 + 1
            self._last = new
            return self.time_us(now) - before // _NANO
        self._last = new._replace(off=new.target(now) - before)
        return 0

    def _status(self, local: int) -> bytes:
        last = self._last
        if last is None:
            return _STATUS.pack(local, local, c.CLOCK_FREE, 0, 0, c.CLOCK_UNKNOWN)
        distance = last.distance(local)
        correction = _SLEW if distance > 0 else -_SLEW if distance < 0 else 0
        return _STATUS.pack(
            local,
            self.time_us(local),
            _state(last, local, abs(distance)),
            self._epoch,
            last.rate + correction,
            _uncertainty(last, local, abs(distance)),
        )


def _state(last: _Adjustment, local: int, distance: int) -> int:
    if local - last.at >= _HOLDOVER_US:
        return c.CLOCK_HOLDOVER
    known = 0 if last.uncertainty == c.CLOCK_UNKNOWN else last.uncertainty
    if last.is_step or distance > max(c.CLOCK_SETTLED_US, known) * _NANO:
        return c.CLOCK_SETTLING
    return c.CLOCK_LOCKED


def _uncertainty(last: _Adjustment, local: int, distance: int) -> int:
    if last.uncertainty == c.CLOCK_UNKNOWN:
        return c.CLOCK_UNKNOWN
    more = distance + (local - last.at) * last.wander
    return min(last.uncertainty - -more // _NANO, c.CLOCK_UNKNOWN)
