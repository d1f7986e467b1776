"""Byte streams that carry J2A: USB, serial ports, Bluetooth, TCP, processes, terminals, memory.

`open(url)` gives a `Transport`, `listen(url)` a `Listener`, `pair()` two transports joined in
memory. Importing this package loads no driver; a driver is loaded when its scheme is first used.

`schemes()` names the URL schemes, and `describe(scheme)` says what one is: the forms of its URLs,
its options, whether it can listen, and what it needs. `j2a_transports.options` has converters of
option values for the declarations of other distributions.

Every scheme has the option ``write_timeout``: seconds without progress before `WriteTimeout`
(default 5, ``none`` waits for ever).
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from ._base import (
    BadUrl,
    LinkClosed,
    LinkLost,
    Listener,
    MissingExtra,
    OpenFailed,
    Transport,
    TransportError,
    WriteTimeout,
)
from ._registry import check, describe, innermost, listen, open, schemes
from ._scheme import COMMON_OPTIONS, Option, Scheme, Usage
from ._url import Url

if TYPE_CHECKING:
    from ._gadget.gadget import UsbGadget
    from ._usb.board import UsbBoard
    from ._usb.find import usb_boards
    from ._usb.link import open_usb_device
    from ._usb.sync import FrameSeen, SyncPort, sync_ports
    from ._usb.watch import UsbArrived, UsbLeft, UsbWatch, watch_usb

__all__ = [
    "COMMON_OPTIONS",
    "BadUrl",
    "FrameSeen",
    "LinkClosed",
    "LinkLost",
    "Listener",
    "MissingExtra",
    "OpenFailed",
    "Option",
    "Scheme",
    "SyncPort",
    "Transport",
    "TransportError",
    "Url",
    "Usage",
    "UsbArrived",
    "UsbBoard",
    "UsbGadget",
    "UsbLeft",
    "UsbWatch",
    "WriteTimeout",
    "check",
    "describe",
    "innermost",
    "listen",
    "open",
    "open_usb_device",
    "pair",
    "schemes",
    "sync_ports",
    "usb_boards",
    "watch_usb",
]

# Names of drivers, which are loaded when they are first used.
_LATER = {
    "FrameSeen": "._usb.sync",
    "SyncPort": "._usb.sync",
    "UsbArrived": "._usb.watch",
    "UsbBoard": "._usb.board",
    "UsbGadget": "._gadget.gadget",
    "UsbLeft": "._usb.watch",
    "UsbWatch": "._usb.watch",
    "open_usb_device": "._usb.link",
    "sync_ports": "._usb.sync",
    "usb_boards": "._usb.find",
    "watch_usb": "._usb.watch",
}


def __getattr__(name: str) -> Any:
    if name not in _LATER:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_LATER[name], __name__), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_LATER})


def pair() -> tuple[Transport, Transport]:
    """Return two transports joined in memory: what one writes the other reads."""
    from ._loopback import pair as make_pair  # noqa: PLC0415 - a driver, loaded when used

    return make_pair()
