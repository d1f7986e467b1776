"""The figures of a run, each beside the bound that analysis gives, as JSON and as a table.

In: what the clocks of the boards showed at known true times, and what the host's clock showed.
Out: figures in microseconds and shares.
Rules: an error is exact: the difference of what a board shows, whole microseconds, to what the
host's clock shows then, or to what another board shows at the same instant. Only readings count
that are behind the time to settle, at the start and behind each disturbance that the settings
name; in a run that is too short for that, those of the time from which on all clocks are set.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from j2a.protocol.clock.estimator import BAUD_TOLERANCE, WINDOW
from j2a_sim._clocks.delays import BOARD_BYTE_S, HOST_BYTE_S
from j2a_sim._clocks.frames import CABLE_S, HUB_S, TIERS
from j2a_sim._clocks.settings import Settings
from j2a_sim._clocks.truth import UNIX_US, Floats, HostClock
from j2a_sim._errors import SimError

__all__ = ["UNKNOWN", "Readings", "Report", "allan", "make_report"]

UNKNOWN: Final = 0xFFFFFFFF
REPLY_BYTES: Final = 20  # of an exchange
HOST_BYTE_US: Final = 1e6 * HOST_BYTE_S
BOARD_BYTE_US: Final = 1e6 * BOARD_BYTE_S
STATES: Final = ("free", "settling", "locked", "holdover")


@dataclass(frozen=True, slots=True)
class Readings:
    """What one board showed.

    Attributes:
        clock_us: its time, microseconds since 1970.
        state, epoch: as SPEC numbers them.
        uncertainty_us: what it announced, or the daemon for it; UNKNOWN: nothing.
    """

    clock_us: NDArray[np.uint64]
    state: NDArray[np.uint8]
    epoch: NDArray[np.uint8]
    uncertainty_us: NDArray[np.uint32]

    def error_us(self, host_us: Floats) -> Floats:
        """Its time minus the host's, which is given as microseconds after UNIX_US."""
        shown = self.clock_us.astype(np.int64) - UNIX_US
        return shown - host_us


@dataclass(frozen=True, slots=True)
class Report:
    """The figures of a run; docs/clock-bench.md says what each is.

    Attributes:
        settings: of the run.
        figures: name -> value; None where there was nothing to measure it by.
        bounds: name of a figure -> what analysis gives for it; none of a run that is too short.
        times_s, errors_us: for plots: true times, and for each board its error to the host.
        counted: which of these times are in the figures.
        cpu_us: processor time of the host for each exchange, on this machine.
    """

    settings: Settings
    figures: dict[str, Any]
    bounds: dict[str, float]
    times_s: Floats
    errors_us: Floats
    counted: NDArray[np.bool_]
    cpu_us: float = 0.0

    def as_dict(self) -> dict[str, Any]:
        """For `--json`."""
        return {
            **self.figures,
            "bounds": self.bounds,
            "settings": self.settings.as_dict(),
            "engine": self.settings.chosen_engine,
            "seed": self.settings.seed,
            "host_cpu_us": self.cpu_us,
        }

    def as_text(self) -> str:
        """A table for people."""
        s = self.settings
        lines = [
            f"{s.boards} boards, {s.seconds:g} s, {s.link}, engine {s.chosen_engine}, "
            f"seed {s.seed}; figures after {s.settle_s:g} s",
            f"{'figure':24}{'value':>14}{'bound':>14}",
        ]
        for name, value in self.figures.items():
            bound = f"{self.bounds[name]:.6g}" if name in self.bounds else ""
            text = f"{value:.6g}" if isinstance(value, float) else str(value)
            text = "-" if value is None else text
            lines.append(f"{name:24}{text:>14}{bound:>14}".rstrip())
        if not s.is_settled:
            lines.append("too short for the clocks to settle: no bounds")
        lines.append(f"the host took {self.cpu_us:.0f} us of processor time for each exchange")
        return "\n".join(lines)


