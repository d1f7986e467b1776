"""`make flash` builds an app and has avrdude write it, or says what is missing.

The avrdude here is a script that copies its arguments and the image; everything else is real.
"""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FAKE = """#!/bin/sh
printf '%s\\n' "$@" >"$0.arguments"
for last in "$@"; do :; done
last=${last#flash:w:}
cp "${last%:i}" "$0.image"
exit "${AVRDUDE_STATUS:-0}"
"""


@pytest.fixture
def programs(tmp_path, need):
    """A folder for PATH that has what make and the compiler take, and a fake avrdude."""
    for tool in ("make", "avr-gcc", "avr-objcopy"):
        need(tool)
    folder = tmp_path / "bin"
    folder.mkdir()
    for directory in (Path("/usr/bin"), Path("/bin"), Path(shutil.which("avr-gcc")).parent):
        for path in directory.iterdir():
            if path.name != "avrdude" and not (folder / path.name).exists():
                (folder / path.name).symlink_to(path)
    (folder / "avrdude").write_text(FAKE)
    (folder / "avrdude").chmod(0o755)
    return folder


@pytest.fixture
def flash(programs, tmp_path):
    """Run make flash with variables; returns the process, with both outputs as text."""

    def run(**variables):
        settings = [f"{name}={value}" for name, value in variables.items()]
        kept = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}
        return subprocess.run(
            ["make", "-s", "-C", ROOT, "flash", f"OUT={tmp_path / 'out'}", *settings],
            capture_output=True,
            text=True,
            check=False,
            env=kept | {"PATH": str(programs)},
        )

    return run


@pytest.fixture
def port(tmp_path):
    """A file in the place of a serial port."""
    (tmp_path / "ttyACM0").touch()
    return tmp_path / "ttyACM0"


def test_the_demo_onto_an_uno(flash, programs, port, tmp_path):
    result = flash(PORT="avr-serial", DEVICE=port)
    assert result.returncode == 0, result.stderr
    words = (programs / "avrdude.arguments").read_text().splitlines()
    image = tmp_path / "out/demo.hex"
    assert words == [
        *("-p", "atmega328p", "-c", "arduino", "-b", "115200", "-D"),
        *("-P", str(port), "-U", f"flash:w:{image}:i"),
    ]
    # The image is that of the ELF, as Intel HEX: records that add up to 0, the last one its end.
    records = [bytes.fromhex(line[1:]) for line in (programs / "avrdude.image").read_text().split()]
    assert all(sum(record) % 256 == 0 for record in records)
    assert records[-1] == bytes.fromhex("00000001ff")
    flashed = b"".join(record[4:-1] for record in records if record[3] == 0)
    binary = tmp_path / "demo.bin"
    elf = image.with_suffix(".elf")
    subprocess.run(["avr-objcopy", "-O", "binary", "-R", ".eeprom", elf, binary], check=True)
    assert flashed == binary.read_bytes()
    assert b"a2jEcho\0" in flashed


def test_a_programmer_an_app_and_a_chip(flash, programs):
    chosen = {"MCU": "atmega88", "APP": "builtins", "PROGRAMMER": "usbasp", "DEVICE": "usb"}
    result = flash(PORT="avr-serial", **chosen)
    assert result.returncode == 0, result.stderr
    words = (programs / "avrdude.arguments").read_text().splitlines()
    assert words[:6] == ["-p", "atmega88", "-c", "usbasp", "-P", "usb"]
    assert words[7].endswith("/builtins.hex:i")


def test_a_failure_of_avrdude_is_one_of_make(flash, port, monkeypatch):
    monkeypatch.setenv("AVRDUDE_STATUS", "1")
    assert flash(PORT="avr-serial", DEVICE=port).returncode != 0


@pytest.mark.parametrize(
    ("variables", "message"),
    [
        ({}, "PORT is missing: give the port of the firmware, such as: make flash PORT=avr-serial"),
        ({"PORT": "avr-serial"}, "DEVICE is missing: give the serial port of the board"),
        ({"PORT": "/dev/ttyACM0"}, "PORT is the port of the firmware, DEVICE the serial port"),
        ({"PORT": "avr-serial", "DEVICE": "/dev/none"}, "/dev/none: there is no such port"),
        ({"PORT": "avr", "DEVICE": "usb"}, "no port.mk in ports/avr; there is avr-serial"),
        ({"PORT": "posix", "DEVICE": "usb"}, "cannot write this port, only avr-serial avr-usb"),
        ({"PORT": "avr-serial", "DEVICE": "usb", "MCU": "atmega88"}, "give a programmer, such as"),
    ],
)
def test_what_is_missing_or_unknown_is_named(flash, programs, tmp_path, variables, message):
    result = flash(**variables)
    assert result.returncode != 0
    assert message in result.stderr
    assert not (programs / "avrdude.arguments").exists()
    assert not (tmp_path / "out").exists()


def test_without_avrdude(flash, programs, port, tmp_path):
    (programs / "avrdude").unlink()
    result = flash(PORT="avr-serial", DEVICE=port)
    assert result.returncode != 0
    assert "avrdude is missing: install the package avrdude" in result.stderr
    assert not (tmp_path / "out").exists()
