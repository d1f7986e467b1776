"""The ends of a transfer: short headers, empty last chunks, the end of the offsets (J2A-MANY)."""

from j2a_spec import constants as c

from j2a_conformance._judge import fail, inform
from j2a_conformance.device._case import Case
from j2a_conformance.device._peer import Peer

from .many import echo_many

_END = 2**32 - 1


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
