"""GET_STATUS, SET_FEATURE and CLEAR_FEATURE, and what a halt is (9.4.1, 9.4.5, 9.4.9)."""

from j2a_spec import constants as c
from j2a_spec import usb
from j2a_spec.oracle import Frame, encode

from firmware.tests.usb9.checks import Check, listing
from firmware.tests.usb9.device import (
    CLEAR_FEATURE,
    DEVICE,
    ENDPOINT,
    GET_STATUS,
    HALT,
    IN,
    INTERFACE,
    OPCODE,
    OUT,
    REMOTE_WAKEUP,
    SET_FEATURE,
    TEST_MODE,
    Device,
)

CHECKS: list[Check] = []
check = listing(CHECKS)


def missing_endpoints(device: Device) -> list[int]:
    """Addresses of endpoints that the device has not: other numbers, and other directions."""
    found = device.endpoints()
    every = [number | way for number in (*range(1, 8), 15) for way in (0, IN)]
    return [address for address in every if address not in found]


def kind(endpoint: int) -> str:
    return "IN" if endpoint & IN else "OUT"


@check("9.4.5")
def status_of_the_device(device: Device) -> None:
    """GET_STATUS tells the source of power as bmAttributes does, and that it wakes no host."""
    device.to_address()
    attributes = usb.configuration.parse(device.descriptor(usb.CONFIGURATION)).head.bmAttributes
    expected = attributes >> 6 & 1
    assert device.status() == expected
    device.configure()
    assert device.status() == expected


@check("9.4.5")
def status_of_interfaces(device: Device) -> None:
    """Each interface has the status 0, and one that does not exist is refused."""
    device.to_configured()
    count = len(device.interfaces())
    assert [device.status(INTERFACE, number) for number in range(count)] == [0] * count
    for number in (count, count + 1, 127, 255):
        device.refuses(IN | INTERFACE, GET_STATUS, 0, number, 2)


@check("9.4.5")
def status_of_endpoints(device: Device) -> None:
    """Each endpoint that is not halted has the status 0, endpoint 0 as well."""
    device.to_configured()
    for endpoint in (0, IN, *device.endpoints()):
        assert device.status(ENDPOINT, endpoint) == 0


@check("9.4.5")
def status_of_missing_endpoints(device: Device) -> None:
    """GET_STATUS of an endpoint that does not exist is refused, also in the other direction."""
    device.to_configured()
    for endpoint in missing_endpoints(device):
        device.refuses(IN | ENDPOINT, GET_STATUS, 0, endpoint, 2)


@check("9.4.5")
def status_in_address(device: Device) -> None:
    """In the Address state only the device and endpoint 0 have a status."""
    device.to_address()
    device.status()
    assert device.status(ENDPOINT, 0) == 0
    device.refuses(IN | INTERFACE, GET_STATUS, 0, 0, 2)
    for endpoint in device.endpoints():
        device.refuses(IN | ENDPOINT, GET_STATUS, 0, endpoint, 2)


@check("9.4.9")
def halt(device: Device) -> None:
    """A halted endpoint stalls and says so in its status; the others go on."""
    device.to_configured()
    for endpoint in device.endpoints():
        device.halt(endpoint)
        assert device.status(ENDPOINT, endpoint) == 1
        for _ in range(3):
            assert device.once(kind(endpoint), endpoint) == "STALL"
        for other in set(device.endpoints()) - {endpoint}:
            assert device.status(ENDPOINT, other) == 0
            assert device.once(kind(other), other) in ("ACK", "NAK")
        device.halt(endpoint, on=False)
        assert device.status(ENDPOINT, endpoint) == 0
        device.configure()
        device.works()


@check("9.4.5")
def clear_resets_the_toggle(device: Device) -> None:
    """After CLEAR_FEATURE(ENDPOINT_HALT) the next packet is DATA0 on both sides."""
    device.to_configured()
    for packets in (1, 2):
        for _ in range(packets):
            device.works()
        for endpoint in (c.USB_IN, c.USB_OUT):
            device.halt(endpoint)
            device.halt(endpoint, on=False)
        frame = encode(Frame(c.SOF, 1, OPCODE[c.GET_ECHO], b"first"))
        assert device.transact("OUT", c.USB_OUT, frame, 0)[0] == "ACK"
        assert device.take(c.USB_IN, 0) == encode(Frame(c.SOF, 1, c.ECHO, b"first"))
        device.configure()


@check("9.4.5")
def clear_without_halt_resets_the_toggle(device: Device) -> None:
    """CLEAR_FEATURE(ENDPOINT_HALT) resets the toggle of this endpoint, also of one not halted."""
    device.to_configured()
    frame = encode(Frame(c.SOF, 1, OPCODE[c.GET_ECHO], b"again"))
    reply = encode(Frame(c.SOF, 1, c.ECHO, b"again"))
    assert device.transact("OUT", c.USB_OUT, frame, 0)[0] == "ACK"
    assert device.take(c.USB_IN, 0) == reply
    device.halt(c.USB_OUT, on=False)
    assert device.transact("OUT", c.USB_OUT, frame, 0)[0] == "ACK"
    assert device.take(c.USB_IN, 1) == reply
    device.halt(c.USB_IN, on=False)
    assert device.transact("OUT", c.USB_OUT, frame, 1)[0] == "ACK"
    assert device.take(c.USB_IN, 0) == reply


