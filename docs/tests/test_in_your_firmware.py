"""The page "J2A in your firmware": its example does what it says, its figures are measured."""

import json
import re
import shlex
import struct
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from j2a_sim import AvrSim, SimLink, ToolMissing
from j2a_spec.capabilities import CAPABILITIES

import j2a

ROOT = Path(__file__).parents[2]
FLOW = ROOT / "docs/examples/flow"
PAGE = (ROOT / "docs/in-your-firmware.md").read_text()
MINUS = "\N{MINUS SIGN}"
SIF_ALARM, SIF_MEASURED = 0x40, 0x41
LIMIT_S = 200
OK, PASSED, FAILED = 0x00, 0x01, 0xFF


def u32(number):
    return struct.pack("<I", number)


def total(board):
    return struct.unpack("<I", board.call("total").payload)[0]


@pytest.fixture(scope="module")
def program(build_firmware):
    return build_firmware("flow", APP_DIR=FLOW)


@pytest.fixture
def board(program):
    with j2a.connect(f"exec:{shlex.quote(str(program))}", timeout=LIMIT_S) as board:
        yield board


def test_the_interrupt_counts_and_the_function_tells(board):
    assert board.properties["name"] == "flow meter"
    assert board.properties["serial"] == "0042"
    before, began_s = total(board), time.monotonic()
    while (counted := total(board) - before) <= 50:
        assert time.monotonic() - began_s < LIMIT_S
        time.sleep(0.01)
    assert counted < 600_000 * (time.monotonic() - began_s)


def test_a_smaller_room_is_told_once(build_firmware):
    small = build_firmware("flow", APP_DIR=FLOW, ROOM=128)
    with j2a.connect(f"exec:{shlex.quote(str(small))}", timeout=LIMIT_S) as board:
        assert board.properties["j2a.room"] == "128"


def test_an_alarm_comes_once_from_the_main_loop(board):
    seen, came = [], threading.Event()

    def on_alarm(sif):
        seen.append(struct.unpack("<I", sif.payload)[0])
        came.set()

    board.on_sif(SIF_ALARM, on_alarm)
    for ahead in (200, 2_000, 20_000):  # a busy machine may be late for the first
        at = total(board) + ahead
        if board.call("setAlarm", u32(at)).code == OK:
            break
    else:
        pytest.fail("no alarm was set")
    assert came.wait(LIMIT_S)
    assert seen[0] >= at
    assert board.read_debug() == "alarm\n"
    assert board.call("setAlarm", u32(at)).code == PASSED
    time.sleep(0.05)
    assert len(seen) == 1


@pytest.mark.parametrize(
    ("name", "payload"),
    [
        ("setAlarm", b""),
        ("setAlarm", bytes(5)),
        ("measure", b""),
        ("measure", b"\x00"),
        ("measure", b"\x0b"),
        ("measure", b"\x01\x01"),
    ],
)
def test_what_does_not_fit_is_refused(board, name, payload):
    assert board.call(name, payload) == (FAILED, b"")


def test_a_reply_from_elsewhere(board):
    assert board.call("about").payload == b"0.1 l per pulse; wheel of 2026"


def test_sifs_of_a_function_come_before_its_reply(board):
    numbers = []
    board.on_sif(SIF_MEASURED, lambda sif: numbers.append(struct.unpack("<BH", sif.payload)[0]))
    assert board.call("measure", b"\x0a") == (OK, b"")
    end = time.monotonic() + LIMIT_S
    while len(numbers) < 10 and time.monotonic() < end:
        time.sleep(0.01)
    assert numbers == list(range(10))


def test_notes_are_kept_as_a_whole(board):
    assert board.read_many("notes") == b""
    board.write_many("notes", bytes(range(250)) + bytes(50))
    assert board.read_many("notes") == bytes(range(250)) + bytes(50)
    with pytest.raises(j2a.FunctionFailed):
        board.write_many("notes", bytes(301))
    assert board.read_many("notes") == bytes(range(250)) + bytes(50)
    board.write_many("notes", b"short")
    assert board.read_many("notes") == b"short"


def test_the_log_does_not_change_while_it_is_read(board):
    end = time.monotonic() + LIMIT_S
    while len(log := board.read_many("log")) < 4 and time.monotonic() < end:
        time.sleep(0.05)
    samples = struct.unpack(f"<{len(log) // 2}H", log)
    assert all(samples[1:])
    with pytest.raises(j2a.FunctionFailed):
        board.write_many("log", b"x")


