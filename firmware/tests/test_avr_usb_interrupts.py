"""How long the interrupts of the port avr-usb take, which the application must expect at any time.

In: the port on the simulated chips, and a host that asks for all there is. Out: the longest time in
each of the two handlers, against what firmware/README.md says of them.
"""

import re
from pathlib import Path

import pytest

from firmware.tests.usb9 import CHECKS, Device

pytestmark = pytest.mark.avr

README = Path(__file__).parents[1] / "README.md"
VECTORS = {
    "atmega32u4": (10, 11),
    "atmega32u2": (11, 12),
}  # USB_GEN and USB_COM, as avr-libc counts
BY_NAME = {check.name: check for check in CHECKS}
ASKED = (
    "descriptors.length-1-to-65535",
    "contents.serial-number",
    "configurations.again-resets-toggles",
    "features.halt",
    "interfaces.set-of-missing",
    "refusals.class-and-vendor-requests",
    "transfers.setup-repeated",
    "bus.suspended-when-configured",
    "bus.unplugged-while-suspended",
    "application.reset-while-it-waits",
)


@pytest.fixture(scope="module")
def longest(build):
    """Cycles, by chip and vector."""
    found = dict.fromkeys((mcu, vector) for mcu in VECTORS for vector in VECTORS[mcu])
    for mcu, vectors in VECTORS.items():
        elf = build(port="avr-usb", core_as_one=False, MCU=mcu)
        for name in ASKED:
            with Device(elf, mcu) as device:
                BY_NAME[name].run(device)
                for vector in vectors:
                    seen = device.sim.interrupts(vector)
                    assert seen.count > 0, (mcu, vector)
                    found[mcu, vector] = max(found[mcu, vector] or 0, seen.longest_cycles)
    return found


def test_they_are_as_short_as_the_readme_says(longest):
    (said,) = re.findall(r"take up to\s(\d+)\scycles", README.read_text("utf-8"))
    assert 0.95 * int(said) < max(longest.values()) <= int(said), longest
