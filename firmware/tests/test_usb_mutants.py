"""The checks of chapter 9 can fail: firmware with one thing wrong each, and the check that notices.

In: the port avr-usb, edited in a copy. Out: for each mutant the check that is named here fails on
it. That the same checks pass on the port as it is, test_usb_chapter9.py shows.
"""

import shutil
import sys
from dataclasses import dataclass
from pathlib import Path

import construct
import pytest

from j2a.sim import SimError

sys.path.insert(0, str(Path(__file__).parent))
try:
    from usb9 import CHECKS, NAME, Device
finally:
    sys.path.remove(str(Path(__file__).parent))

pytestmark = pytest.mark.avr

FIRMWARE = Path(__file__).parents[1]
MCU = "atmega32u4"
BY_NAME = {check.name: check for check in CHECKS}


@dataclass(frozen=True)
class Mutant:
    """One edit: what stands once in a file becomes something else, and which check sees it."""

    what: str
    check: str
    file: str
    find: str
    replace: str


CONTROL, REQUESTS = "usb_control.c", "usb_requests.c"
CONTROLLER, DESCRIPTORS, PORT = "usb_device.c", "usb_descriptors.c", "port.c"
MUTANTS = [
    Mutant(
        "no empty packet at the end of a data stage",
        "descriptors.empty-packet-at-the-end",
        CONTROL,
        "(sent == size && !ends_short)",
        "sent == size",
    ),
    Mutant(
        "wLength does not matter",
        "descriptors.length-1-to-65535",
        CONTROL,
        "size = setup.length;",
        "",
    ),
    Mutant(
        "a request error is not shown",
        "refusals.until-the-next-setup",
        CONTROL,
        "UECONX = _BV(EPEN) | _BV(STALLRQ);",
        "UECONX = _BV(EPEN);",
    ),
    Mutant(
        "the new address holds at once",
        "addresses.after-the-status-stage",
        REQUESTS,
        "usb_new_address = value | _BV(ADDEN);",
        "UDADDR = value;\n        UDADDR = value | _BV(ADDEN);",
    ),
    Mutant(
        "an address that was given up holds later",
        "addresses.given-up",
        CONTROL,
        "    usb_new_address = 0;\n    sent = 0;",
        "    sent = 0;",
    ),
    Mutant(
        "a SETUP in the data stage goes on where the old transfer was",
        "transfers.setup-in-the-data-stage",
        CONTROL,
        "    sent = 0;\n",
        "",
    ),
    Mutant(
        "the data toggle stays when a halt is cleared",
        "features.clear-resets-the-toggle",
        REQUESTS,
        "_BV(EPEN) | _BV(STALLRQC) | _BV(RSTDT)",
        "_BV(EPEN) | _BV(STALLRQC)",
    ),
    Mutant(
        "a halt does not show in the status",
        "features.halt",
        REQUESTS,
        "if (UENUM != 0 && (UECONX & _BV(STALLRQ)))",
        "if (UENUM == 0)",
    ),
    Mutant(
        "the direction of an endpoint's address does not matter",
        "features.status-of-missing-endpoints",
        REQUESTS,
        "!= address)",
        "% 16 != number)",
    ),
    Mutant(
        "interfaces have a status before they are configured",
        "features.status-in-address",
        REQUESTS,
        "!is_configured() || index >= USB_INTERFACES",
        "index >= USB_INTERFACES",
    ),
    Mutant(
        "there is one interface too many",
        "interfaces.get-of-missing",
        REQUESTS,
        "index >= USB_INTERFACES",
        "index > USB_INTERFACES",
    ),
    Mutant(
        "interfaces have a second setting",
        "interfaces.set-of-missing",
        REQUESTS,
        "        if (value != 0)\n            return USB_STALL;\n        set_interface(index);",
        "        set_interface(index);",
    ),
    Mutant(
        "any configuration can be chosen",
        "configurations.unknown-in-address",
        REQUESTS,
        "value > 1 || ",
        "",
    ),
    Mutant(
        "the same configuration again does nothing",
        "configurations.again-resets-toggles",
        REQUESTS,
        "usb_configure(value);",
        "if (value != is_configured())\n            usb_configure(value);",
    ),
    Mutant(
        "the half of a frame outlasts SET_CONFIGURATION",
        "configurations.begins-the-link-anew",
        PORT,
        "    if (lost)\n        j2a_rx_lost();",
        "    (void)lost;",
    ),
    Mutant(
        "requests of vendors are taken for standard ones",
        "refusals.class-and-vendor-requests",
        REQUESTS,
        "(setup->type & 0x7C)",
        "(setup->type & 0x1C)",
    ),
    Mutant(
        "a reset leaves the configuration",
        "states.reset-in-configured",
        CONTROLLER,
        "        usb_configure(false);\n        usb_control_reset();",
        "        usb_control_reset();",
    ),
    Mutant(
        "nothing is sent after a suspend",
        "bus.suspended-when-configured",
        CONTROLLER,
        "    usb_trouble &= (uint8_t)~USB_SUSPENDED;\n",
        "",
    ),
    Mutant(
        "who waits for the host waits for ever",
        "application.reset-while-it-waits",
        PORT,
        "usb_trouble != 0 || usb_trouble_is_due()",
        "false",
    ),
    Mutant(
        "a burst that fills its last packet has no end",
        "stream.transfers-end",
        PORT,
        "(UEBCLX != 0 || empty_packet_due)",
        "UEBCLX != 0",
    ),
    Mutant(
        "what finds no room in a packet is dropped",
        "stream.host-does-not-read",
        PORT,
        "if (usb_trouble != 0 || usb_trouble_is_due()) {\n                usb_trouble |= DROPPING;",
        "{",
    ),
    Mutant(
        "a packet is given back after its first byte",
        "stream.packets-of-any-size",
        PORT,
        "(flags & _BV(RXOUTI)) && UEBCLX == 0",
        "flags & _BV(RXOUTI)",
    ),
    Mutant(
        "wTotalLength is one too many",
        "contents.configuration-descriptor",
        DESCRIPTORS,
        "BYTES(CONFIGURATION_SIZE)",
        "BYTES(CONFIGURATION_SIZE + 1)",
    ),
    Mutant(
        "bMaxPacketSize0 is not the packet size",
        "descriptors.packets-are-full",
        DESCRIPTORS,
        "0, 0, 0, USB_PACKET0,",
        "0, 0, 0, 64,",
    ),
    Mutant(
        "an interrupt endpoint instead of a bulk one",
        "contents.interface-of-a-board",
        DESCRIPTORS,
        "J2A_USB_IN, BULK,",
        "J2A_USB_IN, INTERRUPT,",
    ),
    Mutant(
        "no serial number",
        "contents.serial-number",
        DESCRIPTORS,
        "PRODUCT, SERIAL_NUMBER, 1}",
        "PRODUCT, 0, 1}",
    ),
    Mutant(
        "a device qualifier at full speed",
        "descriptors.no-device-qualifier",
        DESCRIPTORS,
        "if (type == DEVICE) {",
        "if (type != CONFIGURATION) {",
    ),
    Mutant(
        "bit 7 of bmAttributes is not set",
        "contents.configuration-descriptor",
        DESCRIPTORS,
        "BUS_POWERED = 0x80",
        "BUS_POWERED = 0x00",
    ),
]


@pytest.fixture(scope="module")
def workshop(tmp_path_factory):
    """A copy of the port."""
    folder = tmp_path_factory.mktemp("mutants") / "avr-usb"
    shutil.copytree(FIRMWARE / "ports/avr-usb", folder)
    return folder


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.what.replace(" ", "-"))
def test_is_noticed(workshop, make, avr, mutant):
    path = workshop / mutant.file
    whole = path.read_text()
    assert whole.count(mutant.find) == 1, mutant.find
    path.write_text(whole.replace(mutant.find, mutant.replace))
    try:
        out = workshop.parent / "out"
        built = make(PORT_DIR=workshop, APP="demo", MCU=MCU, USB_NAME=NAME, OUT=out)
    finally:
        path.write_text(whole)
    assert built.returncode == 0, built.stderr
    with (
        Device(out / "demo.elf", MCU) as device,
        pytest.raises((AssertionError, SimError, construct.ConstructError)),
    ):
        BY_NAME[mutant.check].run(device)
