"""The budgets: each limit is a test, the snapshot is what is measured, and what is wrong is found.

In: firmware/verify/budget/budget.toml and snapshot.json. Out: one test for each limit. What has
changed since the snapshot was written is measured, and besides one build for each kind of figure of
each port, in a folder of its own; the controls change the limits, the snapshot and the firmware,
and each must be noticed.
"""

import contextlib
import fcntl
import io
import json
import os
import re
import subprocess
import sys
import threading
import tomllib
from dataclasses import replace
from pathlib import Path

import pytest
from j2a_sim import AvrSim
from j2a_spec.capabilities import CAPABILITIES

from firmware.verify.budget import (
    avr_run,
    avr_stack,
    builds,
    callgraph,
    measured,
    report,
    runs,
    snapshot,
)
from firmware.verify.budget import measure as command
from firmware.verify.budget.builds import BudgetError

FIRMWARE = Path(__file__).parents[1]
BUDGET = FIRMWARE / "verify/budget"

pytestmark = pytest.mark.avr

ENTRIES = tomllib.loads((BUDGET / "budget.toml").read_text())["build"]
LIMITS = [(entry["name"], *item) for entry in ENTRIES for item in entry.get("limit", {}).items()]
TOOLS = (
    *("avr-gcc", "arm-none-eabi-gcc", "riscv64-unknown-elf-gcc"),
    *("qemu-system-arm", "qemu-system-riscv32", "valgrind", "node"),
)
FULL = "avr-serial/full"
# Measured whatever has changed: each port, each way to measure, and what the tests below look at.
# Each other build is measured where anything changed that decides about its figures.
ALWAYS = [
    *(FULL, "avr-serial/demo", "avr-serial/cycles", "avr-serial/cycles-room-32"),
    *("avr-usb/full-32u4", "template/atmega328p", "cortex-m/full"),
    *("rp2040/full", "rp2040/counts", "riscv/demo", "posix/full", "posix/counts"),
]
COMMAND = [sys.executable, "-m", "firmware.verify.budget.measure"]
SMALL = "J2A_SELFTEST_SMALL"  # goes with J2A_WITH_SELFTEST
VARIABLES = {"LINKS", "ROOM", "RXBUF", "TXBUF"}  # of the Makefile, for options of the same names
# Not measured: bytes that are what they say, a constant, and a buffer of ports to large machines.
WITHOUT = {"J2A_DEBUGBUF", "J2A_PAUSE_MS", "J2A_TXBUF"}
OURS = {"avr-serial", "avr-usb", "cortex-m", "posix", "riscv", "rp2040", "template"}


def measure(*arguments, **environment):
    """The command; within this process, where it needs no other environment."""
    if not environment:
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = command.main([*map(str, arguments)])
        return subprocess.CompletedProcess(arguments, code, out.getvalue(), err.getvalue())
    return subprocess.run(
        [*COMMAND, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, **environment},
    )


@pytest.fixture(scope="session")
def tools(need, missing):
    for tool in TOOLS:
        need(tool)
    if not (FIRMWARE / "verify/emulators/rp2040/node_modules").is_dir():
        missing("rp2040js is not installed: run sh tools/npm.sh firmware/verify/emulators/rp2040")


@pytest.fixture(scope="session")
def out(tmp_path_factory):
    return tmp_path_factory.mktemp("budget")


@pytest.fixture(scope="session")
def checked(tools, out):
    """The run of --check over what has changed, the figures of all, and those of `ALWAYS`."""
    result = measure("--check", "--changed", "--out", out, "--save", out / "figures.json")
    assert result.returncode in (0, 1), result.stderr
    new = measure("--check", "--only", *ALWAYS, "--out", out, "--save", out / "always.json")
    assert new.returncode == 0, new.stdout + new.stderr
    always = json.loads((out / "always.json").read_text())
    assert set(always) == {*ALWAYS}
    return result, json.loads((out / "figures.json").read_text()) | always


@pytest.fixture
def one(checked, out):
    """Look at one build with another budget or snapshot; the figures are there already."""

    def run(*arguments, name=FULL):
        figures = () if "--rebuild" in arguments else ("--figures", out / "figures.json")
        return measure("--only", name, "--out", out, *figures, *arguments)

    return run


