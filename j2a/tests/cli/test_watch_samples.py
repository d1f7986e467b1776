"""`j2a watch` of a board with sensors: samples, and how regularly they come."""

import json
import re
import struct
from time import monotonic, sleep

import pytest

import j2a
from j2a.cli import _watch
from j2a.cli._samples import (
    LAST,
    Rates,
    last_text,
    rate_head,
    rate_text,
    sample_facts,
    sample_text,
)
from j2a.cli._typed import json_of
from j2a.events import Reading
from j2a.io.clock import Clock
from j2a.recording import Recorder
from j2a.types.coding import PythonTypes
from j2a.types.samples import SampleCodec
from j2a.types.transds_file import read_transds
from j2a.virtual import VirtualBoard

from .conftest import served

FILE = """
SENSOR(quad, 0, quad, X, 2, i16, -1, (unit, deg), (period, 20000))
SENSOR(log, 1, log, X, 3, u8, none, (queue, 4), (period, 20000))
ACTUATOR(lamp, 2, lamp, X, 1, bool, none)
"""

HEAD = ["sensor", "samples", "per", "s", "jitter", "delay", "most", "lost", "missed"]


@pytest.fixture
def board():
    device = VirtualBoard(read_transds(FILE))
    device.measure()
    yield from served(device)


def sample(*readings, **more):
    made = {"board": "b", "name": "quad", "sequence": 0, "host_time": 0.0, **more}
    return j2a.Sample(readings=tuple(Reading(*one) for one in readings), **made)


@pytest.mark.parametrize(("command", "data"), [("call", []), ("read", []), ("write", ["01"])])
def test_a_transducer_is_no_function(run, board, command, data):
    sensor = run(command, board, "quad", *data)
    assert sensor.code == 2
    assert sensor.err == (
        f"j2a: quad is a sensor and no function: j2a watch {board} quad prints its samples\n"
    )
    actuator = run(command, board, "lamp", *data)
    assert actuator.code == 2
    assert "lamp is an actuator" in actuator.err
    assert "board.transducers['lamp'].set()" in actuator.err
    neither = run(command, board, "quadd", *data)
    assert "no function 'quadd'" in neither.err


def test_samples_are_lines(run, board):
    result = run("watch", board, "quad", "--count", "3")
    assert (result.code, result.err) == (0, "")
    lines = [line.partition("[")[0].split() for line in result.out.splitlines()]
    assert [line[1:6:2] + line[5:6] for line in lines] == [["opcode", "seq", "quad", "quad"]] * 3
    assert all(line[7:8] == ["deg,"] and line[-1] == "deg" for line in lines)


def test_samples_and_how_regularly_they_come_are_one_view(run, board):
    result = run("watch", board, "quad", "--count", "5")
    assert (result.code, result.err) == (0, "")
    figures = [re.search(r"deg  \[(.*)\]$", line)[1] for line in result.out.splitlines()]
    ms = r"[0-9]+\.[0-9]{2} ms"
    delays = rf"delay {ms}, most {ms}"
    assert re.fullmatch(delays, figures[0])
    assert re.fullmatch(rf"[0-9.]+/s, jitter {ms}, {delays}", figures[-1])
    facts = [
        json.loads(line)
        for line in run("watch", board, "quad", "--count", "5", "--json").out.splitlines()
    ]
    assert [one["samples"] for one in facts] == [1, 2, 3, 4, 5]
    assert all(isinstance(one["delay_ms"], float) and not one["is_relative"] for one in facts)
    assert facts[-1]["per_s"] > 0  # how fast they came depends on the load


def test_figures_of_a_line_are_of_the_last_samples():
    last = Rates(LAST)
    for at in range(200):  # each 10 ms, then each 20 ms, with one gap
        ms = 10 * at if at < 100 else 1000 + 20 * (at - 100) + 500 * (at > 100)
        one = sample((0, 1000 * ms, 1, 1), host_time=ms / 1000 + 1, missed=at == 101)
        last.add(one, 0)
    facts = last.facts("quad")
    assert (facts["samples"], facts["missed"]) == (LAST, 1)
    assert last_text(facts) == (
        "  [50.00/s, jitter 0.00 ms, rel. delay 0.00 ms, most 0.00 ms, missed 1]"
    )


def test_a_reader_that_is_too_slow_bounds_what_waits(run, board, monkeypatch):
    monkeypatch.setattr(_watch, "_MOST_WAITING", 0)
    result = run("watch", board, "--duration", "0.5")
    assert (result.code, result.out) == (0, "")
    assert re.search(r"[1-9][0-9]* SIFs were left out", result.err)


