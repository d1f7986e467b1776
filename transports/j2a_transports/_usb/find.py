"""Find the J2A boards on the USB and their names.

In: a pyusb backend, or none for libusb.  Out: `UsbBoard`s with their pyusb devices.
Rules: a board is told by the class of its interface, whatever vendor and product ids it has;
looking opens no device where Linux gives the strings in sysfs; a device that goes away or cannot
be read while others are looked at does not disturb them.
"""

from __future__ import annotations

import contextlib
import errno
import os
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, NamedTuple
from urllib.parse import quote

from j2a_transports._base import MissingExtra, OpenFailed

from .address import Address
from .board import LINK_CLASS, SYNC_CLASS, UsbBoard

BULK: Final = 2
INTERRUPT: Final = 3
# libusb's codes of speeds, in Mbit/s.
SPEEDS: Final = {1: 1.5, 2: 12.0, 3: 480.0, 4: 5000.0, 5: 10000.0, 6: 20000.0}
SYSFS: Final = Path("/sys/bus/usb/devices")
DEVICE_FILES: Final = Path("/dev/bus/usb")

UDEV_ADVICE: Final = (
    'not allowed to open it: run `sudo "$(command -v j2a)" setup udev` once and plug it in again; '
    "logged in from elsewhere (ssh) also `sudo usermod -aG plugdev $USER`, and log in again"
)
WINUSB_ADVICE: Final = (
    "Windows has no driver for it; give the interface the driver WinUSB, for example with Zadig"
)


class Found(NamedTuple):
    """A board and its `usb.core.Device`."""

    board: UsbBoard
    device: Any


class Pair(NamedTuple):
    """The two endpoints of an interface, as pyusb describes them."""

    interface: Any
    incoming: Any
    outgoing: Any


def usb_boards(backend: Any = None) -> list[UsbBoard]:
    """Look for the J2A boards on the USB; none is opened where the system knows their strings.

    Args:
        backend: a pyusb backend (`usb.backend.IBackend`), None for libusb.

    Returns:
        The boards, in the order of bus and address.

    Raises:
        MissingExtra: pyusb is not installed.
        OpenFailed: libusb is not there or does not work.
    """
    return [found.board for found in scan(backend or libusb())]


def libusb(what: str = "usb:") -> Any:
    """Return pyusb's libusb backend, with the library of libusb-package or of the system.

    Args:
        what: the URL that needs it, for messages.
    """
    try:
        from usb.backend import libusb1  # noqa: PLC0415 - an extra
    except ImportError:
        raise MissingExtra(what, "pyusb libusb-package", "usb") from None
    backend = None
    with contextlib.suppress(ImportError):
        import libusb_package  # noqa: PLC0415 - an extra

        path = libusb_package.get_library_path()
        # pyusb logs and returns None where the library does not load.
        backend = libusb1.get_backend(find_library=lambda _: path) if path else None
    backend = backend or libusb1.get_backend()
    if backend is None:
        raise OpenFailed(
            f"{what} needs the library libusb 1.0, which is not there or does not work: "
            "pip install libusb-package brings one, on Debian also apt install libusb-1.0-0"
        )
    return backend


def is_libusb(backend: Any) -> bool:
    """Tell whether devices of this backend are those of the operating system."""
    return type(backend).__module__ == "usb.backend.libusb1"


def scan(backend: Any, interface: int | None = None) -> list[Found]:
    """Return all boards; with `interface` all devices that have a pair of endpoints there.

    Raises:
        OpenFailed: the backend cannot list the devices.
    """
    try:
        found = [
            Found(describe(device, pair.interface, backend), device)
            for device in devices(backend)
            for pair in link_interfaces(device, interface)
        ]
    except (OSError, NotImplementedError) as error:
        raise OpenFailed(f"usb: the devices cannot be listed: {error}") from error
    found.sort(key=lambda each: (each.board.bus, each.board.address, each.board.interface))
    names = stable_names([each.board for each in found])
    if interface is not None:
        names = [f"{name}?interface={interface}" for name in names]
    return [
        Found(replace(each.board, url=name), each.device)
        for each, name in zip(found, names, strict=True)
    ]


def devices(backend: Any) -> Iterator[Any]:
    """Yield all devices as `usb.core.Device`."""
    import usb.core  # noqa: PLC0415 - an extra; the backend comes from it

    for handle in backend.enumerate_devices():
        # It may go away between the two.
        with contextlib.suppress(usb.core.USBError):
            yield usb.core.Device(handle, backend)


def link_interfaces(device: Any, number: int | None = None) -> list[Pair]:
    """Return the interfaces that carry bytes: of the link's class, or that with this number.

    The first configuration that has one counts.
    """
    for index in range(device.bNumConfigurations):
        try:
            pairs = link_interfaces_of(device[index], number)
        except (OSError, NotImplementedError, IndexError):
            # Gone meanwhile, or descriptors that contradict each other.
            return []
        if pairs:
            return pairs
    return []


def link_interfaces_of(configuration: Any, number: int | None) -> list[Pair]:
    """Do the same in one configuration; of several alternate settings the first that fits."""
    pairs: dict[int, Pair] = {}
    for interface in configuration:
        fits = (
            class_of(interface) == LINK_CLASS
            if number is None
            else interface.bInterfaceNumber == number
        )
        pair = endpoints(interface) if fits else None
        if pair is not None:
            pairs.setdefault(interface.bInterfaceNumber, pair)
    return list(pairs.values())