def counted(settings: Settings, times_s: Floats) -> NDArray[np.bool_]:
    """Which readings count: those behind the start and each disturbance by the time to settle.

    A slew of the host's clock is none: boards have to follow it.
    """
    settle = settings.settle_s
    good = times_s >= settle
    for at, lasts in (
        (settings.step_at, 0.0),
        (settings.suspend_at, settings.suspend_for),
        (settings.unplug_at, settings.unplug_for),
    ):
        if at is not None:
            good &= (times_s < at) | (times_s >= at + lasts + settle)
    return good


def make_report(
    settings: Settings,
    times_s: Floats,
    boards: list[Readings],
    host: HostClock,
    *,
    more: dict[str, Any],
    slack_us: float,
    drift_us: float = 0.0,
    cpu_us: float = 0.0,
) -> Report:
    """Work the figures out.

    Args:
        settings: of the run.
        times_s: at which all boards were read.
        boards: what they showed.
        host: the host's clock.
        more: figures that were counted elsewhere, such as backwards.
        slack_us: the least of what the exchanges' round trips left unexplained.
        cpu_us: processor time of the host for each exchange.
        drift_us: how far the oscillators take the clocks from the host's in holdover, at most.

    Raises:
        SimError: no reading counts.
    """
    host_us = host.unix_us(times_s)
    errors = np.array([board.error_us(host_us) for board in boards])
    good = announced = counted(settings, times_s)
    if settings.holdover_at is not None:
        good = good & (times_s < settings.holdover_at)
    if not good.any():
        raise SimError(
            f"no clock is read after it has settled, which takes {settings.settle_s:g} s from the "
            "start and from each disturbance: choose more --seconds"
        )
    if not settings.is_settled:  # else a clock that nobody has set is an error that shows
        is_set = np.all([board.epoch != 0 for board in boards], axis=0)
        good, announced = good & is_set, announced & is_set
        if not good.any():
            raise SimError("no clock is read after it was set: choose more --seconds")
    figures: dict[str, Any] = _pairs(errors[:, good])
    figures["host_rms_us"] = _rms(errors[:, good])
    figures["host_peak_us"] = float(np.abs(errors[:, good]).max(initial=0))
    # In holdover nobody announces anything for a board on a USB: the daemon is gone.
    figures.update(_uncertainty(boards, errors, good if settings.link == "usb" else announced))
    states = np.concatenate([board.state[good] for board in boards])
    figures["locked"] = float(np.mean(states == STATES.index("locked"))) if states.size else 0.0
    figures["epochs"] = [int(board.epoch[-1]) for board in boards]
    if settings.holdover_at is not None:
        figures["holdover_end_us"] = float(np.abs(errors[:, -1]).max())
    figures.update(more)
    step = max(1, len(times_s) // 20_000)
    return Report(
        settings,
        figures,
        bounds(settings, slack_us, drift_us) if settings.is_settled else {},
        times_s[::step],
        errors[:, ::step],
        good[::step],
        cpu_us,
    )


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0


def _pairs(errors: Floats) -> dict[str, Any]:
    """The worst of all pairs, by rms and by the greatest difference; None where there is none."""
    pairs = [errors[one] - errors[other] for one, other in combinations(range(len(errors)), 2)]
    return {
        "pair_rms_us": max(map(_rms, pairs), default=None),
        "pair_peak_us": max((float(np.abs(pair).max(initial=0)) for pair in pairs), default=None),
    }


def _uncertainty(boards: list[Readings], errors: Floats, good: NDArray[np.bool_]) -> dict[str, Any]:
    """How honest the announced uncertainties are."""
    told = np.array([board.uncertainty_us for board in boards])[:, good]
    known = told != UNKNOWN
    inside = np.abs(errors[:, good]) <= told
    return {
        "inside_uncertainty": float(np.mean(inside[known])) if known.any() else 0.0,
        "known_uncertainty": float(np.mean(known)) if known.size else 0.0,
        "uncertainty_us": float(np.median(told[known])) if known.any() else None,
        "readings": int(known.size),
    }


def bounds(settings: Settings, slack_us: float, drift_us: float = 0.0) -> dict[str, float]:
    """What analysis gives.

    Between two boards on a USB: a board takes the whole microseconds of its local time to whole
    microseconds of its clock, which cuts off two parts, each as likely as another from 0 to 1 us.
    So two clocks that agree show times that differ by sqrt(4/12) us rms, and by less than 2 us. The
    counter ticks each half microsecond, which the filter hardly lets through; a hub and its cable
    take up to 70 ns, and an interrupt is up to four cycles late, 0.25 us at 16 MHz, behind the
    instruction that it met. What is shown differs by whole microseconds. To the host: half of
    what a round trip leaves unexplained, and half a microsecond of rounding; by UART also half of
    what the board's bit rate, which is not the nominal one, takes off the reply. In holdover: what
    the oscillators do, the error at its begin, twice, and what a rate can be off that is true for
    all exchanges which the host keeps. Elsewhere two boards differ by no more than the sum of their
    errors to the host.
    At worst a board is off by all of what a round trip leaves unexplained, because the truth and
    the estimate both lie in it. As much is announced: half of it, and once more half, by which the
    lines through all kept exchanges diverge from the middle of them to the newest one; then a
    microsecond of the counter and one that is rounded up, and by UART what the speed of the longest
    message may be off. While the host's clock is slewed boards are behind it, and in holdover what
    is announced grows: no bound.
    """
    host = slack_us / 2 + 0.5
    if settings.link == "serial":
        host += REPLY_BYTES * abs(HOST_BYTE_US - BOARD_BYTE_US) / 2
    found = {"host_rms_us": host}
    if settings.slew_at is None:
        found["host_peak_us"] = 2 * host
        if settings.holdover_at is None:
            is_serial = settings.link == "serial"
            baud = BAUD_TOLERANCE * HOST_BYTE_US * REPLY_BYTES if is_serial else 0.0
            found["uncertainty_us"] = 2 * host + 2 + baud
    if settings.holdover_at is not None:
        kept_s, held_s = WINDOW * settings.period_s, settings.seconds - settings.holdover_at
        found["holdover_end_us"] = drift_us + 2 * host * (1 + held_s / kept_s)
    if settings.boards == 1:
        return found
    if settings.link != "usb":
        return {**found, "pair_rms_us": host * math.sqrt(2), "pair_peak_us": 4 * host}
    hubs = 1e6 * (TIERS * HUB_S[1] + CABLE_S)
    latency = 0.25 / math.sqrt(12)
    counter = 0.5 / math.sqrt(12)
    rms = math.sqrt(4 / 12 + 2 * latency**2 + 2 * counter**2 + hubs**2)
    peak = math.floor(2 + hubs + 2 * 0.25 + 0.5)
    return {**found, "pair_rms_us": rms, "pair_peak_us": peak}


def allan(errors_us: Floats, interval_s: float) -> tuple[Floats, Floats]:
    """The overlapping Allan deviation of a clock.

    Args:
        errors_us: its errors at equal intervals.
        interval_s: between two of them.

    Returns:
        Averaging times in seconds, one for each octave, and the deviations, without unit.
    """
    count = len(errors_us)
    spans = [2**i for i in range(int(math.log2(max(1, count // 3))) + 1)] if count >= 3 else []
    made = []
    for m in spans:
        second = errors_us[2 * m :] - 2 * errors_us[m:-m] + errors_us[: -2 * m]
        made.append(float(np.sqrt(np.mean(second**2) / 2)) * 1e-6 / (m * interval_s))
    return np.array(spans, dtype=np.float64) * interval_s, np.array(made)
