"""Requests that no device, or not this one, knows: each ends in a stall that lasts for it only."""

import random

from j2a_spec import constants as c

from firmware.tests.usb9.checks import Check, listing
from firmware.tests.usb9.device import (
    CLASS,
    DEVICE,
    ENDPOINT,
    GET_CONFIGURATION,
    GET_DESCRIPTOR,
    GET_INTERFACE,
    GET_STATUS,
    IN,
    INTERFACE,
    OTHER,
    OUT,
    RESERVED,
    SET_ADDRESS,
    SET_CONFIGURATION,
    SET_DESCRIPTOR,
    SET_INTERFACE,
    SYNCH_FRAME,
    VENDOR,
    Device,
    setup,
)

CHECKS: list[Check] = []
check = listing(CHECKS)


@check("9.4.8")
def set_descriptor(device: Device) -> None:
    """SET_DESCRIPTOR, which is optional, is refused where there is nothing to be set."""
    device.to_configured()
    for kind, length in ((1, 18), (2, 48), (3, 4), (3, 64), (3, 200)):
        device.refuses(OUT, SET_DESCRIPTOR, kind << 8, 0, length)
    device.works()


@check("9.4.11")
def synch_frame(device: Device) -> None:
    """SYNCH_FRAME is refused by all endpoints, for none is isochronous."""
    device.to_configured()
    for endpoint in (0, IN, *device.endpoints(), 0x84):
        device.refuses(IN | ENDPOINT, SYNCH_FRAME, 0, endpoint, 2)


@check("9.2.7")
def reserved_requests(device: Device) -> None:
    """Standard requests with a number that has no meaning are refused, in each direction."""
    device.to_configured()
    for request in (2, 4, 13, 14, 20, 48, 49, 127, 128, 254, 255):
        for to in (DEVICE, INTERFACE, ENDPOINT):
            device.refuses(IN | to, request, 0, 0, 8)
            device.refuses(OUT | to, request, 0, 0, 8)
            device.refuses(OUT | to, request)
    device.works()


@check("9.2.7")
def class_and_vendor_requests(device: Device) -> None:
    """Requests of classes and vendors are refused, also those with a standard request's number."""
    device.to_configured()
    for kind in (CLASS, VENDOR):
        for to in (DEVICE, INTERFACE, ENDPOINT, OTHER):
            for request in (0, SET_ADDRESS, GET_DESCRIPTOR, SET_CONFIGURATION, 0x22, 255):
                device.refuses(IN | kind | to, request, 0x0100, 0, 64)
                device.refuses(OUT | kind | to, request, 0x0001)
                device.refuses(OUT | kind | to, request, 0, 0, 7)
    device.works()


@check("9.3.1")
def reserved_type(device: Device) -> None:
    """Requests of the type that is reserved are refused."""
    device.to_configured()
    for to in (DEVICE, INTERFACE, ENDPOINT, OTHER, 31):
        for request in (GET_STATUS, SET_ADDRESS, GET_DESCRIPTOR, SET_CONFIGURATION):
            device.refuses(IN | RESERVED | to, request, 0x0100, 0, 18)
            device.refuses(OUT | RESERVED | to, request, 1)
    device.works()


@check("9.3.1")
def reserved_recipients(device: Device) -> None:
    """Standard requests to recipients that are reserved are refused."""
    device.to_configured()
    for to in (OTHER, 4, 15, 31):
        device.refuses(IN | to, GET_STATUS, 0, 0, 2)
        device.refuses(IN | to, GET_DESCRIPTOR, 0x0100, 0, 18)
        device.refuses(OUT | to, SET_CONFIGURATION, 1)
    device.works()


@check("9.4")
def wrong_recipients(device: Device) -> None:
    """A standard request to a recipient that it is not defined for is refused."""
    device.to_configured()
    for to in (INTERFACE, ENDPOINT):
        device.refuses(OUT | to, SET_ADDRESS, 55)
        device.refuses(OUT | to, SET_CONFIGURATION, 0)
        device.refuses(IN | to, GET_CONFIGURATION, 0, 0, 1)
    for to in (DEVICE, ENDPOINT):
        device.refuses(IN | to, GET_INTERFACE, 0, 0, 1)
        device.refuses(OUT | to, SET_INTERFACE)
    for to in (DEVICE, INTERFACE):
        device.refuses(IN | to, SYNCH_FRAME, 0, c.USB_IN, 2)
    assert device.get(GET_CONFIGURATION, length=1) == b"\1"
    device.works()


@check("9.3.1")
def wrong_direction(device: Device) -> None:
    """Requests that return data are refused when data are to come from the host, and vice versa."""
    device.to_configured()
    device.refuses(OUT, GET_STATUS, 0, 0, 2)
    device.refuses(OUT, GET_CONFIGURATION, 0, 0, 1)
    device.refuses(OUT | INTERFACE, GET_INTERFACE, 0, 0, 1)
    device.refuses(OUT | ENDPOINT, GET_STATUS, 0, c.USB_IN, 2)
    device.refuses(IN, SET_CONFIGURATION, 1, 0, 1)
    device.refuses(IN, SET_ADDRESS, 17, 0, 1)
    device.refuses(IN | INTERFACE, SET_INTERFACE, 0, 0, 1)
    assert device.get(GET_CONFIGURATION, length=1) == b"\1"
    device.works()


@check("8.5.3.4")
def until_the_next_setup(device: Device) -> None:
    """Each further IN and OUT of a refused request is stalled, and the next SETUP is taken."""
    device.to_configured()
    for packet in (
        setup(IN, GET_DESCRIPTOR, 0xFF00, 0, 64),
        setup(OUT, SET_DESCRIPTOR, 0x0100, 0, 18),
        setup(OUT | VENDOR, 1),
    ):
        assert device.once("SETUP", 0, packet) == "ACK"
        device.pause(1)
        for _ in range(3):
            assert device.once("IN", 0, toggle=1) == "STALL"
            assert device.once("OUT", 0, b"data", toggle=1) == "STALL"
        device.pause(5)
        assert device.once("IN", 0, toggle=1) == "STALL"
        device.alive()


@check("9.2.7")
def refused_at_once(device: Device) -> None:
    """A request error shows in the first packet of the data stage, within 50 ms."""
    device.to_configured()
    start = device.sim.cycle
    done = device.control(setup(IN | VENDOR, 3, 0, 0, 255), limit_ms=50)
    assert done is not None
    assert (done.status, done.data) == ("stall", b"")
    assert device.sim.cycle - start < device.sim.cycles(0.050)


@check("9.2.7")
def any_eight_bytes(device: Device) -> None:
    """After any SETUP at all, with or without data, the transfer ends and the next one works."""
    rng = random.Random(9)
    device.to_configured()
    for _ in range(300):
        kind = rng.choice((0x00, 0x01, 0x02, 0x80, 0x81, 0x82, rng.randrange(256)))
        request = rng.choice((*range(13), rng.randrange(256)))
        value, index = (rng.choice((0, 1, 2, 0x100, 0x200, rng.randrange(65536))) for _ in "vi")
        length = rng.choice((0, 0, 1, 2, 8, 18, rng.randrange(200)))
        if request == SET_ADDRESS and kind & 0x60 == 0:
            continue
        packet = setup(kind, request, value, index, length)
        done = device.control(packet, b"" if kind & IN else bytes(length))
        assert done is not None, packet.hex()
        assert done.status in ("ok", "stall"), packet.hex()
        device.alive()
    device.to_configured()
    device.works()
