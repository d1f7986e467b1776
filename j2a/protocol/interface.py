"""Reads the interface of a device and decides whether it can be used (SPEC.md, section 20).

What flows in: the bytes that a2jGetInterface returns, the hash and the mapping. What flows out: the
interface, or an error that says what is wrong with it.
Rules: no input and no output of its own; the size of what is accepted, and of what is kept for
other links of this process, is bounded.
"""

import zlib
from collections import OrderedDict
from collections.abc import Sequence
from typing import Final

from j2a_spec.constants import PROP_INTERFACE

from j2a.errors import ProtocolError, SignatureError
from j2a.types.model import Interface
from j2a.types.parser import parse_interface

__all__ = ["MAX_INTERFACE", "check_interface", "kept_interface"]

MAX_INTERFACE: Final = 65536
"""More bytes are not read (J2A-IFACE-008)."""

_MAX_KEPT: Final = 64

# By hash and mapping, so that the interface of another device is not taken for this one's.
_kept: OrderedDict[tuple[str, tuple[str, ...]], Interface] = OrderedDict()


def kept_interface(announced: str, mapped: Sequence[str]) -> Interface | None:
    """Return the interface of this hash that was read before, if there is one (J2A-IFACE-012)."""
    return _kept.get((announced, tuple(mapped)))


def check_interface(content: bytes, announced: str, mapped: Sequence[str]) -> Interface:
    """Return what the interface of a device says.

    Args:
        content: what a2jGetInterface returned.
        announced: the property j2a.interface, its hash.
        mapped: the names of the mapping, in opcode order.

    Raises:
        ProtocolError: it breaks a rule, so none of it can be used (J2A-IFACE-009).
    """
    crc = f"{zlib.crc32(content):08x}"
    if crc != announced:
        raise ProtocolError(
            f"the CRC-32 of the interface is {crc}, but {PROP_INTERFACE} says {announced!r:.20}"
        )
    try:
        interface = parse_interface(content.decode())
    except UnicodeDecodeError as error:
        raise ProtocolError(f"the interface is not UTF-8: {error.reason}") from None
    except SignatureError as error:
        raise ProtocolError(f"the interface breaks the rules of its language: {error}") from None
    names = [function.name for function in interface.functions]
    if names[: len(mapped)] != list(mapped):
        raise ProtocolError("the interface does not begin with the names of the function map")
    _kept[announced, tuple(mapped)] = interface
    while len(_kept) > _MAX_KEPT:
        _kept.popitem(last=False)
    return interface
