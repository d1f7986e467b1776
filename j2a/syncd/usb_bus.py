"""One USB bus: when its frames begin, by the boards on it.

In: what boards say of frames. Out: the time of a frame, the same for all boards of a round.
Rules: several threads use a bus, one at a time.
"""

from __future__ import annotations

import threading
import time
from typing import Any, Final

from j2a.io.host_time import _HOST, HostTime
from j2a.protocol.clock import BusClock, Exchange, Frame
from j2a.syncd.history import History, Round

__all__ = ["Bus", "host_time"]

FRESH_US: Final = 300_000
"""A packet about an older frame may come too late for a board (SYNC-005)."""
LEAST: Final = 8
"""So many exchanges come before the first packet."""


def host_time() -> HostTime:
    """Return the counter and the clock of this computer, with a reference of its own.

    What belongs to one lock needs no other: a bus tells a time and remembers after how many steps
    of the clock, and no other thread may count one in between.
    """
    return HostTime(_HOST.counter_us, lambda: time.time_ns() // 1000)


class Bus:
    """The frames of one bus.

    Args:
        name: of what the frames come from, such as "usb bus 1".
        interval_s: between two rounds.
        history: gets a record of each round.
        host: the time of the host, which belongs to this bus; None for that of this computer.
    """

    def __init__(
        self, name: str, interval_s: float, history: History, host: HostTime | None = None
    ) -> None:
        self.name = name
        self._interval_us = interval_s * 1e6
        self._history = history
        self._lock = threading.Lock()
        self._host = host_time() if host is None else host
        self._clock = BusClock(self._host.reference)
        self._told: Frame | None = None
        self._told_at_us = float("-inf")
        self._number = 0
        self._is_extra = False
        self._offset_us = 0.0

    def now_us(self) -> float:
        """Return the host's counter, in microseconds."""
        return self._host.counter_us()

    def until_next_round_s(self) -> float:
        """Return the seconds until a round begins; rounds of all boards begin at the same time."""
        return (self._interval_us - self.now_us() % self._interval_us) / 1e6

    def add(self, sent_us: float, came_us: float, frame: int, age_us: int) -> None:
        """Take what a board has said: in which frame a request came."""
        with self._lock:
            estimate = self._clock.estimate
            self._clock.add(Exchange(sent_us, came_us, 0, frame=frame, age_us=age_us))
            newest = self._clock.estimator.newest
            if estimate is not None and newest is not None:
                expected_us = estimate.to_host(newest.received_us)
                self._offset_us = (newest.sent_us + newest.came_us) / 2 - expected_us

    def has_news(self, number: int) -> bool:
        """Return whether boards should hear before the next round that the clock was set or slewed.

        Args:
            number: of the packet that this board was sent last.
        """
        with self._lock:
            self._host.observe()
            return self._clock.is_outdated or (self._is_extra and self._number != number)

    def packet(self) -> tuple[int, Frame | None]:
        """Return what all boards are told in this round.

        Returns: a number that is another one for another packet, and the packet; None while too
            little is known.
        """
        with self._lock:
            now_us = self._host.observe()
            is_due = now_us - self._told_at_us > min(FRESH_US, 0.9 * self._interval_us)
            is_outdated = self._clock.is_outdated
            if is_due or is_outdated:
                self._is_extra = is_outdated
                self._number += 1
                ready = len(self._clock.estimator) >= LEAST
                self._told = self._clock.frame_at(now_us) if ready else None
                self._told_at_us = now_us
                self._note(self._host.reference.to_unix(now_us))
            return self._number, self._told

    def _note(self, unix_us: int) -> None:
        estimate = self._clock.estimate
        if self._told is not None and estimate is not None:
            self._history.add(
                self.name,
                Round(
                    unix_us / 1e6,
                    self._offset_us,
                    1e9 * estimate.rate,
                    self._told.uncertainty_us or 0,
                ),
            )

    def facts(self) -> dict[str, Any]:
        """Return what the status says of the bus, for each of its boards."""
        with self._lock:
            estimate, told = self._clock.estimate, self._told
            if estimate is None or told is None:
                return {"offset_us": None, "rate_ppb": None, "uncertainty_us": None}
            return {
                "offset_us": round(self._offset_us, 1),
                "rate_ppb": round(1e9 * estimate.rate),
                "uncertainty_us": told.uncertainty_us,
            }
