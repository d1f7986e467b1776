"""Builds the small test firmwares, once per session and set of definitions."""

import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NoReturn

import pytest
from j2a_sim import AvrSim, ToolMissing
from j2a_sim._build import build

from firmware.sim.tests.usb_chip import Chip
from firmware.sim.tests.usbip_client import Served

SOURCES = Path(__file__).parent / "firmware"
Build = Callable[..., Path]
Simulate = Callable[..., AvrSim]


def has_avr_libc() -> bool:
    """Whether the compiler finds the header that every AVR program begins with."""
    command = ["avr-gcc", "-mmcu=atmega328p", "-E", "-x", "c", "-"]
    include = b"#include <avr/io.h>\n"
    return not subprocess.run(command, input=include, capture_output=True, check=False).returncode


@pytest.fixture(scope="session")
def firmware(
    tmp_path_factory: pytest.TempPathFactory,
    need: Callable[[str], None],
    missing: Callable[[str], NoReturn],
) -> Build:
    """firmware("echo", BAUD=115200) compiles echo.c, for the ATmega328P, and gives the ELF."""
    need("avr-gcc")
    try:
        build()
    except ToolMissing as error:
        missing(str(error))
    folder = tmp_path_factory.mktemp("firmware")
    made: dict[str, Path] = {}

    def compile_(name: str, mcu: str = "atmega328p", **defines: int) -> Path:
        key = "-".join([name, mcu, *(f"{k}{v}" for k, v in sorted(defines.items()))])
        if key not in made:
            elf = folder / f"{key}.elf"
            options = [f"-D{k}={v}" for k, v in {"F_CPU": "16000000UL", **defines}.items()]
            command = ["avr-gcc", f"-mmcu={mcu}", "-std=gnu99", "-Os", "-Wall", "-Werror"]
            command += [*options, str(SOURCES / f"{name}.c"), "-o", str(elf)]
            result = subprocess.run(command, capture_output=True, text=True, check=False)
            if result.returncode and not has_avr_libc():
                missing("avr-libc is missing: install the package avr-libc")
            assert result.returncode == 0, result.stderr
            made[key] = elf
        return made[key]

    return compile_


@pytest.fixture
def simulate(firmware: Build) -> Iterator[Simulate]:
    """simulate("echo", BAUD=115200, host_baud=9600): capitals for avr-gcc, the rest for AvrSim."""
    sims: list[AvrSim] = []

    def start(name: str, **options: int) -> AvrSim:
        defines = {k: v for k, v in options.items() if k.isupper()}
        rest = {k: v for k, v in options.items() if not k.isupper()}
        sims.append(AvrSim(firmware(name, **defines), **rest))
        return sims[-1]

    yield start
    for sim in sims:
        sim.close()


@pytest.fixture
def usb_board(firmware: Build) -> Iterator[Simulate]:
    """usb_board(SERIAL=ord("B")) is an ATmega32U4 with firmware/usb_board.c, serial number SNB."""
    sims: list[AvrSim] = []

    def start(**defines: int) -> AvrSim:
        sims.append(AvrSim(firmware("usb_board", "atmega32u4", **defines), "atmega32u4"))
        return sims[-1]

    yield start
    for sim in sims:
        sim.close()


@pytest.fixture
def open_chip(firmware: Build) -> Iterator[Callable[[str], Chip]]:
    """open_chip("atmega32u4") is a chip whose registers the test reads and writes itself."""
    sims: list[AvrSim] = []

    def start(mcu: str) -> Chip:
        sims.append(AvrSim(firmware("poke", mcu), mcu))
        return Chip(sims[-1])

    yield start
    for sim in sims:
        sim.close()


@pytest.fixture
def served(usb_board: Simulate) -> Iterator[Served]:
    """A USB/IP server with one board, as fast as possible."""
    with Served(usb_board()) as served:
        yield served