def class_of(interface: Any) -> tuple[int, int, int]:
    """Return class, subclass and protocol."""
    return (
        interface.bInterfaceClass,
        interface.bInterfaceSubClass,
        interface.bInterfaceProtocol,
    )


def endpoints(interface: Any) -> Pair | None:
    """Return the first endpoint of each direction, bulk before interrupt; None without both."""
    sides: dict[bool, Any] = {}
    for kind in (BULK, INTERRUPT):
        for endpoint in interface:
            if endpoint.bmAttributes & 3 == kind:
                sides.setdefault(bool(endpoint.bEndpointAddress & 0x80), endpoint)
    return Pair(interface, sides[True], sides[False]) if len(sides) == 2 else None


def describe(device: Any, interface: Any, backend: Any) -> UsbBoard:
    """Collect what is known of a board; its URL is still missing."""
    ports = device.port_numbers
    port_path = f"{device.bus}-{'.'.join(map(str, ports))}" if ports else None
    real = is_libusb(backend)
    file = DEVICE_FILES / f"{device.bus or 0:03}" / f"{device.address or 0:03}"
    there = real and file.exists()
    problem = None
    if there and not os.access(file, os.R_OK | os.W_OK):
        problem = UDEV_ADVICE
    if real and port_path and (SYSFS / port_path).is_dir():
        strings = strings_of_sysfs(SYSFS / port_path)
    else:
        strings, trouble = strings_of_device(device)
        problem = problem or trouble
    return UsbBoard(
        "",
        device.idVendor,
        device.idProduct,
        *strings,
        bus=device.bus or 0,
        address=device.address or 0,
        port_path=port_path,
        speed=SPEEDS.get(device.speed or 0),
        interface=interface.bInterfaceNumber,
        device_file=str(file) if there else None,
        sync=has_sync(device),
        problem=problem,
    )


def has_sync(device: Any) -> bool:
    """Tell whether the device has an interface of the class of SyncUSB."""
    try:
        return any(
            class_of(interface) == SYNC_CLASS
            for configuration in device
            for interface in configuration
        )
    except (OSError, NotImplementedError, IndexError):
        return False


Strings = tuple[str | None, str | None, str | None]


def strings_of_sysfs(folder: Path) -> Strings:
    """Return manufacturer, product and serial number as the kernel has read them."""

    def read(name: str) -> str | None:
        try:
            return (folder / name).read_text("utf-8", "replace").rstrip("\n") or None
        except OSError:
            return None

    return read("manufacturer"), read("product"), read("serial")


def strings_of_device(device: Any) -> tuple[Strings, str | None]:
    """Ask the device itself for the same; also return what is wrong when it cannot be asked."""
    import usb.util  # noqa: PLC0415 - an extra

    was_open = is_open(device)
    indices = (device.iManufacturer, device.iProduct, device.iSerialNumber)
    try:
        languages = usb.util.get_langids(device)
        strings = [
            usb.util.get_string(device, index, languages[0]) if index and languages else None
            for index in indices
        ]
        return (strings[0] or None, strings[1] or None, strings[2] or None), None
    except (OSError, NotImplementedError, ValueError) as error:
        # ValueError: what the device sends is no UTF-16.
        return (None, None, None), trouble_of(error)
    finally:
        if not was_open:
            with contextlib.suppress(OSError, NotImplementedError):
                usb.util.dispose_resources(device)


def is_open(device: Any) -> bool:
    """Tell whether the program of this `usb.core.Device` has it open; pyusb has no word for it."""
    return getattr(getattr(device, "_ctx", None), "handle", None) is not None


def trouble_of(error: Exception) -> str | None:
    """Return the advice for a device that cannot be queried, or None."""
    if isinstance(error, OSError) and error.errno in (errno.EACCES, errno.EPERM):
        return UDEV_ADVICE
    if isinstance(error, NotImplementedError) and sys.platform == "win32":
        return WINUSB_ADVICE
    return None


def stable_names(boards: list[UsbBoard]) -> list[str]:
    """Return a URL for each board that no other one of them has.

    The serial number comes first, then the path of ports, which stays as long as the board is
    plugged in at the same place, then the address. A device with several interfaces needs
    their number too.
    """
    twins = Counter((board.bus, board.address) for board in boards)
    choices = [list(_names(board)) for board in boards]
    if any(count > 1 for count in twins.values()):
        choices = [
            [f"{name}?interface={board.interface}" for name in names]
            if twins[board.bus, board.address] > 1
            else names
            for board, names in zip(boards, choices, strict=True)
        ]
    count = Counter(name for names in choices for name in names)
    # Buses and addresses are different, so the last choice always is.
    return [next((name for name in names if count[name] == 1), names[-1]) for names in choices]


def _names(board: UsbBoard) -> Iterator[str]:
    ids = f"{board.vendor:04x}:{board.product:04x}"
    if board.serial:
        text = quote(board.serial, safe="")
        if Address.is_serial(text):
            yield f"usb://{text}"
        yield f"usb://{ids}/{text}"
    if board.port_path:
        yield f"usb://{board.port_path}"
    yield f"usb://{board.bus:03}:{board.address:03}"
