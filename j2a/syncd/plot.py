"""Plots of clocks as SVG: series of points over a shared axis.

In: numbers. Out: a text that browsers and viewers show, readable on light and dark ground.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from itertools import pairwise
from statistics import median
from typing import Final

from j2a.syncd.history import Round, allan_deviation, phases_us

__all__ = ["Panel", "draw", "panels_of"]

Points = Sequence[tuple[float, float]]
WIDTH: Final = 820
HEIGHT: Final = 200
_LEFT: Final = 90
_GAP: Final = 70
_TOP: Final = 40
_MAX_POINTS: Final = 2000
_COLOURS: Final = ("#1f77b4", "#d95f02", "#1b9e77", "#7570b3", "#e7298a", "#66a61e")
_MAX_DECADES: Final = 15
_LEAST_SPREAD: Final = 1e-12
"""Less than this, also as a part of the values themselves, is a flat line."""
_LEAST_LOG: Final = 1e-300
"""What is smaller has no decade that a float can be."""


@dataclass(frozen=True, slots=True)
class Panel:
    """One set of axes.

    Attributes:
        title: above it, with the unit of y.
        x_title: below it, with its unit.
        series: points by the name of the line.
        is_log: both axes are logarithmic; points that are not above 0 are left out.
    """

    title: str
    x_title: str
    series: Mapping[str, Points]
    is_log: bool = False


def panels_of(boards: dict[str, list[Round]]) -> list[Panel]:
    """Return the panels of a history: offset, rate, uncertainty, and Allan deviation."""
    start_s = min((r.time_s for rounds in boards.values() for r in rounds[:1]), default=0.0)

    def over_time(name: str) -> Mapping[str, Points]:
        return {
            board: [(r.time_s - start_s, getattr(r, name)) for r in rounds]
            for board, rounds in boards.items()
        }

    deviations = {}
    for board, rounds in boards.items():
        if len(rounds) > 3:
            # The median, for the clock of the computer may have been set, or slept.
            period_s = median(later.time_s - one.time_s for one, later in pairwise(rounds))
            if period_s > 0:
                deviations[board] = allan_deviation(phases_us(rounds, period_s), period_s)
    seconds = "seconds since the first round"
    return [
        Panel("offset (µs)", seconds, over_time("offset_us")),
        Panel("rate (ppb)", seconds, over_time("rate_ppb")),
        Panel("uncertainty (µs)", seconds, over_time("uncertainty_us")),
        Panel("Allan deviation (ppm)", "averaging time (s)", deviations, is_log=True),
    ]


def draw(title: str, panels: Sequence[Panel]) -> str:
    """Return an SVG of the panels, one below the other."""
    names = sorted({name for panel in panels for name in panel.series})
    colours = {name: _COLOURS[k % len(_COLOURS)] for k, name in enumerate(names)}
    total = _TOP + len(panels) * (HEIGHT + _GAP) + 22 * len(names) + 10
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_LEFT + WIDTH + 30} {total}" '
        f'font-family="sans-serif" font-size="13"><title>{escape(title)}</title>',
        '<rect width="100%" height="100%" fill="#ffffff"/>',
        f'<text x="{_LEFT}" y="22" font-size="16" fill="#222">{escape(title)}</text>',
    ]
    for k, panel in enumerate(panels):
        parts += _panel(panel, _TOP + k * (HEIGHT + _GAP), colours)
    for k, name in enumerate(names):
        y = _TOP + len(panels) * (HEIGHT + _GAP) + 22 * k
        parts.append(
            f'<rect x="{_LEFT}" y="{y}" width="14" height="14" fill="{colours[name]}"/>'
            f'<text x="{_LEFT + 20}" y="{y + 12}" fill="#222">{escape(name)}</text>'
        )
    return "".join(parts) + "</svg>\n"


def _panel(panel: Panel, top: float, colours: dict[str, str]) -> list[str]:
    lines = {
        name: shown
        for name, points in panel.series.items()
        if (shown := _shown(points, is_log=panel.is_log))
    }
    parts = [
        f'<text x="{_LEFT}" y="{top + 12}" fill="#222">{escape(panel.title)}</text>',
        f'<rect x="{_LEFT}" y="{top + 20}" width="{WIDTH}" height="{HEIGHT}" fill="none" '
        'stroke="#999"/>',
        f'<text x="{_LEFT + WIDTH}" y="{top + HEIGHT + 54}" text-anchor="end" '
        f'fill="#555">{escape(panel.x_title)}</text>',
    ]
    if not lines:
        middle = f'x="{_LEFT + WIDTH / 2}" y="{top + 20 + HEIGHT / 2}"'
        return [*parts, f'<text {middle} text-anchor="middle" fill="#777">nothing yet</text>']
    x_axis = _Axis([x for points in lines.values() for x, _ in points], is_log=panel.is_log)
    y_axis = _Axis([y for points in lines.values() for _, y in points], is_log=panel.is_log)
    for value, text in y_axis.ticks():
        y = top + 20 + HEIGHT * (1 - y_axis.place(value))
        parts.append(
            f'<line x1="{_LEFT}" x2="{_LEFT + WIDTH}" y1="{y:.1f}" y2="{y:.1f}" stroke="#ddd"/>'
            f'<text x="{_LEFT - 6}" y="{y + 4:.1f}" text-anchor="end" fill="#555">{text}</text>'
        )
    for value, text in x_axis.ticks():
        x = _LEFT + WIDTH * x_axis.place(value)
        parts.append(
            f'<text x="{x:.1f}" y="{top + HEIGHT + 36}" text-anchor="middle" '
            f'fill="#555">{text}</text>'
        )
    for name, points in lines.items():
        path = " ".join(
            f"{_LEFT + WIDTH * x_axis.place(x):.1f},{top + 20 + HEIGHT * (1 - y_axis.place(y)):.1f}"
            for x, y in points
        )
        parts.append(
            f'<polyline points="{path}" fill="none" stroke="{colours[name]}" stroke-width="1.5"/>'
        )
    return parts


def _shown(points: Points, *, is_log: bool) -> list[tuple[float, float]]:
    """Return the points that can be drawn; of very many, the extremes of each stretch."""
    finite = [
        (x, y)
        for x, y in points
        if math.isfinite(x) and math.isfinite(y) and (not is_log or min(x, y) >= _LEAST_LOG)
    ]
    if len(finite) <= _MAX_POINTS:
        return finite
    stretch = math.ceil(2 * len(finite) / _MAX_POINTS)
    shown = []
    for k in range(0, len(finite), stretch):
        part = finite[k : k + stretch]
        ends = {min(part, key=lambda p: p[1]), max(part, key=lambda p: p[1])}
        shown += sorted(ends)
    return shown


class _Axis:
    """The range of one axis and its round numbers."""

    def __init__(self, values: Sequence[float], *, is_log: bool) -> None:
        self._is_log = is_log
        low, high = min(values), max(values)
        if is_log:
            self._low = float(math.floor(math.log10(low)))
            self._high = max(float(math.ceil(math.log10(high))), self._low + 1)
            return
        spread, large = high - low, max(abs(low), abs(high))
        if spread <= _LEAST_SPREAD * large or spread < _LEAST_SPREAD:
            spread = large if large > _LEAST_SPREAD else 1.0
        self._step = 10.0 ** math.floor(math.log10(spread / 4))
        for factor in (5, 2):
            if spread / (factor * self._step) >= 4:
                self._step *= factor
                break
        self._low = math.floor(low / self._step) * self._step
        self._high = max(math.ceil(high / self._step) * self._step, self._low + self._step)

    def place(self, value: float) -> float:
        """Return where a value stands, 0 to 1."""
        at = math.log10(value) if self._is_log else value
        return (at - self._low) / (self._high - self._low)

    def ticks(self) -> list[tuple[float, str]]:
        """Return round values of the range and their texts."""
        if self._is_log:
            every = math.ceil((self._high - self._low) / _MAX_DECADES)
            decades = range(int(self._low), int(self._high) + 1, every)
            return [(10.0**n, f"1e{n}") for n in decades]
        count = round((self._high - self._low) / self._step)
        return [
            (value, f"{value:.6g}")
            for value in (self._low + k * self._step for k in range(count + 1))
        ]
