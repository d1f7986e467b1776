"""The figures of the bench, from readings whose errors are known."""

import json
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
from j2a_sim import SimError
from j2a_sim._clocks.plot import picture
from j2a_sim._clocks.report import UNKNOWN, Readings, allan, bounds, make_report
from j2a_sim._clocks.settings import SETTLE_S, Settings
from j2a_sim._clocks.truth import UNIX_US, HostClock


def readings(host_us, errors_us, uncertainty=20, state=2):
    count = len(host_us)
    shown = (UNIX_US + np.round(host_us + errors_us)).astype(np.uint64)
    return Readings(
        shown,
        np.full(count, state, np.uint8),
        np.full(count, 1, np.uint8),
        np.full(count, uncertainty, np.uint32),
    )


@pytest.fixture
def times():
    return np.linspace(1, 100, 10_000)


@pytest.fixture
def clock():
    return HostClock(np.random.default_rng(1), 100, ntp=False, ppm=0)


def report(times, clock, errors, **more):
    settings = Settings(boards=len(errors), seconds=100, **more)
    host = clock.unix_us(times)
    boards = [readings(host, error) for error in errors]
    return make_report(settings, times, boards, clock, more={"backwards": 0}, slack_us=30.0)


def test_errors_between_boards_and_to_the_host(times, clock):
    zero = np.zeros(len(times))
    found = report(times, clock, [zero + 5, zero + 7, zero - 1]).figures
    assert found["pair_rms_us"] == pytest.approx(8, abs=0.1), "the worst pair"
    assert found["pair_peak_us"] == pytest.approx(8, abs=1.1)
    assert found["host_rms_us"] == pytest.approx(np.sqrt((25 + 49 + 1) / 3), abs=0.1)
    assert found["inside_uncertainty"] == 1.0 and found["known_uncertainty"] == 1.0
    assert found["locked"] == 1.0


def test_what_was_not_measured_does_not_look_perfect(times, clock):
    """One board has no pair; a board that announces nothing is not known to a microsecond."""
    found = report(times, clock, [np.zeros(len(times))])
    told = json.loads(json.dumps(found.as_dict()))
    assert told["pair_rms_us"] is None and told["pair_peak_us"] is None
    assert not {"pair_rms_us", "pair_peak_us"} & told["bounds"].keys()
    rows = {line.split()[0]: line.split()[1:] for line in found.as_text().splitlines()}
    assert rows["pair_rms_us"] == rows["pair_peak_us"] == ["-"]


def test_what_is_outside_its_uncertainty_is_counted(times, clock):
    error = np.where(times > 90, 30.0, 0.0)
    found = report(times, clock, [error, np.zeros(len(times))]).figures
    assert found["inside_uncertainty"] == pytest.approx(1 - 0.5 * 10 / 90, abs=0.001)


def test_disturbances_and_the_start_are_left_out(times, clock):
    error = np.where((times < 10) | ((times >= 50) & (times < 60)), 1e6, 0.0)
    settled = report(times, clock, [error, error], step_at=50.0).figures
    assert settled["host_rms_us"] < 1
    assert report(times, clock, [error, error]).figures["host_rms_us"] > 1e5


def test_an_unknown_uncertainty_is_told_as_such(times, clock):
    host = clock.unix_us(times)
    boards = [readings(host, np.zeros(len(times)), UNKNOWN)]
    settings = Settings(boards=1, seconds=100)
    found = make_report(settings, times, boards, clock, more={}, slack_us=30.0).figures
    assert found["known_uncertainty"] == 0 and found["inside_uncertainty"] == 0
    assert found["uncertainty_us"] is None


def test_allan_deviations_of_known_noises():
    rng = np.random.default_rng(3)
    white_phase = rng.normal(0, 1, 2**14)  # us
    taus, values = allan(white_phase, 1.0)
    assert values[0] == pytest.approx(np.sqrt(3) * 1e-6, rel=0.05)
    assert values[4] / values[0] == pytest.approx(1 / 16, rel=0.1), "falls with tau"
    steady = 1e-6 * 1e6 * np.arange(1000.0)  # 1 ppm off, which is no instability
    assert allan(steady, 1.0)[1].max() < 1e-12
    assert list(taus[:3]) == [1.0, 2.0, 4.0]
    assert len(allan(np.zeros(2), 1.0)[0]) == 0


