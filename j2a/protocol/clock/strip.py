"""The lines that pass between bounds above and below them.

What flows in: for each exchange an interval that holds the truth. What flows out: the line in the
middle of the widest strip between all bounds, and how far up and down any line can be.
Rules: plain arithmetic; of n points only those matter that a line can touch, which are a few.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

__all__ = ["Bounds", "Strip", "fit_strip"]

_PASSES: Final = 40
_CLOSE: Final = 1e-4
_Point = tuple[float, float]
_Tangent = tuple[float, float]
"""A value of a concave function, and its slope there."""


class Bounds(NamedTuple):
    """The truth at `x` is between `low` and `high`."""

    x: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Strip:
    """What is known of a line that passes between all bounds.

    Attributes:
        slope: of the widest strip, whose middle is the estimate.
        middle: of that strip at x = 0.
        width: of that strip; below 0 where no line passes between the bounds.
        low, high: no line is below or above this at x = 0.
        slopes: the least and the greatest slope of a line.
    """

    slope: float
    middle: float
    width: float
    low: float
    high: float
    slopes: tuple[float, float]


def fit_strip(points: Sequence[Bounds], max_slope: float) -> Strip:
    """Return the strip between the bounds.

    Args:
        points: one or more, in the order of x.
        max_slope: the greatest absolute slope that is possible.
    """
    above = _hull([(x, high) for x, _, high in points])
    below = [(x, -y) for x, y in _hull([(x, -low) for x, low, _ in points])]

    def top(slope: float) -> _Tangent:
        value, x = min((y - slope * x, x) for x, y in above)
        return value, -x

    def bottom(slope: float) -> _Tangent:
        value, x = min((slope * x - y, -x) for x, y in below)
        return value, -x

    def width(slope: float) -> _Tangent:
        one, other = top(slope), bottom(slope)
        return one[0] + other[0], one[1] + other[1]

    slope, widest = _maximum(width, -max_slope, max_slope)
    middle = (top(slope)[0] - bottom(slope)[0]) / 2
    if widest < 0:
        return Strip(slope, middle, widest, middle, middle, (slope, slope))
    least, most = _root(width, -max_slope, slope), _root(width, max_slope, slope)
    high = _maximum(top, least, most)[1]
    low = -_maximum(bottom, least, most)[1]
    return Strip(slope, middle, widest, low, high, (least, most))


def _hull(points: Sequence[_Point]) -> list[_Point]:
    """Return the points that a line from below can touch."""
    hull: list[_Point] = []
    for x, y in points:
        while len(hull) > 1:
            (x0, y0), (x1, y1) = hull[-2:]
            if (y1 - y0) * (x - x0) < (y - y0) * (x1 - x0):
                break
            hull.pop()
        if hull and hull[-1][0] == x:
            if hull[-1][1] <= y:
                continue
            hull.pop()
        hull.append((x, y))
    return hull


def _maximum(function: Callable[[float], _Tangent], low: float, high: float) -> tuple[float, float]:
    """Return where a concave function of straight pieces is greatest, and how great.

    The tangents at two arguments with the maximum between them meet above it; that is the next
    argument. Where the maximum is a level piece, its middle is returned.
    """
    left, right = function(low), function(high)
    if left[1] < 0:
        return low, left[0]
    if right[1] > 0:
        return high, right[0]
    at, found = (low, left) if left[1] == 0 else (high, right)
    for _ in range(_PASSES if found[1] else 0):
        at = low + (right[0] - left[0] - right[1] * (high - low)) / (left[1] - right[1])
        ceiling = left[0] + left[1] * (at - low)
        found = function(at)
        if found[1] == 0 or not low < at < high or ceiling - found[0] < _CLOSE:
            break
        if found[1] > 0:
            low, left = at, found
        else:
            high, right = at, found
    if found[1] == 0:
        level = found[0] - _CLOSE
        ends = _crossing(function, low, at, level), _crossing(function, high, at, level)
        return sum(ends) / 2, found[0]
    return at, found[0]


def _root(function: Callable[[float], _Tangent], outside: float, inside: float) -> float:
    return _crossing(function, outside, inside, 0.0)


def _crossing(
    function: Callable[[float], _Tangent], outside: float, inside: float, level: float
) -> float:
    """Return where a concave function crosses a level, from an argument outside on.

    Newton's method never passes the crossing of a concave function, and ends at the last piece.
    """
    for _ in range(_PASSES):
        value, slope = function(outside)
        if value >= level or slope == 0 or outside == inside:
            break
        outside += (level - value) / slope
    return outside