@pytest.mark.parametrize(("name", "metric", "limit"), LIMITS)
def test_limit(checked, name, metric, limit):
    assert checked[1][name][metric] <= limit


def test_what_was_promised_is_limited():
    limits = {(name, metric): limit for name, metric, limit in LIMITS}
    assert limits[FULL, "flash"] <= 2048
    assert limits[FULL, "ram"] <= 300
    assert limits["avr-serial/minimal", "flash"] <= 900
    assert limits["avr-serial/minimal-room-32", "total"] <= 128
    assert limits["avr-serial/cycles", "rx_plain"] <= 55
    assert limits["avr-serial/cycles", "rx_escaped"] <= 55
    assert limits["avr-serial/cycles", "received"] <= 160
    assert limits["avr-serial/sensors-32u2", "total"] <= 1024
    assert limits["avr-usb/full-32u2", "flash"] <= 4096
    assert limits["avr-usb/full-32u2", "ram"] <= 300


def test_each_figure_of_the_other_ports_is_limited(checked):
    """A compiler that the snapshot does not know is held to limits alone."""
    for entry in ENTRIES:
        if not entry["name"].startswith("avr-serial/"):
            figures = checked[1][entry["name"]].keys() - {"compiler", "total"}
            assert entry["limit"].keys() - {"total"} == figures, entry["name"]


def test_snapshot_and_table_are_what_is_measured(checked):
    result, _ = checked
    assert result.returncode == 0, result.stdout + result.stderr


@pytest.mark.exhaustive
def test_each_build_is_what_the_snapshot_says(tools, out):
    """Whatever has changed; the C libraries and the emulators may have, too."""
    result = measure("--check", "--out", out)
    assert result.returncode == 0, result.stdout + result.stderr


def test_each_port_of_ours_is_measured():
    """One that somebody adds may come without a budget: a port is its folder and a testee."""
    there = {path.parent.name for path in FIRMWARE.glob("ports/*/port.mk")}
    assert there >= OURS
    assert {entry["name"].partition("/")[0] for entry in ENTRIES} >= OURS
    always = [build for build in builds.load() if build.name in ALWAYS]
    assert {build.name.partition("/")[0] for build in always} >= OURS
    of_ports = {(build.port, kind) for build in builds.load() for kind in build.measure}
    of_ports -= {("avr-usb", "callgraph"), ("cortex-m", "core"), ("rp2040", "core")}
    of_ports -= {("cortex-m", "counts"), ("riscv", "counts")}  # rp2040 has them in an emulator, too
    assert {(build.port, kind) for build in always for kind in build.measure} >= of_ports


# ------------------------------------------------------------------- what has changed


@pytest.mark.parametrize("name", ["avr-serial/sensors", "avr-usb/full-32u4", "rp2040/full"])
def test_what_the_compiler_reads_decides_whether_a_build_has_changed(checked, out, name):
    (build,) = (build for build in builds.load() if build.name == name)
    counted = {path.resolve() for path in measured.files(build, FIRMWARE)}
    builds.make(build, out.resolve())  # where it was not measured
    read = set()
    for listing in (out / name).rglob("*.d"):
        words = listing.read_text().replace("\\\n", " ").split()
        read |= {(FIRMWARE / word.rstrip(":")).resolve() for word in words}
    ours = {path for path in read if path.is_relative_to(FIRMWARE) and path.suffix != ".o"}
    assert len(ours) > 30
    assert ours <= counted


def test_each_source_counts(tmp_path):
    (build,) = (build for build in builds.load() if build.name == FULL)
    firmware = tmp_path / "firmware"
    for path in measured.files(build, FIRMWARE):
        copy = firmware / path.relative_to(FIRMWARE)
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_bytes(path.read_bytes())

    def digest(build, compiler="avr-gcc"):
        return measured.digest(build, compiler, firmware)

    before = digest(build)
    assert before == measured.digest(build, "avr-gcc", FIRMWARE), "wherever the folder is"
    assert digest(replace(build, limit={}, note="another")) == before
    assert digest(build, "avr-gcc 4") != before
    assert digest(replace(build, options={"J2A_ROOM": 64})) != before
    for name in ("Makefile", "core/ext/j2a_many.c", "ports/common/avr_ram.ld", "apps/main.c"):
        text = (firmware / name).read_bytes()
        (firmware / name).write_bytes(text + b"\n")
        assert digest(build) != before, name
        (firmware / name).write_bytes(text)
    (firmware / "core/README.md").write_text("of no consequence")
    assert digest(build) == before
    (firmware / "core/ext/j2a_more.c").touch()
    assert digest(build) != before


