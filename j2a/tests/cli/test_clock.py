"""`j2a clock`, and the clock in `j2a info`, as a user runs them."""

import argparse
import json
import signal
import subprocess
import sys

import pytest
from j2a_spec import constants as c

import j2a
from j2a.cli import _clock
from j2a.cli._clock import offset_text, time_text
from j2a.cli._serve import virtual_board
from j2a.tests.library.clocked import ClockedDevice
from j2a.tests.library.test_clock import SimulatedLink

from .conftest import WAIT_S, served


@pytest.fixture
def device():
    return ClockedDevice(ppm=50)


@pytest.fixture
def board(device):
    yield from served(device)


@pytest.fixture
def other():
    yield from served(ClockedDevice(ppm=-50))


@pytest.fixture
def without():
    yield from served(j2a.Device())


def lines(result):
    return [json.loads(line) for line in result.out.splitlines()]


def test_a_clock_is_shown_and_left_alone(run, board, device):
    result = run("clock", board)
    assert (result.code, result.err) == (0, "")
    head, line = result.out.splitlines()
    assert head.split() == ["board", "state", "epoch", "offset", "rate", "uncertainty"]
    assert line.split()[:3] == [board, "free", "0"]
    assert {one[0] for one in device.requests} == {c.CLOCK_EXCHANGE, c.CLOCK_STATUS}


def test_json_is_a_line_for_each_board(run, board, other):
    result = run("clock", board, other, "--rounds", "2", "--json")
    assert result.code == 0
    assert [one["url"] for one in lines(result)] == [board, other]
    assert set(lines(result)[0]) == {
        "url",
        "time",
        "state",
        "epoch",
        "offset_us",
        "rate_ppb",
        "uncertainty_us",
        "round_trip_us",
        "can_be_set",
    }


def test_a_board_without_a_clock_is_told(run, board, without):
    result = run("clock", without)
    assert result.code == 2
    assert "tells no time" in result.err
    assert result.out == ""
    result = run("clock", board, without, "--rounds", "1", "--json")
    assert result.code == 2
    first, last = lines(result)
    assert first["url"] == board
    assert (last["error"]["type"], last["error"]["exit_code"]) == ("NoClock", 2)
    assert last["error"]["outcome"] == "not_sent"
    result = run("clock", without, "--discipline")
    assert (result.code, "cannot be set" in result.err) == (2, True)


def test_clocks_are_kept_right_for_so_long(run, board, other):
    result = run("clock", board, other, "--discipline", "--watch", "--seconds", "2.5", "--json")
    assert (result.code, result.err) == (0, "")
    last = {one["url"]: one for one in lines(result)}
    assert {one["epoch"] for one in last.values()} == {1}
    assert {one["state"] for one in last.values()} <= {"settling", "locked"}
    assert all(abs(one["offset_us"]) < 100_000 for one in last.values())


@pytest.mark.parametrize("word", ["--discipline", "--watch"])
def test_so_many_exchanges_are_made_first(run, board, device, word):
    result = run("clock", board, word, "--rounds", "30", "--period", "5", "--seconds", "0.01")
    assert (result.code, result.err) == (0, "")
    assert sum(one[0] == c.CLOCK_EXCHANGE for one in device.requests) >= 30


@pytest.mark.parametrize("word", ["--discipline", "--watch"])
@pytest.mark.parametrize("answer", [b"", b"nonsense", bytes(255)])
def test_a_board_that_answers_nonsense_is_told_once(run, word, answer):
    device = ClockedDevice()
    device.spoil = lambda payload: (0, answer)
    for url in served(device):
        result = run("clock", url, word, "--period", "0.2", "--seconds", "1")
        assert (result.code, result.out) == (5, "")
        assert result.err.count("no exchange has succeeded yet") == 1


def test_a_virtual_board_has_a_clock_and_measures_on_when_it_is_set(tmp_path):
    """The first adjustment moves its clock by decades, and its waves must not wait for that."""
    path = tmp_path / "transds.def"
    path.write_text("SENSOR(a, 0, a, X, 1, u8, none, (period, 10000))\n")
    for url in served(virtual_board(str(path), {}, clock=40.0)):
        with j2a.connect(url, timeout=WAIT_S) as client:
            sensor = client.transducers["a"]
            sensor.wait(WAIT_S)
            assert client.clock.sync().epoch == 1
            before = sensor.time_us()
            samples = [sensor.wait(WAIT_S) for _ in range(20)]
            assert samples[-1].time_us > before - 1_000_000


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_it_goes_on_until_it_is_stopped(board, number, code):
    command = [sys.executable, "-m", "j2a", "clock", board, "--watch", "--period", "0.1"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as it:
        for _ in range(4):
            assert it.stdout.readline()
        it.send_signal(number)
        _, err = it.communicate(timeout=WAIT_S)
    assert (it.returncode, err) == (code, "")


def test_info_tells_of_the_clock(run, board, device):
    result = run("info", board)
    assert "clock     free, -" in result.out
    assert lines(run("info", board, "--json"))[0]["clock"]["state"] == "free"
    device.spoil = lambda _payload: (2, b"")
    result = run("info", board)
    assert result.code == 0
    assert "clock " not in result.out
    assert "the clock of the device tells nothing" in result.err


def test_info_tells_of_no_clock(run, without):
    assert lines(run("info", without, "--json"))[0]["clock"] is None


@pytest.mark.parametrize(
    ("us", "text"), [(-1.26, "-1.3 us"), (9e6, "+9000000.0 us"), (-1.5e9, "-1500.000 s")]
)
def test_offsets_are_read_at_a_glance(us, text):
    assert offset_text(us) == text


def test_times_have_a_unit():
    assert (time_text(3.14), time_text(15_000)) == ("3.1 us", "15.0 ms")


def test_seconds_and_periods_are_those_of_a_simulation(capsys):
    """This computer would let ten times as many pass."""
    now = [0.0]
    with ClockedDevice(now_s=lambda: now[0]) as device:
        link = SimulatedLink(device)
        device._now_s = link.clock
        with j2a.Client(link, timeout=10.0) as board, board.clock.follow(5.0) as keeper:
            args = argparse.Namespace(watch=True, seconds=20.0, period=5.0, json=True)
            begun_s = link.clock()
            assert _clock._watch([board], [keeper], args) == 0
            assert 19.9 < link.clock() - begun_s < 150
    assert 1 <= len(capsys.readouterr().out.splitlines()) <= 5
