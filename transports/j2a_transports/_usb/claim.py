"""Taking a USB interface from the system, and giving it back.

In: a `usb.core.Device`.  Out: the claimed interface with its endpoints.
Rules: only this interface is touched, and the device gets a configuration only when it has none
with it; what was done is put on a stack that undoes it; what a device or the system refuses is an
`OpenFailed` that says what to do.
"""

from __future__ import annotations

import contextlib
import errno
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

from j2a_transports._base import OpenFailed

from .find import (
    SYSFS,
    UDEV_ADVICE,
    WINUSB_ADVICE,
    Pair,
    is_libusb,
    link_interfaces,
    link_interfaces_of,
)

_BUSY: Final = "another program uses it; close that program"
_GONE: Final = "it went away while it was opened; is it plugged in well?"
_ADVICE: Final = {
    errno.EACCES: UDEV_ADVICE,
    errno.EPERM: UDEV_ADVICE,
    errno.EBUSY: _BUSY,
    errno.ENODEV: _GONE,
    errno.ENOENT: _GONE,
    errno.ESHUTDOWN: _GONE,
}


@contextlib.contextmanager
def explained(url: str) -> Iterator[None]:
    try:
        yield
    except NotImplementedError as error:
        advice = WINUSB_ADVICE if sys.platform == "win32" else f"its driver cannot do that: {error}"
        raise OpenFailed(f"{url}: {advice}") from error
    except RuntimeError as error:  # the system has no thread to give
        raise OpenFailed(f"{url}: {error}") from error
    except OSError as error:
        advice = _ADVICE.get(error.errno or 0, f"{error}; plug it in again")
        raise OpenFailed(f"{url}: {advice}") from error


def claim(url: str, device: Any, interface: int | None, undo: contextlib.ExitStack) -> Pair:
    """Configure the device where it is not, and take the interface."""
    import usb.util  # noqa: PLC0415 - an extra; the device comes from it

    configuration = _active(device)
    pairs = link_interfaces_of(configuration, interface) if configuration is not None else []
    if not pairs:
        pairs = link_interfaces(device, interface)
        if not pairs:
            which = "of class FF/12/EF" if interface is None else str(interface)
            raise OpenFailed(
                f"{url}: the device has no interface {which} with an endpoint in each direction"
            )
        device.set_configuration(device[pairs[0].interface.configuration])
    pair = pairs[0]
    claimed = pair.interface.bInterfaceNumber
    with contextlib.suppress(NotImplementedError):
        # Only Linux and macOS have drivers to detach.
        if device.is_kernel_driver_active(claimed):
            device.detach_kernel_driver(claimed)
            undo.callback(_attach, device, claimed)
    usb.util.claim_interface(device, claimed)
    undo.callback(_release, device, claimed)
    if pair.interface.bAlternateSetting:
        device.set_interface_altsetting(claimed, pair.interface.bAlternateSetting)
    return pair


def _active(device: Any) -> Any:
    """Return the active configuration, None when the device has none."""
    import usb.core  # noqa: PLC0415 - an extra; the device comes from it

    try:
        return device.get_active_configuration()
    except usb.core.USBError as error:
        # pyusb's own error for it has no number; those of the system have.
        if error.errno is not None:
            raise
        return None


def claim_shown(device: Any, pair: Pair) -> Callable[[], bool]:
    """Return what tells whether the interface is still claimed; it is where nothing shows it.

    A reset by another program unbinds the driver, and the next transfer binds it again, perhaps
    before anybody has looked: the link in sysfs is another one then.
    """
    driver = None
    if is_libusb(device.backend) and device.port_numbers:
        ports = ".".join(map(str, device.port_numbers))
        configuration = device[pair.interface.configuration].bConfigurationValue
        name = f"{device.bus}-{ports}:{configuration}.{pair.interface.bInterfaceNumber}"
        driver = SYSFS / name / "driver"
    bound = _number_of(driver)
    return lambda: bound is None or _number_of(driver) == bound


def _number_of(path: Path | None) -> int | None:
    """Return the inode of what is there, a link itself and not its target; None for nothing."""
    try:
        return path.lstat().st_ino if path else None
    except OSError:
        return None


def clear_halt(device: Any, endpoint: int) -> None:
    """Make both sides start with the same data toggle."""
    try:
        device.clear_halt(endpoint)
    except NotImplementedError:
        pass
    except OSError as error:
        # A device that does not know this request has no halts, and begins anew when claimed.
        if error.errno != errno.EPIPE:
            raise


def _release(device: Any, interface: int) -> None:
    import usb.util  # noqa: PLC0415 - an extra; the device comes from it

    # A device that is gone refuses this and the next.
    with contextlib.suppress(OSError, NotImplementedError):
        usb.util.release_interface(device, interface)


def _attach(device: Any, interface: int) -> None:
    with contextlib.suppress(OSError, NotImplementedError):
        device.attach_kernel_driver(interface)


def dispose(device: Any) -> None:
    import usb.util  # noqa: PLC0415 - an extra; the device comes from it

    with contextlib.suppress(OSError, NotImplementedError):
        usb.util.dispose_resources(device)
