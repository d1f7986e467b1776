"""What the simulated oscillators and clocks show at each instant of true time.

In: a random generator, parts per million, kelvin. Out: functions of true time, exact to the
rounding of a double: an hour in seconds is told to less than a picosecond.
Rules: true time is in seconds from the start of a run; all randomness comes from the generator that
is given, so that a seed names a run.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, overload

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

__all__ = ["UNIX_US", "HostClock", "Oscillator", "Slew", "Step", "crystal", "temperature"]

Floats = NDArray[np.float64]

GRID_S: Final = 1.0
PPM: Final = 1e-6
# The host's clock at the start of a run: 2026-01-01 00:00:00 UTC.
UNIX_US: Final = 1_767_225_600_000_000


class Oscillator:
    """An oscillator, by its relative error of frequency at points of time, linear between them.

    Args:
        rates: relative errors, 1e-6 for 1 ppm fast, at true times 0, step_s, 2 * step_s ...; after
            the last one the rate stays.
        step_s: seconds from one to the next.

    Attributes:
        rates, step_s: as given.
        phases: what it has counted at those times, in its own seconds.
    """

    def __init__(self, rates: Floats, step_s: float = GRID_S) -> None:
        self.rates = np.ascontiguousarray(rates, dtype=np.float64)
        self.step_s = step_s
        steps = step_s * (1 + (self.rates[1:] + self.rates[:-1]) / 2)
        self.phases = np.concatenate([[0.0], np.cumsum(steps)])
        self._rows: list[tuple[float, float, float]] | None = None

    @overload
    def elapsed_s(self, true_s: float) -> float: ...

    @overload
    def elapsed_s(self, true_s: Floats) -> Floats: ...

    def elapsed_s(self, true_s: Floats | float) -> Floats | float:
        """What it counts from 0 to a true time, in its own seconds."""
        if isinstance(true_s, float):
            return self._elapsed_s(true_s)
        at, past = self._place(np.asarray(true_s, dtype=np.float64))
        linear = self.phases[at] + past * (1 + self.rates[at])
        return np.asarray(linear + self._slope(at) * past**2 / 2)

    def _elapsed_s(self, true_s: float) -> float:
        """The same for one time, for which numpy takes ten times as long."""
        if self._rows is None:
            slopes = self._slope(np.arange(len(self.rates)))
            columns = (self.phases, self.rates, slopes)
            self._rows = list(zip(*(column.tolist() for column in columns), strict=True))
        at = min(max(int(true_s / self.step_s), 0), len(self._rows) - 1)
        phase, rate, slope = self._rows[at]
        past = true_s - at * self.step_s
        return phase + past * (1 + rate) + slope * (past * past) / 2

    def true_s(self, elapsed_s: Floats | float) -> Floats:
        """The true time at which it has counted so many seconds, to less than a nanosecond."""
        counted = np.asarray(elapsed_s, dtype=np.float64)
        at = np.clip(np.searchsorted(self.phases, counted, "right") - 1, 0, len(self.rates) - 1)
        rest = counted - self.phases[at]
        past = rest / (1 + self.rates[at])
        for _ in range(2):  # Newton: the first guess is off by some 1e-5 of the rate's change
            slope = self._slope(at)
            wrong = past * (1 + self.rates[at]) + slope * past**2 / 2 - rest
            past = past - wrong / (1 + self.rates[at] + slope * past)
        return np.asarray(at * self.step_s + past)

    def rate(self, true_s: Floats | float) -> Floats:
        """The relative error of its frequency at a true time."""
        at, past = self._place(np.asarray(true_s, dtype=np.float64))
        return np.asarray(self.rates[at] + self._slope(at) * past)

    def _place(self, true_s: Floats) -> tuple[NDArray[np.int64], Floats]:
        at = np.clip((true_s / self.step_s).astype(np.int64), 0, len(self.rates) - 1)
        return at, true_s - at * self.step_s

    def _slope(self, at: NDArray[np.int64]) -> Floats:
        after = np.minimum(at + 1, len(self.rates) - 1)
        return np.asarray((self.rates[after] - self.rates[at]) / self.step_s)


def temperature(rng: Generator, seconds: float) -> Floats:
    """How far a board's temperature is from that at its start, in kelvin, at each second.

    The board warms up by 5 to 15 K with a time constant of 2 to 10 minutes; the room swings by up
    to 1 K within 10 to 40 minutes, as heating and air conditioning make it; draughts are a random
    walk of 0.3 K that forgets itself within a minute.
    """
    times = np.arange(0.0, seconds + 2 * GRID_S, GRID_S)
    warm = rng.uniform(5, 15) * -np.expm1(-times / rng.uniform(120, 600))
    phase = rng.uniform(0, 2 * np.pi)
    swing = np.sin(2 * np.pi * times / rng.uniform(600, 2400) + phase) - np.sin(phase)
    keep = np.exp(-GRID_S / 60)
    kicks = rng.normal(0, 0.3 * np.sqrt(1 - keep**2), len(times))
    draught = np.zeros(len(times))
    for i in range(1, len(times)):
        draught[i] = draught[i - 1] * keep + kicks[i]
    return np.asarray(warm + rng.uniform(0, 1) * swing + draught)


def crystal(rng: Generator, seconds: float, ppm: float, kelvin: Floats | None = None) -> Oscillator:
    """Make the oscillator of a board.

    Args:
        rng: the source of all that is random.
        seconds: how long the run is.
        ppm: the most that the crystal is off at the start; each value up to it is as likely.
        kelvin: the temperature, as temperature() makes it; None: it does not change.

    Returns:
        The oscillator. An AT-cut crystal drifts by at most 0.3 ppm a kelvin near room temperature,
        depending on the angle at which it was cut.
    """
    count = len(np.arange(0.0, seconds + 2 * GRID_S, GRID_S))
    rates = np.full(count, rng.uniform(-ppm, ppm))
    slope = rng.uniform(-0.3, 0.3)
    if kelvin is not None:
        rates = rates + slope * kelvin
    return Oscillator(rates * PPM)


@dataclass(frozen=True, slots=True)
class Step:
    """The host's clock is set: at `at_s` it goes forward by `by_s`, back if that is negative."""

    at_s: float
    by_s: float