def test_what_may_be_why_nothing_comes_is_told_once(run, demo, board, monkeypatch):
    monkeypatch.setattr(_watch, "_HINT_S", 0.1)
    result = run("watch", demo, "counter", "--duration", "1")
    assert (result.code, result.out) == (0, "")
    assert result.err.startswith("j2a: nothing came yet; ")
    assert result.err.count("\n") == 1
    assert run("watch", board, "quad", "--duration", "0.5").err == ""


def test_samples_as_json(run, board):
    result = run("watch", board, "log", "--count", "2", "--json")
    for line in result.out.splitlines():
        facts = json.loads(line)
        assert (facts["sensor"], facts["opcode"]) == ("log", 1)
        assert facts["lost"] >= 0  # on a busy machine the queue of the board is full at times
        assert facts["is_reset"] is False
        assert facts["units"] == {"value": ""}
        assert {one["channel"] for one in facts["readings"]} <= {0, 1, 2}
        assert all(one["time_us"] > 0 and 0 <= one["value"] <= 255 for one in facts["readings"])


def test_how_regularly_they_come(run, board):
    # How many tables there are and which sensor is in the first one depends on the load; the number
    # of samples in all of them does not.
    result = run("watch", board, "--rates", "--count", "150")
    assert (result.code, result.err) == (0, "")
    lines = [line.split() for line in result.out.splitlines()]
    assert lines[0] == HEAD
    assert {line[0] for line in lines} == {"sensor", "quad", "log"}
    assert sum(int(line[1]) for line in lines if line != HEAD) == 150
    told = run("watch", board, "--rates", "--count", "70", "--json").out
    facts = [json.loads(line) for line in told.splitlines()]
    assert {one["sensor"] for one in facts} == {"quad", "log"}
    assert set(facts[0]) == {
        *("sensor", "samples", "per_s", "jitter_ms", "delay_ms", "most_ms", "is_relative"),
        *("lost", "missed"),
    }
    assert sum(one["samples"] for one in facts) == 70
    assert facts[0]["is_relative"] is False


def test_delays_are_relative_where_the_board_does_not_tell_its_time(run, board, monkeypatch):
    def measure(clock, rounds):
        raise j2a.NoClock("it tells no time")

    monkeypatch.setattr(Clock, "measure", measure)
    result = run("watch", board, "--rates", "--duration", "1.2")
    assert (result.code, result.err) == (0, "")
    assert result.out.splitlines()[0].split() == [
        *("sensor", "samples", "per", "s", "jitter", "rel.", "delay", "rel.", "most"),
        *("lost", "missed"),
    ]


def test_a_replay_that_is_faster_has_no_delays(run, start, tmp_path):
    path, sensors = tmp_path / "a.mcap", read_transds("SENSOR(quad, 0, quad, X, 1, u8, none)")
    with Recorder(path) as recorder:
        recorder.add_board("b", sensors)
        for number in range(600):
            payload = struct.pack("<QB", 10_000 * number + 1_000_000, 1)
            one = sample(sequence=number, payload=payload)
            recorder.write("b", one, 1_700_000_000_000_000_000 + 10_000_000 * number)
    player = start("replay", str(path), "--speed", "4")
    url = player.line_with("listening").split()[-1]
    result = run("watch", url, "--rates", "--count", "300", "--json")
    tables = [json.loads(line) for line in result.out.splitlines()]
    assert sum(one["samples"] for one in tables) == 300
    assert {one["delay_ms"] for one in tables} == {None}


def test_a_name_that_is_none(run, board, demo):
    result = run("watch", board, "servo")
    assert result.code == 2
    assert "no SIF or sensor 'servo'; it has: quad, log;" in result.err
    result = run("watch", board, "lamp")
    assert (result.code, result.err) == (2, "j2a: lamp is an actuator, which sends no samples\n")
    result = run("watch", board, demo)
    assert result.code == 2
    assert "j2a watch takes one board; run it once for each" in result.err
    result = run("watch", demo, "--rates")
    assert result.code == 2
    assert "has no sensors" in result.err


@pytest.mark.parametrize(
    ("one", "text"),
    [
        (sample((0, 5, 1.5, 1.5), (1, 6, 2.0, 2.0), unit="deg"), "quad  1.5 deg, 2.0 deg"),
        (sample((0, None, 0, None), (1, 6, -1, None)), "quad  none yet, N/A"),
        (sample((2, 5, 1, 1), (0, 6, 2, 2)), "quad  [2] 1, [0] 2"),
        (sample((0, 5, 1, 1), lost=3), "quad  1  (3 lost)"),
        (sample((0, 5, 0.0, float("nan"))), "quad  NaN"),
        (
            sample((0, 5, 1, (1, 2)), lost=3, field_units=(("x", "mm"), ("up", ""), ("y", "deg"))),
            "quad  [1, 2]  (x mm, y deg, 3 lost)",
        ),
        (sample((0, 5, 1, 1), lost=3, is_reset=True), "quad  1  (3 lost, the clock went back)"),
    ],
)
def test_what_a_line_says(one, text):
    assert sample_text(one, sensor_of("f64, none")) == text


