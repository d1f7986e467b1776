"""`j2a sim clocks`: the clocks of boards agree as well as they promise, in exact simulated time."""

import json
import os
import subprocess
import sys

import pytest
from j2a_sim import SimError
from j2a_sim._clocks.run import run
from j2a_sim._clocks.settings import Settings

from j2a.cli import main
from j2a.cli._exit import OUTPUT_CLOSED, USAGE

READINGS = 40_000
SEEDS = range(1, 21)


def figures(**settings):
    """The figures of a run, after a look whether they are within their bounds."""
    report = run(Settings(**{"readings": READINGS, **settings}))
    for name, bound in report.bounds.items():
        assert report.figures[name] <= bound, name
    return report.figures


def assert_honest(found):
    """What boards announce is true, or on a USB what the daemon announces for them."""
    assert found["backwards"] == 0
    assert found["known_uncertainty"] > 0.99
    assert found["inside_uncertainty"] >= 0.997


def assert_pairs(found):
    assert found["pair_rms_us"] <= 1
    assert found["pair_peak_us"] <= 3


# -- boards compiled for this machine -------------------------------------------------------------


@pytest.mark.parametrize("seed", [1, 2])
def test_any_two_of_eight_boards_on_a_usb_agree_to_a_microsecond(seed):
    found = figures(seconds=20, seed=seed, engine="native")
    assert_pairs(found)
    assert_honest(found)
    assert found["locked"] > 0.999


def test_lost_starts_of_frames_and_a_busy_host_change_little():
    found = figures(seconds=30, seed=3, engine="native", lost_sof=0.01, load="heavy")
    assert_pairs(found)
    assert_honest(found)


def test_a_time_of_a_frame_whose_start_was_lost_is_understood():
    assert_pairs(figures(boards=4, seconds=40, seed=5, engine="native", lost_sof=0.1))


def test_many_boards_are_told_the_time_as_well_as_few():
    """The daemon keeps so many answers, and gets four of each board in a round."""
    found = figures(boards=64, seconds=20, seed=2, engine="native")
    assert_pairs(found)
    assert_honest(found)
    assert found["host_peak_us"] < 100 and found["uncertainty_us"] < 150


@pytest.mark.parametrize("seed", range(1, 9))
def test_no_board_takes_the_first_packet_for_one_of_a_second_before(seed):
    found = figures(boards=2, seconds=20, seed=seed, engine="native")
    assert found["host_peak_us"] < 200


@pytest.mark.parametrize("seed", [1, 2])
def test_a_board_at_115200_baud_follows_its_host(seed):
    found = figures(seconds=60, seed=seed, link="serial", boards=4, engine="native")
    assert found["host_rms_us"] <= 20
    assert_honest(found)


@pytest.mark.parametrize("link", ["tcp", "rfcomm"])
def test_asymmetry_of_networks_is_in_the_uncertainty(link):
    assert_honest(figures(seconds=60, link=link, boards=4))


def assert_follows_a_step(link, hours, seed=1):
    settings = Settings(
        boards=3, seconds=100, link=link, engine="native", readings=READINGS, seed=seed,
        step_at=35.0, step_by=3600.0 * hours,
    )  # fmt: skip
    report = run(settings)
    assert_honest(report.figures)
    assert report.figures["host_peak_us"] < 1000
    jumps = abs(report.errors_us) > 1e6
    late = report.times_s > 35.0 + 2 * settings.period_s
    assert not jumps[:, late].any(), "told within two rounds"
    assert report.figures["epochs"] == [2, 2, 2], "one step at the start, and one for the host's"


@pytest.mark.parametrize("link", ["usb", "serial"])
@pytest.mark.parametrize("hours", [1, -1])
def test_boards_follow_a_step_of_the_hosts_clock(link, hours):
    assert_follows_a_step(link, hours)


@pytest.mark.parametrize("link", ["usb", "serial"])
def test_a_slew_of_the_hosts_clock_is_no_step_and_not_missed(link):
    """It runs faster from 40 s to 100 s, by as much as NTP does at most; all of it counts."""
    found = figures(boards=3, seconds=120, engine="native", slew_at=40.0, link=link)
    if link == "usb":
        assert_pairs(found)
    assert found["epochs"] == [1, 1, 1]
    assert_honest(found)


