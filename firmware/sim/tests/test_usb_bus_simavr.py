"""The same firmware on our model of the USB controller and on simavr's: an independent look."""

import subprocess
from pathlib import Path

import pytest
from j2a_sim import AvrSim
from j2a_sim._build import _pkg_config
from j2a_sim._elf import read_program

pytestmark = pytest.mark.avr

ECHO = bytes(3 * i & 0xFF for i in range(33))


@pytest.fixture
def driver(tmp_path, need):
    need("cc")
    made = tmp_path / "simavr_usb"
    source = Path(__file__).parent / "simavr_usb.c"
    flags, _ = _pkg_config()
    result = subprocess.run(
        ["cc", "-std=gnu11", str(source), *flags, "-o", str(made)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    return made


def test_both_models_see_the_same_device(firmware, driver, tmp_path):
    elf = firmware("usb_board", "atmega32u4")
    with AvrSim(elf, "atmega32u4") as sim:
        ours = sim.usb.enumerate()
        sim.usb.write(0x02, ECHO)
        echo = sim.usb.read(0x81)
        assert sim.usb.counters.fifo_errors == 0
    image = tmp_path / "flash"
    image.write_bytes(read_program(elf).flash)
    result = subprocess.run(
        [driver, "atmega32u4", image, str(len(ECHO)), str(len(ours.configuration))],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert result.returncode == 0, result.stderr
    theirs = [line for line in result.stdout.split("\n") if line]
    assert theirs == [ours.device.hex(), ours.configuration.hex(), ECHO.hex()]
    assert echo == ECHO
