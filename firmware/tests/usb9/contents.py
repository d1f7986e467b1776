"""What stands in the descriptors, against the grammar and the constants of j2a_spec (9.6)."""

import pytest
from j2a_spec import constants as c
from j2a_spec import usb

from firmware.tests.usb9.checks import Check, listing
from firmware.tests.usb9.descriptors import ENGLISH, strings
from firmware.tests.usb9.device import Device

CHECKS: list[Check] = []
check = listing(CHECKS)


def head(device: Device):
    """The device descriptor."""
    device.to_address()
    return usb.device.parse(device.descriptor(usb.DEVICE))


def configuration(device: Device):
    """The configuration with all that belongs to it."""
    device.to_address()
    return usb.configuration.parse(device.descriptor(usb.CONFIGURATION))


def find(device: Device, *kind: int):
    """The one interface of a class, subclass and protocol."""
    (found,) = [
        interface
        for interface in configuration(device).interfaces
        if (
            interface.bInterfaceClass,
            interface.bInterfaceSubClass,
            interface.bInterfaceProtocol,
        )
        == kind
    ]
    return found


@check("9.6.1")
def device_descriptor(device: Device) -> None:
    """The device descriptor has 18 bytes, a legal packet size, and no class of its own."""
    found = head(device)
    assert found.bcdUSB in (0x0110, 0x0200)
    assert (found.bDeviceClass, found.bDeviceSubClass, found.bDeviceProtocol) == (0, 0, 0)
    assert found.bNumConfigurations == 1
    for digit in (found.bcdDevice >> shift & 15 for shift in (0, 4, 8, 12)):
        assert digit <= 9


@check("9.6.1", pytest.mark.requirement("USB-005"))
def vendor_and_product(device: Device) -> None:
    """A board without a vendor id of its own has the one of prototypes."""
    found = head(device)
    assert (found.idVendor, found.idProduct) == (c.USB_VENDOR, c.USB_PRODUCT)


@check("9.6.1", pytest.mark.requirement("USB-004"))
def serial_number(device: Device) -> None:
    """There is a serial number, and no character in it that a file name could not have."""
    index = head(device).iSerialNumber
    assert index
    text = device.string(index)
    assert text
    assert text.isascii()
    assert text.replace("-", "").replace("_", "").isalnum()


@check("9.6.3")
def configuration_descriptor(device: Device) -> None:
    """wTotalLength and bNumInterfaces say what follows; bmAttributes has bit 7, not 4 to 0."""
    found = configuration(device).head
    assert found.bConfigurationValue == 1
    assert found.bmAttributes & 0x9F == 0x80
    assert found.bMaxPower <= 250


@check("9.6.3")
def power(device: Device) -> None:
    """A device that has no power of its own says how much it takes from the bus."""
    found = configuration(device).head
    assert found.bmAttributes & 0x40 or found.bMaxPower > 0


@check("9.6.5")
def interface_numbers(device: Device) -> None:
    """Interfaces are numbered from 0 without gaps, each with the setting 0."""
    found = configuration(device).interfaces
    assert [interface.bInterfaceNumber for interface in found] == list(range(len(found)))
    assert {interface.bAlternateSetting for interface in found} == {0}


@check("9.6.5", pytest.mark.requirement("USB-001"))
def interface_of_a_board(device: Device) -> None:
    """The interface FF/12/EF has one bulk endpoint in each direction, and no other."""
    found = find(device, c.USB_CLASS, c.USB_SUBCLASS, c.USB_PROTOCOL)
    assert {(e.bEndpointAddress, e.bmAttributes, e.wMaxPacketSize) for e in found.endpoints} == {
        (c.USB_IN, usb.BULK, c.USB_PACKET),
        (c.USB_OUT, usb.BULK, c.USB_PACKET),
    }
    assert len(found.endpoints) == 2


@check("9.6.5", pytest.mark.requirement("SYNC-001"))
def interface_of_the_time(device: Device) -> None:
    """The interface FF/34/01, with the string SyncUSB, has one interrupt endpoint to the device."""
    found = find(device, c.USB_CLASS, c.SYNCUSB_SUBCLASS, c.SYNCUSB_PROTOCOL)
    (endpoint,) = found.endpoints
    assert (endpoint.bEndpointAddress, endpoint.bmAttributes) == (c.SYNCUSB_OUT, usb.INTERRUPT)
    assert endpoint.wMaxPacketSize >= c.SYNCUSB_SIZE
    assert device.string(found.iInterface) == c.SYNCUSB_NAME


@check("9.6.6")
def endpoint_addresses(device: Device) -> None:
    """No address is used twice, none is that of endpoint 0, and reserved bits are 0."""
    found = [e for i in configuration(device).interfaces for e in i.endpoints]
    addresses = [e.bEndpointAddress for e in found]
    assert len(set(addresses)) == len(addresses)
    assert all(address & 0x0F and not address & 0x70 for address in addresses)
    assert all(e.bmAttributes in (usb.BULK, usb.INTERRUPT) for e in found)


@check("5.8.3")
def packet_sizes_of_bulk(device: Device) -> None:
    """A bulk endpoint of full speed has packets of 8, 16, 32 or 64 bytes."""
    found = [e for i in configuration(device).interfaces for e in i.endpoints]
    assert all(e.wMaxPacketSize in (8, 16, 32, 64) for e in found if e.bmAttributes == usb.BULK)


@check("5.7.3")
def packet_sizes_of_interrupt(device: Device) -> None:
    """An interrupt endpoint of full speed has up to 64 bytes and is asked every 1 to 255 ms."""
    found = [e for i in configuration(device).interfaces for e in i.endpoints]
    for e in found:
        if e.bmAttributes == usb.INTERRUPT:
            assert 1 <= e.wMaxPacketSize <= 64
            assert 1 <= e.bInterval <= 255


@check("9.6.7")
def languages(device: Device) -> None:
    """String 0 names the languages: at least one, each once, English among them."""
    device.to_address()
    whole = device.descriptor(usb.STRING)
    assert whole[0] == len(whole)
    assert len(whole) % 2 == 0
    found = device.languages()
    assert ENGLISH in found
    assert len(set(found)) == len(found)


@check("9.6.7")
def strings_exist(device: Device) -> None:
    """Each string that a descriptor names exists, is UTF-16 and not empty, in each language."""
    device.to_address()
    for index in strings(device):
        for language in device.languages():
            assert usb.string.parse(device.descriptor(usb.STRING, index, language))
