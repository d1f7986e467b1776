"""What a host tells the clock of a board, and when.

What flows in: the estimate of the board's counter, the time of the host, and what the board says of
its clock. What flows out: the next request, and how long to wait before the next exchange.
Rules: the clock of a board is set once, and then only slewed, unless the host's clock was set or
the board began anew (SPEC.md, section 25). Nothing here waits or sends.
"""

from typing import Final

from j2a.protocol.clock.estimator import Estimate, Estimator, Exchange, Verdict
from j2a.protocol.clock.messages import Adjust, ClockState, Status
from j2a.protocol.clock.reference import ReferenceClock

__all__ = ["BURST", "Discipline"]

BURST: Final = 8
"""So many exchanges in quick succession give the first estimate."""
BURST_S: Final = 0.05
STEP_LIMIT_US: Final = 100_000
"""A greater error takes minutes to slew."""
_PPB: Final = 1e9


class Discipline:
    """Decides for one board.

    Args:
        reference: the time of the host.
        estimator: of the board's counter.

    Attributes:
        status: what the board said last; None before.
        steps: how often the board's clock was set.
    """

    def __init__(self, reference: ReferenceClock, estimator: Estimator | None = None) -> None:
        self.reference = reference
        self.estimator = Estimator() if estimator is None else estimator
        self.status: Status | None = None
        self.steps = 0
        self._target: Adjust | None = None
        self._host_steps = reference.steps
        self._since_reset = 0

    # ------------------------------------------------------------------ what happens

    def add(self, exchange: Exchange) -> Verdict:
        """Take an exchange."""
        verdict = self.estimator.add(exchange)
        if verdict is Verdict.RESTARTED:
            self._begin_anew()
        if verdict in (Verdict.TAKEN, Verdict.RESTARTED):
            self._since_reset += 1
        return verdict

    def reset(self) -> None:
        """Begin anew: the board has restarted."""
        self.estimator.reset()
        self._begin_anew()

    def _begin_anew(self) -> None:
        self.status = self._target = None
        self._since_reset = 0

    def take_status(self, status: Status, adjust: Adjust | None = None) -> None:
        """Take what the board says of its clock.

        Args:
            status: this.
            adjust: the request that it answers, which the board has taken.
        """
        if adjust is not None:
            is_set = self.status is not None and status.epoch != self.status.epoch
            self.steps += is_set or adjust.is_step
            self._target = adjust
            self._host_steps = self.reference.steps
        self.status = status

    # ------------------------------------------------------------------ what to do

    def delay_s(self, period_s: float) -> float:
        """Return how long to wait before the next exchange: first a burst, then ever longer."""
        if self.estimator.estimate is None:
            return min(BURST_S, period_s)
        doublings = min(max(self._since_reset - BURST, 0), 16)
        return min(BURST_S * 2.0**doublings, period_s)

    def next_adjust(self) -> Adjust | None:
        """Return what to tell the board now; None while too little is known."""
        estimate = self.estimator.estimate
        if estimate is None or self._since_reset < BURST:
            return None
        return self.adjust_of(estimate)

    def adjust_of(self, estimate: Estimate) -> Adjust:
        """Return what an estimate tells the board."""
        reference, status = self.reference, self.status
        local_us = estimate.counter_us
        target_us = reference.to_unix(estimate.host_us)
        error_us = self.error_us
        is_step = (
            status is None
            or status.state is ClockState.FREE
            or self._host_steps != reference.steps
            or error_us is None
            or abs(error_us) > STEP_LIMIT_US
        )
        rate = (1 + reference.rate) * (1 + estimate.rate) - 1
        # Until the next round, at the latest when the board says that it is alone.
        wander = estimate.rate_error + estimate.wander
        return Adjust(
            is_step,
            local_us,
            target_us,
            round(rate * _PPB),
            round(estimate.error_us + 0.5),
            round(wander * _PPB),
        )

    # ------------------------------------------------------------------ the board's clock

    @property
    def error_us(self) -> float | None:
        """Time of the board less time of the host, when it last told it; None if not known."""
        status, estimate = self.status, self.estimator.estimate
        if status is None or estimate is None:
            return None
        return status.time_us - self.reference.to_unix(estimate.to_host(status.local_us))

    def to_local(self, time_us: int) -> float:
        """Return the counter of the board at a time of its clock.

        While it slews, its clock is on the line of the last status until that meets the line that
        it was told, and then on the latter.
        """
        status = self.status
        if status is None or status.state is ClockState.FREE:
            return time_us
        local = status.local_us + (time_us - status.time_us) / (1 + status.rate_ppb / _PPB)
        target = self._target
        if target is None or local <= status.local_us:
            return local
        told = target.local_us + (time_us - target.time_us) / (1 + target.rate_ppb / _PPB)
        # A clock that is ahead reaches a time earlier than it was told to.
        is_ahead = self._told_at(target, status.local_us) <= status.time_us
        return min(local, told) if is_ahead else max(local, told)

    def to_time(self, local_us: float) -> float:
        """Return the clock of the board at a time of its counter."""
        status = self.status
        if status is None or status.state is ClockState.FREE:
            return local_us
        passed = local_us - status.local_us
        time = status.time_us + passed + passed * status.rate_ppb / _PPB
        target = self._target
        if target is None or passed <= 0:
            return time
        told = self._told_at(target, local_us)
        is_ahead = self._told_at(target, status.local_us) <= status.time_us
        return max(time, told) if is_ahead else min(time, told)

    @staticmethod
    def _told_at(target: Adjust, local_us: float) -> float:
        passed = local_us - target.local_us
        return target.time_us + passed + passed * target.rate_ppb / _PPB
