"""The functions of the scripted device, and its answers that no case checks.

What flows in: requests. What flows out: the return value and the payload of a reply. Rules: frozen;
a case that needs another device states it, and the host meets that over a new link.
"""

import re
from dataclasses import dataclass, field, fields, replace
from functools import cache
from typing import Any, Self

from j2a_spec import constants as c

__all__ = [
    "BARE",
    "DEMO",
    "FETCH",
    "OLD",
    "PING",
    "ROOMY",
    "STORE",
    "Device",
    "NotingDevice",
    "chunk_reply",
    "pattern",
    "properties_content",
]

PING = "ping"
FETCH = "fetch"
STORE = "store"

_ROOM = re.compile("[1-9][0-9]{1,2}")


def pattern(size: int) -> bytes:
    """Return `size` bytes whose period does not divide that of chunks or of offsets."""
    return (bytes(range(7)) * (size // 7 + 1))[:size]


def chunk_reply(code: int, flags: int, offset: int, data: bytes = b"") -> bytes:
    """Return the payload of a reply of a2jMany; `flags` may hold any bits, `offset` in bytes."""
    return bytes((code, flags)) + offset.to_bytes(4, "little") + data


@cache
def properties_content(properties: tuple[tuple[str, str], ...]) -> bytes:
    """Return what a2jGetProperties has; the grammar would refuse what some cases are about."""
    return "".join(f"{key}\0{value}\0" for key, value in properties).encode()


@dataclass(frozen=True, slots=True)
class Device:
    """A device as a host sees it.

    Attributes:
        names: of its functions in opcode order.
        mapping: code and payload of the reply of a2jGetMapping; None is the one that `names` make.
        properties: keys and values; None where a2jGetProperties is refused.
        interface: what a read of a2jGetInterface gives, or None.
        transds: what a read of a2jGetTransds gives, or None.
        content: what a read of `fetch` gives.
        chunk: the most data that it puts into a chunk, 1..249 bytes.
        offset_mask: the bits of an offset that it honours; 0xFF is a device of 2014.
    """

    names: tuple[str, ...] = (*c.BUILTINS, PING, FETCH, STORE)
    mapping: tuple[int, bytes] | None = None
    properties: tuple[tuple[str, str], ...] | None = (
        ("name", "conductor"),
        (c.PROP_SPEC, c.SPEC_VERSION),
    )
    interface: bytes | None = None
    transds: bytes | None = None
    content: bytes = b"content"
    chunk: int = c.MANY_DATA
    offset_mask: int = 0xFFFFFFFF

    @classmethod
    def of(cls, device: "Device", **more: Any) -> Self:
        """Return a device of this class that has what another one has, and more."""
        return cls(**{known.name: getattr(device, known.name) for known in fields(Device)}, **more)

    def opcode(self, name: str) -> int:
        """Return the opcode of a function that the device has."""
        return self.names.index(name)

    @property
    def room(self) -> int:
        """The property j2a.room in bytes, 255 where the device does not announce it."""
        text = dict(self.properties or ()).get(c.PROP_ROOM, "")
        is_room = _ROOM.fullmatch(text) and c.MIN_ROOM <= int(text) < c.MAX_PAYLOAD
        return int(text) if is_room else c.MAX_PAYLOAD

    @property
    def rxbuf(self) -> int:
        """The property j2a.rxbuf in bytes, or 0 where the device does not announce it."""
        return int(dict(self.properties or ()).get(c.PROP_RXBUF, "0"))

    def asks_about_it(self, opcode: int, payload: bytes) -> bool:
        """Tell whether a request asks for the mapping, the properties, the interface or the
        descriptors of transducers.

        A host may ask for them whenever it likes, so cases leave such requests to the device.
        """
        if c.MANY in self.names and opcode == self.names.index(c.MANY):
            about = (c.GET_PROPERTIES, c.GET_INTERFACE, c.GET_TRANSDS)
            return payload[:1] in [bytes((self.opcode(n),)) for n in about if n in self.names]
        return opcode == 0

    def answer(self, opcode: int, payload: bytes) -> tuple[int, bytes]:
        """Return the code and the payload of the reply to a request."""
        if opcode == 0:
            return self._map()
        name = self.names[opcode] if opcode < len(self.names) else ""
        if name and len(payload) > self.room:
            return c.RET_FAILED, b""
        if name == c.GET_ECHO:
            return c.ECHO, payload
        if name == PING:
            return c.RET_OK, payload
        if name == c.GET_DEBUG:
            return c.RET_OK, b""
        if name == c.MANY and len(payload) >= c.MANY_HEADER:
            return self._many(payload)
        return (c.RET_FAILED, b"") if name == c.MANY else (c.ERR_OPCODE, b"\x01\x00")

    def _map(self) -> tuple[int, bytes]:
        if self.mapping is not None:
            return self.mapping
        return c.RET_OK, b"".join(name.encode() + b"\0" for name in self.names)

    def _many(self, payload: bytes) -> tuple[int, bytes]:
        func, flags, offset = payload[0], payload[1], int.from_bytes(payload[2:6], "little")
        name, is_write = self.names[func] if func < len(self.names) else "", flags & c.FLAG_WRITE
        if name == c.GET_ECHO_MANY:
            last = flags & c.FLAG_LAST
            return c.RET_OK, chunk_reply(c.ECHO_MANY, last, offset, payload[6:])
        contents = {FETCH: self.content}
        if self.properties is not None:
            contents[c.GET_PROPERTIES] = properties_content(self.properties)
        if self.interface is not None:
            contents[c.GET_INTERFACE] = self.interface
        if self.transds is not None:
            contents[c.GET_TRANSDS] = self.transds
        if name == STORE and is_write:
            return c.RET_OK, chunk_reply(c.RET_OK, c.FLAG_LAST, offset)
        if name not in contents:
            return c.ERR_OPCODE, b"\x02\x00"
        if is_write:
            return c.RET_OK, chunk_reply(c.RET_FAILED, 0, offset)
        start = offset & self.offset_mask
        data = contents[name][start : start + self.chunk]
        is_last = start + len(data) >= len(contents[name])
        return c.RET_OK, chunk_reply(c.RET_OK, c.FLAG_LAST if is_last else 0, offset, data)


@dataclass(frozen=True)
class NotingDevice(Device):
    """A device that notes requests to a2jMany about itself, as those for its properties are."""

    asked: list[bytes] = field(default_factory=list)

    def answer(self, opcode: int, payload: bytes) -> tuple[int, bytes]:
        """Return the code and the payload of the reply to a request."""
        if opcode and self.asks_about_it(opcode, payload):
            self.asked.append(payload)
        return super().answer(opcode, payload)


DEMO = Device()
"""The device of most cases."""

ROOMY = replace(DEMO, properties=((c.PROP_SPEC, c.SPEC_VERSION), (c.PROP_RXBUF, "1000")))
"""A device with room for several requests, so that calls may wait together."""

OLD = Device(
    names=tuple(name for name in DEMO.names if name not in (c.GET_PROPERTIES, c.GET_DEBUG)),
    properties=None,
    offset_mask=0xFF,
)
"""A device of 2014: without properties, with a2jMany that looks at the lowest byte of an offset."""

BARE = Device(names=tuple(n for n in DEMO.names if n not in c.WITH_MANY), properties=None)
"""A device without a2jMany; what it has at opcode 1 is a2jDebug."""
