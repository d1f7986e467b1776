"""How a counter far away runs, from exchanges with it.

What flows in: exchanges, each with two times of the host and one of the counter. What flows out: an
estimate that turns times of the one into times of the other, with a bound of its error.
Rules: the host's times are those of one steady counter, in microseconds, never those of a clock
that is set. A request cannot arrive before it was sent, nor a reply before it was made, so each
exchange gives an interval that holds the truth, however slow it was; the estimate is the middle of
what all of them leave. Nothing is assumed about how a round trip divides into there and back:
half of the least slack is uncertainty at least (SPEC.md, section 23; J2A-CLOCK-025).
"""

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from typing import Final

from j2a_spec.constants import CLOCK_MAX_TURNAROUND

from j2a.protocol.clock.strip import Bounds, Strip, fit_strip

__all__ = ["Estimate", "Estimator", "Exchange", "Verdict"]

WINDOW: Final = 64
"""So many exchanges are kept."""
MAX_RATE: Final = 0.01
"""A ceramic resonator is off by 0.5 %, and so may the counter of the host be."""
RESOLUTION_US: Final = 1.0
"""Times of the counter are whole microseconds."""
BAUD_TOLERANCE: Final = 0.025
"""By so much a UART may be faster or slower than its nominal speed."""
MAX_ROUND_TRIP_US: Final = 1_000_000
"""A slower exchange tells nothing (J2A-CLOCK-023)."""
_JUMP_US: Final = 500.0
"""A counter that is off by more has begun anew, unless its rate can have changed so much."""
_MAX_RATE_CHANGE: Final = 2e-3
_LEAST_WANDER: Final = 2e-8
_MOST_WANDER: Final = 1e-6
"""Changes of the rate in a second that one window may hold."""
_CALMING: Final = 0.98
_NARROW: Final = 0.1
"""A strip narrower than this part of the fastest exchange is about to contradict itself."""
_US: Final = 1e6


@dataclass(frozen=True, slots=True)
class Exchange:
    """One request and its reply.

    Attributes:
        sent_us: when the host sent the request, on the host's counter.
        came_us: when it had the reply.
        received_us: when the request had arrived, on the counter far away.
        turnaround_us: from then until the reply was made.
        bytes_out: length of the request on the wire; for links of a known speed.
        bytes_in: that of the reply.
        frame: number of the USB frame in which the request arrived; None where it is not known.
        age_us: from the start of this frame until the request had arrived.
    """

    sent_us: float
    came_us: float
    received_us: int
    turnaround_us: int = 0
    bytes_out: int = 0
    bytes_in: int = 0
    frame: int | None = None
    age_us: int = 0


