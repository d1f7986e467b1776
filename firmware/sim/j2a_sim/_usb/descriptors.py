"""USB descriptors as a host sees them, declared with construct (USB 2.0, section 9.6).

In: the bytes that a device answers to GET_DESCRIPTOR. Out: the fields under the standard's names.
Rule: what cannot be descriptors is a SimError that says where it goes wrong.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final

import construct as cs
from j2a_spec import usb as spec

from j2a_sim._errors import SimError

TYPE_MASK: Final = 0x03  # of bmAttributes of an endpoint
SELF_POWERED: Final = 0x40  # of bmAttributes of a configuration
IN: Final = 0x80  # in an endpoint's address, and in bmRequestType
# Bits 12 and 11 of wMaxPacketSize are further transactions of a high-speed microframe.
PACKET_MASK: Final = 0x7FF

_HEAD = ("bLength" / cs.Byte, "bDescriptorType" / cs.Byte)
_CONFIGURATION = cs.Struct(
    *_HEAD,
    "wTotalLength" / cs.Int16ul,
    "bNumInterfaces" / cs.Byte,
    "bConfigurationValue" / cs.Byte,
    "iConfiguration" / cs.Byte,
    "bmAttributes" / cs.Byte,
    "bMaxPower" / cs.Byte,
)
_INTERFACE = cs.Struct(
    *_HEAD,
    "bInterfaceNumber" / cs.Byte,
    "bAlternateSetting" / cs.Byte,
    "bNumEndpoints" / cs.Byte,
    "bInterfaceClass" / cs.Byte,
    "bInterfaceSubClass" / cs.Byte,
    "bInterfaceProtocol" / cs.Byte,
    "iInterface" / cs.Byte,
)
SETUP = cs.Struct(
    "bmRequestType" / cs.Byte,
    "bRequest" / cs.Byte,
    "wValue" / cs.Int16ul,
    "wIndex" / cs.Int16ul,
    "wLength" / cs.Int16ul,
)


@dataclass(slots=True)
class Described:
    """A descriptor with what follows it before the next of its kind.

    Attributes:
        fields: the descriptor, with the standard's names as attributes.
        extra: descriptors of other types that follow it, such as class-specific ones, as bytes.
        parts: the interfaces of a configuration (one for each alternate setting), or the endpoints
            of an interface.
    """

    fields: Any
    extra: bytes = b""
    parts: list[Described] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Descriptors:
    """What a device has told of itself.

    Attributes:
        device: the fields of its device descriptor.
        configurations: its configurations, in their order.
    """

    device: Any
    configurations: tuple[Described, ...]

    def configuration(self, value: int) -> Described | None:
        """Return the configuration with this bConfigurationValue."""
        for configuration in self.configurations:
            if configuration.fields.bConfigurationValue == value:
                return configuration
        return None

    @property
    def self_powered(self) -> bool:
        """Whether the device has power of its own, in its first configuration."""
        return bool(self.configurations[0].fields.bmAttributes & SELF_POWERED)

    def packet(self, endpoint: int) -> int:
        """Return the largest packet of an endpoint, in bytes; 64 for one that is not described."""
        for configuration in self.configurations:
            for interface in configuration.parts:
                for part in interface.parts:
                    if part.fields.bEndpointAddress == endpoint:
                        return int(part.fields.wMaxPacketSize & PACKET_MASK) or 64
        return 64


def parse_device(data: bytes) -> Any:
    """Return the fields of a device descriptor.

    Raises:
        SimError: it is none.
    """
    try:
        return spec.device.parse(data)
    except cs.ConstructError as error:
        raise SimError(f"{len(data)} bytes are no device descriptor: {error}") from None


def parse_configuration(data: bytes) -> Described:
    """Take a configuration descriptor and all that belongs to it apart.

    Args:
        data: wTotalLength bytes.

    Raises:
        SimError: a descriptor is cut off, or out of order.
    """
    found: Described | None = None
    at = 0
    while at < len(data):
        size = data[at]
        chunk = data[at : at + size]
        if size < 2 or len(chunk) < size:
            raise SimError(f"the configuration descriptor is damaged at byte {at}")
        try:
            found = _add(found, chunk)
        except cs.ConstructError:
            raise SimError(f"a descriptor at byte {at} of a configuration is too short") from None
        at += size
    if found is None:
        raise SimError("the configuration descriptor is empty")
    return found


def _add(found: Described | None, chunk: bytes) -> Described:
    """Put one descriptor into its place in a configuration; returns the configuration."""
    kind = chunk[1]
    if found is None:
        if kind != spec.CONFIGURATION:
            raise SimError(f"a configuration begins with a descriptor of type {kind}")
        return Described(_CONFIGURATION.parse(chunk))
    if kind == spec.INTERFACE:
        found.parts.append(Described(_INTERFACE.parse(chunk)))
        return found
    if kind == spec.ENDPOINT:
        if not found.parts:
            raise SimError("an endpoint descriptor comes before the first interface")
        found.parts[-1].parts.append(Described(spec.endpoint.parse(chunk)))
        return found
    last = found
    while last.parts:
        last = last.parts[-1]
    last.extra += chunk
    return found
