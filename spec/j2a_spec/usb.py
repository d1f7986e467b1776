"""USB: descriptors and the packets of SyncUSB, declared with construct.

What flows in and out: bytes as they travel on the bus, and the fields by the names of the USB 2.0
specification, chapter 9. Rules: nothing here knows of a board or a host; tests take from here what
the descriptors of both have to be.
"""

from typing import Any, Final

import construct as cs

DEVICE: Final = 1
CONFIGURATION: Final = 2
STRING: Final = 3
INTERFACE: Final = 4
ENDPOINT: Final = 5

BULK: Final = 2
INTERRUPT: Final = 3
"""Transfer type: the two lowest bits of bmAttributes of an endpoint."""

device = cs.Struct(
    "bLength" / cs.Const(18, cs.Int8ul),
    "bDescriptorType" / cs.Const(DEVICE, cs.Int8ul),
    "bcdUSB" / cs.Int16ul,
    "bDeviceClass" / cs.Int8ul,
    "bDeviceSubClass" / cs.Int8ul,
    "bDeviceProtocol" / cs.Int8ul,
    "bMaxPacketSize0" / cs.OneOf(cs.Int8ul, (8, 16, 32, 64)),
    "idVendor" / cs.Int16ul,
    "idProduct" / cs.Int16ul,
    "bcdDevice" / cs.Int16ul,
    "iManufacturer" / cs.Int8ul,
    "iProduct" / cs.Int8ul,
    "iSerialNumber" / cs.Int8ul,
    "bNumConfigurations" / cs.Int8ul,
)

_configuration_head = cs.Struct(
    "bLength" / cs.Const(9, cs.Int8ul),
    "bDescriptorType" / cs.Const(CONFIGURATION, cs.Int8ul),
    "wTotalLength" / cs.Int16ul,
    "bNumInterfaces" / cs.Int8ul,
    "bConfigurationValue" / cs.Int8ul,
    "iConfiguration" / cs.Int8ul,
    # Bit 7 is always set; 6: has power of its own; 5: can wake the host.
    "bmAttributes" / cs.Int8ul,
    # In units of 2 mA.
    "bMaxPower" / cs.Int8ul,
)

endpoint = cs.Struct(
    "bLength" / cs.Const(7, cs.Int8ul),
    "bDescriptorType" / cs.Const(ENDPOINT, cs.Int8ul),
    "bEndpointAddress" / cs.Int8ul,
    "bmAttributes" / cs.Int8ul,
    "wMaxPacketSize" / cs.Int16ul,
    "bInterval" / cs.Int8ul,
)

interface = cs.Struct(
    "bLength" / cs.Const(9, cs.Int8ul),
    "bDescriptorType" / cs.Const(INTERFACE, cs.Int8ul),
    "bInterfaceNumber" / cs.Int8ul,
    "bAlternateSetting" / cs.Int8ul,
    "bNumEndpoints" / cs.Int8ul,
    "bInterfaceClass" / cs.Int8ul,
    "bInterfaceSubClass" / cs.Int8ul,
    "bInterfaceProtocol" / cs.Int8ul,
    "iInterface" / cs.Int8ul,
    "endpoints" / cs.Array(cs.this.bNumEndpoints, endpoint),
)


def _is_whole(context: Any) -> bool:
    endpoints = sum(len(found.endpoints) for found in context.interfaces)
    return bool(context.head.wTotalLength == 9 + 9 * len(context.interfaces) + 7 * endpoints)


configuration = cs.Struct(
    "head" / _configuration_head,
    "interfaces" / cs.Array(cs.this.head.bNumInterfaces, interface),
    cs.Check(_is_whole),
    cs.Terminated,
)

string = cs.Prefixed(
    cs.ExprAdapter(cs.Int8ul, cs.obj_ - 1, cs.obj_ + 1),
    cs.FocusedSeq(
        "text",
        cs.Const(STRING, cs.Int8ul),
        "text" / cs.GreedyString("utf-16-le"),
        cs.Terminated,
    ),
)

sync = cs.Struct(
    "time_us" / cs.Int64ul,
    "frame" / cs.ExprValidator(cs.Int16ul, lambda frame, _context: frame < 2048),
    cs.Terminated,
)
"""A packet of SyncUSB (SYNC-002): microseconds since the Unix epoch, number of the USB frame."""

seen = cs.Struct(
    "nonce" / cs.Int16ul,
    "frame" / cs.Int16ul,
    "age_us" / cs.Int16ul,
    cs.Terminated,
)
"""The answer to the request of SyncUSB (SYNC-008): wValue, number of the last frame, its age."""
