"""The Service Discovery Protocol of Bluetooth, as much as it takes to find a serial port.

In: a way to exchange packets with an SDP server.  Out: the serial ports that it offers (Serial Port
Profile, UUID 0x1101) with name and RFCOMM channel; and the packet that registers one at BlueZ.
Rules: no socket and no clock here; whatever bytes the server sends, the only error is `SdpError`;
an answer is bounded in bytes, rounds and nesting.
Source: Bluetooth Core Specification, volume 3, part B.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from typing import Any, Final, NamedTuple
from uuid import UUID

PSM: Final = 1
# The most that one L2CAP packet can hold.
PACKET: Final = 65535

_BASE_UUID: Final = "-0000-1000-8000-00805f9b34fb"
_RFCOMM_UUID: Final = UUID(f"{3:08x}{_BASE_UUID}")

_ERROR_RESPONSE: Final = 0x01
_SEARCH_ATTRIBUTE_REQUEST: Final = 0x06
_SEARCH_ATTRIBUTE_RESPONSE: Final = 0x07
# These two are BlueZ's own, for programs on the same machine.
_REGISTER_REQUEST: Final = 0x75
_REGISTER_RESPONSE: Final = 0x76

_CLASSES: Final = 0x0001
_PROTOCOLS: Final = 0x0004
_BROWSE_GROUPS: Final = 0x0005
_PROFILES: Final = 0x0009
_NAME: Final = 0x0100

_MAX_ANSWER: Final = 65536
_MAX_ROUNDS: Final = 256
_MAX_DEPTH: Final = 16
# How much the server may send at a time: it knows best.
_MAX_ATTRIBUTE_BYTES: Final = 0xFFFF

_UNSIGNED, _SIGNED, _UUID, _TEXT, _BOOLEAN, _SEQUENCE, _ALTERNATIVE, _ADDRESS = range(1, 9)


class SdpError(ValueError):
    """The server refused, or its answer makes no sense; the message says what."""


class SerialService(NamedTuple):
    """A serial port that a device offers.

    Attributes:
        name: what the device calls it, perhaps empty.
        channel: its RFCOMM channel, 1 to 30.
    """

    name: str
    channel: int


def serial_services(exchange: Callable[[bytes], bytes]) -> list[SerialService]:
    """Ask a server for its serial ports.

    Args:
        exchange: sends one packet and returns the one that answers it.

    Returns:
        The services in the server's order; none when it has no serial port.

    Raises:
        SdpError: the server refused or its answer makes no sense.
    """
    pattern = _sequence(_uuid(0x1101))
    wanted = _sequence(_u16(_PROTOCOLS), _u16(_NAME))
    lists = bytearray()
    continuation = b""
    for round_ in range(_MAX_ROUNDS):
        body = (
            pattern
            + struct.pack(">H", _MAX_ATTRIBUTE_BYTES)
            + wanted
            + bytes([len(continuation)])
            + continuation
        )
        request = struct.pack(">BHH", _SEARCH_ATTRIBUTE_REQUEST, round_, len(body)) + body
        part, continuation = _answer(exchange(request), round_)
        lists += part
        if len(lists) > _MAX_ANSWER:
            raise SdpError(f"its answer is longer than {_MAX_ANSWER} bytes")
        if not continuation:
            return list(_services(parse_element(bytes(lists))))
    raise SdpError(f"its answer does not end after {_MAX_ROUNDS} packets")


def registration(name: str, channel: int) -> bytes:
    """Make the packet that registers a serial port at BlueZ's local socket.

    The record lives as long as the connection to that socket.

    Args:
        name: what the service is called.
        channel: its RFCOMM channel, 1 to 30.
    """
    attributes = {
        _CLASSES: _sequence(_uuid(0x1101)),
        _PROTOCOLS: _sequence(
            _sequence(_uuid(0x0100)), _sequence(_uuid(0x0003), struct.pack(">BB", 0x08, channel))
        ),
        # The group that a client sees that browses without knowing what it looks for.
        _BROWSE_GROUPS: _sequence(_uuid(0x1002)),
        _PROFILES: _sequence(_sequence(_uuid(0x1101), _u16(0x0102))),
        _NAME: _text(name),
    }
    record = _sequence(*(_u16(number) + value for number, value in attributes.items()))
    body = b"\0" + record
    return struct.pack(">BHH", _REGISTER_REQUEST, 0, len(body)) + body


def check_registration(answer: bytes) -> None:
    """Raise `SdpError` unless `answer` says that the record was registered."""
    _body(answer, 0, _REGISTER_RESPONSE)


def parse_element(data: bytes) -> Any:
    """Take one data element apart, which must fill `data`.

    Returns:
        None, int, bool, `UUID`, bytes (text and addresses), or a list of such (sequence,
        alternative).

    Raises:
        SdpError: it is none, is cut off, has bytes after it, or is nested too deeply.
    """
    value, end = _element(data, 0, 0)
    if end != len(data):
        raise SdpError(f"{len(data) - end} bytes follow the end of its answer")
    return value


def _answer(packet: bytes, transaction: int) -> tuple[bytes, bytes]:
    """Return the attribute bytes and the continuation state of one response."""
    body = _body(packet, transaction, _SEARCH_ATTRIBUTE_RESPONSE)
    if len(body) < 3:
        raise SdpError("its answer is cut off")
    (count,) = struct.unpack_from(">H", body)
    part, rest = body[2 : 2 + count], body[2 + count :]
    if len(part) != count or not rest or len(rest) != 1 + rest[0]:
        raise SdpError("the lengths in its answer do not fit")
    if rest[0] and not count:
        raise SdpError("it promises more but sends nothing")
    return part, rest[1:]


def _body(packet: bytes, transaction: int, kind: int) -> bytes:
    if len(packet) < 5:
        raise SdpError("its answer is cut off")
    got, number, length = struct.unpack_from(">BHH", packet)
    body = packet[5:]
    if length != len(body):
        raise SdpError("the lengths in its answer do not fit")
    if got == _ERROR_RESPONSE:
        raise SdpError(f"it refuses the request with error {body[:2].hex() or 'unknown'}")
    if (got, number) != (kind, transaction):
        raise SdpError(f"it sent packet {got:#04x} number {number} instead of the answer")
    return body


def _element(data: bytes, at: int, depth: int) -> tuple[Any, int]:
    """Return the value of the element at `at`, and where it ends."""
    if depth > _MAX_DEPTH:
        raise SdpError("its answer is nested too deeply")
    start, end = _extent(data, at)
    kind, body = data[at] >> 3, data[start:end]
    if kind == 0:
        return None, end
    if kind == _UNSIGNED:
        return int.from_bytes(body, "big"), end
    if kind == _SIGNED:
        return int.from_bytes(body, "big", signed=True), end
    if kind == _UUID:
        return _to_uuid(body), end
    if kind in (_TEXT, _ADDRESS):
        return body, end
    if kind == _BOOLEAN:
        return any(body), end
    if kind in (_SEQUENCE, _ALTERNATIVE):
        values = []
        while start < end:
            value, start = _element(data, start, depth + 1)
            values.append(value)
        if start != end:
            raise SdpError("an element in its answer is longer than what holds it")
        return values, end
    raise SdpError(f"its answer has an element of the unknown type {kind}")


def _extent(data: bytes, at: int) -> tuple[int, int]:
    """Return where the body of the element at `at` starts and ends."""
    if at >= len(data):
        raise SdpError("its answer is cut off")
    kind, size = data[at] >> 3, data[at] & 7
    start = at + 1
    if size < 5:
        length = 0 if kind == 0 else 1 << size
    else:
        width = 1 << size - 5
        length = int.from_bytes(data[start : start + width], "big")
        start += width
    if start + length > len(data):
        raise SdpError("its answer is cut off")
    return start, start + length


def _to_uuid(body: bytes) -> UUID:
    if len(body) in (2, 4):
        return UUID(f"{int.from_bytes(body, 'big'):08x}{_BASE_UUID}")
    if len(body) != 16:
        raise SdpError(f"a UUID in its answer has {len(body)} bytes")
    return UUID(bytes=body)


def _services(records: Any) -> Iterator[SerialService]:
    """Yield the services that have a channel; a record is a list of attribute, value, ..."""
    for record in records if isinstance(records, list) else []:
        if not isinstance(record, list):
            continue
        found = dict(
            pair
            for pair in zip(record[::2], record[1::2], strict=False)
            if isinstance(pair[0], int)
        )
        channel = _channel(found.get(_PROTOCOLS))
        name = found.get(_NAME)
        if channel is not None:
            text = name.decode("utf-8", "replace") if isinstance(name, bytes) else ""
            yield SerialService(text.rstrip("\0"), channel)


def _channel(protocols: Any) -> int | None:
    """Find [RFCOMM, channel] in a protocol list, or in the first alternative that has it."""
    if not isinstance(protocols, list):
        return None
    if protocols[:1] == [_RFCOMM_UUID] and len(protocols) > 1:
        channel = protocols[1]
        # A truth value is an int, too.
        return channel if type(channel) is int and 1 <= channel <= 30 else None
    for protocol in protocols:
        if (channel := _channel(protocol)) is not None:
            return channel
    return None


def _sequence(*parts: bytes) -> bytes:
    body = b"".join(parts)
    if len(body) > 0xFF:
        return struct.pack(">BH", _SEQUENCE << 3 | 6, len(body)) + body
    return bytes([_SEQUENCE << 3 | 5, len(body)]) + body


def _text(value: str) -> bytes:
    # Cutting may leave half a character, which is taken away.
    body = value.encode()[:255].decode(errors="ignore").encode()
    return bytes([_TEXT << 3 | 5, len(body)]) + body


def _uuid(short: int) -> bytes:
    return struct.pack(">BH", _UUID << 3 | 1, short)


def _u16(value: int) -> bytes:
    return struct.pack(">BH", _UNSIGNED << 3 | 1, value)
