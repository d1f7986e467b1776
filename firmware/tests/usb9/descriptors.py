"""GET_DESCRIPTOR: which descriptors there are, lengths, and how their packets end (9.4.3)."""

from collections.abc import Iterator

from j2a_spec import usb

from firmware.tests.usb9.checks import Check, listing
from firmware.tests.usb9.device import GET_DESCRIPTOR, IN, INTERFACE, OUT, Device, setup

CHECKS: list[Check] = []
check = listing(CHECKS)

ENGLISH = 0x0409
DEVICE_QUALIFIER, OTHER_SPEED = 6, 7


def everything(device: Device) -> Iterator[tuple[int, int, bytes]]:
    """wValue, wIndex and bytes of each descriptor that the device has."""
    yield usb.DEVICE << 8, 0, device.descriptor(usb.DEVICE)
    yield usb.CONFIGURATION << 8, 0, device.descriptor(usb.CONFIGURATION)
    yield usb.STRING << 8, 0, device.descriptor(usb.STRING)
    language = device.languages()[0]
    for index in sorted(strings(device)):
        value = usb.STRING << 8 | index
        yield value, language, device.descriptor(usb.STRING, index, language)


def strings(device: Device) -> set[int]:
    """The indices of the strings that the other descriptors name."""
    head = usb.device.parse(device.descriptor(usb.DEVICE))
    whole = usb.configuration.parse(device.descriptor(usb.CONFIGURATION))
    found = {head.iManufacturer, head.iProduct, head.iSerialNumber, whole.head.iConfiguration}
    return (found | {interface.iInterface for interface in whole.interfaces}) - {0}


def whole_configuration(device: Device) -> int:
    return int.from_bytes(device.get(GET_DESCRIPTOR, usb.CONFIGURATION << 8, 0, 9)[2:4], "little")


@check("9.4.3")
def the_same_in_each_state(device: Device) -> None:
    """Each descriptor can be read in the Default, Address and Configured state, and is the same."""
    device.to_default()
    expected = list(everything(device))
    device.set_address(5)
    assert list(everything(device)) == expected
    device.configure()
    assert list(everything(device)) == expected


@check("9.4.3")
def length_1_to_65535(device: Device) -> None:
    """As many bytes come as are asked for, or as there are if these are fewer."""
    device.to_address()
    for value, index, whole in everything(device):
        n, p = len(whole), device.packet0
        for length in sorted({1, 2, 7, 8, 9, 17, 18, p - 1, p, p + 1, n - 1, n, n + 1, 255, 65535}):
            got = device.get(GET_DESCRIPTOR, value, index, length)
            assert got == whole[:length], f"{value:#06x}, {length} bytes"


@check("9.3.1")
def length_0(device: Device) -> None:
    """With wLength 0 there is no data stage: the status stage follows at once, to the host."""
    device.to_address()
    for value, index, _whole in everything(device):
        assert device.once("SETUP", 0, setup(IN, GET_DESCRIPTOR, value, index, 0)) == "ACK"
        assert device.take(0, 1) == b""
        device.alive()


@check("9.4.3")
def configuration_in_one(device: Device) -> None:
    """The configuration comes with its interfaces and endpoints, as long as wTotalLength says."""
    device.to_address()
    assert len(device.descriptor(usb.CONFIGURATION)) == whole_configuration(device)


@check("5.5.3")
def packets_are_full(device: Device) -> None:
    """Each packet of a data stage but the last has bMaxPacketSize0 bytes, with toggles in turn."""
    device.to_address()
    whole = device.descriptor(usb.CONFIGURATION)
    assert len(whole) == whole_configuration(device)
    device.once("SETUP", 0, setup(IN, GET_DESCRIPTOR, usb.CONFIGURATION << 8, 0, len(whole)))
    got, toggle = b"", 1
    while len(got) < len(whole):
        packet = device.take(0, toggle)
        got, toggle = got + packet, toggle ^ 1
        assert len(packet) == device.packet0 or len(got) == len(whole)
    assert got == whole
    assert device.transact("OUT", 0, b"", 1)[0] == "ACK"


