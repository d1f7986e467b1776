"""The checks of chapter 9 of the USB 2.0 specification, on the simulated chips.

In: the demo of the port avr-usb. Out: each check of the list (usb9/) on each chip. Each has a chip
of its own, whose first instruction is the first thing that happens. The chips differ in their
clocks and in the memory of their endpoints; of the checks that concern neither one in four is made
on the second chip, and the others in the exhaustive run.
"""

import pytest

from firmware.tests.usb9 import CHECKS, NAME, Device, rows

pytestmark = pytest.mark.avr

CHIPS = ("atmega32u4", "atmega32u2")
OF_THE_CHIP = ("bus.", "stream.", "transfers.")


def on_each_chip():
    """Chip and check; see above for what is left to the exhaustive run."""
    for check in CHECKS:
        yield pytest.param(CHIPS[0], check, id=f"{CHIPS[0]}-{check.name}", marks=check.marks)
    others = 0
    for check in CHECKS:
        marks = [*check.marks]
        if not check.name.startswith(OF_THE_CHIP):
            marks += [pytest.mark.exhaustive] if others % 4 else []
            others += 1
        yield pytest.param(CHIPS[1], check, id=f"{CHIPS[1]}-{check.name}", marks=marks)


@pytest.fixture(scope="module", params=CHIPS)
def chip(request, build):
    return build(port="avr-usb", MCU=request.param, USB_NAME=NAME), request.param


@pytest.mark.requirement("USB-006")
@pytest.mark.parametrize(("chip", "check"), [*on_each_chip()], indirect=["chip"])
def test_chapter_9(chip, check):
    with Device(*chip) as device:
        check.run(device)


@pytest.mark.sampled(2)  # each check on one of the chips, in turn
@pytest.mark.parametrize(
    ("mcu", "check"),
    [
        pytest.param(mcu, check, id=f"{mcu}-{check.name}")
        for at, check in enumerate(check for check in CHECKS if check.name[:4] == "bus.")
        for mcu in (CHIPS if at % 2 else CHIPS[::-1])
    ],
)
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


@pytest.mark.sampled(5)
@pytest.mark.parametrize(
    "check", [pytest.param(check, id=check.name) for check in CHECKS if check.name[:4] == "bus."]
)
@pytest.mark.parametrize("sleep", [0, 1])
@pytest.mark.parametrize("mcu", CHIPS)
def test_flags_of_suspend_that_the_firmware_clears(build, mcu, sleep, check):
    """Whether SUSPI and WAKEUPI clear each other, the firmware bears both."""
    options = {"OPTIONS": "-DJ2A_USB_SLEEP=1"} if sleep else {}  # by itself it does not
    elf = build(port="avr-usb", MCU=mcu, USB_NAME=NAME, **options)
    with Device(elf, mcu) as device:
        device.bus.suspend_flags = "independent"
        check.run(device)


def test_the_list():
    names = [name for name, _section, _sentence in rows()]
    assert len(names) == len(set(names)) >= 30
    for name, section, sentence in rows():
        assert section[0] in "5789", name
        assert sentence.endswith("."), name
