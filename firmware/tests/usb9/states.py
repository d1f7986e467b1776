"""The states of a device, and the ways from each to the others by power and reset (9.1)."""

import pytest
from j2a_spec import constants as c
from j2a_spec import usb

from firmware.tests.usb9.checks import Check, listing
from firmware.tests.usb9.device import (
    ADDRESS,
    GET_CONFIGURATION,
    GET_DESCRIPTOR,
    HALF,
    IN,
    Device,
    setup,
)

CHECKS: list[Check] = []
check = listing(CHECKS)

READ = setup(IN, GET_DESCRIPTOR, usb.DEVICE << 8, 0, 64)


def is_in_default_state(device: Device) -> None:
    """It answers at address 0 only, and is not configured."""
    device.bus.address = 0
    assert device.once("SETUP", 0, READ) == "ACK"
    device.learn()
    device.alive()
    for address in (ADDRESS, 1):
        device.bus.address = address
        assert device.once("SETUP", 0, READ) is None
    device.bus.address = 0
    for endpoint, kind in ((c.USB_IN, "IN"), (c.USB_OUT, "OUT"), (c.SYNCUSB_OUT, "OUT")):
        assert device.once(kind, endpoint) is None


@check("7.1.5.1")
def pull_up_needs_power(device: Device) -> None:
    """Without VBUS the pull-up of D+ is off, and an unplugged device takes it away."""
    assert not device.bus.attached
    device.plug()
    device.bus.unplug()
    device.pause(10)
    assert not device.bus.attached


@check("7.1.7.3")
def attaches_in_100_ms(device: Device) -> None:
    """The device shows itself within 100 ms after VBUS has come."""
    device.bus.plug()
    device.pause(100)
    assert device.bus.attached


@check("9.1.1.3")
def silent_before_reset(device: Device) -> None:
    """A device that has power answers nothing before the first reset."""
    device.plug()
    for address in (0, 1):
        device.bus.address = address
        assert device.once("SETUP", 0, READ) is None
        assert device.once("IN", 0) is None


@check("9.1.1.3")
def default_after_reset(device: Device) -> None:
    """After the reset the device answers at address 0 and nowhere else."""
    device.plug()
    device.reset()
    is_in_default_state(device)


@check("7.1.7.5")
def ready_10_ms_after_reset(device: Device) -> None:
    """10 ms after the end of a reset, of 10 ms and of 50, the device takes a request."""
    device.plug()
    for ms in (10, 50):
        device.bus.reset(ms)
        device.pause(10)
        assert device.once("SETUP", 0, READ) == "ACK"
        assert device.take(0, 1)[:2] == bytes((18, usb.DEVICE))


@check("9.1.1.3")
def reset_in_default(device: Device) -> None:
    """A reset in the Default state leaves the device there; also several in a row."""
    device.to_default()
    for _ in range(3):
        device.bus.reset()
    device.pause(10)
    is_in_default_state(device)


@check("9.1.1.4")
def reset_in_address(device: Device) -> None:
    """A reset in the Address state takes the address away."""
    device.to_address()
    device.reset()
    is_in_default_state(device)


@check("9.1.1.5")
def reset_in_configured(device: Device) -> None:
    """A reset in the Configured state takes address, configuration and endpoints away."""
    device.to_configured()
    device.works()
    device.reset()
    is_in_default_state(device)
    device.set_address(ADDRESS)
    assert device.get(GET_CONFIGURATION, length=1) == b"\0"
    device.configure()
    device.works()


@check("7.1.7.5")
def reset_in_a_control_transfer(device: Device) -> None:
    """A reset between the stages of a control transfer ends it."""
    for packets in range(3):
        device.to_default()
        device.once("SETUP", 0, setup(IN, GET_DESCRIPTOR, usb.CONFIGURATION << 8, 0, 255))
        for toggle in (1, 0)[:packets]:
            device.transact("IN", 0, toggle=toggle)
        device.reset()
        is_in_default_state(device)


@check("7.1.7.5", pytest.mark.requirement("USB-011"))
def reset_in_bulk_transfers(device: Device) -> None:
    """A reset drops what waits in both directions, and the halves of frames."""
    device.to_configured()
    device.leave_unread()
    device.bus.write(c.USB_OUT, HALF)
    device.pause(1)
    device.to_configured()
    assert device.once("IN", c.USB_IN) == "NAK"
    device.works()


@check("9.1.1.1")
def replugged(device: Device) -> None:
    """Plugged in again the device starts as one that was never there."""
    for prepare in (device.plug, device.to_default, device.to_address, device.to_configured):
        prepare()
        device.bus.unplug()
        device.pause(50)
        device.plug()
        device.reset()
        is_in_default_state(device)
        device.to_configured()
        device.works()
        device.bus.unplug()
        device.pause(50)


@check("9.1.1.1")
def unplugged_in_a_control_transfer(device: Device) -> None:
    """The device comes back after it was unplugged between the stages of a control transfer."""
    device.to_default()
    device.once("SETUP", 0, READ)
    device.bus.unplug()
    device.pause(20)
    device.to_configured()
    device.works()