def commands():
    boxes = re.findall(r"^```sh\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
    return [line for box in boxes for line in box.splitlines()]


def test_the_commands_of_the_page(need):
    """In the project's folder, as the page says; the build goes to a folder of its own."""
    need("make")
    need("cc")
    printed = ""
    for line in commands():
        result = subprocess.run(
            line,
            shell=True,
            cwd=ROOT,
            env={"PATH": f"{Path(sys.executable).parent}:/usr/local/bin:/usr/bin:/bin"},
            capture_output=True,
            text=True,
            timeout=LIMIT_S,
            check=False,
        )
        assert result.returncode == 0, f"{line}\n{result.stdout}{result.stderr}"
        printed += result.stdout
    for line in re.findall(r"^```text\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE):
        for part in line.splitlines():
            pattern = r"\s+".join(map(re.escape, part.split())).replace(r"\.\.\.", ".*")
            assert re.search(pattern, printed), part


def test_mistakes_show_as_the_page_says(build_firmware):
    program = build_firmware("mistakes", APP_DIR=Path(__file__).parent / "mistakes")
    with j2a.connect(f"exec:{shlex.quote(str(program))}", timeout=LIMIT_S) as board:
        assert board.call("unset", b"\x05\x06\x07") == (OK, b"\x01\x06\x07")
        assert board.call("overwritten", b"ab") == (OK, b"bb")
        assert board.call("high") == (FAILED, b"")
        with pytest.raises(j2a.CallTimeout):
            board.call("slow", timeout=0.05)
        assert board.echo(b"well again") == b"well again"
        with pytest.raises(j2a.ProtocolError, match="never end"):
            board.read_many("endless")
        assert board.read_many("repeated") == bytes((1, 2, 3, 1, 2, 3))


@pytest.mark.avr
def test_each_pulse_at_the_pin_is_counted(build_firmware, missing):
    """By the program that the page shows."""
    elf = build_firmware("flow", port="avr-serial", APP_DIR=FLOW)
    [shown] = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    found = {}
    try:
        exec(shown.replace("flow.elf", str(elf)), found)
    except ToolMissing as error:
        missing(str(error))
    assert isinstance(found["sim"], AvrSim)
    assert isinstance(found["link"], SimLink)
    assert found["counted"] == 1000


@pytest.mark.avr
def test_of_two_links_the_one_that_asks_gets_the_sifs(need, build_firmware):
    need("qemu-system-arm")
    elf = build_firmware("flow", port="cortex-m", APP_DIR=FLOW, LINKS=2)
    launcher = ROOT / "firmware/ports/common/qemu.py"
    for serial in ("-serial stdio -serial null", "-serial null -serial stdio"):
        words = f"-M mps2-an385 -display none -monitor none {serial} -kernel {elf}"
        url = f"exec:{sys.executable} {launcher} qemu-system-arm {words}"
        with j2a.connect(url, timeout=LIMIT_S, boot_time=LIMIT_S) as board:
            test_sifs_of_a_function_come_before_its_reply(board)
            test_notes_are_kept_as_a_whole(board)


def test_the_costs_are_those_of_the_budget():
    snapshot = json.loads((ROOT / "firmware/verify/budget/snapshot.json").read_text())
    full = snapshot["avr-serial/full"]
    assert f"({full['flash']} bytes of flash, {full['ram']} of RAM)" in PAGE
    row = r"^\| `[^|]*` \|[^|]*\| ([^|]+) \| ([^|]+) \| `avr-serial/([^`]+)` \|$"
    rows = re.findall(row, PAGE, re.MULTILINE)
    assert len(rows) == 8
    for flash, ram, name in rows:
        build = snapshot[f"avr-serial/{name}"]
        expected = (build["flash"] - full["flash"], build["ram"] - full["ram"])
        assert tuple(int(n.replace(MINUS, "-")) for n in (flash, ram)) == expected


def test_each_option_is_on_the_page():
    text = (ROOT / "firmware/core/j2a_options.h").read_text()
    announced = {part.option for part in CAPABILITIES.values() if part.token}
    for name in announced:  # in the table that is generated
        assert f"| `{name}` |" in (ROOT / "docs/library.md").read_text(), name
    for name in {*re.findall(r"#ifndef (J2A_(?!OPTIONS_H)\w+)", text)} - announced:
        assert f"`{name}" in PAGE or f" {name}=" in PAGE, name