@pytest.mark.parametrize(
    ("kind", "one", "text"),
    [
        (
            "i16, none, (scale, 0.18)",
            sample((0, 5, 95, 95 * 0.18), (1, 6, 18, 18 * 0.18), unit="deg"),
            "quad  17.1 deg, 3.24 deg",
        ),
        (
            "array(i16, 2), none, (scale, 0.1)",
            sample((0, 5, (3, 1), (3 * 0.1, 0.1))),
            "quad  [0.3, 0.1]",
        ),
    ],
)
def test_a_line_has_values_in_the_unit(kind, one, text):
    assert sample_text(one, sensor_of(kind)) == text


def sensor_of(kind):
    """Return a sensor of a type, with what stands behind it in a transds.def."""
    [sensor] = read_transds(f"SENSOR(quad, 0, quad, X, 1, {kind})").transducers
    return sensor


@pytest.mark.parametrize("more", ["", ", (queue, 3)"])
@pytest.mark.parametrize(
    ("kind", "raw", "text"),
    [
        ("f32, none", 0.1, "0.1"),
        ("f32, none", 3e10, "30000000000.0"),
        ("f32, none, (scale, 0.5), (offset, 101325)", 0.004, "101325.002"),
        ("array(f32, 2), none", (0.1, 0.7), "[0.1, 0.7]"),
        ("array(f32, 2), none, (scale, 3)", (0.5, 0.1), "[1.5, 0.3]"),
        ("f64, none", 1732785000.123456, "1732785000.123456"),
        ("f64, none", 123456792.0, "123456792.0"),
        ("array(f64, 2), none", (123456792.0, 0.1 + 0.2), "[123456792.0, 0.30000000000000004]"),
        ("i32, none, (scale, 1), (offset, 0)", 123456792, "123456792.0"),
        ("i16, none, (scale, 0.18)", 95, "17.1"),
        ("i16, none, (scale, 0.004887585532746823)", 512, "2.50244"),
        ("array(i16, 2), none, (scale, 0.18)", (95, 2), "[17.1, 0.36]"),
        ("u64, none, (scale, 0.001)", 1732785000123, "1732785000.123"),
        ("u64, none, (scale, 0.000001)", 1732785000123456, "1732785000.123456"),
    ],
)
def test_a_line_has_the_digits_that_the_sensor_gives(kind, raw, text, more):
    sensor = sensor_of(kind + more)
    codec = SampleCodec(sensor, PythonTypes())
    value = codec.pack_raw(raw)
    payload = struct.pack("<HBQ" if more else "<Q", *((0, 0) if more else ()), 5) + value
    readings = codec.unpack_queued(payload)[1] if more else codec.unpack(payload)
    assert {hash(one) for one in readings}
    one = j2a.Sample("b", "quad", 0, readings, 0.0, payload=payload)
    assert sample_text(one, sensor) == f"quad  {text}"
    [told] = sample_facts(one)["readings"]
    assert told["value"] == json_of(codec.physical(codec.unpack_raw(value)))


def test_rates():
    rates = Rates()
    assert rates.take() == {}
    # On the board each 10 ms, one 2 ms late; to the host 1 ms, then 1, 4 and 2.
    for device_ms, host_s in ((100, 5.001), (110, 5.011), (122, 5.026), (130, 5.032)):
        rates.add(sample((0, device_ms * 1000, 1, 1), host_time=host_s, lost=1, missed=2), 0)
    [(name, facts)] = rates.take().items()
    assert name == "quad"
    assert (facts["samples"], facts["lost"], facts["missed"]) == (4, 4, 8)
    assert facts["is_relative"]
    assert facts["per_s"] == pytest.approx(3 / 0.031)
    assert facts["jitter_ms"] == pytest.approx(1.632993)
    assert facts["delay_ms"] == pytest.approx(0.5)
    assert facts["most_ms"] == pytest.approx(3.0)
    assert rate_text(name, facts).split() == [
        *("quad", "4", "96.77", "1.63", "ms", "0.50", "ms", "3.00", "ms", "4", "8")
    ]
    # The next span is empty, and says so.
    [(name, facts)] = rates.take().items()
    assert rate_text(name, facts).split() == ["quad", "0", "-", "-", "-", "-", "0", "0"]


