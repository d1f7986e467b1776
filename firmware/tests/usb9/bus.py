"""Suspend and resume, and the frames of the bus (7.1.7.6, 7.1.7.7, 9.1.1.6)."""

import pytest
from j2a_spec import constants as c
from j2a_spec.oracle import Frame

from firmware.tests.usb9.application import BUSY_MS, begin, block
from firmware.tests.usb9.checks import Check, listing
from firmware.tests.usb9.device import GET_CONFIGURATION, GET_DESCRIPTOR, IN, OPCODE, Device, setup
from firmware.tests.usb9.states import is_in_default_state

CHECKS: list[Check] = []
check = listing(CHECKS)


def sleep(device: Device, ms: float = 50) -> None:
    """Suspend for some time, resume, and the 10 ms that a device has to recover (9.2.6.2)."""
    device.bus.suspend()
    device.pause(ms)
    device.bus.resume()
    device.pause(10)


@check("9.1.1.6")
def suspended_when_configured(device: Device) -> None:
    """Address and configuration outlast a suspend, of 3 ms as well as of a second."""
    device.to_configured()
    for ms in (3, 4, 10, 1000):
        sleep(device, ms)
        device.alive()
        assert device.get(GET_CONFIGURATION, length=1) == b"\1"
        device.works()


@check("9.1.1.6")
def suspended_in_address(device: Device) -> None:
    """A suspend in the Address state leaves the address as it is."""
    device.to_address()
    sleep(device)
    device.alive()
    device.configure()
    device.works()


@check("9.1.1.6")
def suspended_in_default(device: Device) -> None:
    """A suspend in the Default state leaves the device there."""
    device.to_default()
    sleep(device)
    device.alive()
    device.set_address(3)
    device.alive()


@check("7.1.7.6")
def data_outlast_suspend(device: Device) -> None:
    """What waited in both directions, and the toggles, are the same after a suspend."""
    device.to_configured()
    device.works()
    waiting = device.leave_unread()
    sleep(device, 100)
    assert device.listen(1) == [waiting]
    device.works()


@check("7.1.7.6", pytest.mark.requirement("USB-010"))
def replies_made_in_a_suspend(device: Device) -> None:
    """Functions that end while the bus is suspended: their replies come whole after the resume."""
    device.to_configured()
    for size in (0, 3, 40, 58):  # such a request fits into an endpoint's memory
        begin(device)
        device.send(Frame(c.SOF, 4, OPCODE[c.GET_ECHO], bytes(size)))
        device.pause(2)
        sleep(device, 2 * BUSY_MS)
        assert device.listen(2) == [Frame(c.SOF, 9, 0), Frame(c.SOF, 4, c.ECHO, bytes(size))]
        device.works()


@check("7.1.7.6", pytest.mark.requirement("USB-010"))
def suspended_in_the_midst_of_a_frame(device: Device) -> None:
    """A device that waits for the host to read waits through suspends, and loses no byte."""
    device.to_configured()
    waiting = device.leave_unread(bytes(range(255)))
    for ms in (3, 4, 500):
        sleep(device, ms)
    assert device.listen(1, 0.1) == []
    sleep(device, 20)
    assert device.listen(1) == [waiting]
    device.works()


@check("7.1.7.5", pytest.mark.requirement("USB-011"))
def reset_ends_suspend_while_it_waits(device: Device) -> None:
    """A reset in a suspend drops what the device waits with, and it goes on as new."""
    device.to_configured()
    block(device)
    device.bus.suspend()
    device.pause(20)
    device.to_configured()
    assert device.once("IN", c.USB_IN) == "NAK"
    device.works()


@check("7.1.7.6")
def suspended_in_a_control_transfer(device: Device) -> None:
    """A control transfer that a suspend cuts in two does not hinder the next one."""
    device.to_configured()
    device.once("SETUP", 0, setup(IN, GET_DESCRIPTOR, 0x0200, 0, 255))
    device.take(0, 1)
    sleep(device)
    device.alive()
    device.works()


@check("7.1.7.5")
def reset_ends_suspend(device: Device) -> None:
    """A reset while the bus is suspended leads to the Default state."""
    device.to_configured()
    device.bus.suspend()
    device.pause(20)
    device.reset()
    is_in_default_state(device)
    device.to_configured()
    device.works()


@check("9.1.1.6")
def unplugged_while_suspended(device: Device) -> None:
    """A device that is unplugged while it is suspended starts anew when it is plugged in."""
    for prepare in (lambda: None, lambda: block(device)):
        device.to_configured()
        prepare()
        device.bus.suspend()
        device.pause(20)
        device.bus.unplug()
        device.pause(20)
        assert not device.bus.attached
        device.to_configured()
        device.works()


@check("7.1.7.6")
def suspended_many_times(device: Device) -> None:
    """A device outlasts suspend and resume in turn, thirty times, with traffic between."""
    device.to_configured()
    for number in range(30):
        sleep(device, 3 + number % 5)
        device.works(bytes((number,)) * number)


@check("8.4.3")
def frames_do_not_disturb(device: Device) -> None:
    """Starts of frame, over more than one wrap of their number, change nothing."""
    device.to_configured()
    waiting = device.leave_unread()
    before = device.bus.frame
    device.pause(2500)
    assert device.bus.frame != before
    assert device.listen(1) == [waiting]
    device.works()


@check("7.1.12")
def clock_of_the_host(device: Device) -> None:
    """A host whose frames are 0.05 % too long or too short is followed."""
    device.to_configured()
    exact = device.bus.frame_cycles
    for factor in (0.9995, 1.0005):
        device.bus.frame_cycles = exact * factor
        device.pause(200)
        for number in range(20):
            device.works(bytes((number,)) * 100)
    assert device.once("IN", c.USB_IN) == "NAK"