def test_a_board_that_was_told_once_is_not_said_to_be_right():
    """It has no rate: told each 5 s only, it is off by 0.4 ms before it is told again."""
    settings = Settings(
        boards=2, seconds=20, period_s=5.0, seed=2, engine="native", readings=READINGS
    )
    found = run(settings).figures
    assert found["inside_uncertainty"] >= 0.997
    assert 0.4 < found["known_uncertainty"] < 0.6, "from the second packet on, at 15 s"


def test_boards_find_back_after_suspend_and_unplugging():
    found = figures(
        boards=4, seconds=70, engine="native", suspend_at=15.0, suspend_for=12.0, unplug_at=40.0
    )
    assert_pairs(found)
    assert_honest(found)
    assert found["epochs"] == [1, 1, 1, 1], "and the one that began anew is in its first epoch"


def test_holdover_drifts_as_the_crystal_does():
    found = figures(boards=3, seconds=300, link="serial", holdover_at=100.0)
    assert found["holdover_end_us"] > 0
    assert_honest(found)


def test_the_same_seed_gives_the_same_run():
    one, two, other = (figures(boards=2, seconds=12, engine="native", seed=s) for s in (7, 7, 8))
    assert one == two
    assert one != other


# -- the real firmware ----------------------------------------------------------------------------


@pytest.mark.avr
@pytest.mark.slow
def test_the_real_firmware_on_a_usb():
    """Four real boards are in test_acting_together.py."""
    found = figures(boards=2, seconds=13, engine="avr", lost_sof=0.001)
    assert_pairs(found)
    assert_honest(found)


@pytest.mark.avr
@pytest.mark.slow
def test_the_real_firmware_at_115200_baud():
    found = figures(boards=1, seconds=34, link="serial", engine="avr")
    assert found["host_rms_us"] <= 20
    assert_honest(found)


# -- the command ----------------------------------------------------------------------------------


def test_the_command_prints_its_figures_as_json(capsys, tmp_path):
    words = "sim clocks --boards 2 --seconds 4 --seed 5 --link usb --engine native --readings 2000"
    picture = tmp_path / "clocks.svg"
    assert main([*words.split(), "--json", "--svg", str(picture)]) == 0
    told = json.loads(capsys.readouterr().out)
    for name in ("pair_rms_us", "pair_peak_us", "host_rms_us", "inside_uncertainty", "backwards"):
        assert name in told
    assert told["seed"] == 5 and told["engine"] == "native" and told["settings"]["settle_s"] == 2
    assert picture.read_text().startswith("<svg")


def test_a_short_run_counts_no_clock_that_nobody_has_set():
    """Packets begin with the second round, and the first clocks are set in the third second."""
    found = figures(boards=2, seconds=4, engine="native", seed=5)
    assert found["host_peak_us"] < 10_000
    assert 0 < found["readings"] < READINGS / 2
    with pytest.raises(SimError, match="no clock is read after it was set"):
        figures(boards=2, seconds=3, engine="native", seed=5, period_s=2.0)


@pytest.mark.parametrize("link", ["usb", "serial"])
def test_the_command_shows_on_a_terminal_how_far_it_is(capsys, monkeypatch, link):
    monkeypatch.setattr("j2a.cli._progress._FIRST_S", 0.0)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    words = f"sim clocks --boards 1 --seconds 4 --link {link} --engine native --readings 100"
    assert main(words.split()) == 0
    told = capsys.readouterr()
    assert "sim clocks  [" in told.err
    assert " %  " in told.err
    assert "sim clocks  [" not in told.out


def test_the_command_says_what_is_wrong(capsys, monkeypatch):
    assert main(["sim", "clocks", "--boards", "0"]) == USAGE
    assert "--boards 0 is out of range" in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "numpy", None)
    for name in [name for name in sys.modules if name.startswith("j2a_sim._clocks.")]:
        monkeypatch.delitem(sys.modules, name)
    assert main(["sim", "clocks", "--seconds", "4"]) == USAGE
    assert "pip install numpy" in capsys.readouterr().err


def test_a_picture_that_cannot_be_written_is_told_before_the_run(capsys, tmp_path):
    words = "sim clocks --boards 8 --seconds 86400 --engine native --svg"
    for path in (tmp_path, tmp_path / "none" / "clocks.svg"):
        assert main([*words.split(), str(path)]) == USAGE
        told = capsys.readouterr()
        assert f"cannot write {path}: " in told.err
        assert not told.out


