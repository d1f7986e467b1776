"""Transducers that a sketch lists, on a simulated Uno: the example, kinds of types, wrong lists."""

import subprocess
import sys
from pathlib import Path

import pytest
from j2a_sim import AvrSim, SimLink

import j2a
from j2a.types.transds_file import read_transds

pytestmark = pytest.mark.avr

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "firmware/library/arduino/examples/Sensors/Sensors.ino"
KINDS = ROOT / "firmware/tests/arduino/Kinds/Kinds.ino"
CORE = Path("/usr/share/arduino/hardware/arduino/avr/cores/arduino/Arduino.h")
LAMP = "PB1"  # pin 9


def listed(sketch):
    """What a sketch lists, as the lines of a transds.def."""
    text = sketch.read_text().partition("#define J2A_TRANSDUCERS")[2].partition("#include")[0]
    return read_transds(text.replace("\\\n", "\n"))


@pytest.fixture(scope="module")
def build(need, missing, packed, tmp_path_factory):
    """Build a sketch for an Uno; returns the image, and what was printed."""
    need("avr-gcc")
    if not CORE.is_file():
        missing("there is no Arduino core for AVR: install the package arduino-core-avr")
    out = tmp_path_factory.mktemp("sketches")

    def compiled(name, text, *options):
        folder = out / name
        folder.mkdir(exist_ok=True)
        (folder / f"{name}.ino").write_text(text)
        command = [sys.executable, ROOT / "tools/arduino_build.py", "--board", "uno"]
        command += ["--library", packed, "--out", out, folder, *options]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        said = done.stderr.replace("\u2018", "'").replace("\u2019", "'")
        assert (done.returncode == 0) == (said == "")
        return out / "uno" / f"{name}.elf", said

    return compiled


@pytest.fixture
def start(build):
    """Start a sketch in the simulator; returns the simulator and a client."""
    opened = []

    def started(path):
        image, said = build(path.stem, path.read_text())
        assert said == ""
        sim = AvrSim(image)
        for pin in ("PD2", "PD3"):
            sim.pins.drive(pin, 0)
        sim.adc.set_volts(0, 2.5)
        sim.adc.set_volts(1, 1.0)
        client = j2a.Client(SimLink(sim))
        opened.extend((sim, client))
        return sim, client

    yield started
    for one in reversed(opened):
        one.close()


def test_the_example(start):
    sim, board = start(EXAMPLE)
    transducers = board.transducers
    assert transducers.descriptors == listed(EXAMPLE)
    (millivolts,) = transducers["light"].wait(10).values
    assert abs(millivolts - 2500) < 10
    with transducers["distance"].samples() as samples:
        # Of the data sheet.
        for mm, volts in ((300, 1.99), (600, 1.04), (1100, 0.60), (1500, 0.45)):
            sim.adc.set_volts(1, volts)
            transducers["distance"].trigger()
            (millimeters,) = samples.wait(10).values
            assert millimeters == pytest.approx(mm, rel=0.06)
        sim.adc.set_volts(1, 0.1)  # too far
        transducers["distance"].trigger()
        assert samples.wait(10).values == (None,)
    with transducers["encoder"].samples() as samples:
        for a, b, degrees in ((1, 0, 9), (0, 1, 18), (1, 1, 9)):  # forward, forward, back
            sim.pins.drive("PD3", b)
            sim.pins.drive("PD2", a)
            assert samples.wait(10).values == (degrees,)


def test_the_lamp_of_the_example_goes_off_without_a_host(start):
    sim, board = start(EXAMPLE)
    lamp, light = board.transducers["lamp"], board.transducers["light"]
    lamp.set(100)
    assert lamp.read()[0].value == 100
    assert sim.pins.level(LAMP) == 1
    with pytest.raises(j2a.WrongArgument):
        lamp.set(101)
    begin_us = lamp.time_us()
    with light.samples() as samples:  # which ask nothing of the board
        while samples.wait(10).times_us[0] < begin_us + 1_100_000:
            pass
    assert sim.pins.level(LAMP) == 0
    assert lamp.read()[0].value == 0


