"""The line between bounds: against the definition, by trying slopes."""

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from j2a.protocol.clock.strip import Bounds, fit_strip

MOST = 0.01


def width(points: list[Bounds], slope: float) -> float:
    return min(p.high - slope * p.x for p in points) - max(p.low - slope * p.x for p in points)


@st.composite
def bounds(draw: st.DrawFn) -> list[Bounds]:
    xs = sorted(draw(st.lists(st.integers(-(10**7), 0), min_size=1, max_size=20)))
    slope = draw(st.floats(-0.009, 0.009))
    lows = [draw(st.floats(0.01, 1e4)) for _ in xs]
    highs = [draw(st.floats(0.01, 1e4)) for _ in xs]
    return [
        Bounds(float(x), slope * x - low, slope * x + high)
        for x, low, high in zip(xs, lows, highs, strict=True)
    ]


@settings(max_examples=60, deadline=None)
@given(bounds(), st.randoms(use_true_random=False))
def test_no_slope_leaves_a_wider_strip(points: list[Bounds], draw: random.Random) -> None:
    found = fit_strip(points, MOST)
    assert found.width == pytest.approx(width(points, found.slope), abs=1e-6)
    slopes = [draw.uniform(-MOST, MOST) for _ in range(200)]
    slopes += [found.slope + draw.gauss(0, 1e-6) for _ in range(50)]
    assert max(width(points, s) for s in slopes if abs(s) <= MOST) <= found.width + 1e-3


@settings(max_examples=60, deadline=None)
@given(bounds(), st.randoms(use_true_random=False))
def test_each_line_between_the_bounds_is_inside(points: list[Bounds], draw: random.Random) -> None:
    found = fit_strip(points, MOST)
    assert found.width >= 0
    least, most = found.slopes
    for _ in range(200):
        slope = draw.uniform(least - 1e-4, most + 1e-4)
        if abs(slope) > MOST or width(points, slope) < 0:
            continue
        assert least - 1e-9 <= slope <= most + 1e-9
        for end in (
            min(p.high - slope * p.x for p in points),
            max(p.low - slope * p.x for p in points),
        ):
            assert found.low - 1e-3 <= end <= found.high + 1e-3


def test_one_exchange_tells_no_slope() -> None:
    found = fit_strip([Bounds(0.0, -5.0, 15.0)], MOST)
    assert (found.slope, found.middle, found.width) == (0.0, 5.0, 20.0)
    assert (found.low, found.high, found.slopes) == (-5.0, 15.0, (-MOST, MOST))


def test_bounds_that_contradict_leave_no_strip() -> None:
    points = [Bounds(-2e6, 0.0, 1.0), Bounds(-1e6, 50.0, 51.0), Bounds(0.0, 0.0, 1.0)]
    assert fit_strip(points, MOST).width == pytest.approx(-49.0)
