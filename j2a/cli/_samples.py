"""Samples of sensors, as `j2a watch` shows them.

In: samples. Out: a line or an object for each, and for each sensor how regularly they come: the
last ones behind each line, or all of a span of time in a table.
Rules: a delay is that from the time stamp to the arrival, where the clock of the board is known;
else above that of the quickest sample in the same span of time, as the clocks of board and host are
not the same one. All delays of a table are of one kind. There are none where the clock of the board
does not run as that of the host does, as in a recording that is replayed faster.
"""

import math
import statistics
from collections import deque
from itertools import pairwise
from typing import Any, Final

import j2a
from j2a.cli._typed import json_of, plain
from j2a.types.scaled_numbers import scaling_of, shortest_in_unit
from j2a.types.transducers import Transducer

LAST: Final = 50
"""So many samples are behind the figures in the line of one."""

_US: Final = 1e6
_MS: Final = 1e3
_SLACK_US: Final = 1e3
"""By so much, and the error of the clock, a delay may be below 0: times of day are that exact."""
Facts = dict[str, float | int | None]
"""How regularly samples come: counts and, in milliseconds, times; None where it is not known."""


def sample_text(sample: j2a.Sample, sensor: Transducer) -> str:
    """Return a sample of a sensor as people read it, such as "quad  12.5 deg, N/A"."""
    unit = f" {sample.unit}" if sample.unit else ""
    channels = [one.channel for one in sample.readings]
    is_plain = channels == list(range(len(channels)))
    parts = [
        ("" if is_plain else f"[{one.channel}] ") + _value_text(one, unit, sensor)
        for one in sample.readings
    ]
    notes = [f"{name} {unit}" for name, unit in sample.field_units if unit]
    notes += [f"{sample.lost} lost"] * bool(sample.lost)
    notes += ["the clock went back"] * sample.is_reset
    more = f"  ({', '.join(notes)})" if notes else ""
    return f"{sample.name}  {', '.join(parts)}{more}"


def _value_text(reading: j2a.Reading, unit: str, sensor: Transducer) -> str:
    if reading.time_us is None:
        return "none yet"
    if reading.value is None:
        return "N/A"
    return f"{plain(_short(reading.value, reading.raw, sensor))}{unit}"


def _short(value: Any, raw: Any, sensor: Transducer) -> Any:
    """Leave out the digits that scaling and the f64 of an f32 add; JSON has all of them."""
    if isinstance(value, tuple) and isinstance(raw, tuple) and not hasattr(value, "_fields"):
        parts = zip(value, raw, strict=True)  # structures have no scale
        return tuple(_short(one, other, sensor) for one, other in parts)
    if not isinstance(value, float) or not math.isfinite(value):
        return value
    return shortest_in_unit(raw, sensor.type.element, *scaling_of(sensor))


def sample_facts(sample: j2a.Sample) -> dict[str, Any]:
    """Return what JSON has of a sample."""
    return {
        "sensor": sample.name,
        "unit": sample.unit,
        "units": sample.units,
        "readings": [
            {"channel": one.channel, "time_us": one.time_us, "value": json_of(one.value)}
            for one in sample.readings
        ],
        "lost": sample.lost,
        "is_reset": sample.is_reset,
    }


def rounded(facts: Facts) -> Facts:
    """Return figures as JSON has them."""
    return {key: round(one, 3) if isinstance(one, float) else one for key, one in facts.items()}