def test_a_gap_of_which_a_sif_of_another_kind_tells_is_counted():
    rates, last = Rates(), Rates(LAST)
    for gone, missed, expected in ((4, 1, 1), (4, 0, 0), (7, 0, 3), (9, 2, 2)):
        one = sample((0, 5, 1, 1), gone=gone, missed=missed)
        rates.add(one, 0)
        last.add(one, 0)
        assert rates.take()["quad"]["missed"] == expected
    assert last.facts("quad")["missed"] == 6


def test_delays_are_true_where_the_clock_is_known():
    rates = Rates()
    for late_us in (700, 900, 400):
        rates.add(sample((0, 5000, 1, 1), host_us=1_000_000), 1_000_000 + late_us)
    rates.add(sample((0, 5000, 1, 1)), 9_000_000)  # before the clock was known
    [(_, facts)] = rates.take().items()
    assert facts["is_relative"] is False
    assert facts["delay_ms"] == pytest.approx(0.7)
    assert facts["most_ms"] == pytest.approx(0.9)
    # One is enough: it need not be quicker than others.
    rates.add(sample((0, 5000, 1, 1), host_us=1_000_000), 1_000_500)
    [(_, facts)] = rates.take().items()
    assert facts["delay_ms"] == pytest.approx(0.5)


def test_there_are_no_delays_where_the_clock_does_not_run_as_that_of_the_host():
    for is_doubted, host_us in ((True, None), (True, 1_000_000), (False, 1_003_000)):
        rates, last = Rates(), Rates(LAST)
        for number in (1, 2):
            one = sample((0, 40_000 * number, 1, 1), host_us=host_us, host_time=5 + number / 100)
            rates.add(one, 1_000_500, 1_400, is_doubted=is_doubted)
            last.add(one, 1_000_500, 1_400, is_doubted=is_doubted)
        assert last_text(last.facts(one.name)) == "  [100.00/s]"
        [(_, facts)] = rates.take().items()
        assert (facts["delay_ms"], facts["most_ms"], facts["is_relative"]) == (None, None, False)


def test_a_delay_below_that_error_of_the_clock_is_0():
    rates = Rates()
    rates.add(sample((0, 5000, 1, 1), host_us=1_001_000), 1_000_500, 400)
    [(_, facts)] = rates.take().items()
    assert (facts["delay_ms"], facts["is_relative"]) == (0, False)


def test_all_delays_of_a_table_are_of_one_kind():
    rates = Rates()
    rates.add(sample((0, 5000, 1, 1), host_us=1_000_000), 1_000_500)
    rates.add(sample((0, 5000, 1, 1), name="log"), 1_000_500)
    assert [facts["is_relative"] for facts in rates.take().values()] == [True, True]


@pytest.mark.parametrize("is_relative", [False, True])
def test_head_and_lines_have_one_width(is_relative):
    rates = Rates()
    rates.add(sample((0, 5000, 1, 1)), 0)
    [(name, facts)] = rates.take().items()
    assert len(rate_head(is_relative=is_relative)) == len(rate_text(name, facts))


def test_rates_begin_anew_when_the_clock_does():
    rates = Rates()
    rates.add(sample((0, 9_000_000, 1, 1), host_time=1.0, host_us=1), 5)
    rates.add(sample((0, 1_000, 1, 1), host_time=2.0, is_reset=True), 0)
    rates.add(sample((0, None, 0, None), host_time=2.5), 0)
    rates.add(sample((0, 11_000, 1, 1), host_time=2.01), 0)
    [(_, facts)] = rates.take().items()
    assert facts["samples"] == 2
    assert facts["most_ms"] == pytest.approx(0.0, abs=1e-6)


def test_a_flood_does_not_defer_the_end(run, board, monkeypatch):
    shown = []

    def show_slowly(one, *_args):
        sleep(0.1)
        shown.append(one)

    monkeypatch.setattr(_watch, "_print", show_slowly)
    begin = monotonic()
    result = run("watch", board, "--duration", "2")
    took_s = monotonic() - begin
    assert result.code == 0
    assert 0 < len(shown) < 40
    [unseen] = re.findall("^j2a: ([0-9]+) SIFs came in time and are not shown", result.err)
    assert int(unseen) > 0
    assert len(shown) + int(unseen) < 250  # 2 sensors, 50 each second
    assert took_s < 60
    result = run("watch", board, "--duration", "2", "--count", "100")
    assert result.code == 0