@check("8.5.3.2")
def empty_packet_at_the_end(device: Device) -> None:
    """What fills its last packet and is shorter than asked for ends with an empty packet."""
    device.to_address()
    full = [each for each in everything(device) if len(each[2]) % device.packet0 == 0]
    assert full, "no descriptor of this device shows it"
    for value, index, whole in full:
        for length in (len(whole) + 1, 255, 65535):
            device.once("SETUP", 0, setup(IN, GET_DESCRIPTOR, value, index, length))
            for number in range(len(whole) // device.packet0):
                assert len(device.take(0, 1 - number % 2)) == device.packet0
            assert device.take(0, 1 - len(whole) // device.packet0 % 2) == b""
            assert device.transact("OUT", 0, b"", 1)[0] == "ACK"


@check("8.5.3.2")
def no_empty_packet_when_exact(device: Device) -> None:
    """What is as long as asked for has no empty packet: the status stage follows."""
    device.to_address()
    for value, index, whole in everything(device):
        for length in {len(whole), len(whole) // device.packet0 * device.packet0} - {0}:
            device.once("SETUP", 0, setup(IN, GET_DESCRIPTOR, value, index, length))
            got, toggle = b"", 1
            while len(got) < length:
                packet = device.take(0, toggle)
                assert packet
                got, toggle = got + packet, toggle ^ 1
            assert device.transact("OUT", 0, b"", 1)[0] == "ACK"
            device.alive()


@check("9.4.3")
def unknown_types(device: Device) -> None:
    """Descriptors that do not exist are refused; interfaces and endpoints are not read alone."""
    device.to_configured()
    for kind in (0, usb.INTERFACE, usb.ENDPOINT, 8, 9, 11, 15, 0x21, 0x29, 0x42, 0xFF):
        device.refuses(IN, GET_DESCRIPTOR, kind << 8, 0, 255)


@check("9.6.2")
def no_device_qualifier(device: Device) -> None:
    """With full speed only, DEVICE_QUALIFIER and OTHER_SPEED_CONFIGURATION are refused."""
    device.to_default()
    for state in (lambda: None, lambda: device.set_address(4), device.configure):
        state()
        device.refuses(IN, GET_DESCRIPTOR, DEVICE_QUALIFIER << 8, 0, 10)
        device.refuses(IN, GET_DESCRIPTOR, OTHER_SPEED << 8, 0, 9)


@check("9.4.3")
def unknown_configuration(device: Device) -> None:
    """A configuration whose index is bNumConfigurations or more is refused."""
    device.to_address()
    count = usb.device.parse(device.descriptor(usb.DEVICE)).bNumConfigurations
    for index in (count, count + 1, 255):
        device.refuses(IN, GET_DESCRIPTOR, usb.CONFIGURATION << 8 | index, 0, 255)


@check("9.4.3")
def unknown_string(device: Device) -> None:
    """A string that no descriptor names is refused, in each language."""
    device.to_address()
    known = strings(device)
    for index in (max(known) + 1, max(known) + 2, 127, 128, 238, 255):
        for language in (device.languages()[0], ENGLISH, 0):
            device.refuses(IN, GET_DESCRIPTOR, usb.STRING << 8 | index, language, 255)


@check("9.6.7")
def string_in_another_language(device: Device) -> None:
    """Asked for in a language that it has not, a string is refused or comes in one that it has."""
    device.to_address()
    others = {0x0407, 0x0411, 0xFFFF} - set(device.languages())
    for index in sorted(strings(device)):
        packet = [setup(IN, GET_DESCRIPTOR, usb.STRING << 8 | index, id, 255) for id in others]
        for done in map(device.control, packet):
            assert done is not None
            assert done.status == "stall" or usb.string.parse(done.data) == device.string(index)
            device.alive()


@check("9.4.3")
def only_to_the_device(device: Device) -> None:
    """GET_DESCRIPTOR to an interface, as classes define it, is refused where no class does."""
    device.to_configured()
    for kind in (usb.DEVICE, usb.CONFIGURATION, usb.STRING, 0x21, 0x22):
        device.refuses(IN | INTERFACE, GET_DESCRIPTOR, kind << 8, 0, 64)


@check("9.3.1")
def not_to_the_device(device: Device) -> None:
    """GET_DESCRIPTOR whose data go from the host to the device is refused."""
    device.to_address()
    for kind in (usb.DEVICE, usb.CONFIGURATION, usb.STRING):
        for length in (1, 8, 18, 64):
            device.refuses(OUT, GET_DESCRIPTOR, kind << 8, 0, length)