def test_what_emulates_and_what_reads_the_program_counts():
    """A change of either may change a figure."""
    of = {build.name: measured.files(build, FIRMWARE) for build in builds.load()}
    emulator = FIRMWARE / "verify/emulators/rp2040"
    assert {*emulator.glob("*.mjs")} <= {*of["rp2040/counts"]}
    assert emulator / "package-lock.json" in of["rp2040/counts"]
    bounds = [build.name for build in builds.load() if "bound" in build.measure]
    assert bounds
    assert all(FIRMWARE / "sim/j2a_sim/_elf.py" in of[name] for name in bounds)


@pytest.mark.parametrize("option", ["--out", "--save", "--budget", "--snapshot", "--figures"])
def test_files_that_cannot_be_used_are_named(option, tmp_path):
    damaged = tmp_path / "damaged"
    damaged.write_bytes(b"\xff")
    wrong = damaged if option in {"--budget", "--snapshot", "--figures"} else damaged / "folder"
    kept = ("--figures", snapshot.SNAPSHOT) if option in {"--save", "--snapshot"} else ()
    result = measure("--only", FULL, "--check", *kept, option, wrong)
    assert result.returncode == 2, result.stdout + result.stderr
    assert damaged.name in result.stderr
    assert "Traceback" not in result.stderr


def test_a_run_that_waits_for_another_one_says_so(tmp_path, capsys):
    with (tmp_path / "lock").open("w") as first, (tmp_path / "lock").open("w") as second:
        fcntl.flock(first, fcntl.LOCK_EX)
        timer = threading.Timer(0.2, lambda: fcntl.flock(first, fcntl.LOCK_UN))
        timer.start()
        command._lock(second, tmp_path)
        timer.join()
    assert f"waiting for another run that builds in {tmp_path}" in capsys.readouterr().err


def test_only_what_has_changed_is_measured(tools, tmp_path, monkeypatch):
    """The others have the figures of the snapshot."""
    names = ["avr-serial/full", "avr-serial/minimal"]
    chosen = [build for build in builds.load() if build.name in names]
    hashes = {
        build.name: measured.digest(build, runs.compiler(build, FIRMWARE), FIRMWARE)
        for build in chosen
    }
    monkeypatch.setattr(measured, "read", lambda: hashes | {names[1]: "of other sources"})
    done = []
    monkeypatch.setattr(
        command.runs, "measure", lambda build, *_: done.append(build.name) or figures[build.name]
    )
    figures = snapshot.read()
    result = measure("--check", "--changed", "--only", *names, "--out", tmp_path)
    assert result.returncode == 0, result.stdout + result.stderr
    assert done == names[1:]
    figures[names[1]] = replace(figures[names[1]], figures={"flash": 1.0})
    assert measure("--check", "--changed", "--only", *names, "--out", tmp_path).returncode == 1


def test_each_switch_is_measured():
    """Each option of the core and of a port is in a build in which nothing else is changed."""
    files = [FIRMWARE / "core/j2a_options.h", *FIRMWARE.glob("ports/*/j2a_port_config.h")]
    text = "".join(path.read_text() for path in files)
    switches = {name for name in re.findall(r"#ifndef (J2A_\w+)", text) if not name.endswith("_H")}
    switches -= WITHOUT
    alone = {name for build in builds.load() if len(build.options) == 1 for name in build.options}
    # A part of the protocol comes with the parts that it needs.
    names = {build.name for build in builds.load()}
    alone |= {part.option for part in CAPABILITIES.values() if f"avr-serial/{part.id}" in names}
    for entry in ENTRIES:
        options = {option.partition("=")[0] for option in entry.get("options", [])}
        options |= {f"J2A_{name}" for name in entry.get("make", {}) if name in VARIABLES}
        if len(options - {SMALL}) == 1:
            alone |= options
    assert switches == {name for name in alone if name.startswith("J2A_")}


