"""What a host tells the clock of a board, and when.

What flows in: exchanges with the board, the time of the host, and what the board says of its clock.
What flows out: the next request, how long to wait before the next exchange, and times of the board
as times of its counter.
Rules: the clock of a board is set once, and then only slewed, unless the host's clock was set or
the board began anew (J2A-CLOCK-026, J2A-CLOCK-028). Nothing here waits or sends.
"""

import math
from collections import deque
from typing import Final

from j2a_spec.constants import CLOCK_FRAME_STEP_S, CLOCK_FRAME_WANDER

from j2a.protocol.clock.estimator import Estimator, Exchange, Verdict
from j2a.protocol.clock.messages import Adjust, ClockState, Status
from j2a.protocol.clock.reference import ReferenceClock

__all__ = ["BURST", "Discipline"]

BURST: Final = 8
"""So many exchanges in quick succession give the first estimate."""
BURST_S: Final = 0.05
_FOREIGN_US: Final = CLOCK_FRAME_STEP_S * 1_000_000
"""A board that is off by more, and was not told so, was set by something else (J2A-CLOCK-028)."""
_PPB: Final = 1e9
_ON_WAY_US: Final = 10_000_000
"""A time stamp that comes later than that after it was made is not expected."""
_LINES: Final = 64
"""So many replies tell how old time stamps were made: a minute and more of them."""
_HELD_WANDER: Final = CLOCK_FRAME_WANDER / _PPB
"""A board that is left alone may warm up by 15 K, and a crystal change by 0.3 ppm a kelvin."""


