"""What the daemon remembers, and the plots of it."""

import itertools
import json
import math
import random
import xml.etree.ElementTree as ET
from dataclasses import replace

import pytest

from j2a.syncd import history
from j2a.syncd.history import History, Round, allan_deviation, rounds_of
from j2a.syncd.plot import Panel, draw, panels_of


def some(count, seed=1):
    noise = random.Random(seed)
    return [Round(1e9 + t, noise.gauss(0, 3), 1e4, 5.0) for t in range(count)]


def test_rounds_come_back_from_json():
    kept = History()
    for one in some(5):
        kept.add("left", one)
    assert rounds_of(kept.facts("left")) == some(5)
    assert kept.facts("right") == []


def test_memory_is_bounded(monkeypatch):
    monkeypatch.setattr(history, "MAX_BOARDS", 3)
    monkeypatch.setattr(history, "MAX_ROUNDS", 4)
    kept = History()
    for number in range(10):
        for one in some(9):
            kept.add("first", one)
            kept.add(f"board {number}", one)
    assert kept.boards == ["board 8", "first", "board 9"]
    assert all(rounds_of(kept.facts(board)) == some(9)[-4:] for board in kept.boards)
    assert sum(map(len, kept._boards.values())) <= 3 * 4 * 5


@pytest.mark.parametrize("most", [1, 2, 3, 7])
def test_those_that_were_heard_last_are_kept_in_the_order_in_which_they_were(monkeypatch, most):
    monkeypatch.setattr(history, "MAX_BOARDS", most)
    kept, drawn, heard = History(), random.Random(most), []
    for _ in range(300):
        board = f"board {drawn.randrange(most + 3)}"
        kept.add(board, *some(1))
        heard = [*(one for one in heard if one != board), board][-most:]
        assert kept.boards == heard


@pytest.mark.parametrize("count", [1, 2, 1999, 2000, 2001, 3999, 4001, 7200, 20_000])
def test_what_is_told_is_thinned_regularly_and_ends_with_the_newest(count):
    kept = History()
    rounds = some(count)
    for one in rounds:
        kept.add("left", one)
    told = rounds_of(kept.facts("left"))
    assert min(count, 1000) <= len(told) <= 2000
    assert told[-1] == rounds[-1]
    assert set(told) <= set(rounds)
    steps = {later.time_s - one.time_s for one, later in itertools.pairwise(told)}
    assert len(steps) <= 1
    # The oldest are there, too: as many as are kept, less one step.
    kept_s = min(count, history.MAX_ROUNDS) - 1
    assert told[-1].time_s - told[0].time_s > kept_s - max(steps, default=1)


def test_a_reply_is_small_enough_to_delay_no_board():
    kept = History()
    for number in range(20_000):
        kept.add("left", Round(1.7e9 + number / 7, -number / 7e3, 1e5 / 7, number / 11))
    assert len(json.dumps({"rounds": kept.facts("left")})) < 200_000


@pytest.mark.parametrize("facts", [None, 1, [1], [[1, 2, 3]], [[1, 2, 3, "x"]], {"a": 1}])
def test_what_is_no_history_is_refused(facts):
    with pytest.raises(ValueError, match="no history"):
        rounds_of(facts)


def test_allan_deviation_of_a_drift_is_nothing_and_of_white_noise_falls_with_time():
    line = allan_deviation([3.0 * t for t in range(100)], 1.0)
    assert [tau for tau, _ in line] == [1, 2, 4, 8, 16, 32]
    assert all(deviation < 1e-9 for _, deviation in line)
    # A ramp of frequency of D us/s each second: D * tau / sqrt(2).
    for tau, deviation in allan_deviation([t * t / 2 for t in range(100)], 1.0):
        assert deviation == pytest.approx(tau / math.sqrt(2))
    noise = allan_deviation([one.offset_us for one in some(4096)], 0.5)
    for (tau, deviation), (_, later) in itertools.pairwise(noise[:7]):
        assert deviation == pytest.approx(3 * math.sqrt(3) / tau, rel=0.2)
        assert later < deviation
    assert allan_deviation([1.0, 2.0], 1.0) == []


@pytest.mark.parametrize("count", range(40))
def test_a_deviation_is_the_mean_of_two_second_differences_at_least(count):
    found = allan_deviation([one.offset_us for one in some(count)], 0.5)
    assert [tau / 0.5 for tau, _ in found] == [n for n in (1, 2, 4, 8, 16) if 2 * n + 2 <= count]


@pytest.mark.parametrize("set_s", [3600.0, -3600.0])
def test_a_step_of_the_clock_changes_no_allan_deviation(set_s):
    def deviations(rounds):
        (panel,) = (one for one in panels_of({"left": rounds}) if "Allan" in one.title)
        return panel.series["left"]

    rounds = some(400)
    moved = [replace(one, time_s=one.time_s + set_s) for one in rounds[200:]]
    assert deviations(rounds[:200] + moved) == deviations(rounds)


def texts(svg):
    return [element.text for element in ET.fromstring(svg).iter() if element.text]


def test_a_plot_shows_each_board_in_each_panel():
    svg = draw("Clocks", panels_of({"left <1>": some(50), "right": some(50, 2)}))
    root = ET.fromstring(svg)
    lines = root.findall(".//{http://www.w3.org/2000/svg}polyline")
    assert len(lines) == 8
    assert len(lines[0].get("points").split()) == 50
    assert {"left <1>", "right", "offset (µs)", "Allan deviation (ppm)"} <= set(texts(svg))


@pytest.mark.parametrize("count", [0, 1, 2, 3])
def test_a_plot_of_next_to_nothing(count):
    assert "nothing yet" in texts(draw("Clocks", panels_of({"left": some(count)})))


def test_a_long_series_keeps_its_extremes_and_stays_small():
    points = [(float(t), 1.0) for t in range(100_000)]
    points[777], points[99_000] = (777.0, 50.0), (99_000.0, -50.0)
    svg = draw("x", [Panel("y", "x", {"a": points})])
    assert len(svg) < 60_000
    ys = [float(p.split(",")[1]) for p in svg.split('points="')[1].split('"')[0].split()]
    # 200 pixels from 60 on stand for 60 to -60.
    assert (min(ys), max(ys)) == pytest.approx((60 + 10 / 0.6, 260 - 10 / 0.6), abs=0.1)


def test_values_that_cannot_be_drawn_are_left_out():
    points = [(0.0, math.nan), (1.0, math.inf), (2.0, 5.0), (3.0, 6.0)]
    svg = draw("x", [Panel("y", "x", {"a": points}), Panel("z", "x", {"a": points}, is_log=True)])
    assert svg.count("<polyline") == 2
    assert "nan" not in svg and "inf" not in svg


def test_flat_lines_and_huge_ranges_have_axes():
    almost = [(0.0, 7e15), (1.0, math.nextafter(7e15, 8e15))]
    least = [(0.0, 0.0), (5e-324, 5e-324)]
    for points in (
        [(0.0, 0.0)],
        almost,
        least,
        [(0.0, 7e15), (1.0, 7e15)],
        [(1e-9, 1e-12), (1e9, 1e12)],
    ):
        for is_log in (False, True):
            shown = [(x + 1, y + 1) for x, y in points] if is_log else points
            assert "<polyline" in draw("x", [Panel("y", "x", {"a": shown}, is_log=is_log)])
