"""The blocks for FunctionFS: golden bytes, and read as a host reads them."""

from __future__ import annotations

import struct

import construct as cs
import pytest
from j2a_spec import constants, usb
from j2a_transports._gadget import descriptors as own

# Magic 3, length 24 + 39 + 39 + 57, flags 7 (full, high, super speed); 5, 5 and 8 descriptors.
GOLDEN_HEAD = "030000009f00000007000000 05000000 05000000 08000000"
GOLDEN_FULL = """
    0904000002ff12ef01
    07058102400000
    07050202400000
    0904010001ff340102
    07050303100001
"""
GOLDEN_HIGH = """
    0904000002ff12ef01
    07058102000200
    07050202000200
    0904010001ff340102
    07050303100004
"""
GOLDEN_SUPER = """
    0904000002ff12ef01
    07058102000400 063000000000
    07050202000400 063000000000
    0904010001ff340102
    07050303100004 063000001000
"""
# Magic 2, length 16 + 2 + 4 + 8, two strings, one language: 0x0409.
GOLDEN_STRINGS = bytes.fromhex("02000000 1e000000 02000000 01000000 0904") + b"J2A\0SyncUSB\0"


def speeds(block: bytes) -> dict[int, list[bytes]]:
    """Take a block apart by what linux/usb/functionfs.h says: packet size -> its descriptors."""
    magic, length, flags, *counts = struct.unpack_from("<6I", block)
    assert (magic, length, flags) == (3, len(block), 0b111)
    at, found = 24, {}
    for packet, count in zip((64, 512, 1024), counts, strict=True):
        own_ones = []
        for _ in range(count):
            own_ones.append(block[at : at + block[at]])
            at += block[at]
        found[packet] = own_ones
    assert at == len(block)
    return found


def interfaces(descriptors: list[bytes]) -> list[cs.Container]:
    """Read them as a host does, which gets them without the companions behind one another."""
    data = b"".join(one for one in descriptors if one[1] in (usb.INTERFACE, usb.ENDPOINT))
    return list(cs.GreedyRange(usb.interface).parse(data))


def test_golden_bytes() -> None:
    expected = bytes.fromhex(GOLDEN_HEAD + GOLDEN_FULL + GOLDEN_HIGH + GOLDEN_SUPER)
    assert own.descriptor_block(sync=True) == expected
    assert own.string_block(sync=True) == GOLDEN_STRINGS


@pytest.mark.requirement("USB-001")
@pytest.mark.parametrize("sync", [False, True])
def test_the_interface_of_frames(sync: bool) -> None:
    for packet, descriptors in speeds(own.descriptor_block(sync=sync)).items():
        first = interfaces(descriptors)[0]
        assert (first.bInterfaceNumber, first.bAlternateSetting, first.iInterface) == (0, 0, 1)
        assert first.bInterfaceClass == constants.USB_CLASS
        assert first.bInterfaceSubClass == constants.USB_SUBCLASS
        assert first.bInterfaceProtocol == constants.USB_PROTOCOL
        to_host, from_host = first.endpoints
        assert to_host.bEndpointAddress == constants.USB_IN
        assert from_host.bEndpointAddress == constants.USB_OUT
        for endpoint in first.endpoints:
            assert endpoint.bmAttributes == usb.BULK
            assert endpoint.wMaxPacketSize == packet
    assert min(speeds(own.descriptor_block(sync=sync))) == constants.USB_PACKET


@pytest.mark.requirement("SYNC-001")
def test_the_interface_of_the_time() -> None:
    for descriptors in speeds(own.descriptor_block(sync=True)).values():
        second = interfaces(descriptors)[1]
        assert (second.bInterfaceNumber, second.iInterface) == (1, 2)
        assert second.bInterfaceClass == constants.USB_CLASS
        assert second.bInterfaceSubClass == constants.SYNCUSB_SUBCLASS
        assert second.bInterfaceProtocol == constants.SYNCUSB_PROTOCOL
        (endpoint,) = second.endpoints
        assert endpoint.bEndpointAddress == constants.SYNCUSB_OUT
        assert endpoint.bmAttributes == usb.INTERRUPT
        assert endpoint.wMaxPacketSize > constants.SYNCUSB_SIZE
    assert own.string_block(sync=True).split(b"\0")[-2].decode() == constants.SYNCUSB_NAME


def test_every_endpoint_has_a_companion_at_super_speed_only() -> None:
    for packet, descriptors in speeds(own.descriptor_block(sync=True)).items():
        kinds = [one[1] for one in descriptors]
        expected = [usb.ENDPOINT, 0x30] if packet == 1024 else [usb.ENDPOINT]
        assert kinds == [usb.INTERFACE, *expected * 2, usb.INTERFACE, *expected]


def test_without_the_time_there_is_one_interface_and_one_string() -> None:
    for descriptors in speeds(own.descriptor_block(sync=False)).values():
        assert len(interfaces(descriptors)) == 1
    assert (
        own.string_block(sync=False)
        == bytes.fromhex("02000000 16000000 01000000 01000000 0904") + b"J2A\0"
    )


def test_numbers_are_those_of_the_specification() -> None:
    pairs = {
        "VENDOR": "USB_VENDOR",
        "PRODUCT": "USB_PRODUCT",
        "CLASS": "USB_CLASS",
        "SUBCLASS": "USB_SUBCLASS",
        "PROTOCOL": "USB_PROTOCOL",
        "IN": "USB_IN",
        "OUT": "USB_OUT",
        "SYNC_SUBCLASS": "SYNCUSB_SUBCLASS",
        "SYNC_PROTOCOL": "SYNCUSB_PROTOCOL",
        "SYNC_OUT": "SYNCUSB_OUT",
        "SYNC_SIZE": "SYNCUSB_SIZE",
        "SYNC_NAME": "SYNCUSB_NAME",
    }
    for mine, specified in pairs.items():
        assert getattr(own, mine) == getattr(constants, specified), mine
