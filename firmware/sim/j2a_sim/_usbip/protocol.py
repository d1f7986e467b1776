"""The messages of USB/IP 1.1.1, declared with construct.

In and out: bytes on the connection, and fields by the names of the Linux kernel's description of
the protocol (Documentation/usb/usbip_protocol.rst). All numbers are big endian, but for the setup
packet, which travels as on the bus.
Rule: what is no message is a BadMessage; nothing here trusts a length of the other side.
"""

from __future__ import annotations

from typing import Any, Final

import construct as cs

VERSION: Final = 0x0111
TCP_PORT: Final = 3240

REQ_DEVLIST: Final = 0x8005
REP_DEVLIST: Final = 0x0005
REQ_IMPORT: Final = 0x8003
REP_IMPORT: Final = 0x0003

# Status of a reply to one of these requests.
ST_OK: Final = 0
ST_NA: Final = 1
ST_DEV_BUSY: Final = 2
ST_DEV_ERR: Final = 3
ST_NODEV: Final = 4

CMD_SUBMIT: Final = 1
CMD_UNLINK: Final = 2
RET_SUBMIT: Final = 3
RET_UNLINK: Final = 4

DIR_OUT: Final = 0
DIR_IN: Final = 1
URB_ZERO_PACKET: Final = 0x0040
SPEED_FULL: Final = 2
# Above these a client is not believed.
MOST_DATA: Final = 1 << 20
MOST_PACKETS: Final = 1024
ISO_PACKET_SIZE: Final = 16

OP = cs.Struct(
    "version" / cs.Int16ub,
    "code" / cs.Int16ub,
    "status" / cs.Int32ub,
)
BUSID_SIZE: Final = 32
BUSID = cs.PaddedString(BUSID_SIZE, "ascii")
DEVICE = cs.Struct(
    "path" / cs.PaddedString(256, "ascii"),
    "busid" / BUSID,
    "busnum" / cs.Int32ub,
    "devnum" / cs.Int32ub,
    "speed" / cs.Int32ub,
    "idVendor" / cs.Int16ub,
    "idProduct" / cs.Int16ub,
    "bcdDevice" / cs.Int16ub,
    "bDeviceClass" / cs.Byte,
    "bDeviceSubClass" / cs.Byte,
    "bDeviceProtocol" / cs.Byte,
    "bConfigurationValue" / cs.Byte,
    "bNumConfigurations" / cs.Byte,
    "bNumInterfaces" / cs.Byte,
)
INTERFACE = cs.Struct(
    "bInterfaceClass" / cs.Byte,
    "bInterfaceSubClass" / cs.Byte,
    "bInterfaceProtocol" / cs.Byte,
    cs.Padding(1),
)
DEVLIST = cs.PrefixedArray(
    cs.Int32ub,
    cs.Struct("device" / DEVICE, "interfaces" / INTERFACE[cs.this.device.bNumInterfaces]),
)

_SUBMIT = cs.Struct(
    "transfer_flags" / cs.Int32ub,
    "transfer_buffer_length" / cs.Int32sb,
    "start_frame" / cs.Int32sb,
    "number_of_packets" / cs.Int32sb,
    "interval" / cs.Int32sb,
    "setup" / cs.Bytes(8),
)
_UNLINK = cs.Struct("unlink_seqnum" / cs.Int32ub, cs.Padding(24))
_SUBMITTED = cs.Struct(
    "status" / cs.Int32sb,
    "actual_length" / cs.Int32sb,
    "start_frame" / cs.Default(cs.Int32sb, 0),
    "number_of_packets" / cs.Default(cs.Int32sb, 0),
    "error_count" / cs.Default(cs.Int32sb, 0),
    cs.Padding(8),
)
_UNLINKED = cs.Struct("status" / cs.Int32sb, cs.Padding(24))
HEADER = cs.Struct(
    "command" / cs.Int32ub,
    "seqnum" / cs.Int32ub,
    "devid" / cs.Default(cs.Int32ub, 0),
    "direction" / cs.Default(cs.Int32ub, 0),
    "ep" / cs.Default(cs.Int32ub, 0),
    "u"
    / cs.Switch(
        cs.this.command,
        {
            CMD_SUBMIT: _SUBMIT,
            CMD_UNLINK: _UNLINK,
            RET_SUBMIT: _SUBMITTED,
            RET_UNLINK: _UNLINKED,
        },
        default=cs.Error,
    ),
)
HEADER_SIZE: Final = 48


class BadMessage(Exception):  # noqa: N818 - the name says what came
    """The other side does not speak this protocol, or asks for more than is believed."""


def parse_command(data: bytes) -> Any:
    """Return the fields of a command.

    Args:
        data: HEADER_SIZE bytes.

    Raises:
        BadMessage: it is no CMD_SUBMIT or CMD_UNLINK, or one of its numbers is out of range.
    """
    try:
        header = HEADER.parse(data)
    except cs.ConstructError:
        raise BadMessage(f"no command: {data[:4].hex()}") from None
    if header.command not in {CMD_SUBMIT, CMD_UNLINK}:
        raise BadMessage(f"command {header.command} is none of a client")
    if header.command == CMD_SUBMIT:
        if header.direction not in {DIR_OUT, DIR_IN} or header.ep > 15:
            raise BadMessage(f"direction {header.direction}, endpoint {header.ep}")
        if not 0 <= header.u.transfer_buffer_length <= MOST_DATA:
            raise BadMessage(f"{header.u.transfer_buffer_length} bytes in a transfer")
        if not -1 <= header.u.number_of_packets <= MOST_PACKETS:
            raise BadMessage(f"{header.u.number_of_packets} packets in a transfer")
    return header


def following(header: Any) -> int:
    """Return how many bytes follow a command: data to the device, and isochronous packets."""
    if header.command != CMD_SUBMIT:
        return 0
    data = header.u.transfer_buffer_length if header.direction == DIR_OUT else 0
    return int(data + max(0, header.u.number_of_packets) * ISO_PACKET_SIZE)


def returned(seqnum: int, status: int, data: bytes = b"", actual: int | None = None) -> bytes:
    """Build a RET_SUBMIT.

    Args:
        seqnum: of the command.
        status: 0, or an errno with a minus sign.
        data: what came from the device.
        actual: how many bytes went to the device; None for a transfer from the device.
    """
    length = len(data) if actual is None else actual
    fields = {"status": status, "actual_length": length}
    return bytes(HEADER.build({"command": RET_SUBMIT, "seqnum": seqnum, "u": fields})) + data


def unlinked(seqnum: int, status: int) -> bytes:
    """Build a RET_UNLINK; the status is -ECONNRESET when the transfer was still under way."""
    fields = {"command": RET_UNLINK, "seqnum": seqnum, "u": {"status": status}}
    return bytes(HEADER.build(fields))


def reply(code: int, status: int = ST_OK) -> bytes:
    """Build the head of a reply to a request for a list or an import."""
    return bytes(OP.build({"version": VERSION, "code": code, "status": status}))