def test_kinds_of_types(start):
    _, board = start(KINDS)
    transducers = board.transducers
    assert transducers.descriptors == listed(KINDS)
    assert board.call("one").payload == b"\x01"
    with transducers["imu"].samples() as samples:
        transducers["move"].set({"rate": (1, -2, 32767), "heat": 21.5})
        (motion,) = samples.wait(10).values
        assert (tuple(motion.rate), motion.heat) == ((1, -2, 32767), 21.5)
    with transducers["level"].samples() as samples:
        transducers["target"].set(-2.5)
        assert samples.wait(10).values == (-2.5,)
    with transducers["matrix"].samples() as samples:
        transducers["row"].set((1, 2, 65535))
        (reading,) = samples.wait(10).readings
        assert (reading.channel, tuple(reading.value)) == (1, (1, 2, 65535))
    with transducers["state"].samples() as samples:
        transducers["switch_"].set("off")
        assert [value.name for value in samples.wait(10).values] == ["on"]
    with pytest.raises(j2a.WrongArgument):
        transducers["target"].set(2.6)
    level = transducers["level"]
    level.topic = "c"
    assert level.topic == "c"


ONE = "SENSOR(a, 1, a, X, 1, uint8_t, none)"
SKETCH = """\
#define J2A_TRANSDUCERS {list}
#include <J2A.h>
J2A_SENSE(a);
J2A_FUNCTIONS();
J2A_PROPERTIES();
void setup() {{ transds_init(); a_sense(0, 1); }}
void loop() {{ transds_process(); }}
"""


class TestWrongLists:
    @pytest.mark.parametrize(
        ("listed", "said"),
        [
            (ONE.replace("1, a", "255, a"), "id_of_a_is_0_to_254"),
            (ONE.replace("X, 1", "X, 0"), "channels_of_a_are_1_to_255"),
            (ONE.replace("X, 1", "X, 29"), "a_sample_of_a_is_longer_than_a_frame"),
            (ONE.replace("none", "none, (queue, 256)"), "queue_of_a_is_1_to_255"),
            (f"{ONE} {ONE}", "j2a_index_a"),
            (f"{ONE} {ONE.replace('(a', '(b')}", "duplicate case value"),
            (ONE.replace("uint8_t", "u7"), "u7"),
            (ONE.replace("none", "x"), "'x' was not declared"),
            (ONE.replace(" 1, a", " 1, c"), "'a_set_cb' was not declared"),
            (f"{ONE} ACTUATOR(b, 2, b, X, 1, bool, 0)", "undefined reference to `b_set'"),
        ],
    )
    def test_do_not_compile(self, build, listed, said):
        assert said in build("Wrong", SKETCH.format(list=listed))[1]

    def test_the_right_one_does(self, build):
        assert build("Right", SKETCH.format(list=ONE))[1] == ""

    @pytest.mark.parametrize(
        ("opcode", "said"), [(1, "f: its opcode is the id of a sensor"), (2, "")]
    )
    def test_sif_with_the_opcode_of_samples(self, build, opcode, said):
        listed = f"{ONE} ACTUATOR(b, 2, b, X, 1, bool, 0)"
        sketch = SKETCH.format(list=listed).replace(
            "J2A_FUNCTIONS()",
            f'void b_set(uint8_t, bool) {{}}\nj2a::sif<{opcode}> f;\nJ2A_FUNCTIONS(J2A_SIF(f, ""))',
        )
        printed = build("Opcode", sketch)[1]
        assert said in printed if said else printed == ""

    def test_list_behind_the_library(self, build):
        lines = SKETCH.format(list=ONE).splitlines(keepends=True)
        lines[0], lines[1] = lines[1], lines[0]
        said = build("Behind", "".join(lines[:2] + lines[3:]))[1]
        assert "#define J2A_TRANSDUCERS must stand before #include <J2A.h>" in said

    @pytest.mark.parametrize("part", ["TRANSDUCERS", "SIF", "CLOCK"])
    def test_without_a_part_that_they_need(self, build, part):
        said = build("Without", SKETCH.format(list=ONE), f"--options=-DJ2A_WITH_{part}=0")[1]
        assert "J2A_TRANSDUCERS needs J2A_WITH_TRANSDUCERS=1" in said

    def test_settings_cannot_be_saved(self, build):
        said = build("Saved", SKETCH.format(list=ONE), "--options=-DJ2A_WITH_SAVE=1")[1]
        assert "a sketch cannot keep the settings" in said