class Discipline:
    """Decides for one board.

    Args:
        reference: the time of the host.
        estimator: of the board's counter.

    Attributes:
        status: what the board said last; None before.
        epoch_local_us: since when the epoch of `status` lasts, at the latest, on the board's
            counter; None where nobody knows how long.
        steps: how often the board's clock was set by this host.
    """

    def __init__(self, reference: ReferenceClock, estimator: Estimator | None = None) -> None:
        self.reference = reference
        self.estimator = Estimator() if estimator is None else estimator
        self.status: Status | None = None
        self.epoch_local_us: int | None = None
        self.steps = 0
        self._target: Adjust | None = None
        # The latest time of the epochs before that one, as far as they are known.
        self._past_us = -math.inf
        # What the board said before, each with what it was told then: lines of the same epoch.
        self._lines: deque[tuple[Status, Adjust | None]] = deque(maxlen=_LINES)
        self._course = reference.course
        # That of the request on its way; the clock may be set before the reply comes.
        self._asked_course = self._course
        self._since_reset = 0
        # Of the exchange before, even if the estimator took it for absurd or doubted it.
        self._received_us: int | None = None

    # ------------------------------------------------------------------ what happens

    def add(self, exchange: Exchange) -> Verdict:
        """Take an exchange that was made after all others."""
        is_reset = self._received_us is not None and exchange.received_us < self._received_us
        if is_reset:
            self.reset()
        self._received_us = exchange.received_us
        verdict = self.estimator.add(exchange)
        if verdict is Verdict.RESTARTED:
            self._begin_anew()
        if verdict in (Verdict.TAKEN, Verdict.RESTARTED):
            self._since_reset += 1
        return Verdict.RESTARTED if is_reset and verdict is Verdict.TAKEN else verdict

    def reset(self) -> None:
        """Begin anew: the board has restarted."""
        self.estimator.reset()
        self._received_us = None
        self._begin_anew()

    def _begin_anew(self) -> None:
        self.status = self._target = self.epoch_local_us = None
        self._lines.clear()
        self._since_reset = 0

    def take_status(self, status: Status, adjust: Adjust | None = None) -> None:
        """Take what the board says of its clock.

        Args:
            status: this.
            adjust: the request of `next_adjust` that it answers, which the board has taken; None
                for another one.
        """
        before = self.status
        if before is not None and status.epoch != before.epoch:
            self._past_us = max(self._past_us, self.to_time(status.local_us))
            self.epoch_local_us = status.local_us
            self.steps += adjust is not None
            self._lines.clear()
        # Nobody knows what line another request has told it, such as one about a USB frame.
        self._target = adjust
        if adjust is not None:
            self._course = self._asked_course
        self.status = status
        self._lines.append((status, adjust))

    # ------------------------------------------------------------------ what to do

    def delay_s(self, period_s: float) -> float:
        """Return how long to wait before the next exchange: first a burst, then ever longer."""
        if self.estimator.estimate is None:
            return min(BURST_S, period_s)
        doublings = min(max(self._since_reset - BURST, 0), 16)
        return min(BURST_S * 2.0**doublings, period_s)

    @property
    def is_outdated(self) -> bool:
        """The clock of the host was set or slewed since the board was told; it is worth a round."""
        return self._target is not None and self.reference.has_left(self._course)

    def next_adjust(self, now_us: float, least: int = BURST) -> Adjust | None:
        """Return what to tell the board now.

        The status must be known before (`take_status`).

        Args:
            now_us: the time of the host's counter.
            least: so many exchanges have to be known since the board began.

        Returns: the request; None while too little is known.
        """
        estimate, status = self.estimator.estimate, self.status
        if estimate is None or status is None or self._since_reset < least:
            return None
        reference, error_us = self.reference, self.error_us
        is_foreign = self._target is None and abs(error_us or 0.0) >= _FOREIGN_US
        is_set = self._course[0] != reference.steps
        self._asked_course = reference.course
        rate = (1 + reference.rate) * (1 + estimate.rate) - 1
        uncertainty = estimate.uncertainty_us(estimate.to_counter(now_us))
        return Adjust(
            status.state is not ClockState.FREE and (is_set or is_foreign),
            estimate.counter_us,
            reference.to_unix(estimate.host_us),
            round(rate * _PPB),
            round(uncertainty + 0.5),
            round((estimate.rate_error + max(estimate.wander, _HELD_WANDER)) * _PPB),
        )

    # ------------------------------------------------------------------ the board's clock

    @property
    def error_us(self) -> float | None:
        """Time of the board less time of the host, when it last told it; None if not known."""
        status, estimate = self.status, self.estimator.estimate
        if status is None or estimate is None:
            return None
        return status.time_us - self.reference.to_unix(estimate.to_host(status.local_us))

    def is_of_epoch(self, time_us: float, now_us: float, *, is_stamp: bool = True) -> bool:
        """Return whether a time is of the epoch that lasts (J2A-CLOCK-027).

        A stamp of a time that has not come is from before the clock was set back. One of a time
        that came twice may be, as long as it can have been on its way since then.

        Args:
            time_us: on the clock of the board.
            now_us: the counter of the board now, at the latest.
            is_stamp: something was stamped with it, so it is no time to come.
        """
        # Where nobody knows since when: the counter has begun at 0.
        since_us = 0 if self.epoch_local_us is None else self.epoch_local_us
        local_us = self.to_local(time_us)
        if local_us < since_us or (is_stamp and local_us > now_us):
            return False
        return time_us > self._past_us or now_us - since_us >= _ON_WAY_US

    def to_local(self, time_us: float) -> float:
        """Return the counter of the board at a time of its clock.

        While it slews, its clock is on the line of the last status until that meets the line that
        it was told, and then on the latter. A time before the last status is on the line of an
        earlier one, as far as these are kept.
        """
        status, target = self.status, self._target
        if status is None or status.state is ClockState.FREE:
            return time_us
        for earlier in reversed(self._lines):
            status, target = earlier
            if status.time_us <= time_us:
                break
        local = status.local_us + (time_us - status.time_us) / (1 + status.rate_ppb / _PPB)
        if target is None or local <= status.local_us:
            return local
        told = target.local_us + (time_us - target.time_us) / (1 + target.rate_ppb / _PPB)
        # A clock that is ahead reaches a time earlier than it was told to.
        return min(local, told) if self._is_ahead(status, target) else max(local, told)

    def to_time(self, local_us: float) -> float:
        """Return the clock of the board at a time of its counter."""
        status, target = self.status, self._target
        if status is None or status.state is ClockState.FREE:
            return local_us
        passed = local_us - status.local_us
        time = status.time_us + passed + passed * status.rate_ppb / _PPB
        if target is None or passed <= 0:
            return time
        told = _told_at(target, local_us)
        return max(time, told) if self._is_ahead(status, target) else min(time, told)

    @staticmethod
    def _is_ahead(status: Status, target: Adjust) -> bool:
        return _told_at(target, status.local_us) <= status.time_us


def _told_at(target: Adjust, local_us: float) -> float:
    passed = local_us - target.local_us
    return target.time_us + passed + passed * target.rate_ppb / _PPB
