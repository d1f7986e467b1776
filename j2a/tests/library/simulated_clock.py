"""A board with a crystal of its own behind a link with delays, in simulated time that is exact."""

import math
import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from j2a.protocol.clock import Adjust, ClockState, Exchange, Status

US = 1e6
SLEW = 1e-3

Delays = Callable[[random.Random], tuple[float, float]]
"""Draws how long a request and its reply take beside their bytes, in microseconds."""


def serial(draw: random.Random) -> tuple[float, float]:
    """A UART of the host itself: the system call, the interrupt, and waking up."""
    return 20 + draw.expovariate(1 / 20), 30 + draw.expovariate(1 / 50)


def symmetric(draw: random.Random) -> tuple[float, float]:
    return max(1.0, draw.gauss(100, 20)), max(1.0, draw.gauss(100, 20))


def asymmetric(draw: random.Random) -> tuple[float, float]:
    return 20 + draw.expovariate(1 / 10), 400 + draw.expovariate(1 / 200)


def instant(draw: random.Random) -> tuple[float, float]:
    return draw.random(), draw.random()


def bursts(draw: random.Random) -> tuple[float, float]:
    late = 30_000 * draw.random() if draw.random() < 0.1 else 0.0
    return 100 + draw.expovariate(1 / 300) + late, 100 + draw.expovariate(1 / 300)


def latency_timer(draw: random.Random) -> tuple[float, float]:
    """A USB-serial adapter that keeps what came until its timer of 16 ms runs out."""
    return 60 + draw.uniform(0, 1000), 60 + draw.uniform(0, 16_000)


def latency_timer_1(draw: random.Random) -> tuple[float, float]:
    """Such an adapter whose timer was set to 1 ms."""
    return 60 + draw.uniform(0, 1000), 60 + draw.uniform(0, 1000)


def usb(draw: random.Random) -> tuple[float, float]:
    """Bulk transfers of full speed: the host controller asks for a reply every so often."""
    return 30 + draw.uniform(0, 125), 40 + draw.uniform(0, 250)


def ethernet(draw: random.Random) -> tuple[float, float]:
    late = 2_000 * draw.random() if draw.random() < 0.02 else 0.0
    return 60 + draw.expovariate(1 / 40), 80 + draw.expovariate(1 / 60) + late


def rfcomm(draw: random.Random) -> tuple[float, float]:
    """Slots of 625 us; a radio that was asleep takes longer, and some packets are sent again."""
    there = 1250 * draw.randint(1, 4) + 5_000 * (draw.random() < 0.2)
    back = 1250 * draw.randint(2, 12) + 10_000 * (draw.random() < 0.2)
    return there + draw.uniform(0, 625), back + draw.uniform(0, 625)


@dataclass
class Board:
    """A counter that runs wrong by some ppm, which wander, and a clock as SPEC.md has it.

    `host_us` is the truth: the time of the host's counter.
    """

    draw: random.Random
    delays: Delays = serial
    ppm: float = 50.0
    wander_ppm: float = 0.0
    byte_us: float = 0.0
    host_us: float = 5e6
    counter_us: float = 1000.0
    time_us: float = 1000.0
    rate: float = 0.0
    target: tuple[float, float] | None = None
    state: ClockState = ClockState.FREE
    epoch: int = 0
    jumps_back: int = field(default=0, init=False)

    def run(self, us: float) -> None:
        """Let so much true time pass."""
        while us > 0:
            step = min(us, 100_000.0)
            us -= step
            counted = step * (1 + self.ppm * 1e-6)
            self.host_us += step
            self.counter_us += counted
            self._run_clock(counted)
            self.ppm += self.draw.gauss(0, self.wander_ppm * math.sqrt(step / US))

    def _run_clock(self, counted: float) -> None:
        before = self.time_us
        self.time_us += counted * (1 + self.rate)
        if self.target is None:
            return
        local, time = self.target
        error = time + (self.counter_us - local) * (1 + self.rate) - self.time_us
        most = SLEW * counted
        self.time_us += max(-most, min(error, most))
        left = error - max(-most, min(error, most))
        self.state = ClockState.LOCKED if abs(left) < 10 else ClockState.SETTLING
        self.jumps_back += self.time_us < before

    def exchange(
        self, *, bytes_out: int = 0, bytes_in: int = 0, turnaround: float = 40
    ) -> Exchange:
        """Make an exchange; the time passes meanwhile."""
        there, back = self.delays(self.draw)
        sent = self.host_us
        self.run(there + bytes_out * self.byte_us)
        received = int(self.counter_us)
        self.run(turnaround)
        turned = int(self.counter_us) - received
        self.run(back + bytes_in * self.byte_us)
        return Exchange(sent, self.host_us, received, turned, bytes_out, bytes_in)

    def status(self) -> Status:
        rate = self.rate
        if self.target is not None and self.state is ClockState.SETTLING:
            local, time = self.target
            error = time + (self.counter_us - local) * (1 + self.rate) - self.time_us
            rate += math.copysign(SLEW, error)
        return Status(
            int(self.counter_us), int(self.time_us), self.state, self.epoch, round(rate * 1e9), None
        )

    def adjust(self, adjust: Adjust) -> Status:
        assert adjust.local_us <= self.counter_us, "a board that has begun anew refuses"
        self.rate = adjust.rate_ppb * 1e-9
        self.target = float(adjust.local_us), float(adjust.time_us)
        if adjust.is_step or self.state is ClockState.FREE:
            self.time_us = adjust.time_us + (self.counter_us - adjust.local_us) * (1 + self.rate)
            self.epoch = self.epoch % 255 + 1
        self.state = ClockState.SETTLING
        self._run_clock(0.0)
        return self.status()

    def reset(self) -> None:
        """Begin anew, as after a loss of power."""
        self.counter_us = self.time_us = self.draw.uniform(1e3, 1e5)
        self.target, self.rate, self.state, self.epoch = None, 0.0, ClockState.FREE, 0


def exchanges(
    board: Board, seconds: float, period_s: float = 1.0
) -> Iterator[tuple[Exchange, float]]:
    """Make exchanges, a burst and then one each period; yield each with the time until the next."""
    end = board.host_us + seconds * US
    count = 0
    while board.host_us < end:
        pause = min(period_s * US, 50_000.0 * 2 ** max(count - 8, 0))
        yield board.exchange(bytes_out=12, bytes_in=25), pause
        board.run(pause)
        count += 1
