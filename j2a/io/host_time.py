"""The time of this computer for the clocks of boards.

What flows in: the computer's counters. What flows out: readings of a steady one, and Unix time.
Rules: there is one per process, and one for each link whose time is simulated, which is then both.
The steady counter is one that NTP does not slew, where the system has it, so that a slew of the
computer's clock is not taken for one of a board's crystal.
"""

import os
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Final

from j2a.protocol.clock import ReferenceClock

if TYPE_CHECKING:
    from j2a_transports import Transport

__all__ = ["HostTime", "host_time_of"]

_US: Final = 1e6
_TRIES: Final = 10
_QUICK_US: Final = 2.0
_SLOW_US: Final = 10.0
_Readings = Callable[[], tuple[float, int]]


class HostTime:
    """The counter and the clock of a computer.

    Args:
        counter_us: reads the steady counter, in microseconds.
        unix_us: reads the clock, in microseconds since 1970.

    Attributes:
        counter_us: as given.
        reference: turns times of the counter into Unix time.
    """

    def __init__(self, counter_us: Callable[[], float], unix_us: Callable[[], int]) -> None:
        self.counter_us = counter_us
        self.reference = ReferenceClock()
        self._unix_us = unix_us
        self._is_known = False
        self.renew_lock()

    def renew_lock(self) -> None:
        """Make a lock that nobody holds; in a child process its holder does not exist."""
        self._lock = threading.Lock()

    def observe(self) -> float:
        """Let the reference know the time of now; return it on the counter, in microseconds.

        A reading that was interrupted again and again is left out, unless it is the first one.
        """
        with self._lock:
            best = (float("inf"), 0.0, 0)
            for _ in range(_TRIES):
                before, unix_us = self.counter_us(), self._unix_us()
                after = self.counter_us()
                best = min(best, (after - before, (before + after) / 2, unix_us))
                if best[0] < _QUICK_US:
                    break
            took_us, counter_us, unix_us = best
            if took_us <= _SLOW_US or not self._is_known:
                self.reference.observe(counter_us, unix_us)
                self._is_known = True
        return counter_us


def _counter_us() -> Callable[[], float]:
    clock = getattr(time, "CLOCK_MONOTONIC_RAW", None)
    if clock is None:
        return lambda: time.perf_counter_ns() / 1000
    read = time.clock_gettime_ns
    return lambda: read(clock) / 1000


_HOST: Final = HostTime(_counter_us(), lambda: time.time_ns() // 1000)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_HOST.renew_lock)


def host_time_of(transport: "Transport") -> HostTime:
    """Return the time of the host at the end of a link."""
    if not transport.is_simulated:
        return _HOST
    clock = transport.clock
    return HostTime(lambda: clock() * _US, lambda: round(clock() * _US))
