"""GET_INTERFACE and SET_INTERFACE, of interfaces with one setting each (9.4.4, 9.4.10)."""

from j2a_spec import constants as c

from firmware.tests.usb9.checks import Check, listing
from firmware.tests.usb9.device import (
    ENDPOINT,
    GET_INTERFACE,
    IN,
    INTERFACE,
    OUT,
    SET_INTERFACE,
    Device,
    setup,
)

CHECKS: list[Check] = []
check = listing(CHECKS)


@check("9.4.4")
def setting_is_0(device: Device) -> None:
    """GET_INTERFACE returns 0 for each interface."""
    device.to_configured()
    for number in range(len(device.interfaces())):
        assert device.get(GET_INTERFACE, 0, number, 1, INTERFACE) == b"\0"


@check("9.4.4")
def get_of_missing(device: Device) -> None:
    """GET_INTERFACE of an interface that does not exist is refused."""
    device.to_configured()
    count = len(device.interfaces())
    for number in (count, count + 1, 255):
        device.refuses(IN | INTERFACE, GET_INTERFACE, 0, number, 1)


@check("9.4.10")
def set_of_missing(device: Device) -> None:
    """SET_INTERFACE of an interface or a setting that does not exist is refused."""
    device.to_configured()
    count = len(device.interfaces())
    for number in (count, count + 1, 255):
        device.refuses(OUT | INTERFACE, SET_INTERFACE, 0, number)
    for number in range(count):
        for setting in (1, 2, 255):
            device.refuses(OUT | INTERFACE, SET_INTERFACE, setting, number)
        assert device.get(GET_INTERFACE, 0, number, 1, INTERFACE) == b"\0"
    device.works()


@check("9.4.10")
def set_0(device: Device) -> None:
    """SET_INTERFACE to the only setting is refused, or ends halts and lets toggles start anew."""
    device.to_configured()
    device.works()
    (number,) = [
        i.bInterfaceNumber for i in device.interfaces() if i.bInterfaceSubClass == c.USB_SUBCLASS
    ]
    device.halt(c.USB_IN)
    done = device.control(setup(OUT | INTERFACE, SET_INTERFACE, 0, number))
    assert done is not None
    if done.status == "ok":
        assert device.status(ENDPOINT, c.USB_IN) == 0
        device.bus.clear_toggle(None)
    else:
        assert done.status == "stall"
        device.alive()
        assert device.status(ENDPOINT, c.USB_IN) == 1
        device.halt(c.USB_IN, on=False)
    device.leave_unread()
    assert device.take(c.USB_IN)
    device.works()


@check("9.4.4")
def not_in_address(device: Device) -> None:
    """In the Address state GET_INTERFACE and SET_INTERFACE are refused."""
    device.to_address()
    for number in range(3):
        device.refuses(IN | INTERFACE, GET_INTERFACE, 0, number, 1)
        device.refuses(OUT | INTERFACE, SET_INTERFACE, 0, number)
