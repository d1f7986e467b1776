"""SET_ADDRESS, and who answers at which address (9.4.6)."""

from j2a_spec import usb

from firmware.tests.usb9.checks import Check, listing
from firmware.tests.usb9.device import (
    GET_DESCRIPTOR,
    IN,
    OUT,
    SET_ADDRESS,
    Device,
    setup,
)

CHECKS: list[Check] = []
check = listing(CHECKS)

READ = setup(IN, GET_DESCRIPTOR, usb.DEVICE << 8, 0, 18)


def lives_at(device: Device, address: int) -> bool:
    """Whether the device answers a SETUP at an address."""
    device.bus.address = address
    return device.once("SETUP", 0, READ) == "ACK"


@check("9.4.6")
def after_the_status_stage(device: Device) -> None:
    """The status stage of SET_ADDRESS is at the old address; after it the new one holds."""
    device.to_default()
    for old, new in ((0, 5), (5, 77)):
        device.bus.address = old
        assert device.once("SETUP", 0, setup(OUT, SET_ADDRESS, new)) == "ACK"
        device.pause(5)
        device.bus.address = new
        assert device.once("IN", 0, toggle=1) is None
        device.bus.address = old
        assert device.take(0, 1) == b""
        device.pause(2)
        assert lives_at(device, new)
        device.alive()
        assert not lives_at(device, old)


@check("9.2.6.3")
def new_one_after_2_ms(device: Device) -> None:
    """2 ms after the status stage the device answers at its new address."""
    for address in (1, 2, 63, 64, 126, 127):
        device.to_default()
        device.put(SET_ADDRESS, address)
        device.pause(2)
        assert lives_at(device, address)
        device.alive()


@check("9.2.6.3")
def done_in_50_ms(device: Device) -> None:
    """The status stage of SET_ADDRESS comes within 50 ms."""
    device.to_default()
    assert device.once("SETUP", 0, setup(OUT, SET_ADDRESS, 3)) == "ACK"
    start = device.sim.cycle
    assert device.take(0, 1) == b""
    assert device.sim.cycle - start < device.sim.cycles(0.050)


@check("8.5.3.3")
def after_a_lost_acknowledgement(device: Device) -> None:
    """The address holds only when the device knows that the host has its status."""
    device.to_default()
    for old, new in ((0, 5), (5, 6)):
        assert device.once("SETUP", 0, setup(OUT, SET_ADDRESS, new)) == "ACK"
        assert device.lose(0) == b""
        device.pause(5)
        device.bus.address = new
        assert device.once("IN", 0, toggle=1) is None
        device.bus.address = old
        assert device.take(0, 1) == b""
        device.pause(2)
        assert lives_at(device, new)
        device.alive()


@check("9.4.6")
def given_up(device: Device) -> None:
    """A SET_ADDRESS whose status stage never comes leaves the address as it was."""
    device.to_default()
    assert device.once("SETUP", 0, setup(OUT, SET_ADDRESS, 5)) == "ACK"
    device.pause(1)
    device.alive()
    device.pause(2)
    assert not lives_at(device, 5)
    assert lives_at(device, 0)
    device.set_address(6)
    device.alive()


@check("9.4.6")
def zero_in_default(device: Device) -> None:
    """SET_ADDRESS to 0 in the Default state is no error and changes nothing."""
    device.to_default()
    device.set_address(0)
    device.alive()
    device.set_address(4)
    device.alive()


@check("9.4.6")
def zero_in_address(device: Device) -> None:
    """SET_ADDRESS to 0 in the Address state leads back to the Default state."""
    device.to_address(33)
    device.set_address(0)
    device.alive()
    assert not lives_at(device, 33)
    device.bus.address = 0
    device.set_address(34)
    device.alive()


@check("9.4.6")
def another_in_address(device: Device) -> None:
    """A second SET_ADDRESS in the Address state replaces the first."""
    device.to_address(10)
    for old, new in ((10, 11), (11, 127), (127, 1)):
        device.bus.address = old
        device.set_address(new)
        device.alive()
        assert not lives_at(device, old)


@check("8.3.2.1")
def others_are_not_heard(device: Device) -> None:
    """Tokens for other addresses are not answered, whatever they are, and do no harm."""
    device.to_configured()
    device.leave_unread()
    for address in (0, 1, 8, 10, 41, 127):
        device.bus.address = address
        assert device.once("SETUP", 0, setup(OUT, SET_ADDRESS, 50)) is None
        assert device.once("IN", 0, toggle=1) is None
        assert device.once("IN", 0x81) is None
        assert device.once("OUT", 0x02, b"for somebody else") is None
    device.bus.address = 9
    device.listen(1)
    device.works()
