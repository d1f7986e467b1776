"""The checks of chapter 9 of the USB 2.0 specification, on the simulated chips.

In: the demo of the port avr-usb. Out: each check of the list (usb9/) on each chip. Each has a chip
of its own, whose first instruction is the first thing that happens.
"""

import pytest

from firmware.tests.usb9 import CHECKS, NAME, Device, rows

pytestmark = pytest.mark.avr

CHIPS = ("atmega32u4", "atmega32u2")


@pytest.fixture(scope="module", params=CHIPS)
def chip(request, build):
    return build(port="avr-usb", MCU=request.param, USB_NAME=NAME), request.param


@pytest.mark.requirement("USB-006")
@pytest.mark.parametrize(
    "check", [pytest.param(check, id=check.name, marks=check.marks) for check in CHECKS]
)
def test_chapter_9(chip, check):
    with Device(*chip) as device:
        check.run(device)


@pytest.mark.parametrize(
    "check", [pytest.param(check, id=check.name) for check in CHECKS if check.name[:4] == "bus."]
)
@pytest.mark.parametrize("mcu", CHIPS)
def test_suspend_asleep(build, mcu, check):
    """The same with firmware that sleeps while the bus is suspended, its clocks off."""
    elf = build(port="avr-usb", MCU=mcu, USB_NAME=NAME, OPTIONS="-DJ2A_USB_SLEEP=1")
    with Device(elf, mcu) as device:
        check.run(device)


@pytest.mark.sampled(4)  # of each chip, of each way to count, and of each check in turn
@pytest.mark.parametrize(
    "check",
    [
        pytest.param(check, id=check.name)
        for check in CHECKS
        if check.name.startswith(("transfers.", "stream.", "bus.s"))
    ],
)
@pytest.mark.parametrize("counting", ["banks", "setup as 0", "setup as 8"])
def test_however_the_chip_counts_bytes(chip, counting, check):
    """The data sheets leave open what UEBCLX counts of two banks, and of a SETUP."""
    with Device(*chip) as device:
        device.bus.counting = counting
        check.run(device)


@pytest.mark.sampled(3)
@pytest.mark.parametrize(
    "check", [pytest.param(check, id=check.name) for check in CHECKS if check.name[:4] == "bus."]
)
@pytest.mark.parametrize("sleep", [0, 1])
@pytest.mark.parametrize("mcu", CHIPS)
def test_flags_of_suspend_that_the_firmware_clears(build, mcu, sleep, check):
    """Whether SUSPI and WAKEUPI clear each other, the firmware bears both."""
    elf = build(port="avr-usb", MCU=mcu, USB_NAME=NAME, OPTIONS=f"-DJ2A_USB_SLEEP={sleep}")
    with Device(elf, mcu) as device:
        device.bus.suspend_flags = "independent"
        check.run(device)


def test_the_list():
    names = [name for name, _section, _sentence in rows()]
    assert len(names) == len(set(names)) >= 30
    for name, section, sentence in rows():
        assert section[0] in "5789", name
        assert sentence.endswith("."), name
