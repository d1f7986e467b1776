"""Control requests and bus events while the application is busy or waits for the host (9.2.6)."""

import pytest
from j2a_spec import constants as c
from j2a_spec import usb
from j2a_spec.oracle import Frame

from firmware.tests.usb9.checks import Check, listing
from firmware.tests.usb9.device import (
    GET_CONFIGURATION,
    IN,
    OPCODE,
    SET_ADDRESS,
    VENDOR,
    Device,
)

CHECKS: list[Check] = []
check = listing(CHECKS)

BUSY_MS = 400


def begin(device: Device) -> None:
    """Let a function of the device compute."""
    device.send(Frame(c.SOF, 9, OPCODE["delay"], BUSY_MS.to_bytes(2, "little")))
    device.pause(2)


def block(device: Device) -> None:
    """Let the device wait with replies that the host does not fetch."""
    for seq in range(8):
        device.send(Frame(c.SOF, seq, OPCODE[c.GET_ECHO], bytes(200)))
    device.pause(50)


def serves(device: Device) -> None:
    """All kinds of requests, each in the time that it has."""
    start = device.sim.cycle
    device.descriptor(usb.CONFIGURATION)
    device.string(usb.device.parse(device.descriptor(usb.DEVICE)).iSerialNumber)
    device.refuses(IN | VENDOR, 1, 0, 0, 4)
    device.halt(c.SYNCUSB_OUT)
    device.halt(c.SYNCUSB_OUT, on=False)
    assert device.get(GET_CONFIGURATION, length=1) == b"\1"
    assert device.sim.cycle - start < device.sim.cycles(0.050)


@check("9.2.6.4")
def requests_while_it_computes(device: Device) -> None:
    """Requests are served in their time while a function of the application computes."""
    device.to_configured()
    begin(device)
    for _ in range(3):
        serves(device)
    assert device.once("IN", c.USB_IN) == "NAK"
    assert device.listen(1) == [Frame(c.SOF, 9, 0)]
    device.works()


@check("9.2.6.4")
def requests_while_it_waits(device: Device) -> None:
    """Requests are served in their time while the device has replies that nobody fetches."""
    device.to_configured()
    block(device)
    for _ in range(3):
        serves(device)
    assert device.listen(8) == [Frame(c.SOF, seq, c.ECHO, bytes(200)) for seq in range(8)]
    device.works()


@check("9.2.6.3", pytest.mark.requirement("USB-011"))
def reset_while_it_computes(device: Device) -> None:
    """A device that computes can be reset and configured; the reply to the old host never comes."""
    device.to_configured()
    begin(device)
    device.reset()
    device.to_default()
    start = device.sim.cycle
    device.put(SET_ADDRESS, 3)
    assert device.sim.cycle - start < device.sim.cycles(0.050)
    device.pause(2)
    device.bus.address = 3
    device.configure()
    device.send(Frame(c.SOF, 1, OPCODE[c.GET_ECHO], b"of the new host"))
    assert device.listen(1, 2 * BUSY_MS) == [Frame(c.SOF, 1, c.ECHO, b"of the new host")]
    assert device.listen(1, 20) == []


@check("9.1.1.3", pytest.mark.requirement("USB-011"))
def reset_while_it_waits(device: Device) -> None:
    """A device that waits for a host that does not read goes on after a reset, as new."""
    device.to_configured()
    block(device)
    device.to_configured()
    assert device.once("IN", c.USB_IN) == "NAK"
    device.works()


@check("9.1.1.1")
def unplugged_while_it_waits(device: Device) -> None:
    """A device that waits for the host to read does not hang when it is unplugged."""
    device.to_configured()
    block(device)
    device.bus.unplug()
    device.pause(100)
    device.to_configured()
    device.works()


@check("9.1.1.1")
def unplugged_while_it_computes(device: Device) -> None:
    """A device that is unplugged and plugged in again while it computes comes back."""
    device.to_configured()
    begin(device)
    device.bus.unplug()
    device.pause(50)
    device.to_configured()
    device.pause(BUSY_MS)
    device.works()


@check("9.1.1.6")
def suspended_while_it_computes(device: Device) -> None:
    """A suspend during a computation does not lose the reply."""
    device.to_configured()
    begin(device)
    device.bus.suspend()
    device.pause(50)
    device.bus.resume()
    device.pause(10)
    assert device.listen(1) == [Frame(c.SOF, 9, 0)]
    device.works()


@check("9.4.7", pytest.mark.requirement("USB-011"))
def configured_again_while_it_computes(device: Device) -> None:
    """SET_CONFIGURATION while a function computes: its reply never comes, the next one does."""
    device.to_configured()
    begin(device)
    device.configure()
    device.send(Frame(c.SOF, 1, OPCODE[c.GET_ECHO], b"next"))
    assert device.listen(1, 2 * BUSY_MS) == [Frame(c.SOF, 1, c.ECHO, b"next")]
    assert device.listen(1, 20) == []


@check("9.1.1.5")
def sends_before_it_is_configured(device: Device) -> None:
    """SIFs that fall due while there is no host do not keep the device from being configured."""
    device.to_configured()
    assert device.call("sifPeriod", b"\1\0").opcode == 0
    device.to_default()
    device.pause(100)
    device.set_address(4)
    device.pause(100)
    device.configure()
    device.send(Frame(c.SOF, 8, OPCODE["sifPeriod"], b"\0\0"))
    assert Frame(c.SOF, 8, 0) in device.listen(10, 100)
