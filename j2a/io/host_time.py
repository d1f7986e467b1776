"""The time of this computer for the clocks of boards.

What flows in: the computer's counters. What flows out: readings of a steady one, and Unix time.
Rules: there is one per process, one for each bus of `j2a syncd`, and one for each link whose time
is simulated, which is then both.
The steady counter is one that NTP does not slew, where the system has it, so that a slew of the
computer's clock is not taken for one of a board's crystal.
"""

import math
import os
import sys
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Final

from j2a.protocol.clock import ReferenceClock

if TYPE_CHECKING:
    from j2a_transports import Transport

__all__ = ["HostTime", "host_time", "host_time_of"]

_US: Final = 1e6
_TRIES: Final = 10
_QUICK_US: Final = 2.0
_SLOW_US: Final = 10.0
_GLANCE_US: Final = 1000.0
_SLOWEST_US: Final = 250.0
"""Where no reading is quicker for a second, it is this machine that takes so long."""


class HostTime:
    """The counter and the clock of a computer.

    Args:
        counter_us: reads the steady counter, in microseconds.
        unix_us: reads the clock, in microseconds since 1970.
        slewed_us: reads a clock that is slewed like that one and never set, if there is one.

    Attributes:
        counter_us: as given.
        reference: turns times of the counter into Unix time.
    """

    def __init__(
        self,
        counter_us: Callable[[], float],
        unix_us: Callable[[], int],
        slewed_us: Callable[[], int | None] = lambda: None,
    ) -> None:
        self.counter_us = counter_us
        self.reference = ReferenceClock()
        self._unix_us = unix_us
        self._slewed_us = slewed_us
        self._known_at_us = self._looked_at_us = -math.inf
        self._limit_us = math.inf
        self.renew_lock()

    def renew_lock(self) -> None:
        """Make a lock that nobody holds; in a child process its holder does not exist."""
        # Only an RLock can tell a signal handler that its own thread holds it.
        self._lock = threading.RLock()

    def observe(self) -> float:
        """Let the reference know the time of now; return it on the counter, in microseconds.

        A reading that was interrupted again and again is left out, unless it is the first one. So
        is that of a signal handler amid another of its own thread, which is as new.
        """
        is_amid: bool = self._lock._is_owned()  # type: ignore[attr-defined]
        if is_amid and self._known_at_us > -math.inf:
            return self.counter_us()
        with self._lock:
            best = self._reading()
            for _ in range(_TRIES - 1):
                if best[0] < _QUICK_US:
                    break
                best = min(best, self._reading())
            took_us, counter_us, unix_us, slewed_us = best
            if counter_us - self._known_at_us >= _US:
                self._limit_us = max(self._limit_us, _SLOWEST_US)
            if took_us <= self._limit_us:
                self.reference.observe(counter_us, unix_us, slewed_us)
                self._known_at_us = counter_us
                self._limit_us = max(_SLOW_US, min(self._limit_us, 2 * took_us))
            self._looked_at_us = counter_us
        return counter_us

    def glance(self) -> float:
        """Do the same, unless somebody has within the last millisecond.

        For each of many samples: to read all the clocks costs more than the rest of its way.
        """
        now_us = self.counter_us()
        return now_us if 0 <= now_us - self._looked_at_us < _GLANCE_US else self.observe()

    def _reading(self) -> tuple[float, float, int, int | None]:
        """Return how long it took, and the time of each of the three in its middle."""
        before, unix_us, slewed_us = self.counter_us(), self._unix_us(), self._slewed_us()
        after = self.counter_us()
        return after - before, (before + after) / 2, unix_us, slewed_us


def _counter_us() -> Callable[[], float]:
    clock = getattr(time, "CLOCK_MONOTONIC_RAW", None)
    if clock is None:
        return lambda: time.perf_counter_ns() / 1000
    read = time.clock_gettime_ns
    return lambda: read(clock) / 1000


def _slewed_us() -> Callable[[], int | None]:
    """Linux slews CLOCK_MONOTONIC with the clock; elsewhere it is not said what it does."""
    if sys.platform != "linux":
        return lambda: None
    return lambda: time.clock_gettime_ns(time.CLOCK_MONOTONIC) // 1000


def host_time() -> HostTime:
    """Return the counter and the clock of this computer, with a reference of its own.

    Whoever counts the steps of the clock needs one that nobody else asks: a step is told once.
    """
    return HostTime(_counter_us(), lambda: time.time_ns() // 1000, _slewed_us())


_HOST: Final = host_time()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_HOST.renew_lock)


def host_time_of(transport: "Transport") -> HostTime:
    """Return the time of the host at the end of a link."""
    if not transport.is_simulated:
        return _HOST
    clock = transport.clock
    return HostTime(lambda: clock() * _US, lambda: round(clock() * _US))
