"""The bulk and interrupt endpoints: packets and the stream, toggles, NAK (8.4, 8.6)."""

import random

import pytest
from j2a_spec import constants as c
from j2a_spec import usb
from j2a_spec.oracle import Frame, encode

from firmware.tests.usb9.checks import Check, listing
from firmware.tests.usb9.device import OPCODE, Device

CHECKS: list[Check] = []
check = listing(CHECKS)

ECHO = OPCODE[c.GET_ECHO]
OVERHEAD = 5  # bytes of a frame beside its payload, when nothing is escaped


def echo(seq: int, payload: bytes) -> tuple[Frame, Frame]:
    """A request and its reply."""
    return Frame(c.SOF, seq, ECHO, payload), Frame(c.SOF, seq, c.ECHO, payload)


def plain(size: int) -> tuple[Frame, Frame]:
    """A request, and a reply of so many bytes on the wire: no byte of it is escaped."""
    for value in range(0x80, 0xC0):
        request, reply = echo(2, bytes((value,)) * (size - OVERHEAD))
        if len(encode(request)) == len(encode(reply)) == size:
            return request, reply
    raise AssertionError(size)


@check("8.4.6.1")
def nothing_to_send(device: Device) -> None:
    """A bulk endpoint that has nothing for the host answers NAK."""
    device.to_configured()
    for _ in range(20):
        assert device.once("IN", c.USB_IN) == "NAK"
        device.sim.run(333)
    device.works()
    assert device.once("IN", c.USB_IN) == "NAK"


@check("8.3.2.2")
def other_endpoints(device: Device) -> None:
    """Endpoints that the descriptors do not name answer nothing."""
    device.to_configured()
    known = device.endpoints()
    for number in range(1, 16):
        if number not in known:
            assert device.once("OUT", number, b"x") is None
        if number | 0x80 not in known:
            assert device.once("IN", number | 0x80) is None
    device.works()


@check("5.8.3", pytest.mark.requirement("USB-007"))
def packets_of_any_size(device: Device) -> None:
    """A frame may come in packets of any size, and several frames in one packet."""
    device.to_configured()
    rng = random.Random(1)
    for size in (1, 2, 7, 8, 9, 31, 63, 64, None):
        frames = [echo(seq, rng.randbytes(40)) for seq in range(3)]
        data = b"".join(encode(request) for request, _ in frames)
        while data:
            step = size or rng.randrange(1, 65)
            device.bus.submit_out(c.USB_OUT, data[:step])
            data = data[step:]
        assert device.listen(3) == [reply for _, reply in frames]


@check("8.4.6.3", pytest.mark.requirement("USB-009"))
def empty_packets_from_the_host(device: Device) -> None:
    """Empty packets are acknowledged and stand for no bytes, within a frame as well."""
    device.to_configured()
    request, reply = echo(5, b"between empty packets")
    for _ in range(5):
        assert device.transact("OUT", c.USB_OUT)[0] == "ACK"
    for byte in encode(request):
        device.bus.submit_out(c.USB_OUT, bytes((byte,)))
        device.bus.submit_out(c.USB_OUT, b"")
    assert device.listen(1) == [reply]
    device.works()


@check("5.8.3", pytest.mark.requirement("USB-014"))
def transfers_end(device: Device) -> None:
    """A burst to the host ends with a short packet, or an empty one after one that was full."""
    device.to_configured()
    for size in (5, 62, 63, 64, 65, 127, 128, 129, 192, 256, 260):
        request, reply = plain(size)
        transfer = device.bus.submit_in(c.USB_IN, 4096)
        device.send(request)
        done = device.finish(transfer, 50)
        assert done is not None, f"{size} bytes do not end"
        assert (done.status, done.data) == ("ok", encode(reply))
        device.pause(2)
        assert device.once("IN", c.USB_IN) == "NAK"


