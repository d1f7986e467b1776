"""One USB bus: when its frames begin, by the boards on it.

In: what boards say of frames. Out: the time of a frame, the same for all boards of a round.
Rules: several threads use a bus, one at a time. Of all answers of a round the quickest counts, so
that what is known spans as long a time with many boards as with one; a board whose answers
contradict those of most others counts for nothing. One that tells the lower 10 bits of numbers only
counts as the others do, once that is known.
"""

import math
import threading
from dataclasses import replace
from typing import Any, Final

from j2a_spec.constants import CLOCK_MAX_TURNAROUND

from j2a.io.host_time import HostTime, host_time
from j2a.protocol.clock import BusClock, Estimate, Exchange, Frame
from j2a.protocol.clock.bus import FRAME_US, FRAMES
from j2a.syncd.following import Following
from j2a.syncd.history import History, Round
from j2a.syncd.numbering import SHORT, Numbering, nearest

__all__ = ["Bus"]

FRESH_US: Final = 300_000
"""A packet about an older frame may come too late for a board (SYNC-005)."""
LEAST: Final = 8
"""So many exchanges come before the first packet, and of two rounds: one tells no rate."""
ODD: Final = 4
"""A board is an odd one after so many answers in a row that contradict the line."""
_JUMP_US: Final = 500.0
_RATE_CHANGE: Final = 2e-3
"""Of an answer that is off by more than both, the estimator would say that it contradicts."""
_MOST_UNSURE_US: Final = 100_000
_MOST_SLOW_US: Final = 200_000
"""A slower answer does not tell which of 1024 frames it means."""


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
        self._begin()
        # Of each board: how many of its last answers in a row contradicted the line.
        self._contradicting: dict[object, int] = {}
        self._numbering: dict[object, Numbering] = {}
        self._told: Frame | None = None
        self._following = Following()
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

    def _begin(self) -> None:
        """Know nothing of the frames yet."""
        self._clock = BusClock(self._host.reference)
        self._best: Exchange | None = None
        self._rounds = 0

    def add(self, board: object, sent_us: float, came_us: float, frame: int, age_us: int) -> None:
        """Take what a board has said: in which frame a request came.

        Args:
            board: names it.
            sent_us, came_us: when it was asked, and when the answer came, on the host's counter.
            frame: the number of the frame, modulo 2048.
            age_us: since its begin; 65535 stands for more, which tells nothing (SYNC-008).
        """
        if age_us >= CLOCK_MAX_TURNAROUND:
            return
        exchange = Exchange(sent_us, came_us, 0, frame=frame, age_us=age_us)
        with self._lock:
            numbering = self._numbering.setdefault(board, Numbering())
            if came_us - sent_us < _MOST_SLOW_US:
                numbering.see(frame, (sent_us + came_us) / 2 - age_us)
            if numbering.modulo == SHORT:
                exchange = self._whole(exchange)
            if self._fits(exchange):
                self._contradicting[board] = 0
            else:
                self._contradicting[board] = self._contradicting.get(board, 0) + 1
                odd = sum(map(self._is_odd, self._contradicting))
                if 2 * odd <= len(self._contradicting):
                    return
                # Most boards say so: the frames themselves have begun anew.
                self._begin()
                self._contradicting = dict.fromkeys(self._contradicting, 0)
            if len(self._clock.estimator) < LEAST:
                self._clock.add(exchange)
            elif self._best is None or exchange.came_us - exchange.sent_us < (
                self._best.came_us - self._best.sent_us
            ):
                self._best = exchange

    def is_odd(self, board: object) -> bool:
        """Return whether the frames of a board are not those of this bus."""
        with self._lock:
            return self._is_odd(board)

    def _is_odd(self, board: object) -> bool:
        return self._contradicting.get(board, 0) >= ODD

    def forget(self, board: object) -> None:
        """Let a board count no more; it is gone."""
        with self._lock:
            self._contradicting.pop(board, None)
            self._numbering.pop(board, None)

    def modulo(self, board: object) -> int | None:
        """Return how many numbers the frames of a board have: 2048 or 1024; None: not known yet."""
        with self._lock:
            return self._numbering[board].modulo if board in self._numbering else None

    @property
    def _is_short(self) -> bool:
        """Nobody on this bus tells more than the lower 10 bits of a number."""
        known = {one.modulo for one in self._numbering.values()}
        return SHORT in known and FRAMES not in known

    def _whole(self, exchange: Exchange) -> Exchange:
        """Give an answer with the lower 10 bits of a number the one that is nearest to the line."""
        estimate, frame = self._clock.estimate, exchange.frame
        if estimate is None or frame is None:
            return exchange
        began_us = (exchange.sent_us + exchange.came_us) / 2 - exchange.age_us
        expected = estimate.to_counter(began_us) / FRAME_US
        return replace(exchange, frame=nearest(expected, frame, SHORT) % FRAMES)

    def _fits(self, exchange: Exchange) -> bool:
        """Return whether an answer can be true if the line is."""
        estimate, frame = self._clock.estimate, exchange.frame
        if estimate is None or frame is None:
            return True
        low_us = exchange.sent_us - exchange.age_us
        high_us = exchange.came_us - exchange.age_us
        expected = estimate.to_counter((low_us + high_us) / 2) / FRAME_US
        counter_us = FRAME_US * nearest(expected, frame, FRAMES)
        began_us = estimate.to_host(counter_us)
        allowed_us = estimate.uncertainty_us(counter_us) + _JUMP_US
        allowed_us += _RATE_CHANGE * abs(counter_us - estimate.counter_us)
        return low_us - allowed_us <= began_us <= high_us + allowed_us

    def _take_best(self) -> None:
        """Let the line know the quickest answer since the last round."""
        self._rounds += len(self._clock.estimator) > 0
        if self._best is None:
            return
        estimate = self._clock.estimate
        self._clock.add(self._best)
        self._best = None
        newest = self._clock.estimator.newest
        if estimate is not None and newest is not None:
            expected_us = estimate.to_host(newest.received_us)
            self._offset_us = (newest.sent_us + newest.came_us) / 2 - expected_us

    def _frame(self, now_us: float) -> Frame | None:
        """Return a frame and its time, None while too little is known.

        It is one that has surely begun: boards take a number for that of a frame before (SYNC-004).
        """
        estimate = self._clock.estimate
        if estimate is None or self._rounds < 2 or len(self._clock.estimator) < LEAST:
            return None
        unsure_us = estimate.uncertainty_us(estimate.to_counter(now_us))
        return self._clock.frame_at(now_us - unsure_us) if unsure_us < _MOST_UNSURE_US else None

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
                self._take_best()
                self._told = self._frame(now_us)
                if self._told is not None:
                    self._following.tell(self._told, now_us)
                self._told_at_us = now_us
                self._note(self._host.reference.to_unix(now_us))
            told = self._told
            if told is not None and self._is_short:
                told = replace(told, frame=told.frame % SHORT)  # the bit above is a guess
            return self._number, told

    def _uncertainty_us(self, told: Frame) -> int:
        """Return a bound of the error of boards that follow this packet."""
        return math.ceil((told.uncertainty_us or 0) + self._following.lag_us)

    def _rate_ppb(self, estimate: Estimate) -> float:
        """Return by how much frames run faster than the clock of the host."""
        return 1e9 * (1 / ((1 + estimate.rate) * (1 + self._host.reference.rate)) - 1)

    def _note(self, unix_us: int) -> None:
        estimate = self._clock.estimate
        if self._told is not None and estimate is not None:
            self._history.add(
                self.name,
                Round(
                    unix_us / 1e6,
                    self._offset_us,
                    self._rate_ppb(estimate),
                    self._uncertainty_us(self._told),
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
                "rate_ppb": round(self._rate_ppb(estimate)),
                "uncertainty_us": self._uncertainty_us(told),
            }
