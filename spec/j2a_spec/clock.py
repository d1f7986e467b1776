"""The oracle of section 23: what a device with a disciplined clock answers, and when.

What flows in: payloads of requests to a2jClock, each with the local time of the device. What flows
out: the code of the reply, and bounds for the fields of STATUS, because a device may choose how it
leads its time to the target. Rules: fractions only, nothing is rounded before the end.
"""

import math
from dataclasses import dataclass, replace
from fractions import Fraction

import construct as cs

from j2a_spec import constants as c
from j2a_spec.grammar import CLOCK_ADJUST, CLOCK_EXCHANGE

__all__ = ["Bounds", "Clock"]

_PPB = 10**9
_SLEW = Fraction(c.CLOCK_MAX_SLEW_PPM, 10**6)
_HOLDOVER_US = c.CLOCK_HOLDOVER_S * 10**6
_LAG_US = c.CLOCK_MAX_START_MS * 1000
_REQUESTS = {
    c.CLOCK_EXCHANGE: CLOCK_EXCHANGE,
    c.CLOCK_STATUS: cs.Struct("item" / cs.Byte, cs.Terminated),
    c.CLOCK_ADJUST: CLOCK_ADJUST,
}


Off = Fraction | int | None


@dataclass(frozen=True, slots=True)
class Bounds:
    """What STATUS may say: pairs are the smallest and the largest value."""

    time: tuple[int, int]
    states: tuple[int, ...]
    epoch: int
    rate: tuple[int, int]
    uncertainty: tuple[int, int]


@dataclass(frozen=True, slots=True)
class _Adjustment:
    """The target: it has `time` at `local`; `at` is when the device was told, or `early` before."""

    at: int
    local: int
    time: int
    rate: Fraction
    uncertainty: int
    wander: Fraction
    is_step: bool
    early: int
    low: Fraction = Fraction(0)
    high: Fraction = Fraction(0)
    """Bounds of target less time, in microseconds, at `at`."""
    lags: tuple[tuple[int, Fraction], ...] = ()
    """Until which local time the time may run as before an adjustment, and how far that is off."""

    def target(self, local: int) -> Fraction:
        return self.time + (local - self.local) * (1 + self.rate)

    def is_reached(self, local: int) -> bool:
        most = max(abs(self.low), abs(self.high))
        return self.is_step or local - self.at >= 2_000_000 + 1000 * most

    def distance(self, local: int) -> tuple[Fraction, Fraction]:
        """Return the bounds of target less time at a later local time (J2A-CLOCK-012, 013)."""
        most = 1 + Fraction(local - self.local, _PPB)
        if self.is_reached(local):
            return -most, most
        removed = (local - self.at + self.early) * _SLEW
        low = max(self.low - removed, Fraction(0)) if self.low > 0 else self.low
        high = min(self.high + removed, Fraction(0)) if self.high < 0 else self.high
        return low - most, high + most