# ------------------------------------------------------------------- are the figures right?


@pytest.mark.parametrize("name", [FULL, "avr-serial/demo", "cortex-m/full", "riscv/demo"])
def test_sizes_are_those_of_binutils(checked, out, name):
    (elf,) = (out / name).glob("*.elf")
    tool = {"avr-serial": "avr-size", "cortex-m": "arm-none-eabi-size"}.get(
        name.partition("/")[0], "riscv64-unknown-elf-size"
    )
    listed = subprocess.run([tool, "-A", elf], capture_output=True, text=True, check=True).stdout
    size = {name: int(size) for name, size in re.findall(r"^(\.\w+) +(\d+) ", listed, re.MULTILINE)}
    figures = checked[1][name]
    assert figures["flash"] == size[".text"] + size.get(".data", 0)
    assert figures["ram"] == size.get(".data", 0) + size[".bss"]


def test_stack_is_bounded_from_both_sides(checked):
    both = [figures for figures in checked[1].values() if {"stack", "bound"} <= figures.keys()]
    assert len(both) >= 8
    for figures in both:
        # What no load reaches is a few bytes; more would mean that the load does too little.
        assert figures["stack"] <= figures["bound"] <= figures["stack"] + 4


@pytest.mark.parametrize("name", ["avr-serial/cycles", "avr-serial/cycles-room-32"])
def test_an_escape_takes_no_longer_than_two_bytes(checked, out, name):
    """The second byte of an escape is the dearest; the one before it makes up for that."""
    figures = checked[1][name]
    with AvrSim(out / name / "cycles.elf") as sim:
        sim.boot()
        spans = avr_run._spans(sim, 4)
    (nothing,) = (span.cycles for span in spans if span.mark == 10)
    costs = [span.cycles - nothing + avr_run.CALL for span in spans if span.mark == 9]
    assert max(costs) == figures["rx_dearest"]
    before = costs[costs.index(max(costs)) - 1]
    around = figures["received_dearest"] - figures["rx_dearest"]
    assert before + max(costs) + 2 * around < 320
    assert around + min(costs) < figures["received"] < figures["received_dearest"]


DEEP = """#include "j2a_functions.h"
void j2a_app_task(void) {
}
BODY
uint8_t deep(uint8_t *const length, uint8_t **const payload) {
    return down(*length, *payload);
}
"""


@pytest.fixture(scope="module")
def deep(avr, make, tmp_path_factory):
    """Build a program whose function goes deep; the rest of it is compiled once."""
    folder = tmp_path_factory.mktemp("deep")
    app = folder / "app"
    app.mkdir()
    (app / "functions.def").write_text("J2A_CALL(deep, deep)\n")
    (app / "properties.def").write_text("")

    def run(body):
        (app / "app.c").write_text(DEEP.replace("BODY", body))
        elf = folder / "out/deep.elf"
        elf.unlink(missing_ok=True)
        out = folder / "out"
        result = make(core_as_one=True, PORT="avr-serial", APP="deep", APP_DIR=app, OUT=out)
        assert result.returncode == 0, result.stderr
        return elf

    return run


PLAIN = builds.Build("test", "", "avr-serial", (), "deep", {}, {}, (), {})


FRAME = """static uint8_t down(uint8_t length, uint8_t *payload) {
    volatile uint8_t frame[SIZE];
    uint16_t i;
    for (i = 0; i < SIZE; i++)
        frame[i] = (uint8_t)(length + i);
    payload[0] = frame[length % SIZE];
    return 0;
}"""
RECURSION = """static __attribute__((noinline)) uint8_t down(uint8_t length, uint8_t *payload) {
    payload[length] = length;
    return length ? (uint8_t)(down((uint8_t)(length - 1), payload) + payload[0]) : 0;
}"""