class Verdict(Enum):
    """What an exchange was good for."""

    TAKEN = "taken"
    ABSURD = "absurd"
    """It contradicts itself, or took too long."""
    DOUBTED = "doubted"
    """It contradicts all before; the next one decides which of them are right."""
    RESTARTED = "restarted"
    """Two in a row contradict all before: the counter began anew, and so does the estimate."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """Turns times of the counter into times of the host, near the newest exchange.

    Attributes:
        counter_us: the time of the counter to which the others belong.
        host_us: the time of the host at it.
        rate: by which the host's counter runs faster than this one; 1e-6 is 1 ppm.
        error_us: bound of the error at `counter_us`.
        rate_error: bound of the error of `rate`.
        wander: by which `rate_error` grows in a second.
    """

    counter_us: int
    host_us: float
    rate: float
    error_us: float
    rate_error: float
    wander: float

    def to_host(self, counter_us: float) -> float:
        """Return the time of the host at a time of the counter, in microseconds."""
        passed = counter_us - self.counter_us
        return self.host_us + passed + passed * self.rate

    def to_counter(self, host_us: float) -> float:
        """Return the time of the counter at a time of the host, in microseconds."""
        return self.counter_us + (host_us - self.host_us) / (1 + self.rate)

    def uncertainty_us(self, counter_us: float) -> float:
        """Return the bound of the error of `to_host`, in microseconds."""
        passed = abs(counter_us - self.counter_us)
        return self.error_us + passed * (self.rate_error + self.wander * passed / _US)


class Estimator:
    """Keeps the newest exchanges with one counter, and an estimate that is true for all of them.

    Args:
        byte_us: how long a byte takes on the wire; 0 where the link has no speed that is known.
            A link that is faster than that proves it wrong, and it is then taken for 0.
        max_rate: the greatest relative difference between the two counters.
        window: how many exchanges are kept.

    Attributes:
        taken, rejected: counts of exchanges.
        restarts: how often the counter was found to have begun anew.
        byte_us: as given, 0 once it was proved wrong.
    """

    def __init__(
        self, byte_us: float = 0.0, *, max_rate: float = MAX_RATE, window: int = WINDOW
    ) -> None:
        self.byte_us = byte_us
        self.taken = 0
        self.rejected = 0
        self.restarts = 0
        self._max_rate = max_rate
        self._exchanges: deque[Exchange] = deque(maxlen=window)
        # Of the exchanges, in the same order.
        self._intervals: deque[tuple[float, float]] = deque(maxlen=window)
        self._wander = _LEAST_WANDER
        self._doubted: Exchange | None = None
        self._estimate: Estimate | None = None

    @property
    def estimate(self) -> Estimate | None:
        """What is known; None without an exchange, and while it is doubted."""
        return self._estimate if self._doubted is None else None

    @property
    def newest(self) -> Exchange | None:
        """The exchange with the latest time of the counter."""
        return self._exchanges[-1] if self._exchanges else None

    def __len__(self) -> int:
        return len(self._exchanges)

    def reset(self) -> None:
        """Forget all exchanges: the counter has begun anew."""
        self._keep([])
        self._doubted = self._estimate = None
        self._wander = _LEAST_WANDER

    def add(self, exchange: Exchange) -> Verdict:
        """Take one more exchange."""
        if self._is_absurd(exchange):
            self.rejected += 1
            return Verdict.ABSURD
        if self._estimate is not None and not self._is_possible(exchange):
            doubted, self._doubted = self._doubted, exchange
            if doubted is None or not self._agree(doubted, exchange):
                self.rejected += 1
                return Verdict.DOUBTED
            self.reset()
            self.restarts += 1
            self._keep([doubted])
            self._take(exchange)
            return Verdict.RESTARTED
        self._doubted = None
        self._take(exchange)
        return Verdict.TAKEN

    # ------------------------------------------------------------------ single exchanges

    def _is_absurd(self, exchange: Exchange) -> bool:
        round_trip = exchange.came_us - exchange.sent_us
        turnaround = exchange.turnaround_us
        return (
            not 0 <= round_trip <= MAX_ROUND_TRIP_US  # and no NaN
            or not math.isfinite(exchange.came_us)
            or turnaround >= CLOCK_MAX_TURNAROUND
            or turnaround > round_trip
        )

    def _bounds(self, exchange: Exchange) -> tuple[float, float]:
        """Return the times of the host between which the request arrived."""
        low = exchange.sent_us + exchange.bytes_out * self.byte_us - RESOLUTION_US
        wire = exchange.bytes_in * self.byte_us
        high = exchange.came_us - exchange.turnaround_us * (1 - self._max_rate) - wire
        return low, max(high, low)

    def _is_possible(self, exchange: Exchange) -> bool:
        """Whether a counter that runs on can give this exchange."""
        estimate, newest = self._estimate, self.newest
        assert estimate is not None and newest is not None
        low, high = self._bounds(exchange)
        passed = exchange.received_us - newest.received_us
        expected = estimate.to_host(exchange.received_us)
        gap = max(low - expected, expected - high)
        allowed = estimate.uncertainty_us(exchange.received_us) + _JUMP_US
        return gap <= allowed + _MAX_RATE_CHANGE * abs(passed)

    def _agree(self, one: Exchange, other: Exchange) -> bool:
        """Whether one counter gives these two, one after the other."""
        (low, high), (later_low, later_high) = self._bounds(one), self._bounds(other)
        passed = other.received_us - one.received_us
        slack = abs(passed) * self._max_rate + RESOLUTION_US
        return later_low - high - slack <= passed <= later_high - low + slack

    # ------------------------------------------------------------------ all of them

    def _keep(self, exchanges: Iterable[Exchange]) -> None:
        """Keep these exchanges and no others."""
        ordered = sorted(exchanges, key=lambda one: one.received_us)
        self._exchanges.clear()
        self._exchanges.extend(ordered)
        self._intervals.clear()
        self._intervals.extend(map(self._bounds, ordered))

    def _take(self, exchange: Exchange) -> None:
        self.taken += 1
        wire = (exchange.bytes_out + exchange.bytes_in) * self.byte_us
        used = exchange.came_us - exchange.sent_us - exchange.turnaround_us
        is_late = self._exchanges and exchange.received_us < self._exchanges[-1].received_us
        self._exchanges.append(exchange)
        self._intervals.append(self._bounds(exchange))
        if used < wire * (1 - BAUD_TOLERANCE):
            self.byte_us = 0.0
            self._keep(list(self._exchanges))
        elif is_late:  # of another board on a bus
            self._keep(list(self._exchanges))
        self._wander = max(self._wander * _CALMING, _LEAST_WANDER)
        strip = self._fit()
        while strip.width < _NARROW * self._least_slack() and len(self) > 1:
            # The rate changed within the window: somewhat, or else what is old is of no use.
            if self._wander < _MOST_WANDER:
                self._wander = min(2 * self._wander, _MOST_WANDER)
            else:
                self._keep(list(self._exchanges)[(len(self) + 1) // 2 :])
                self._wander = _LEAST_WANDER
            strip = self._fit()
        newest = self._exchanges[-1]
        span = newest.received_us - self._exchanges[0].received_us
        wires = [max(one.bytes_out, one.bytes_in) for one in self._exchanges]
        middle = strip.middle
        error = max(strip.high - middle, middle - strip.low, self._least_slack() / 2)
        least, most = strip.slopes
        self._estimate = Estimate(
            newest.received_us,
            newest.sent_us + middle,
            strip.slope,
            error + RESOLUTION_US + BAUD_TOLERANCE * self.byte_us * max(wires),
            max(most - strip.slope, strip.slope - least) + self._wander * span / _US,
            self._wander,
        )

    def _least_slack(self) -> float:
        """Return the part of the fastest round trip of which nobody knows in which direction."""
        return min(high - low for low, high in self._intervals)

    def _fit(self) -> Strip:
        """Return the line through the intervals; those of old exchanges are widened.

        x is the time of the counter from the newest exchange on, y the time of the host by which
        that of the counter, from the sending of the newest request on, is exceeded.
        """
        newest = self._exchanges[-1]
        points = []
        for one, (low, high) in zip(self._exchanges, self._intervals, strict=True):
            x = one.received_us - newest.received_us
            widened = 0.5 * self._wander * x * x / _US
            y = newest.sent_us + x
            points.append(Bounds(x, low - y - widened, high - y + widened))
        return fit_strip(points, self._max_rate)