def test_a_pipe_for_the_picture_is_not_opened_before_the_run(capsys, tmp_path):
    """It would wait for a reader."""
    pipe = tmp_path / "clocks.svg"
    os.mkfifo(pipe)
    words = "sim clocks --boards 2 --seconds 3 --period-s 2 --link usb --engine native --svg"
    assert main([*words.split(), str(pipe)]) == USAGE, "no clock is set so soon"
    assert "choose more --seconds" in capsys.readouterr().err


def test_a_picture_that_is_there_stays_until_the_run_has_ended(capsys, tmp_path):
    for text in (None, "before"):
        picture = tmp_path / f"{text}.svg"
        if text is not None:
            picture.write_text(text)
        words = "sim clocks --boards 2 --seconds 3 --period-s 2 --link usb --engine native --svg"
        assert main([*words.split(), str(picture)]) == USAGE, "no clock is set so soon"
        assert "choose more --seconds" in capsys.readouterr().err
        assert (picture.read_text() if picture.exists() else None) == text


def test_a_reader_of_the_figures_that_goes_away_is_no_error():
    words = "sim clocks --boards 1 --seconds 4 --link serial --engine native --readings 100 --json"
    reader, writer = os.pipe()
    os.close(reader)
    try:
        done = subprocess.run(
            [sys.executable, "-m", "j2a", *words.split()],
            stdout=writer,
            stderr=subprocess.PIPE,
            timeout=120,
            check=False,
        )
    finally:
        os.close(writer)
    assert (done.returncode, done.stderr) == (OUTPUT_CLOSED, b"")


# -- hours ----------------------------------------------------------------------------------------


@pytest.mark.exhaustive
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("seed", SEEDS)
def test_an_hour_on_a_usb_with_lost_frames(seed):
    found = figures(seconds=3600, seed=seed, lost_sof=0.001, readings=1_000_000)
    assert_pairs(found)
    assert_honest(found)


@pytest.mark.exhaustive
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("seed", SEEDS)
def test_an_hour_at_115200_baud(seed):
    found = figures(seconds=3600, seed=seed, link="serial", readings=1_000_000)
    assert found["host_rms_us"] <= 20
    assert_honest(found)


@pytest.mark.exhaustive
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("link", ["usb", "serial"])
def test_time_never_goes_back_in_ten_million_readings(link, seed):
    """So many with each seed: 8 boards, each read every millisecond."""
    found = figures(seconds=1200, seed=seed, link=link, engine="native", readings=10_000_000)
    assert found["backwards"] == 0
    assert found["readings"] > 0.97 * 10_000_000, "all but those before the clocks have settled"


@pytest.mark.avr
@pytest.mark.exhaustive
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("seed", SEEDS)
def test_the_real_firmware_of_eight_boards_on_a_usb(seed):
    found = figures(seconds=20, seed=seed, engine="avr")
    assert_pairs(found)
    assert_honest(found)
    assert found["locked"] > 0.999


@pytest.mark.exhaustive
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("link", ["usb", "serial"])
def test_an_hour_of_holdover(link, seed):
    assert_honest(figures(boards=4, seconds=3900, link=link, holdover_at=300.0, seed=seed))


@pytest.mark.exhaustive
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("link", ["usb", "serial"])
def test_twenty_seeds_of_a_minute(link, seed):
    found = figures(seconds=60, seed=seed, link=link, engine="native")
    if link == "usb":
        assert_pairs(found)
    else:
        assert found["host_rms_us"] <= 20
    assert_honest(found)


@pytest.mark.exhaustive
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("link", ["usb", "serial"])
@pytest.mark.parametrize("hours", [1, -1])
def test_twenty_seeds_of_a_step(link, hours, seed):
    assert_follows_a_step(link, hours, seed)


@pytest.mark.exhaustive
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("link", ["usb", "serial"])
def test_twenty_seeds_of_a_slew(link, seed):
    found = figures(boards=4, seconds=130, engine="native", slew_at=40.0, link=link, seed=seed)
    assert found["epochs"] == [1, 1, 1, 1]
    assert_honest(found)


@pytest.mark.exhaustive
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("link", ["tcp", "rfcomm"])
def test_twenty_seeds_of_networks(link, seed):
    assert_honest(figures(seconds=120, link=link, seed=seed))