def test_a_report_is_json_text_and_a_picture(times, clock):
    rng = np.random.default_rng(1)
    made = report(times, clock, [rng.normal(0, 1, len(times)) for _ in range(3)])
    told = json.loads(json.dumps(made.as_dict()))
    for name in ("pair_rms_us", "pair_peak_us", "host_rms_us", "inside_uncertainty", "backwards"):
        assert name in told
        assert name in made.as_text()
    assert told["settings"]["settle_s"] == 10 and told["engine"] == "native"
    assert "pair_rms_us" in told["bounds"]
    root = ElementTree.fromstring(picture(made))
    assert len(root.findall("{*}polyline")) == 1 + 3 + 3


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"boards": 0}, "--boards 0 is out of range"),
        ({"seconds": 2}, "--seconds 2 is out of range"),
        ({"seconds": float("nan")}, "--seconds nan is out of range"),
        ({"link": "can"}, "none of usb"),
        ({"engine": "avr", "link": "tcp"}, "choose the engine native"),
        ({"link": "serial", "suspend_at": 1.0}, "--suspend-at needs --link usb"),
        ({"link": "tcp", "lost_sof": 0.1}, "--lost-sof needs --link usb"),
        ({"link": "rfcomm", "sof_jitter_ns": 0.0}, "--sof-jitter-ns needs --link usb"),
        ({"lost_sof": 0.9}, "--lost-sof"),
        ({"step_by": 1.0}, "--step-by needs --step-at"),
        ({"slew_ppm": 1.0}, "--slew-ppm needs --slew-at"),
        ({"suspend_for": 1.0}, "--suspend-for needs --suspend-at"),
        ({"unplug_for": 1.0}, "--unplug-for needs --unplug-at"),
        ({"suspend_at": 1.0, "suspend_for": 0.0}, "--suspend-for 0 is out of range"),
        ({"holdover_at": 20.0}, "--holdover-at 20 is out of the run"),
        ({"holdover_at": 10.0}, "--holdover-at 10 comes before the clocks have settled"),
        ({"step_at": -1.0}, "--step-at -1 is out of the run"),
        ({"unplug_at": float("nan")}, "--unplug-at nan is out of the run"),
    ],
)
def test_settings_are_checked(wrong, said):
    with pytest.raises(SimError, match=said):
        Settings(**wrong)


@pytest.mark.parametrize("link", SETTLE_S)
@pytest.mark.parametrize(
    ("period_s", "rounds"), [(0.1, 1), (0.9, 1), (1.0, 1), (1.5, 1.5), (10.0, 10), (60.0, 60)]
)
def test_clocks_settle_in_a_number_of_rounds(link, period_s, rounds):
    needed_s = rounds * SETTLE_S[link]
    for seconds, settled_s, is_settled in (
        (2 * needed_s, needed_s, True),
        (2 * needed_s - 1, needed_s - 0.5, False),
    ):
        settings = Settings(link=link, seconds=seconds, period_s=period_s)
        assert settings.settle_s == settled_s
        assert settings.is_settled is is_settled


def test_a_run_that_ends_before_its_clocks_have_settled_has_no_figures(times, clock):
    with pytest.raises(SimError, match="choose more --seconds"):
        report(times, clock, [np.zeros(len(times))], step_at=95.0, unplug_at=9.0, unplug_for=80.0)


def test_bounds_are_those_of_clocks_that_have_settled(times, clock):
    short = times[times < 19]
    host = clock.unix_us(short)
    for seconds, bounded in ((19, False), (20, True)):
        made = make_report(
            Settings(boards=1, seconds=seconds), short, [readings(host, 0 * short)], clock,
            more={}, slack_us=30.0,
        )  # fmt: skip
        assert bool(made.bounds) == bounded
        assert ("too short" in made.as_text()) == (not bounded)


@pytest.mark.parametrize("link", ["usb", "serial", "tcp", "rfcomm"])
@pytest.mark.parametrize(
    ("disturbed", "unbounded"),
    [
        ({}, set()),
        ({"holdover_at": 50.0}, {"uncertainty_us"}),
        ({"slew_at": 50.0}, {"uncertainty_us", "host_peak_us"}),
    ],
)
def test_each_figure_of_time_has_its_bound(link, disturbed, unbounded):
    found = bounds(Settings(boards=2, seconds=100, link=link, **disturbed), 30.0)
    names = {"pair_rms_us", "pair_peak_us", "host_rms_us", "host_peak_us", "uncertainty_us"}
    assert found.keys() - {"holdover_end_us"} == names - unbounded
    if not unbounded:
        assert found["pair_rms_us"] < found["pair_peak_us"]
        assert 15 < found["host_rms_us"] < found["host_peak_us"] < found["uncertainty_us"]


def test_two_clocks_that_agree_differ_by_what_both_cut_off():
    """Each shows whole microseconds of a sum of whole microseconds and an offset."""
    rng = np.random.default_rng(5)
    true_us = rng.uniform(0, 1e6, 1_000_000)
    shown = []
    for _ in range(2):
        ahead_us = rng.uniform(0, 1000, true_us.size)  # crystals that differ: each is as likely
        shown.append(np.floor(np.floor(true_us + ahead_us) - ahead_us))
    apart = shown[0] - shown[1]
    alone = bounds(Settings(boards=2), 0.0)["pair_rms_us"]
    rms = np.sqrt(np.mean(apart**2))
    assert np.abs(apart).max() < 2
    assert rms == pytest.approx(np.sqrt(1 / 3), rel=0.01)
    assert rms < alone


def test_long_runs_choose_the_fast_engine():
    assert Settings(boards=8, seconds=20).chosen_engine == "avr"
    assert Settings(boards=8, seconds=21).chosen_engine == "native"
    assert Settings(boards=1, seconds=3, link="rfcomm").chosen_engine == "native"
