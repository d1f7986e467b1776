"""The checks of chapter 9: what the USB 2.0 specification asks of a device, as one list.

In: a program of the port avr-usb with the demo, on a simulated chip. Out: CHECKS, each with a name,
a section of the specification and a sentence, and rows(), the same as a table. Rules: each check
has a chip of its own, without power on the bus; what the specification leaves open is not asked
for; expected descriptors come from j2a_spec, never from the firmware.
"""

from firmware.tests.usb9 import (
    addresses,
    application,
    bus,
    configurations,
    contents,
    descriptors,
    features,
    interfaces,
    refusals,
    states,
    stream,
    transfers,
)
from firmware.tests.usb9.checks import Check
from firmware.tests.usb9.device import Device

__all__ = ["CHECKS", "NAME", "Check", "Device", "rows"]

NAME = "chapter9-of-usb"
"""USB_NAME of the program: its descriptor is 32 bytes long, a whole packet of endpoint 0."""

CHECKS: tuple[Check, ...] = tuple(
    check
    for module in (
        states,
        addresses,
        configurations,
        descriptors,
        contents,
        features,
        interfaces,
        refusals,
        transfers,
        stream,
        bus,
        application,
    )
    for check in module.CHECKS
)


def rows() -> list[tuple[str, str, str]]:
    """The list for the documentation: name, section of the USB 2.0 specification, sentence."""
    return [(check.name, check.section, check.sentence) for check in CHECKS]