# The compiler makes room by other instructions from 64 bytes on, and for multiples of 256.
@pytest.mark.parametrize(
    "size",
    [50, 256, 300, *(pytest.param(size, marks=pytest.mark.exhaustive) for size in (100, 255, 512))],
)
def test_deep_stack_is_seen(deep, checked, size):
    elf = deep(FRAME.replace("SIZE", f"{size}"))
    stack = avr_run.stack(elf, PLAIN)
    bound = avr_stack.stack_bound(elf, PLAIN)
    # Deeper than a2jMany, which is the deepest otherwise, by nearly all of the frame.
    assert size < stack <= bound < checked[1][FULL]["bound"] + size


POINTER = """static uint8_t (*volatile chosen)(uint8_t);
static __attribute__((noinline)) uint8_t down(uint8_t length, uint8_t *payload) {
    return chosen ? chosen(length) : payload[0];
}"""


def test_pointers_to_functions_have_no_bound(deep):
    elf = deep(POINTER)
    with pytest.raises(BudgetError, match=r"\w+ (calls|jumps) through a pointer"):
        avr_stack.stack_bound(elf, PLAIN)


def test_recursion_has_no_bound(deep):
    elf = deep(RECURSION)
    with pytest.raises(BudgetError, match="down calls itself"):
        avr_stack.stack_bound(elf, PLAIN)


CALLS = """graph: { title: "x.c"
node: { title: "main" label: "main\\nx.c:1:1\\n8 bytes (static)" }
node: { title: "j2a_process" label: "j2a_process\\nx.c:2:1\\n16 bytes (static)" }
node: { title: "mine" label: "mine\\nx.c:3:1\\n100 bytes (static)" }
node: { title: "handler" label: "handler\\nx.c:4:1\\n24 bytes (static)" }
edge: { sourcename: "main" targetname: "j2a_process" label: "x.c:1:9" }
edge: { sourcename: "j2a_process" targetname: "__indirect_call" label: "x.c:2:9" }
edge: { sourcename: "mine" targetname: "memset" label: "x.c:3:9" }
}
"""


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (CALLS, 8 + 16 + 100 + 32 + 24 + 36),
        (CALLS.replace('targetname: "memset"', 'targetname: "main"'), "main calls j2a_process"),
        (
            CALLS.replace("100 bytes (static)", "9 bytes (dynamic)"),
            "the frame of mine is dynamic",
        ),
        ("", r"no \*\.ci"),
    ],
)
def test_bound_from_the_compiler(tmp_path, text, expected):
    if text:
        (tmp_path / "x.ci").write_text(text)
    functions = tmp_path / "functions.def"
    functions.write_text("J2A_CALL(name, mine)\n")
    if isinstance(expected, int):
        assert callgraph.callgraph_bound(tmp_path, functions, 36, 32) == expected
    else:
        with pytest.raises(BudgetError, match=expected):
            callgraph.callgraph_bound(tmp_path, functions, 36, 32)


# ------------------------------------------------------------------- is what is wrong found?


@pytest.mark.parametrize("name", [FULL, "avr-serial/cycles", "avr-serial/minimal-room-32"])
def test_broken_limits_are_found(one, tmp_path, name):
    budget = (BUDGET / "budget.toml").read_text()
    small = tmp_path / "budget.toml"
    small.write_text(
        re.sub(r"^limit = \{.*\}", lambda m: re.sub(r"\d+", "1", m[0]), budget, flags=re.M)
    )
    result = one("--budget", small, name=name)
    assert result.returncode == 1
    titles = [builds.METRICS[metric].title for build, metric, _ in LIMITS if build == name]
    assert titles
    for title in titles:
        assert re.search(rf"{name}: {title} is [\d.]+, [\d.]+ more than the 1 that", result.stderr)


@pytest.mark.parametrize(("value", "is_broken"), [(9.5, False), (10, False), (10.5, True)])
def test_a_fraction_above_a_limit_breaks_it(value, is_broken):
    build = next(one for one in builds.load() if one.limit)
    metric = next(iter(build.limit))
    limited = replace(build, limit={metric: 10})
    results = {build.name: snapshot.Result("gcc", {metric: value})}
    assert bool(list(snapshot.broken([limited], results))) == is_broken