@check("5.8.3")
def packets_to_the_host(device: Device) -> None:
    """Packets to the host are no longer than wMaxPacketSize, and a long reply fills them."""
    device.to_configured()
    request, reply = plain(260)
    device.send(request)
    sizes, got = [], b""
    while len(got) < 260:
        packet = device.take(c.USB_IN)
        sizes, got = [*sizes, len(packet)], got + packet
    assert (sizes, got) == ([64, 64, 64, 64, 4], encode(reply))


@check("8.6.4")
def repeated_packet(device: Device) -> None:
    """A packet that comes again with its old toggle is acknowledged and dropped."""
    device.to_configured()
    for seq in range(4):
        request, reply = echo(seq, b"once")
        for _ in range(3):
            assert device.transact("OUT", c.USB_OUT, encode(request), seq % 2)[0] == "ACK"
            device.pause(1)
        assert device.listen(1) == [reply]
        assert device.listen(1, limit_ms=3) == []


@check("8.6.4")
def lost_acknowledgements(device: Device) -> None:
    """A packet to the host whose acknowledgement is lost comes again, and only once more."""
    device.to_configured()
    for number in range(5):
        request, reply = echo(number, b"lost")
        device.send(request)
        for _ in range(number):
            assert device.lose(c.USB_IN) == encode(reply)
        assert device.take(c.USB_IN) == encode(reply)
        assert device.once("IN", c.USB_IN) == "NAK"


@check("8.6.2")
def toggles_in_turn(device: Device) -> None:
    """Packets to the host carry DATA0 and DATA1 in turn, over many frames."""
    device.to_configured()
    for number in range(9):
        request, reply = echo(number, b"in turn")
        assert device.transact("OUT", c.USB_OUT, encode(request), number % 2)[0] == "ACK"
        assert device.take(c.USB_IN, number % 2) == encode(reply)


@check("8.4.6.3", pytest.mark.requirement("USB-010"))
def nak_while_busy(device: Device) -> None:
    """While a function computes, what has no room is NAKed and taken later, each byte once."""
    device.to_configured()
    frames = [echo(seq, bytes((seq,)) * 50) for seq in range(1, 40)]
    naks = device.bus.counters.naks
    device.send(Frame(c.SOF, 0, OPCODE["delay"], b"\x32\0"))
    for request, _ in frames:
        device.send(request)
    device.pause(40)
    assert device.bus.counters.naks > naks
    found = device.listen(40)
    assert found == [Frame(c.SOF, 0, 0), *(reply for _, reply in frames)]


@check("8.4.6.1", pytest.mark.requirement("USB-010"))
def host_does_not_read(device: Device) -> None:
    """What the host does not fetch waits, in order and whole, and so do the requests behind it."""
    device.to_configured()
    frames = [echo(seq, bytes((seq,)) * 60) for seq in range(1, 30)]
    for request, _ in frames:
        device.send(request)
    device.pause(300)
    assert device.listen(len(frames)) == [reply for _, reply in frames]
    device.works()


@check("5.7.3", pytest.mark.requirement("SYNC-003"))
def packets_of_the_time(device: Device) -> None:
    """The interrupt endpoint takes packets of any length up to its own, with toggles in turn."""
    device.to_configured()
    toggle = 0
    packet = usb.sync.build({"time_us": 1_000_000, "frame": 2047})
    for data in (packet, packet, b"", packet[:1], packet[:9], packet):
        assert device.transact("OUT", c.SYNCUSB_OUT, data, toggle)[0] == "ACK"
        toggle ^= 1
        device.pause(1)
    device.works()


@check("8.6.2")
def packets_of_the_time_after_halt(device: Device) -> None:
    """CLEAR_FEATURE(ENDPOINT_HALT) lets the interrupt endpoint start with DATA0, too."""
    device.to_configured()
    packet = usb.sync.build({"time_us": 1_000_000, "frame": 1})
    wrong = device.bus.counters.wrong_toggles
    for _ in range(3):
        assert device.transact("OUT", c.SYNCUSB_OUT, packet, 0)[0] == "ACK"
        device.pause(1)
        device.halt(c.SYNCUSB_OUT)
        device.halt(c.SYNCUSB_OUT, on=False)
    assert device.bus.counters.wrong_toggles == wrong
