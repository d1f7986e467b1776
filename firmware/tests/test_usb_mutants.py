"""The checks of chapter 9 can fail: firmware with one thing wrong each, and the check that notices.

In: the port avr-usb, edited in a copy. Out: each mutant can be configured like the port itself, and
the check that is named here fails on it. Where the mistake is one of the start or the address, so
that it cannot be configured, the mutant says so. That the same checks pass on the port as it is,
test_usb_chapter9.py shows.
"""

import shutil
from dataclasses import dataclass
from pathlib import Path

import construct
import pytest
from j2a_sim import SimError

from firmware.tests.usb9 import CHECKS, NAME, Device

pytestmark = pytest.mark.avr

FIRMWARE = Path(__file__).parents[1]
U4, U2 = "atmega32u4", "atmega32u2"
BY_NAME = {check.name: check for check in CHECKS}


@dataclass(frozen=True)
class Mutant:
    """One edit: what stands once in a file becomes something else, and which check sees it."""

    what: str
    check: str
    file: str
    find: str
    replace: str
    chips: tuple[str, ...] = (U4,)
    can_be_configured: bool = True


CONTROL, REQUESTS = "usb_control.c", "usb_requests.c"
CONTROLLER, DESCRIPTORS, ENDPOINTS = "usb_device.c", "usb_descriptors.c", "usb_endpoints.c"
PORT = "port.c"
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
        can_be_configured=False,
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
        can_be_configured=False,
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
        can_be_configured=False,
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
        chips=(U4, U2),
    ),
    Mutant(
        "nothing is sent after a suspend",
        "bus.suspended-when-configured",
        CONTROLLER,
        "    usb_trouble &= (uint8_t)~USB_SUSPENDED;\n",
        "",
        chips=(U4, U2),
    ),
    Mutant(
        "who waits for the host waits for ever",
        "application.reset-while-it-waits",
        PORT,
        "usb_trouble & (uint8_t)~USB_SUSPENDED",
        "false",
    ),
    Mutant(
        "a burst that fills its last packet has no end",
        "stream.transfers-end",
        PORT,
        "UEINTX = USB_SEND;\n            return true;",
        "UEINTX = USB_SEND, packet_due = false;\n            return true;",
    ),
    Mutant(
        "what finds no room in a packet is dropped",
        "stream.host-does-not-read",
        PORT,
        "if (usb_trouble & (uint8_t)~USB_SUSPENDED) {\n                usb_trouble |= DROPPING;",
        "{",
    ),
    Mutant(
        "a packet is given back after its first byte",
        "stream.packets-of-any-size",
        PORT,
        "(flags & _BV(RXOUTI)) && UEBCLX == 0",
        "flags & _BV(RXOUTI)",
        chips=(U4, U2),
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
    Mutant(
        "who waits drops its reply when the bus is suspended",
        "bus.suspended-in-the-midst-of-a-frame",
        PORT,
        "usb_trouble & (uint8_t)~USB_SUSPENDED",
        "usb_trouble",
        chips=(U4, U2),
    ),
    Mutant(
        "replies are dropped while the bus is suspended",
        "bus.replies-made-in-a-suspend",
        PORT,
        "usb_trouble & (uint8_t)~USB_SUSPENDED",
        "usb_trouble",
    ),
    Mutant(
        "nothing wakes a suspended controller",
        "bus.suspended-when-configured",
        CONTROLLER,
        "_BV(EORSTE) | _BV(WAKEUPE)",
        "_BV(EORSTE)",
        can_be_configured=False,
    ),
    Mutant(
        "endpoint 0 is not set up after a reset",
        "states.default-after-reset",
        CONTROLLER,
        "        usb_control_reset();\n",
        "",
        chips=(U4, U2),
        can_be_configured=False,
    ),
    Mutant(
        "resets are not noticed",
        "states.default-after-reset",
        CONTROLLER,
        "UDIEN = _BV(EORSTE) | _BV(SUSPE) | _BV(EORSME);",
        "UDIEN = _BV(SUSPE);",
        can_be_configured=False,
    ),
    Mutant(
        "the controller never joins the bus",
        "states.attaches-in-100-ms",
        CONTROLLER,
        "    UDCON = 0;\n",
        "",
        chips=(U4, U2),
        can_be_configured=False,
    ),
    Mutant(
        "nobody looks at the cable",
        "states.attaches-in-100-ms",
        CONTROLLER,
        "_BV(OTGPADE) | _BV(VBUSTE)",
        "_BV(OTGPADE)",
        can_be_configured=False,
    ),
    Mutant(
        "the regulator of the pads is off",
        "states.attaches-in-100-ms",
        CONTROLLER,
        "UHWCON = _BV(UVREGE);",
        "UHWCON = 0;",
        can_be_configured=False,
    ),
    Mutant(
        "the PLL makes 96 MHz",
        "states.default-after-reset",
        CONTROLLER,
        "PLLFRQ = _BV(PDIV2);",
        "PLLFRQ = _BV(PDIV3) | _BV(PDIV1);",
        can_be_configured=False,
    ),
    Mutant(
        "the clock of the controller stands",
        "states.default-after-reset",
        CONTROLLER,
        "    USBCON = USB_ON;\n",
        "",
        can_be_configured=False,
    ),
    Mutant(
        "the endpoints are held in reset",
        "stream.packets-of-any-size",
        ENDPOINTS,
        "    UERST = 0;\n",
        "",
        chips=(U4, U2),
    ),
    Mutant(
        "the endpoints are never enabled",
        "transfers.status-after-the-work",
        ENDPOINTS,
        "UECONX = _BV(EPEN) | _BV(STALLRQC) | _BV(RSTDT);",
        "UECONX = 0;",
    ),
    Mutant(
        "the endpoints outlast configuration 0",
        "configurations.zero",
        ENDPOINTS,
        "        UECONX = 0;\n        UECFG1X = 0;\n",
        "",
    ),
]


MISTAKES = (AssertionError, SimError, construct.ConstructError)


@pytest.fixture(scope="module")
def workshop(tmp_path_factory):
    """A copy of the port."""
    folder = tmp_path_factory.mktemp("mutants") / "avr-usb"
    shutil.copytree(FIRMWARE / "ports/avr-usb", folder)
    return folder


@pytest.mark.sampled(5)
@pytest.mark.parametrize(
    ("mutant", "mcu"),
    [
        pytest.param(mutant, mcu, id=f"{mutant.what.replace(' ', '-')}-{mcu}")
        for mutant in MUTANTS
        for mcu in mutant.chips
    ],
)
def test_is_noticed(workshop, make, avr, mutant, mcu):
    path = workshop / mutant.file
    whole = path.read_text()
    assert whole.count(mutant.find) == 1, mutant.find
    path.write_text(whole.replace(mutant.find, mutant.replace))
    try:
        out = workshop.parent / "out" / mcu
        variables = {"PORT_DIR": workshop, "APP": "demo", "MCU": mcu, "USB_NAME": NAME}
        built = make(core_as_one=True, OUT=out, **variables)
    finally:
        path.write_text(whole)
    assert built.returncode == 0, built.stderr
    elf = out / "demo.elf"
    with Device(elf, mcu) as device:
        device.is_torn = True  # the mistake may be of that kind
        if mutant.can_be_configured:
            device.to_configured()
        else:
            with pytest.raises(MISTAKES):
                device.to_configured()
    with pytest.raises(MISTAKES), Device(elf, mcu) as device:
        BY_NAME[mutant.check].run(device)