def changed_snapshot(folder, name, **values):
    table = json.loads((BUDGET / "snapshot.json").read_text())
    table[name] |= values
    path = folder / "snapshot.json"
    path.write_text(json.dumps(table))
    return path


def test_snapshot_that_differs_is_found(one, tmp_path, checked):
    flash = checked[1][FULL]["flash"]
    result = one("--check", "--snapshot", changed_snapshot(tmp_path, FULL, flash=flash + 2))
    assert result.returncode == 1
    assert re.search(rf"{FULL} +flash +{flash + 2} +{flash} +-2 +2048", result.stdout)
    assert "--write" in result.stderr


def test_another_compiler_is_held_to_the_limits(one, tmp_path):
    path = changed_snapshot(tmp_path, FULL, flash=1, compiler="avr-gcc 4.0")
    result = one("--check", "--snapshot", path)
    assert result.returncode == 0, result.stderr
    assert "the snapshot by avr-gcc 4.0: only the limits count" in result.stdout


def test_builds_come_and_go():
    old = snapshot.Result("cc", {"flash": 10})
    new = snapshot.Result("cc", {"flash": 12, "ram": 1})
    found, notes = snapshot.differences({"a": old, "b": old}, {"b": new, "c": new}, every=True)
    assert notes == []
    text = report.changed(found, [], markdown=True)
    assert text.splitlines()[2:] == [
        "| a | flash | 10 |  | gone |  |",
        "| b | flash | 10 | 12 | +2 |  |",
        "| b | RAM |  | 1 | new |  |",
        "| c | flash |  | 12 | new |  |",
        "| c | RAM |  | 1 | new |  |",
    ]
    assert snapshot.differences({"a": old, "b": old}, {"b": old}, every=False) == ([], [])


def test_what_a_change_costs(one):
    """Against this very revision, built again: what is not committed yet is all that may differ."""
    name = "avr-serial/atmega32u4"
    result = one("--against", "HEAD", "--rebuild", "--markdown", name=name)
    assert result.returncode == 0, result.stderr
    assert "No figure has changed." in result.stdout or f"| {name} | " in result.stdout
    result = one("--against", "HEAD")
    assert result.returncode == 0, result.stderr
    assert f"{FULL} " in result.stdout or "No figure has changed." in result.stdout
    result = one("--against", "no-such-revision")
    assert result.returncode == 2
    assert "no-such-revision" in result.stderr


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "has no"),
        ("[[build]]\nname = 'x'", "x: app, measure, port is missing"),
        ("[[build]]\nname='x'\nport='p'\napp='a'\nmeasure=['speed']", "measure knows size"),
        ("[[build]]\nname='x'\nport='p'\napp='a'\nmeasure=['size']\nlimit={rom=1}", "limit knows"),
        ("[[build]]\nname='x'\nport='p'\napp='a'\nmeasure=['size']\noptions=['X']", "J2A_ROOM=32"),
        ("[[build]]\nname='x'\nport='p'\napp='a'\nmeasure=['size']", "there is no port p"),
        ("[[build]", "budget.toml"),
    ],
)
def test_wrong_budgets_are_refused_in_one_line(tmp_path, text, message):
    path = tmp_path / "budget.toml"
    path.write_text(text)
    result = measure("--budget", path, "--out", tmp_path)
    assert result.returncode == 2
    assert message in result.stderr
    assert len(result.stderr.splitlines()) == 1


def test_missing_tools_are_told(tmp_path):
    result = measure("--only", FULL, "--out", tmp_path, PATH=str(tmp_path), J2A_REQUIRE_AVR="")
    assert result.returncode == 2
    assert f"left out: {FULL}: avr-gcc is missing" in result.stderr
    result = measure("--only", FULL, "--out", tmp_path, PATH=str(tmp_path), J2A_REQUIRE_AVR="1")
    assert result.returncode == 2
    assert f"measure.py: {FULL}: avr-gcc is missing" in result.stderr


def test_without_the_library_it_says_what_to_do(tmp_path):
    result = subprocess.run(
        [COMMAND[0], "-E", "-S", *COMMAND[1:]],
        cwd=FIRMWARE.parent,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode != 0
    assert "make venv" in result.stderr
    assert "Traceback" not in result.stderr
