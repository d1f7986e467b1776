"""The sensors of a robot on one board: nothing is lost, and there is room for more."""

import importlib.util
import re
import sys
from pathlib import Path

import pytest
from j2a_sim import AvrSim

ROOT = Path(__file__).parent.parent.parent
PAGE = ROOT / "docs/transducers.md"


@pytest.fixture(scope="module")
def robot_load():
    spec = importlib.util.spec_from_file_location("robot_load", ROOT / "tools/robot_load.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def load(robot_load, need):
    need("avr-gcc")
    return robot_load.measure(robot_load.build(), 3.0)


def test_the_rows_are_those_of_the_thesis(robot_load):
    """The products of table 5.1, and their sum, "a little more than 20 kbit/s"."""
    rows = robot_load.TABLE
    assert [(row.sensors, row.bandwidth / row.sensors) for row in rows.values()] == [
        (16, 1),
        (8, 1),
        (16, 400),
        (16, 400),
        (1, 1320),
        (1, 6750),
    ]
    assert 20_000 < sum(row.bandwidth for row in rows.values()) < 21_000


def test_values_hold_at_least_the_bits_of_the_table(robot_load):
    text = robot_load.LIST.read_text("utf-8")
    known = robot_load.read_transds(text)
    for name, row in robot_load.TABLE.items():
        assert 8 * known[name].type.size >= row.bits * row.per_sample, name


@pytest.mark.avr
def test_all_sensors_at_their_top_rates(robot_load, load):
    assert load.lost == 0
    assert not any(load.wrong.values())
    for name, row in robot_load.TABLE.items():
        values = row.samples
        assert 3 * values - 1 <= load.counts[name] <= load.seconds * values * 1.05 + 2, name
    assert 0.3 < load.wire < 0.5
    assert 0.2 < load.busy < 0.6


@pytest.mark.avr
def test_all_bumpers_at_one_moment(robot_load, load):
    """Three times 16 and 8 changes in addition, none of which is lost."""
    for name, row in robot_load.TABLE.items():
        more = robot_load.CRASHES * row.sensors * (name in ("bumper", "cliff"))
        least = robot_load.CRASHES * row.samples - 1 + more
        most = load.crash_seconds * row.samples * 1.05 + 2 + more
        assert least <= load.crashed[name] <= most, name


@pytest.mark.avr
def test_the_wire_carries_what_was_calculated(robot_load, load):
    """And escapes, of 3 in 256 values, and the replies to the host."""
    asked, rows = robot_load.asked(), robot_load.TABLE
    calculated = robot_load.share(sum(asked.values()))
    # The host looks after 3 s at the earliest, and the last sample of each may come just behind.
    least = robot_load.share(sum(asked[name] * (3 - 1 / rows[name].samples) for name in rows))
    assert least <= load.seconds * load.wire
    assert load.wire <= 1.04 * calculated


def test_channels_ask_for_more_than_the_wire(robot_load):
    """A time for each value: frames of 5 bytes around 16 channels of 9, and of 10."""
    channels = robot_load.asked(robot_load.AS_ARRAYS)
    assert channels["infrared"] == 50 * (5 + 16 * 9)
    assert channels["ultrasonic"] == 25 * (5 + 16 * 10)
    assert robot_load.share(channels["infrared"] + channels["ultrasonic"]) > 1
    rest = sum(channels.values()) - channels["infrared"] - channels["ultrasonic"]
    at_most = robot_load.fit() * (channels["infrared"] + channels["ultrasonic"])
    assert robot_load.share(rest + at_most) == pytest.approx(1)


@pytest.mark.avr
def test_the_figures_on_the_page(robot_load, load):
    page = " ".join(PAGE.read_text("utf-8").split())
    pattern = r"take (\d+) % of a wire at 115200 baud and (\d+) % of the processor, (\d+) bytes"
    wire, busy, ram = map(int, re.search(pattern, page).groups())
    with AvrSim(robot_load.build()) as sim:
        assert ram == sim.program.ram_end - 0x100
    assert 100 * load.wire == pytest.approx(wire, abs=1)
    assert 100 * load.busy == pytest.approx(busy, abs=1)
    arrays, channels = robot_load.asked(), robot_load.asked(robot_load.AS_ARRAYS)
    for name, row in robot_load.TABLE.items():
        share = 100 * robot_load.share(arrays[name])
        cells = f"{row.samples:g} | {arrays[name]:g} | {share:.1f} % |"
        assert f"| {name} | {row.sensors} | {row.bandwidth:g} | {cells}" in page
    total = sum(arrays.values())
    bits = sum(row.bandwidth for row in robot_load.TABLE.values())
    assert f"| all | | {bits:g} | | {total:g} | {100 * robot_load.share(total):.1f} % |" in page
    two = sum(channels[name] for name in robot_load.AS_ARRAYS)
    assert f"take {100 * robot_load.share(two):.1f} % of the wire" in page
    assert f"all together {100 * robot_load.share(sum(channels.values())):.1f} %" in page
    assert f"fit at {100 * robot_load.fit():.0f} % of theirs" in page
    assert f"{int(50 * robot_load.fit())} and {int(25 * robot_load.fit())} times" in page
