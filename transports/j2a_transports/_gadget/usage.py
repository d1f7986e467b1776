"""`gadget:` URLs and their options.

In: nothing.  Out: `LISTEN`.
"""

from __future__ import annotations

import re
from typing import Final

from j2a_transports._scheme import Option, Usage
from j2a_transports.options import boolean, integer

from .descriptors import PRODUCT, VENDOR
from .link import CHUNK


def _usb_id(value: str) -> int:
    """four hexadecimal digits."""
    if not re.fullmatch("[0-9A-Fa-f]{4}", value):
        raise ValueError
    return int(value, 16)


def _usb_string(value: str) -> str:
    """1 to 126 characters, none of them a control character."""
    if not 0 < len(value.encode("utf-16-le")) <= 252 or not value.isprintable():
        raise ValueError
    return value


def _gadget_name(value: str) -> str:
    """1 to 32 letters, digits, - and _."""
    if not re.fullmatch("[A-Za-z0-9_-]{1,32}", value):
        raise ValueError
    return value


LISTEN: Final = Usage(
    "gadget:",
    "this computer as a USB board",
    ("gadget:?serial=0001",),
    (
        Option("serial", _usb_string, "serial number, else that of the computer, or its name"),
        Option("vendor", _usb_id, "vendor id", f"{VENDOR:04x}"),
        Option("product", _usb_id, "product id", f"{PRODUCT:04x}"),
        Option("manufacturer", _usb_string, "what the host shows as manufacturer", "J2A"),
        Option("product_name", _usb_string, "what the host shows as product", "J2A device"),
        Option("name", _gadget_name, "name of the gadget in configfs", "j2a"),
        Option("udc", _usb_string, "name of the device controller, where there are several"),
        Option("sync", boolean, "whether to have the interface SyncUSB", "1"),
        Option(
            "buffer",
            integer(1, 1 << 20),
            "bytes that are asked for at once; 64 is for hosts that send no empty packet after a "
            "full last one",
            str(CHUNK),
            "bytes",
        ),
    ),
)
