"""SET_CONFIGURATION and GET_CONFIGURATION, and what they do to endpoints (9.4.7, 9.4.2)."""

import pytest
from j2a_spec import constants as c

from firmware.tests.usb9.checks import Check, listing
from firmware.tests.usb9.device import (
    ENDPOINT,
    GET_CONFIGURATION,
    HALF,
    OUT,
    SET_CONFIGURATION,
    Device,
)

CHECKS: list[Check] = []
check = listing(CHECKS)

BULK = ((c.USB_IN, "IN"), (c.USB_OUT, "OUT"))


def is_configured(device: Device) -> None:
    assert device.get(GET_CONFIGURATION, length=1) == b"\1"
    device.works()


def is_not_configured(device: Device) -> None:
    assert device.get(GET_CONFIGURATION, length=1) == b"\0"
    for endpoint, kind in (*BULK, (c.SYNCUSB_OUT, "OUT")):
        assert device.once(kind, endpoint, b"x" if kind == "OUT" else b"") is None


@check("9.4.2")
def zero_in_address(device: Device) -> None:
    """In the Address state GET_CONFIGURATION returns 0, and no other endpoint than 0 answers."""
    device.to_address()
    is_not_configured(device)


@check("9.4.7")
def one(device: Device) -> None:
    """SET_CONFIGURATION with the descriptor's value configures, and GET_CONFIGURATION tells it."""
    device.to_address()
    device.configure()
    is_configured(device)


@check("9.4.7")
def zero(device: Device) -> None:
    """SET_CONFIGURATION 0 leads back to the Address state, from where 1 configures anew."""
    device.to_configured()
    for _ in range(2):
        device.configure(0)
        is_not_configured(device)
        device.configure(0)
        is_not_configured(device)
        device.configure(1)
        is_configured(device)


@check("9.4.7")
def unknown_in_address(device: Device) -> None:
    """A value that no configuration has is refused, and the device stays in the Address state."""
    device.to_address()
    for value in (2, 3, 128, 255):
        device.refuses(OUT, SET_CONFIGURATION, value)
        is_not_configured(device)


@check("9.4.7")
def unknown_in_configured(device: Device) -> None:
    """Refused in the Configured state, such a value leaves the configuration as it is."""
    device.to_configured()
    device.works()
    for value in (2, 128, 255):
        device.refuses(OUT, SET_CONFIGURATION, value)
        is_configured(device)


@check("9.1.1.5")
def again_resets_toggles(device: Device) -> None:
    """SET_CONFIGURATION 1 in the Configured state lets both data toggles start with DATA0."""
    device.to_configured()
    for packets in (1, 2, 3):
        for _ in range(packets):
            device.works()
        device.configure()
        device.leave_unread()
        assert device.take(c.USB_IN)
        is_configured(device)


@check("9.4.5")
def again_ends_halts(device: Device) -> None:
    """SET_CONFIGURATION ends the halt of each endpoint, also when it is the same configuration."""
    device.to_configured()
    for endpoint in device.endpoints():
        device.halt(endpoint)
        device.configure()
        assert device.status(ENDPOINT, endpoint) == 0
        is_configured(device)


@check("9.4.7", pytest.mark.requirement("USB-011"))
def begins_the_link_anew(device: Device) -> None:
    """What waited in an endpoint before SET_CONFIGURATION is gone, and the half of a frame, too."""
    device.to_configured()
    for value in (1, 0):
        device.leave_unread()
        device.bus.write(c.USB_OUT, HALF)
        device.configure(value)
        device.configure()
        assert device.once("IN", c.USB_IN) == "NAK"
        device.pause(30)  # nor is the half frame answered after the byte timeout
        assert device.once("IN", c.USB_IN) == "NAK"
        device.works()
        device.bus.write(c.USB_OUT, HALF)
        device.configure(value)
        device.configure()
        device.works()


@check("9.1.1.5")
def kept_by_other_requests(device: Device) -> None:
    """Requests that only ask, and refused ones, leave configuration, toggles and data alone."""
    device.to_configured()
    device.works()
    waiting = device.leave_unread()
    device.status()
    device.descriptor(2)
    device.refuses(OUT, SET_CONFIGURATION, 7)
    device.refuses(0x40, 1)
    assert device.listen(1) == [waiting]
    is_configured(device)
