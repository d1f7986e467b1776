"""The data that a gadget passes to FunctionFS: descriptors and strings, and the events it gets.

In: which interfaces there are.  Out: the two blocks that are written to `ep0`, and their numbers.
Rules: layouts are those of `linux/usb/functionfs.h` and of chapter 9 of the USB specifications;
all numbers are little endian; the interface for the time (SyncUSB) is always the second one.
"""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import Final

from j2a_transports._usb.board import LINK_CLASS, SYNC_CLASS

VENDOR: Final = 0x6666
PRODUCT: Final = 0xCAFE
CLASS, SUBCLASS, PROTOCOL = LINK_CLASS
IN: Final = 0x81
OUT: Final = 0x02
_, SYNC_SUBCLASS, SYNC_PROTOCOL = SYNC_CLASS
SYNC_OUT: Final = 0x03
SYNC_SIZE: Final = 10
SYNC_NAME: Final = "SyncUSB"
NAME: Final = "J2A"

# Larger than a packet of SyncUSB, so that every such packet is a short one and ends a read.
SYNC_PACKET: Final = 16

EVENT_SIZE: Final = 12

_DESCRIPTORS_V2: Final = 3
_STRINGS: Final = 2
_US_ENGLISH: Final = 0x0409
_HAS_FULL_SPEED, _HAS_HIGH_SPEED, _HAS_SUPER_SPEED = 1, 2, 4
_INTERFACE, _ENDPOINT, _COMPANION = 4, 5, 0x30
_BULK, _INTERRUPT = 2, 3


class Event(IntEnum):
    """An event that FunctionFS reports on `ep0`; the number is byte 8 of the event."""

    BIND = 0
    UNBIND = 1
    ENABLE = 2
    DISABLE = 3
    SETUP = 4
    SUSPEND = 5
    RESUME = 6


def descriptor_block(*, sync: bool) -> bytes:
    """Return the descriptors for full, high and super speed, as `ep0` takes them first.

    Args:
        sync: whether there is the interface SyncUSB.
    """
    speeds = [
        # A bulk endpoint's packet, bInterval for one poll per millisecond, companions or not.
        _interfaces(sync, packet=64, interval=1, companions=False),
        _interfaces(sync, packet=512, interval=4, companions=False),
        _interfaces(sync, packet=1024, interval=4, companions=True),
    ]
    flags = _HAS_FULL_SPEED | _HAS_HIGH_SPEED | _HAS_SUPER_SPEED
    body = b"".join(struct.pack("<I", len(found)) for found in speeds)
    body += b"".join(b"".join(found) for found in speeds)
    return struct.pack("<III", _DESCRIPTORS_V2, 12 + len(body), flags) + body


def string_block(*, sync: bool) -> bytes:
    """Return the names of the interfaces, as `ep0` takes them second."""
    names = [NAME, SYNC_NAME] if sync else [NAME]
    body = struct.pack("<H", _US_ENGLISH) + b"".join(name.encode() + b"\0" for name in names)
    return struct.pack("<IIII", _STRINGS, 16 + len(body), len(names), 1) + body


def _interfaces(sync: bool, *, packet: int, interval: int, companions: bool) -> list[bytes]:
    """Return the descriptors of one speed, each alone, since the kernel wants their count."""

    def endpoint(address: int, kind: int, size: int, polled: int) -> list[bytes]:
        found = [struct.pack("<BBBBHB", 7, _ENDPOINT, address, kind, size, polled)]
        if companions:
            # One packet at a time, and for a periodic endpoint its bytes per interval.
            found.append(struct.pack("<BBBBH", 6, _COMPANION, 0, 0, size if polled else 0))
        return found

    found = [bytes([9, _INTERFACE, 0, 0, 2, CLASS, SUBCLASS, PROTOCOL, 1])]
    found += endpoint(IN, _BULK, packet, 0)
    found += endpoint(OUT, _BULK, packet, 0)
    if sync:
        found.append(bytes([9, _INTERFACE, 1, 0, 1, CLASS, SYNC_SUBCLASS, SYNC_PROTOCOL, 2]))
        found += endpoint(SYNC_OUT, _INTERRUPT, SYNC_PACKET, interval)
    return found