class Clock:
    """A device without frames that keeps the rules of section 23; the local time only grows.

    Args:
        epoch: the epoch before the first adjustment.
    """

    def __init__(self, epoch: int = 0) -> None:
        self._last: _Adjustment | None = None
        self._epoch = epoch

    def code(self, request: bytes, local: int, early: int = 0, off: Off = None) -> int:
        """Return the code of the reply to a request, and take an adjustment (J2A-CLOCK-003).

        Args:
            request: the payload.
            local: the local time of the device at which it executes the request, in us.
            early: so many us earlier it may have been.
            off: target less time at the local time of the adjustment in us, where it is known.
        """
        if not request:
            return c.CLOCK_BAD_LENGTH
        if request[0] not in _REQUESTS:
            return c.CLOCK_NO_ITEM
        try:
            fields = _REQUESTS[request[0]].parse(request)
        except cs.ConstructError:  # no field has a wrong form but by its length
            return c.CLOCK_BAD_LENGTH
        if request[0] == c.CLOCK_ADJUST:
            if not _is_in_range(fields, local):
                return c.CLOCK_BAD_VALUE
            self._adjust(fields, local, early, off)
        return 0

    def _adjust(self, adjust: cs.Container, local: int, early: int, off: Off) -> None:
        is_step = self._last is None or adjust.mode == c.CLOCK_STEP
        rate, wander = Fraction(adjust.rate, _PPB), Fraction(adjust.wander, _PPB)
        told = (local, adjust.local, adjust.time, rate, adjust.uncertainty, wander)
        if is_step or self._last is None:
            self._epoch = self._epoch % 255 + 1
            self._last = _Adjustment(*told, is_step=True, early=early)
            return
        new = _Adjustment(*told, is_step=False, early=early)
        moved = new.target(local) - self._last.target(local)
        low, high = (bound + moved for bound in self._last.distance(local))
        if off is not None:
            low, high = Fraction(off) - 1, Fraction(off) + 1
        # A device that had reached its target was not on its way to anywhere.
        slew = Fraction(0) if self._last.is_reached(local - early) else _SLEW
        # Adjustments may follow each other before the time runs by the first one; without `off`,
        # the distance from the target before holds that already.
        before = self._last.lags if off is not None else ()
        lags = (*before, (local + _LAG_US, abs(rate - self._last.rate) + slew))
        lags = tuple((until, off_by) for until, off_by in lags if until > local - early)
        lag = sum((until - local + early) * off_by for until, off_by in lags)
        self._last = replace(new, low=low - lag, high=high + lag, lags=lags)

    def bounds(self, local: int) -> Bounds:
        """Return what STATUS may say at a local time, in us."""
        last = self._last
        if last is None:
            return Bounds((local,) * 2, (c.CLOCK_FREE,), 0, (0, 0), (c.CLOCK_UNKNOWN,) * 2)
        low, high = last.distance(local)
        target = last.target(local)
        least = Fraction(0) if low <= 0 <= high else min(abs(low), abs(high))
        most = max(abs(low), abs(high))
        grown = last.uncertainty + (local - last.at) * last.wander
        late = grown + last.early * last.wander
        return Bounds(
            (math.floor(target - high), math.ceil(target - low)),
            self._states(local, least, most),
            self._epoch,
            self._rate(local),
            _uncertainty(last.uncertainty, math.ceil(grown + least), math.ceil(late + most) + 1),
        )

    def _rate(self, local: int) -> tuple[int, int]:
        last = self._last
        assert last is not None
        rate = int(last.rate * _PPB)
        most = 1 if last.is_reached(local) else c.CLOCK_MAX_SLEW_PPM * 1000 + 1
        return rate - most, rate + most

    def _states(self, local: int, least: Fraction, most: Fraction) -> tuple[int, ...]:
        last = self._last
        assert last is not None
        passed = local - last.at
        if passed >= _HOLDOVER_US:
            return (c.CLOCK_HOLDOVER,)
        if passed + last.early >= _HOLDOVER_US:
            return (c.CLOCK_HOLDOVER, c.CLOCK_SETTLING, c.CLOCK_LOCKED)
        if last.is_step:
            return (c.CLOCK_SETTLING,)
        known = 0 if last.uncertainty == c.CLOCK_UNKNOWN else last.uncertainty
        limit = max(c.CLOCK_SETTLED_US, known)
        if least > limit:
            return (c.CLOCK_SETTLING,)
        return (c.CLOCK_LOCKED,) if most <= limit else (c.CLOCK_SETTLING, c.CLOCK_LOCKED)


def _uncertainty(given: int, low: int, high: int) -> tuple[int, int]:
    if given == c.CLOCK_UNKNOWN:
        return c.CLOCK_UNKNOWN, c.CLOCK_UNKNOWN
    return min(low, c.CLOCK_UNKNOWN), min(high, c.CLOCK_UNKNOWN)


def _is_in_range(adjust: cs.Container, local: int) -> bool:
    return (
        adjust.mode in (c.CLOCK_SLEW, c.CLOCK_STEP)
        and local - c.CLOCK_MAX_BEHIND <= adjust.local <= local
        and adjust.time < 1 << 63
        and abs(adjust.rate) <= c.CLOCK_MAX_RATE
        and adjust.wander <= c.CLOCK_MAX_RATE
    )
