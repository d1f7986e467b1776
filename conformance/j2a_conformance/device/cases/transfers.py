"""Transfers: their ends, short headers, the end of the offsets, several at once (J2A-MANY)."""

from collections.abc import Iterator

from j2a_spec import constants as c

from j2a_conformance._judge import fail, inform
from j2a_conformance.device._case import Case
from j2a_conformance.device._peer import Peer, Request
from j2a_conformance.wire._dimensions import payload_of

from .many import echo_many

_END = 2**32 - 1
_LONG_S = 0.5


class ShortHeaderPayload(Case):
    """Calls a2jMany with 0 to 5 bytes of many kinds."""

    ID = "many.short-header-payload"
    EXPECTATION = "0xFF without a payload."
    REQUIREMENTS = ("J2A-MANY-015",)
    LEVEL = "many"
    NEEDS = (c.MANY,)

    def _run(self, peer: Peer) -> None:
        opcode = peer.opcode(c.MANY)
        header = bytes((peer.opcode(c.GET_ECHO_MANY), 1, 2, 3, 4))
        for length in range(c.MANY_HEADER):
            for payload in (header[:length], b"\xff" * length, bytes(length), b"\x12" * length):
                peer.ask(peer.request(opcode, payload, c.RET_FAILED, b""))


class EmptyLast(Case):
    """Sends an empty last chunk behind other chunks, to a2jEchoMany and to `store`."""

    ID = "many.empty-last"
    EXPECTATION = "It is answered like any other, and `store` keeps what came before it."
    REQUIREMENTS = ("J2A-MANY-020",)
    LEVEL = "many"
    NEEDS = (c.MANY,)

    def _run(self, peer: Peer) -> None:
        for offset in (0, 1, 249, 255, 256, 65536, _END):
            echo_many(peer, c.FLAG_WRITE | c.FLAG_LAST, offset, b"")
        if not peer.has("store"):
            return
        for parts in ((b"first",), (b"first", b"second"), (bytes(range(26)),) * 3):
            whole = b"".join(parts)
            offset = 0
            for part in (*parts, b""):
                flags = c.FLAG_WRITE | (0 if part else c.FLAG_LAST)
                reply = peer.ask_many(peer.many("store", flags, offset, part))
                if reply.code > c.RET_MAX:
                    fail(f"code 0x{reply.code:02X} for a chunk of {len(part)} bytes at {offset}")
                offset += len(part)
            if peer.read_all("store") != whole:
                fail(f"`store` does not return the {len(whole)} bytes that were written")


class EndOfOffsets(Case):
    """Reads at the last offsets that 32 bits hold."""

    ID = "many.end-of-offsets"
    EXPECTATION = "No chunk ends behind the offset 4294967295, and none starts anew from 0."
    REQUIREMENTS = ("J2A-MANY-019", "J2A-MANY-007")
    LEVEL = "many"
    NEEDS = (c.MANY,)

    def _run(self, peer: Peer) -> None:
        names = [name for name in (c.GET_PROPERTIES, "store") if peer.has(name)]
        if peer.has("store"):
            peer.ask(peer.many("store", c.FLAG_WRITE | c.FLAG_LAST, 0, b"0123456789"))
        for name in names:
            for before in (0, 1, 2, 5, 6, 25, 26, 100, 247, 248, 249, 250, 255, 256):
                offset = _END - before
                reply = peer.ask_many(peer.many(name, offset=offset))
                if reply.offset + len(reply.data) > _END:
                    fail(f"{name} sends {len(reply.data)} bytes at the offset {offset}")
                if reply.offset != offset or not reply.flags & c.FLAG_LAST:
                    fail(f"{name} returns {reply} for a read at the offset {offset}")
        if not names:
            inform("no function of this device can be read")


class Interleaved(Case):
    """Reads all that can be read through a2jMany in turn, a chunk of each, all at the same offsets;
    once more with another kind of request between two chunks: echoes, refusals, the mapping, and
    writes that fail.
    """

    ID = "many.interleaved"
    EXPECTATION = "The same bytes as when each is read alone: no read leaves anything behind."
    REQUIREMENTS = (
        "J2A-PROP-001",
        "J2A-IFACE-001",
        "J2A-MANY-001",
        "J2A-MANY-002",
        "J2A-MANY-008",
    )
    LEVEL = "many"
    NEEDS = (c.MANY,)

    def _run(self, peer: Peer) -> None:
        contents = (c.GET_PROPERTIES, c.GET_INTERFACE, c.GET_TRANSDS, "store")
        names = [name for name in contents if peer.has(name)]
        if peer.has("store"):
            data = payload_of(min(peer.longest_chunk, 128), 3)  # there is room for so much
            peer.ask(peer.many("store", c.FLAG_WRITE | c.FLAG_LAST, 0, data))
        wholes = {name: peer.read_all(name) for name in names}
        for order in (names, names[::-1]):
            self._read(peer, wholes, order, [])
        most = max(map(len, wholes.values()), default=0)
        if most * peer.link.byte_s < _LONG_S:
            self._read(peer, wholes, names, list(_others(peer, names)))
        if not names:
            inform("no function of this device can be read")

    @staticmethod
    def _read(
        peer: Peer, wholes: dict[str, bytes], names: list[str], between: list[Request]
    ) -> None:
        """Read a chunk of each until all are whole; the longest chunk gives the offsets."""
        offset = number = 0
        while any(offset < len(wholes[name]) for name in names):
            size = 0
            for name in names:
                if between:
                    peer.ask(between[number % len(between)])
                    number += 1
                reply = peer.ask_many(peer.many(name, offset=offset))
                due = wholes[name][offset : offset + len(reply.data)]
                if (reply.code, reply.offset, reply.data) != (c.RET_OK, offset, due):
                    fail(f"{reply} in a read of {name} at offset {offset}, amid others")
                if not reply.data and offset < len(wholes[name]):
                    fail(f"an empty chunk of {name} at {offset}, the end is {len(wholes[name])}")
                size = max(size, len(reply.data))
            offset += size


def _others(peer: Peer, names: list[str]) -> Iterator[Request]:
    """Yield requests of other kinds, which change nothing."""
    yield peer.probe()
    yield peer.many(c.GET_ECHO_MANY, c.FLAG_WRITE | c.FLAG_LAST, 0, b"between")
    yield from (peer.request(opcode, b"x", c.ERR_OPCODE) for opcode in peer.out_of_range()[-1:])
    if peer.claims.mapped:
        yield peer.request(0, b"", c.RET_OK)
    for name in names:
        yield peer.many(name, offset=2**31)
        if name != "store":
            yield peer.many(name, c.FLAG_WRITE, 0, b"no")
    yield peer.request(peer.opcode(c.MANY), b"", c.RET_FAILED)


class ByteOrder(Case):
    """Sends offsets with one bit set to a2jEchoMany, and compares the bytes of the reply."""

    ID = "many.byte-order"
    EXPECTATION = "The least significant byte comes first."
    REQUIREMENTS = ("J2A-MANY-021", "J2A-MANY-002")
    LEVEL = "many"
    NEEDS = (c.MANY,)

    def _run(self, peer: Peer) -> None:
        if peer.has(c.GET_PROPERTIES):
            size = len(peer.read_all(c.GET_PROPERTIES))
            for offset in sorted({1, size // 2, size - 1} & {*range(1, size)}):
                reply = peer.ask_many(peer.many(c.GET_PROPERTIES, offset=offset))
                if not reply.data or reply.offset != offset:
                    fail(f"{reply} for a read of the properties at the offset {offset}")
        for bit in range(32):
            echo_many(peer, 0, 1 << bit, b"order")
