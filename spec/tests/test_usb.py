"""The grammars of USB descriptors and of SyncUSB, against bytes written by hand."""

import construct as cs
import pytest
from j2a_spec import constants as c
from j2a_spec import usb

DEVICE = bytes.fromhex("12 01 00 02 00 00 00 20 66 66 FE CA 00 01 01 02 03 01")
CONFIGURATION = bytes.fromhex(
    "09 02 30 00 02 01 00 80 32"
    "09 04 00 00 02 FF 12 EF 00"
    "07 05 81 02 40 00 00"
    "07 05 02 02 40 00 00"
    "09 04 01 00 01 FF 34 01 04"
    "07 05 03 03 10 00 01"
)


def test_a_device_descriptor():
    device = usb.device.parse(DEVICE)
    assert (device.idVendor, device.idProduct) == (c.USB_VENDOR, c.USB_PRODUCT)
    assert device.bMaxPacketSize0 == 32
    assert usb.device.build(device) == DEVICE


def test_a_configuration_with_both_interfaces():
    found = usb.configuration.parse(CONFIGURATION)
    frames, sync = found.interfaces
    assert (frames.bInterfaceSubClass, frames.bInterfaceProtocol) == (0x12, 0xEF)
    assert [(e.bEndpointAddress, e.bmAttributes) for e in frames.endpoints] == [
        (c.USB_IN, usb.BULK),
        (c.USB_OUT, usb.BULK),
    ]
    assert (sync.bInterfaceSubClass, sync.bInterfaceProtocol) == (0x34, 0x01)
    assert [(e.bEndpointAddress, e.bmAttributes) for e in sync.endpoints] == [
        (c.SYNCUSB_OUT, usb.INTERRUPT)
    ]
    assert usb.configuration.build(found) == CONFIGURATION


@pytest.mark.parametrize("at, value", [(2, 0x31), (4, 1), (4, 3), (13, 1), (1, 7), (10, 5)])
def test_a_configuration_that_contradicts_itself_is_refused(at: int, value: int):
    broken = bytearray(CONFIGURATION)
    broken[at] = value
    with pytest.raises(cs.ConstructError):
        usb.configuration.parse(bytes(broken))


def test_strings_are_utf_16():
    assert usb.string.parse(bytes.fromhex("08 03 4A 00 32 00 41 00")) == "J2A"
    assert usb.string.build("SyncUSB").hex() == "100353007900 6e00630055005300 4200".replace(
        " ", ""
    )
    with pytest.raises(cs.ConstructError):
        usb.string.parse(bytes.fromhex("08 02 4A 00 32 00 41 00"))


@pytest.mark.requirement("SYNC-002")
def test_a_packet_of_syncusb_is_the_example_of_the_specification():
    packet = bytes.fromhex("40 42 0F 00 00 00 00 00 FF 07")
    assert usb.sync.parse(packet) == {"time_us": 1_000_000, "frame": 2047}
    assert usb.sync.build({"time_us": 1_000_000, "frame": 2047}) == packet
    assert len(packet) == c.SYNCUSB_SIZE
    for wrong in (packet[:9], packet + b"\0", packet[:9] + b"\x08"):
        with pytest.raises(cs.ConstructError):
            usb.sync.parse(wrong)
