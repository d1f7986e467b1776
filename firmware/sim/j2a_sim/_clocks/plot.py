"""Pictures of a run: how the errors are distributed, how they change, and the Allan deviation.

In: a report. Out: SVG text; no package is needed for it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations
from typing import Final

import numpy as np

from j2a_sim._clocks.report import Report, allan

__all__ = ["picture"]

LEFT, WIDTH, HEIGHT, GAP = 80, 720, 170, 75
COLORS: Final = (
    *("#0072b2", "#d55e00", "#009e73", "#cc79a7"),
    *("#56b4e9", "#e69f00", "#000000", "#8a7b00"),
)
MOST_POINTS: Final = 1500


class _Panel:
    """A plot with its axes: values of any size in, parts of SVG out."""

    def __init__(
        self, number: int, title: str, x: tuple[float, float], y: tuple[float, float]
    ) -> None:
        self.top = 40 + number * (HEIGHT + GAP)
        self._x, self._y = _wide(x), _wide(y)
        self.parts = [
            f'<text x="{LEFT}" y="{self.top - 10}" font-weight="bold">{title}</text>',
            f'<rect x="{LEFT}" y="{self.top}" width="{WIDTH}" height="{HEIGHT}" fill="none" '
            'stroke="#888"/>',
        ]

    def ticks(self, xs: Sequence[tuple[float, str]], ys: Sequence[tuple[float, str]]) -> None:
        """Label the axes."""
        for value, text in xs:
            at, _ = self._place(value, self._y[0])
            y = self.top + HEIGHT + 18
            self.parts.append(f'<text x="{at:.0f}" y="{y}" text-anchor="middle">{text}</text>')
        for value, text in ys:
            _, at = self._place(self._x[0], value)
            self.parts.append(
                f'<text x="{LEFT - 8}" y="{at + 4:.0f}" text-anchor="end">{text}</text>'
            )

    def line(self, xs: Sequence[float], ys: Sequence[float], color: str) -> None:
        """Draw points as one line."""
        places = (self._place(x, y) for x, y in zip(xs, ys, strict=True))
        text = " ".join(f"{x:.1f},{y:.1f}" for x, y in places)
        self.parts.append(
            f'<polyline points="{text}" fill="none" stroke="{color}" stroke-width="1.2"/>'
        )

    def _place(self, x: float, y: float) -> tuple[float, float]:
        right = (x - self._x[0]) / (self._x[1] - self._x[0])
        up = min(1.0, max(0.0, (y - self._y[0]) / (self._y[1] - self._y[0])))
        return LEFT + WIDTH * right, self.top + HEIGHT * (1 - up)


def _wide(span: tuple[float, float]) -> tuple[float, float]:
    return span if span[1] > span[0] else (span[0] - 0.5, span[0] + 0.5)


def _even(low: float, high: float, unit: str = "") -> list[tuple[float, str]]:
    return [(value, f"{value:.4g}{unit}") for value in np.linspace(low, high, 5)]


def _distribution(report: Report, number: int) -> _Panel:
    errors = report.errors_us[:, report.counted]
    pairs = [errors[a] - errors[b] for a, b in combinations(range(len(errors)), 2)]
    values = np.concatenate(pairs) if pairs else errors.ravel()
    title = "error between two boards, us" if pairs else "error to the host, us"
    low, high = (float(values.min()), float(values.max())) if values.size else (0.0, 0.0)
    low, high = _wide((low, high))
    shares, edges = np.histogram(values, bins=61, range=(low, high))
    shares = shares / max(1, shares.sum())
    panel = _Panel(number, f"{title}: share of readings", (low, high), (0, float(shares.max())))
    panel.line(((edges[1:] + edges[:-1]) / 2).tolist(), shares.tolist(), COLORS[0])
    panel.ticks(_even(low, high), _even(0, float(shares.max())))
    return panel


def _over_time(report: Report, number: int) -> _Panel:
    step = max(1, len(report.times_s) // MOST_POINTS)
    times, errors = report.times_s[::step], report.errors_us[:, ::step]
    seen = report.errors_us[:, report.counted]
    low, high = (float(seen.min()), float(seen.max())) if seen.size else (-1.0, 1.0)
    margin = max(1.0, (high - low) / 10)
    low, high = low - margin, high + margin
    panel = _Panel(
        number, "error of each board to the host, us", (0, report.settings.seconds), (low, high)
    )
    for i, row in enumerate(errors):
        panel.line(times.tolist(), row.tolist(), COLORS[i % len(COLORS)])
    panel.ticks(_even(0, report.settings.seconds, " s"), _even(low, high))
    return panel


def _deviation(report: Report, number: int) -> _Panel:
    errors = report.errors_us[:, report.counted]
    interval = float(np.median(np.diff(report.times_s))) if len(report.times_s) > 1 else 1.0
    rows = [allan(row, interval) for row in errors]
    rows = [(taus, values) for taus, values in rows if len(taus) and (values > 0).all()]
    taus = np.log10(np.concatenate([r[0] for r in rows])) if rows else np.array([0.0, 1.0])
    values = np.log10(np.concatenate([r[1] for r in rows])) if rows else np.array([-9.0, -6.0])
    x = (math.floor(taus.min()), math.ceil(taus.max()))
    y = (math.floor(values.min()), math.ceil(values.max()))
    panel = _Panel(number, "Allan deviation to the host, over averaging time", x, y)
    for i, (times, row) in enumerate(rows):
        panel.line(np.log10(times).tolist(), np.log10(row).tolist(), COLORS[i % len(COLORS)])
    panel.ticks(
        [(n, f"{10.0**n:g} s") for n in range(x[0], x[1] + 1)],
        [(n, f"1e{n}") for n in range(y[0], y[1] + 1)],
    )
    return panel


def picture(report: Report) -> str:
    """Return the three plots as SVG."""
    panels = [_distribution(report, 0), _over_time(report, 1), _deviation(report, 2)]
    height = 40 + len(panels) * (HEIGHT + GAP)
    body = "\n".join(part for panel in panels for part in panel.parts)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {LEFT + WIDTH + 40} {height}" '
        'font-family="sans-serif" font-size="13"><rect width="100%" height="100%" fill="white"/>\n'
        f"{body}\n</svg>\n"
    )