@check("5.8.5")
def halt_of_in_keeps_the_data(device: Device) -> None:
    """What waits for the host when its endpoint is halted comes once, and whole, afterwards."""
    device.to_configured()
    device.works()
    waiting = device.leave_unread(b"w" * 80)
    device.halt(c.USB_IN)
    assert device.once("IN", c.USB_IN) == "STALL"
    device.pause(5)
    device.halt(c.USB_IN, on=False)
    assert device.listen(1) == [waiting]
    assert device.listen(1, limit_ms=5) == []
    device.works()


@check("5.8.5")
def halt_of_out_keeps_the_data(device: Device) -> None:
    """What the device has taken before the halt is executed once, and what it refused is not."""
    device.to_configured()
    device.send(Frame(c.SOF, 1, OPCODE["delay"], b"\x0a\0"))
    device.pause(2)
    first, second, third = (Frame(c.SOF, seq, OPCODE[c.GET_ECHO], bytes(20)) for seq in (2, 3, 4))
    device.bus.completed()
    assert device.transact("OUT", c.USB_OUT, encode(first))[0] == "ACK"
    device.halt(c.USB_OUT)
    assert device.once("OUT", c.USB_OUT, encode(second)) == "STALL"
    device.pause(20)
    device.halt(c.USB_OUT, on=False)
    device.send(third)
    assert [frame.seq for frame in device.listen(3)] == [1, 2, 4]
    device.works()


@check("9.4.9")
def halt_of_missing_endpoints(device: Device) -> None:
    """SET_FEATURE and CLEAR_FEATURE of endpoints that do not exist are refused."""
    device.to_configured()
    for endpoint in missing_endpoints(device):
        for request in (SET_FEATURE, CLEAR_FEATURE):
            device.refuses(OUT | ENDPOINT, request, HALT, endpoint)
    device.works()


@check("9.4.9")
def halt_in_address(device: Device) -> None:
    """In the Address state the features of other endpoints than 0 are refused."""
    device.to_address()
    for endpoint in device.endpoints():
        for request in (SET_FEATURE, CLEAR_FEATURE):
            device.refuses(OUT | ENDPOINT, request, HALT, endpoint)
    device.configure()
    for endpoint in device.endpoints():
        assert device.status(ENDPOINT, endpoint) == 0


@check("9.4.9")
def remote_wakeup(device: Device) -> None:
    """What bmAttributes does not promise, to wake the host, can be neither set nor cleared."""
    device.to_address()
    head = usb.configuration.parse(device.descriptor(usb.CONFIGURATION)).head
    assert not head.bmAttributes & 0x20
    for _ in range(2):
        for request in (SET_FEATURE, CLEAR_FEATURE):
            device.refuses(OUT | DEVICE, request, REMOTE_WAKEUP)
        assert not device.status() & 2
        device.configure()


@check("9.4.9")
def test_mode(device: Device) -> None:
    """TEST_MODE is for devices of high speed, so it is refused, and can never be cleared."""
    device.to_configured()
    for selector in range(6):
        device.refuses(OUT | DEVICE, SET_FEATURE, TEST_MODE, selector << 8)
    device.refuses(OUT | DEVICE, CLEAR_FEATURE, TEST_MODE)
    device.works()


@check("9.4.9")
def unknown_features(device: Device) -> None:
    """Features that do not exist, and those of another recipient, are refused."""
    device.to_configured()
    for request in (SET_FEATURE, CLEAR_FEATURE):
        for value in (HALT, 3, 6, 255, 256):
            device.refuses(OUT | DEVICE, request, value)
        for value in (HALT, REMOTE_WAKEUP, TEST_MODE, 3):
            device.refuses(OUT | INTERFACE, request, value)
        for value in (REMOTE_WAKEUP, TEST_MODE, 3, 256):
            device.refuses(OUT | ENDPOINT, request, value, c.USB_IN)
    assert [device.status(ENDPOINT, endpoint) for endpoint in device.endpoints()] == [0, 0, 0]
    device.works()


@check("9.4.5")
def halt_lasts(device: Device) -> None:
    """Time, other requests and suspend do not end a halt."""
    device.to_configured()
    device.halt(c.USB_IN)
    device.descriptor(usb.CONFIGURATION)
    device.halt(c.USB_OUT)
    device.halt(c.USB_OUT, on=False)
    device.bus.suspend()
    device.pause(10)
    device.bus.resume()
    device.pause(50)
    assert device.status(ENDPOINT, c.USB_IN) == 1
    assert device.once("IN", c.USB_IN) == "STALL"
    device.halt(c.USB_IN, on=False)
    device.works()


@check("9.1.1.3")
def reset_ends_halts(device: Device) -> None:
    """After a reset and a new configuration no endpoint is halted."""
    device.to_configured()
    for endpoint in device.endpoints():
        device.halt(endpoint)
    device.to_configured()
    assert [device.status(ENDPOINT, endpoint) for endpoint in device.endpoints()] == [0, 0, 0]
    device.works()
