"""Another sensor is another line: in transds.def, and nowhere else.

What flows in: the apps with drivers, of which a copy has one line changed. What flows out: what a
host program says of the board, the same program for both; its distances and voltages are those of
the simulated parts.
"""

import itertools
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from j2a_sim import AvrSim, SimLink

import j2a

FIRMWARE = Path(__file__).parents[1]
DRIVERS = FIRMWARE / "drivers"
PAGE = (FIRMWARE.parent / "docs/transducers.md").read_text("utf-8")

INFRARED = "SENSOR(dist_ir, 1, sharp, GP2Y0A21YK, 2, uint16_t, 0, (unit, mm), (enabled, 0),"
FAR = INFRARED.replace("GP2Y0A21YK", "GP2Y0A02YK")
FORERUNNER = INFRARED.replace("GP2Y0A21YK", "GP2D12")
ULTRASONIC = "SENSOR(dist_us, 1, srf02, SRF02, 2, uint32_t, 0x00FFFFFF, (unit, cm),"
ADC = "SENSOR(adc, 2, adc, AVCC/1024, 4, uint16_t, 65535, (unit, mV), (scale, 4.8828125),"
MISSES = "SENSOR(misses, 3, quad_misses, HEDS-6500, 2, uint16_t, none, (period, 100000),"
LISTED = "SENSOR(dist_us, 2, srf02, SRF02, 12, uint32_t, 0x00FFFFFF)"


def said(board):
    """What a host program says: what each sensor is, and what it measures."""
    return {
        name: (one.descriptor.get("model"), one.descriptor.unit, [r.value for r in one.read()])
        for name, one in board.transducers.items()
        if isinstance(one, j2a.Sensor)
    }


def measured(program, ask=said):
    """What a host says of a board with all parts around it, on whatever pins they are."""
    with AvrSim(program) as sim:
        for pin in ("PD2", "PD3", "PD4", "PD5"):
            sim.pins.drive(pin, 0)
        for channel, volts in enumerate((1.30, 0.60, 2.0, 2.5)):
            sim.adc.set_volts(channel, volts)
        sim.twi.set_distance(0x70, 123)
        sim.twi.set_distance(0x71, 456)
        sim.run(sim.cycles(0.5))
        with j2a.Client(SimLink(sim)) as board:
            found = ask(board)
        assert sim.counters.overruns == 0
        assert sim.log == ""
    return found


@pytest.fixture(scope="module")
def swap(make, need, tmp_path_factory):
    """In a copy of an app, change one line of its transds.def, and build it anew as a user does it;
    returns make's result and the program."""
    need("avr-gcc")
    folder = tmp_path_factory.mktemp("swap")

    def build(app, line, other):
        copy = folder / app
        if not copy.exists():
            shutil.copytree(FIRMWARE / "apps" / app, copy)
        text = (FIRMWARE / "apps" / app / "transds.def").read_text("utf-8")
        assert text.count(line) == 1
        assert "\n" not in line + other
        (copy / "transds.def").write_text(text.replace(line, other), "utf-8")
        out = folder / "out"
        done = make(core_as_one=True, PORT="avr-serial", APP=app, APP_DIR=copy, OUT=out)
        return done, out / f"{app}.elf"

    return build


def distances(model, unit, *values):
    return model, unit, [None if mm is None else pytest.approx(mm, rel=0.06) for mm in values]


PARTS = {
    "dist_ir": distances("GP2Y0A21YK", "mm", 200, 500),
    "adc": ("AVCC/1024", "mV", [pytest.approx(v, abs=5) for v in (1300, 600, 2000, 2500)]),
    "quad": ("HEDS-6500", "", [None, None]),  # no step came
    "misses": ("HEDS-6500", "", [None, None]),
}


@pytest.mark.avr
def test_the_app_as_it_is(swap):
    result, program = swap("sensors", INFRARED, INFRARED)
    assert result.returncode == 0, result.stderr
    assert measured(program) == PARTS


