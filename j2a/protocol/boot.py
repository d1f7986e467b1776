"""The boot SIF: what a device says when it begins anew (SPEC.md, section 21).

What flows in and out: the payload of the SIF, and what it means. Rule: any bytes mean something.
"""

import struct
from contextlib import suppress
from typing import Final

from j2a_spec.constants import BOOT_BYTES

from j2a.events import ResetCause, Restart

__all__ = ["pack_boot", "unpack_boot"]

_LAYOUT: Final = struct.Struct("<BHL")


def pack_boot(cause: ResetCause, count: int, interface_hash: str) -> bytes:
    """Return the payload of a boot SIF (J2A-BOOT-002).

    Args:
        cause: why the device began anew.
        count: number of this start, 0..65535.
        interface_hash: the property j2a.interface, 8 hexadecimal digits.
    """
    return _LAYOUT.pack(cause, count, int(interface_hash, 16))


def unpack_boot(payload: bytes) -> Restart:
    """Return what the payload of a boot SIF says (J2A-BOOT-007).

    One that is too short says nothing; what is behind its 7 bytes is ignored.
    """
    if len(payload) < BOOT_BYTES:
        return Restart()
    number, count, crc = _LAYOUT.unpack_from(payload)
    cause = ResetCause.UNKNOWN
    with suppress(ValueError):
        cause = ResetCause(number)
    return Restart(cause, count, f"{crc:08x}")
