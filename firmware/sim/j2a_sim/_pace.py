"""Keeps simulated time from running ahead of the wall clock.

In: the simulated time. Out: how long to wait before simulating on.
Rule: a delay of more than a few milliseconds is forgotten, not made up for: after it simulated
time is simply late, so that a firmware never sees a burst of time pass at once.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

MAX_LAG_S: Final = 0.004


class Pacer:
    """Relates simulated seconds to wall seconds.

    Args:
        speed: simulated seconds per wall second, above 0.
        clock: the wall clock.
    """

    def __init__(self, speed: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._speed, self._clock = speed, clock
        self._simulated_s = self._wall_s = 0.0
        self.restart(0.0)

    def restart(self, simulated_s: float) -> None:
        """Let the present wall time belong to this simulated time."""
        self._simulated_s, self._wall_s = simulated_s, self._clock()

    def wait_s(self, simulated_s: float) -> float:
        """Return the wall seconds until this simulated time is due; 0 when it is due or late."""
        due_s = self._wall_s + (simulated_s - self._simulated_s) / self._speed
        ahead_s = due_s - self._clock()
        if ahead_s < -MAX_LAG_S:
            self.restart(simulated_s)
        return max(ahead_s, 0.0)