@pytest.mark.avr
@pytest.mark.parametrize(
    ("line", "other", "name", "seen"),
    [
        (INFRARED, ULTRASONIC, "dist_us", ("SRF02", "cm", [123, 456])),
        (INFRARED, FAR, "dist_ir", distances("GP2Y0A02YK", "mm", 470, 1100)),
        (INFRARED, FORERUNNER, "dist_ir", distances("GP2D12", "mm", 200, 500)),
        (ADC, ULTRASONIC.replace("1", "2", 1), "dist_us", ("SRF02", "cm", [123, 456])),
        (MISSES, ULTRASONIC.replace("1", "3", 1), "dist_us", ("SRF02", "cm", [123, 456])),
    ],
    ids=("infrared by ultrasonic", "model", "forerunner", "adc by ultrasonic", "in addition"),
)
def test_one_line_swaps_a_sensor(swap, line, other, name, seen):
    """The build of before is there, of the app as it is or with another line swapped."""
    result, program = swap("sensors", line, other)
    assert result.returncode == 0, result.stderr
    old = re.match(r"SENSOR\((\w+)", line)[1]
    wanted = {**{key: part for key, part in PARTS.items() if key != old}, name: seen}
    assert measured(program) == wanted


@pytest.mark.avr
def test_the_swap_on_the_page(swap, monkeypatch, capsys):
    """Its line, its host program, and what it says that this prints."""
    section = PAGE[PAGE.index("### Swap a sensor") :]
    [(line, other)] = re.findall(r"```diff\n-(.+)\n\+(.+)\n```", section)
    program = re.search(r"```python\n(.*?)```", section, re.S)[1]
    before, now = re.search(
        r"`(dist_ir .*?)` was in its output before, and `(.*?)`", section
    ).groups()

    def ask(board):
        monkeypatch.setattr(j2a, "connect", lambda url: board)
        exec(compile(program, "transducers.md", "exec"), {})
        return capsys.readouterr().out.splitlines()

    result, elf = swap("sensors", line, line)
    assert result.returncode == 0, result.stderr
    first = measured(elf, ask)
    assert before in first
    result, elf = swap("sensors", line, other)
    assert result.returncode == 0, result.stderr
    assert measured(elf, ask) == [now if said == before else said for said in first]


@pytest.mark.avr
def test_the_driver_on_the_page(make, need, tmp_path):
    """With the main program and the app.mk on the page of drivers."""
    need("avr-gcc")
    page = (FIRMWARE.parent / "docs/drivers.md").read_text("utf-8")
    section = page[page.index("## Use them in your application") : page.index("## Tests of your")]
    program, driver, line = re.findall(r"```c\n(.*?)```", section, re.S)
    (tmp_path / "drivers").mkdir()
    (tmp_path / "app.c").write_text(program)
    (tmp_path / "app.mk").write_text(re.search(r"```make\n(.*?)```", section, re.S)[1])
    (tmp_path / "drivers/bumper.c").write_text(driver)
    (tmp_path / "transds.def").write_text(line)
    for name in ("functions", "properties"):
        (tmp_path / f"{name}.def").touch()

    def build(**more):
        return make(PORT="avr-serial", APP="cart", APP_DIR=tmp_path, OUT=tmp_path / "out", **more)

    result = build(core_as_one=True)
    assert result.returncode == 0, result.stderr
    with AvrSim(str(tmp_path / "out/cart.elf")) as sim, j2a.Client(SimLink(sim)) as board:
        sensor = board.transducers["bumper"]
        for level in (0, 1):
            sim.pins.drive("PD7", level)
            assert sensor.wait(1).values == (not level,)
    (tmp_path / "transds.def").write_text(line.replace("bool", "float"))
    result = build(core_as_one=True)
    assert result.returncode != 0
    assert re.search(r"conflicting types for .bumper_set_cb", result.stderr)


@pytest.mark.avr
def test_ultrasonic_by_analog_inputs_in_the_listing(swap):
    volts = "SENSOR(volts, 2, adc, AVCC/1024, 4, uint16_t, 65535, (unit, mV), (scale, 4.8828125))"
    result, program = swap("listing", LISTED, volts)
    assert result.returncode == 0, result.stderr
    found = measured(program)
    assert found.keys() == {"quad", "dist_ir", "volts"}
    assert found["volts"] == ("AVCC/1024", "mV", PARTS["adc"][2])
    assert found["dist_ir"][2][:2] == [pytest.approx(470, rel=0.06), pytest.approx(1100, rel=0.06)]