@dataclass(frozen=True, slots=True)
class Slew:
    """From `at_s` on the host's clock runs `ppm` faster for `seconds`, as under NTP."""

    at_s: float
    seconds: float
    ppm: float


class HostClock:
    """The clocks of the host: real time, and monotonic.

    Both run by one crystal. Real time follows NTP: each 64 s the offset is measured with an error
    of 0.2 ms rms, and the rate changes so that it would be gone within 256 s, as the kernel's loop
    does.

    Args:
        rng: the source of all that is random.
        seconds: how long the run is.
        ppm: the most that the crystal is off.
        ntp: whether real time is corrected; else it runs by the crystal alone.
        steps, slews: what happens to real time besides.
    """

    POLL_S: Final = 64
    HALVES_S: Final = 256.0
    MEASURED_RMS_S: Final = 0.0002

    def __init__(
        self,
        rng: Generator,
        seconds: float,
        ppm: float = 20.0,
        *,
        ntp: bool = True,
        steps: tuple[Step, ...] = (),
        slews: tuple[Slew, ...] = (),
    ) -> None:
        self._crystal = crystal(rng, seconds, ppm)
        self.steps = steps
        rates = self._crystal.rates.copy()
        noise = rng.normal(0, self.MEASURED_RMS_S, len(rates))
        if ntp:
            rates = self._discipline(rates, noise)
        times = np.arange(len(rates)) * GRID_S
        for slew in slews:
            rates[(times >= slew.at_s) & (times < slew.at_s + slew.seconds)] += slew.ppm * PPM
        self._real = Oscillator(rates)

    def _discipline(self, rates: Floats, noise: Floats) -> Floats:
        """Return the rates of real time: it starts without an offset and knows most of its rate."""
        rate, offset = rates[0] + noise[0] / self.HALVES_S, 0.0
        correction = -rates[0] + noise[0] / self.HALVES_S
        made = np.empty_like(rates)
        for i in range(len(rates)):
            if i and i % self.POLL_S == 0:
                correction = -rates[i] - (offset + noise[i]) / self.HALVES_S
            rate = rates[i] + correction
            made[i] = rate
            offset += rate * GRID_S
        return made

    @overload
    def monotonic_us(self, true_s: float) -> float: ...

    @overload
    def monotonic_us(self, true_s: Floats) -> Floats: ...

    def monotonic_us(self, true_s: Floats | float) -> Floats | float:
        """Microseconds since the start by the monotonic clock."""
        return self._crystal.elapsed_s(true_s) * 1e6

    @overload
    def unix_us(self, true_s: float) -> float: ...

    @overload
    def unix_us(self, true_s: Floats) -> Floats: ...

    def unix_us(self, true_s: Floats | float) -> Floats | float:
        """Real time as microseconds after UNIX_US, so that a double holds their fractions."""
        shown: Any = self._real.elapsed_s(true_s)
        for step in self.steps:
            # A product, as it is the same for one time and for many.
            shown = shown + (true_s >= step.at_s) * step.by_s
        made: Floats | float = shown * 1e6
        return made
