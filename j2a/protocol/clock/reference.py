"""The time of the host: from its steady counter to microseconds since 1970.

What flows in: readings of the counter and of the clock that people and NTP set, both in
microseconds. What flows out: times of the one as times of the other, and whether the clock was set.
Rules: a clock that runs a little faster or slower is followed; one that jumps by 1 ms or more was
set, which is counted and told (J2A-CLOCK-028). Some systems have a clock that is slewed like that
one and never set: it tells both apart, however long nobody looked.
"""

from collections import deque
from typing import Final

__all__ = ["LOOK_S", "STEP_US", "ReferenceClock"]

LOOK_S: Final = 0.1
"""So often a host that disciplines boards looks whether its clock was set or slewed."""
STEP_US: Final = 1000
"""A change by so much is a step of the host's clock, and a smaller one part of its rate."""
MAX_SLEW: Final = 1e-3
"""Twice as fast as NTP slews a clock."""
BEND_US: Final = 20
"""A reading that is off by more shows that the rate has changed; what was before tells nothing."""
_BASE_US: Final = 90_000
_APART_US: Final = 250_000
_KEPT: Final = 9
_IDLE_US: Final = 2_500_000
"""A change of the rate that nobody saw for longer may be over."""
_US: Final = 1e6
_RATE_CHANGE: Final = 2e-5


class ReferenceClock:
    """Turns times of the host's counter into Unix time, and back.

    Attributes:
        steps: how often the clock was set.
        last_step_us: by how much, the last time.
        rate: by which the clock runs faster than the counter.
    """

    def __init__(self) -> None:
        self.steps = 0
        self.last_step_us = 0
        self.rate = 0.0
        self._anchor = (0.0, 0)
        self._set_us: int | None = None
        self._kept: deque[tuple[float, int]] = deque(maxlen=_KEPT)

    def observe(self, counter_us: float, unix_us: int, slewed_us: int | None = None) -> bool:
        """Take a reading of both; return whether the clock was set since the one before.

        Args:
            counter_us, unix_us: of the counter and of the clock.
            slewed_us: of a clock that the system slews like this one and never sets; None where it
                has none, and then only what is more than a slew in the time since is a step.
        """
        is_step = False
        before_us = self._set_us
        self._set_us = None if slewed_us is None else unix_us - slewed_us
        if self._kept:
            passed = counter_us - self._anchor[0]
            off = unix_us - self.to_unix(counter_us)
            if self._set_us is not None and before_us is not None:
                off_by_step = self._set_us - before_us
                is_step = abs(off_by_step) >= STEP_US
            else:
                off_by_step = round(off)
                is_step = abs(off) >= STEP_US + MAX_SLEW * abs(passed)
            if is_step:
                self.steps += 1
                self.last_step_us = off_by_step
                # The rate stays: it is that of the counter, and NTP has not changed it.
                self._kept.clear()
            elif abs(off) > BEND_US:
                self._kept.clear()
                if passed <= _IDLE_US:
                    self._kept.append(self._anchor)
        self._anchor = counter_us, unix_us
        if not self._kept or counter_us - self._kept[-1][0] >= _APART_US:
            self._kept.append(self._anchor)
        first_us, first_unix = self._kept[0]
        passed = counter_us - first_us
        if passed >= _BASE_US:
            self.rate = (unix_us - first_unix - passed) / passed
        return is_step

    @property
    def course(self) -> tuple[int, float]:
        """How often the clock was set, and its rate; `has_left` compares with it."""
        return self.steps, self.rate

    def has_left(self, course: tuple[int, float]) -> bool:
        """Return whether the clock was set or slewed since then; boards should hear of it."""
        steps, rate = course
        return self.steps != steps or abs(self.rate - rate) > _RATE_CHANGE

    def to_unix(self, counter_us: float) -> int:
        """Return the Unix time at a time of the counter, in whole microseconds."""
        at_us, unix_us = self._anchor
        passed = counter_us - at_us
        return unix_us + round(passed + passed * self.rate)

    def to_counter(self, unix_us: int) -> float:
        """Return the time of the counter at a Unix time."""
        at_us, anchor_us = self._anchor
        return at_us + (unix_us - anchor_us) / (1 + self.rate)
