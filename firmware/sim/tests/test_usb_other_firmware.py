"""Firmware that is written unlike ours: what it needs of the controller, and of hosts.

In: usb_board.c as other makers might write it. Out: it enumerates and answers on the default model.
"""

import j2a_transports
import pytest
import usb.core
from j2a_sim import SimBackend, SimError, UsbLink
from j2a_sim._usb_bus.port import UsbPort
from j2a_transports import WriteTimeout

pytestmark = pytest.mark.avr

INTERRUPT, BULK = 3, 2
SIZES = [size + off for size in range(64, 64 * 9, 64) for off in (-1, 0, 1)]


def read_all(link, count):
    data = b""
    while len(data) < count:
        more = link.read(1.0)
        assert more, f"{len(data)} of {count} bytes came"
        data += more
    return data


def suspend_and_resume(bus, sim):
    bus.suspend()
    sim.run(sim.cycles(0.02))
    assert bus.suspended
    bus.resume()


def test_hardware_that_clears_suspi_is_what_some_firmware_needs(usb_board):
    sim = usb_board(SUSPENDS=1)
    sim.run(sim.cycles(0.05))  # the idle bus is suspend
    assert sim.usb.suspend_flags == UsbPort.SUSPEND_FLAGS[0]
    link = UsbLink(sim)
    link.write(b"hello")
    assert read_all(link, 5) == b"hello"
    suspend_and_resume(sim.usb, sim)
    link.write(b"again")
    assert read_all(link, 5) == b"again"


def test_without_that_it_does_not_come_up(usb_board):
    sim = usb_board(SUSPENDS=1)
    sim.usb.suspend_flags = "independent"
    sim.run(sim.cycles(0.05))
    with pytest.raises(SimError):
        UsbLink(sim)


@pytest.mark.requirement("USB-003", "USB-015")
def test_banks_that_only_a_byte_gives_back(usb_board):
    link = UsbLink(usb_board(KIND=INTERRUPT, NEEDS_BYTES=1))
    for size in SIZES:
        link.write(bytes(size))
        link.write(b".")  # ends the transfer to the host, too
        assert read_all(link, size + 1) == bytes(size) + b"."


def test_an_empty_packet_keeps_such_a_bank(usb_board):
    """The control: a bulk endpoint gets an empty packet, which is the end of this board."""
    link = UsbLink(usb_board(KIND=BULK, NEEDS_BYTES=1))
    link.write(b"hello")
    assert read_all(link, 5) == b"hello"
    link.write(bytes(64))
    link.write(b".")
    assert link.read(1.0) == b""


@pytest.mark.requirement("USB-003", "USB-015")
def test_such_a_board_on_usb(usb_board):
    backend = SimBackend([usb_board(KIND=INTERRUPT, NEEDS_BYTES=1)])
    device = usb.core.find(backend=backend, idVendor=0x6666)
    with j2a_transports.open_usb_device(device) as link:
        for size in SIZES:
            link.write(bytes(size))
            link.write(b".")
            assert read_all(link, size + 1) == bytes(size) + b"."


@pytest.mark.requirement("USB-014")
def test_such_a_board_with_bulk_endpoints_wedges(usb_board):
    backend = SimBackend([usb_board(KIND=BULK, NEEDS_BYTES=1)])
    device = usb.core.find(backend=backend, idVendor=0x6666)
    with j2a_transports.open_usb_device(device) as link:
        link.write_timeout_s = 0.3
        with pytest.raises(WriteTimeout):
            for _ in range(4):
                link.write(bytes(64))


def test_an_unknown_reading(usb_board):
    with pytest.raises(SimError, match="'both' is none of exclusive, independent"):
        usb_board().usb.suspend_flags = "both"