class _Rate:
    """What was seen of one sensor: of all its samples, or of so many last ones."""

    def __init__(self, last: int | None = None, gone: int | None = None) -> None:
        self.gone = gone  # as the last sample told, in whichever span of time
        self.host_s: deque[float] = deque(maxlen=last)
        self.device_s: deque[float] = deque(maxlen=last)
        self.true_s: deque[float] = deque(maxlen=last)
        self.doubts: deque[bool] = deque(maxlen=last)
        self.lost = 0
        self.missed = 0

    def add(self, sample: j2a.Sample, came_us: float, error_us: float, *, is_doubted: bool) -> None:
        self.lost += sample.lost
        # A SIF of another kind may have come behind a gap, and then it tells of it.
        gone = 0 if self.gone is None else sample.gone - self.gone
        self.missed += max(sample.missed, gone)
        self.gone = sample.gone
        if sample.is_reset:  # times before it are of another count
            for kept in (self.host_s, self.device_s, self.true_s, self.doubts):
                kept.clear()
        if sample.host_us is not None:
            delay_us = came_us - sample.host_us
            is_doubted |= delay_us < -error_us - _SLACK_US  # it came before it was taken
            self.true_s.append(max(0.0, delay_us) / _US)
        self.doubts.append(is_doubted)
        if sample.time_us is not None:
            self.host_s.append(sample.host_time)
            self.device_s.append(sample.time_us / _US)

    @property
    def is_relative(self) -> bool:
        """There are samples, and of none it is known how long it took."""
        return bool(self.host_s) and not self.true_s and not any(self.doubts)

    def facts(self, *, is_relative: bool) -> Facts:
        """Return samples, per second, and in ms: jitter of the board, delay at the median, most."""
        count = len(self.device_s)
        span_s = self.host_s[-1] - self.host_s[0] if count > 1 else 0.0
        periods = [b - a for a, b in pairwise(self.device_s)]
        delays, least = list(self.true_s), 0.0
        if is_relative:
            delays = [b - a for a, b in zip(self.device_s, self.host_s, strict=True)]
            delays = delays if count > 1 else []  # one is the quickest
            least = min(delays, default=0.0)
        if any(self.doubts):
            delays = []
        return {
            "samples": count,
            "per_s": (count - 1) / span_s if span_s > 0 else None,
            "jitter_ms": _MS * statistics.pstdev(periods) if len(periods) > 1 else None,
            "delay_ms": _MS * (statistics.median(delays) - least) if delays else None,
            "most_ms": _MS * (max(delays) - least) if delays else None,
            "is_relative": is_relative,
            "lost": self.lost,
            "missed": self.missed,
        }


class Rates:
    """How regularly the samples of each sensor come.

    Args:
        last: so many last samples of each are counted; None: all.
    """

    def __init__(self, last: int | None = None) -> None:
        self._last = last
        self._rates: dict[str, _Rate] = {}

    def add(
        self,
        sample: j2a.Sample,
        came_us: float,
        error_us: float = 0.0,
        *,
        is_doubted: bool = False,
    ) -> None:
        """Take a sample into the present span of time.

        Args:
            sample: of a sensor.
            came_us: when it came, in microseconds since 1970.
            error_us: bound of the error of its `host_us`.
            is_doubted: the clock of the board was asked, and does not run as expected.
        """
        rate = self._rates.setdefault(sample.name, _Rate(self._last))
        rate.add(sample, came_us, error_us, is_doubted=is_doubted)

    def facts(self, name: str) -> Facts:
        """Return what is seen now of a sensor, of which a sample was taken."""
        rate = self._rates[name]
        return rate.facts(is_relative=rate.is_relative)

    def take(self) -> dict[str, Facts]:
        """Return for each sensor what was seen of it since the last time; a new span begins."""
        rates = self._rates
        self._rates = {name: _Rate(self._last, rate.gone) for name, rate in rates.items()}
        is_relative = any(rate.is_relative for rate in rates.values())
        return {name: rate.facts(is_relative=is_relative) for name, rate in rates.items()}


def last_text(facts: Facts) -> str:
    """Return what stands behind the line of a sample: the figures that are known."""
    delay = "rel. delay" if facts["is_relative"] else "delay"
    shown = [
        text.format(facts[key])
        for key, text in (
            ("per_s", "{:.2f}/s"),
            ("jitter_ms", "jitter {:.2f} ms"),
            ("delay_ms", delay + " {:.2f} ms"),
            ("most_ms", "most {:.2f} ms"),
        )
        if facts[key] is not None
    ]
    shown += [f"{key} {facts[key]}" for key in ("lost", "missed") if facts[key]]
    return f"  [{', '.join(shown)}]" if shown else ""


def rate_head(*, is_relative: bool) -> str:
    """Return the head of the table; it says what the delays are."""
    delay, most = ("rel. delay", "rel. most") if is_relative else ("delay", "most")
    return (
        f"{'sensor':<16} {'samples':>8} {'per s':>8} "
        f"{'jitter':>10} {delay:>10} {most:>10} {'lost':>6} {'missed':>6}"
    )


def rate_text(name: str, facts: Facts) -> str:
    """Return the line below the head for a sensor."""

    def cell(key: str, unit: str, width: int) -> str:
        value = facts[key]
        text = "-" if value is None or not math.isfinite(value) else f"{value:.2f}{unit}"
        return f"{text:>{width}}"

    return (
        f"{name:<16} {facts['samples']:>8} {cell('per_s', '', 8)} {cell('jitter_ms', ' ms', 10)} "
        f"{cell('delay_ms', ' ms', 10)} {cell('most_ms', ' ms', 10)} {facts['lost']:>6} "
        f"{facts['missed']:>6}"
    )