@pytest.mark.avr
def test_infrared_behind_the_analog_inputs(build, tmp_path):
    """The order of the lines is free: where turns of the main loop are so long that each of them
    begins a scan for the analog inputs, both sensors go on."""
    app = tmp_path / "sensors"
    shutil.copytree(FIRMWARE / "apps/sensors", app)
    lines = (app / "transds.def").read_text("utf-8").splitlines(keepends=True)
    [infrared] = [line for line in lines if line.startswith(INFRARED)]
    lines.remove(infrared)
    lines.insert(lines.index("#endif\n"), infrared)
    (app / "transds.def").write_text("".join(lines), "utf-8")
    elf = build("sensors", "avr-serial", APP_DIR=app, BAUD="9600")
    with AvrSim(elf) as sim, j2a.Client(SimLink(sim), timeout=5.0) as board:
        inputs, infrared = board.transducers["adc"], board.transducers["dist_ir"]
        inputs.period = 0
        with inputs.samples() as samples:
            inputs.enabled = True
            times = [samples.wait(5).readings[0].time_us for _ in range(30)]
        assert all(b - a > 5000 for a, b in itertools.pairwise(times))  # a SIF in each turn
        assert times[-1] - infrared.read()[0].time_us < 300_000


@pytest.mark.avr
@pytest.mark.parametrize(
    ("other", "message"),
    [
        (
            ULTRASONIC.replace("uint32_t, 0x00FFFFFF", "uint16_t, 0"),
            "conflicting types for .srf02_set_cb",
        ),
        (INFRARED.replace("sharp", "sonar"), "sonar_set_cb"),
        (INFRARED.replace("GP2Y0A21YK", "GP2Y0A41SK"), "SHARP_GP2Y0A41SK"),
    ],
    ids=("type", "driver", "model"),
)
def test_a_line_without_its_driver_is_refused(swap, other, message):
    result, _ = swap("sensors", INFRARED, other)
    assert result.returncode != 0
    assert re.search(message, result.stderr), result.stderr


@pytest.mark.avr
def test_what_no_line_names_is_left_out(build):
    """apps/servo has neither the ADC's interrupt nor the bus's, and nothing of what they keep."""
    program = build("servo", "avr-serial")
    command = ["avr-nm", program]
    names = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert re.search(r" T __vector_5$", names, re.M)  # the encoders
    assert not re.search(r" T __vector_(21|24)$", names, re.M)
    assert not re.search(r"adc|sharp|srf02|twi", names)


def test_a_driver_of_several_lines_is_called_once(need, tmp_path):
    """In the order of the lines, and an actuator's as a sensor's."""
    need("cc")
    prefixes = ("one", "two", "one", "three", "two", "one")
    (tmp_path / "transds.def").write_text(
        "".join(
            f"{'ACTUATOR' if id_ == 2 else 'SENSOR'}(t{id_}, {id_}, {prefix}, X, 1, u8, none)\n"
            for id_, prefix in enumerate(prefixes)
        )
    )
    (tmp_path / "functions.def").touch()
    hooks = "".join(
        f'void {name}_{hook}(void) {{ puts("{name}_{hook}"); }}\n'
        for name in ("one", "two", "three")
        for hook in ("init", "task")
    )
    (tmp_path / "main.c").write_text(
        f'#include <stdio.h>\n#include "drivers.h"\n{hooks}'
        "int main(void) { drivers_init(); drivers_task(); return 0; }\n"
    )
    folders = ("core", "ports/common", "ports/posix", "drivers", "drivers/avr")
    includes = [f"-I{path}" for path in (tmp_path, *(FIRMWARE / folder for folder in folders))]
    options = ["-DJ2A_WITH_TRANSDUCERS=1", "-DJ2A_RXBUF=255", "-DJ2A_TXBUF=0"]
    sources = [tmp_path / "main.c", DRIVERS / "drivers.c"]
    program = tmp_path / "calls"
    command = ["cc", "-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", *options, *includes]
    subprocess.run([*command, *sources, "-o", program], check=True)
    done = subprocess.run([program], capture_output=True, text=True, check=True)
    names = ("one", "two", "three")
    assert done.stdout.split() == [f"{name}_{hook}" for hook in ("init", "task") for name in names]
