"""a2jMany: the header, the kinds of functions, all four bytes of the offset (J2A-MANY)."""

from itertools import product

from j2a_spec import constants as c

from j2a_conformance._case import Case
from j2a_conformance._judge import fail, inform, skip
from j2a_conformance._peer import ManyReply, Peer

OFFSETS = (
    0, 1, 0x12, 0x7D, 0xED, 255, 256, 257, 498, 0x127D, 0xED00, 0xFFFF, 0x10000, 0x12EDED,
    0x7D0000, 0x1000000, 0x12ED7D11, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF,
)  # fmt: skip


def echo_many(peer: Peer, flags: int, offset: int, data: bytes) -> None:
    """Exchange a chunk with a2jEchoMany and compare everything."""
    peer.carried(lambda: _echo_many(peer, flags, offset, data))


def _echo_many(peer: Peer, flags: int, offset: int, data: bytes) -> None:
    reply = peer.ask_many(peer.many(c.GET_ECHO_MANY, flags, offset, data))
    wanted = ManyReply(c.ECHO_MANY, flags & c.FLAG_LAST, offset, data)
    if reply != wanted:
        peer.link.record("expected", text=str(wanted))
        fail(f"a2jEchoMany returns {reply}")


class EchoLengths(Case):
    """Sends chunks of every length from 0 to 249, or what fits into the room of the device, through
    a2jEchoMany.
    """

    ID = "many.echo-lengths"
    EXPECTATION = "Data, offset and isLast come back, with 0xBE inside and 0x00 outside."
    REQUIREMENTS = (
        "J2A-MANY-001",
        "J2A-MANY-002",
        "J2A-MANY-004",
        "J2A-MANY-008",
        "J2A-ECHO-002",
        "J2A-FRAME-005",
    )
    LEVEL = "many"

    def _run(self, peer: Peer) -> None:
        for length in range(peer.longest_chunk + 1):
            flags = c.FLAG_WRITE | (length % 2)
            echo_many(peer, flags, length * 249, bytes(range(length)))
        for value in sorted(c.STUFFED):
            data = bytes((value,)) * peer.longest_chunk
            echo_many(peer, c.FLAG_LAST, value * 0x01010101, data)


class Offsets(Case):
    """Sends chunks with offsets that use each of the four bytes through a2jEchoMany."""

    ID = "many.offsets"
    EXPECTATION = "The offset of the reply is that of the request."
    REQUIREMENTS = ("J2A-MANY-001", "J2A-MANY-002", "J2A-MANY-008", "J2A-ECHO-002")
    LEVEL = "many"

    def _run(self, peer: Peer) -> None:
        for offset in OFFSETS:
            echo_many(peer, c.FLAG_LAST, offset, b"offset")


class Flags(Case):
    """Sends chunks with all 256 values of the flags, with and without data."""

    ID = "many.flags"
    EXPECTATION = (
        "isLast comes back as it was, every other flag as 0, and unknown flags are ignored."
    )
    REQUIREMENTS = ("J2A-MANY-009", "J2A-MANY-010", "J2A-ECHO-002")
    LEVEL = "many"

    def _run(self, peer: Peer) -> None:
        for flags, data in product(range(256), (b"", b"f")):
            echo_many(peer, flags, 7, data)


class ShortHeader(Case):
    """Calls a2jMany with 0 to 5 bytes of payload."""

    ID = "many.short-header"
    EXPECTATION = "The code 0xFF, and never a call of the function."
    REQUIREMENTS = ("J2A-MANY-003",)
    LEVEL = "many"

    def _run(self, peer: Peer) -> None:
        header = bytes((peer.opcode(c.GET_ECHO_MANY), 1, 2, 3, 4))
        for payload in (*(header[:n] for n in range(6)), b"\xff", b"\0\0\0", b"\xff" * 5):
            peer.ask(peer.request(peer.opcode(c.MANY), payload, c.RET_FAILED))


class InnerCode(Case):
    """Has a function that a2jMany calls return 0xFF, and others 0xBE and 0x00."""

    ID = "many.inner-code"
    EXPECTATION = "0x00 outside, whatever is inside."
    REQUIREMENTS = ("J2A-MANY-004", "J2A-MANY-002")
    LEVEL = "many"

    def _run(self, peer: Peer) -> None:
        codes = {peer.ask_many(peer.many(c.GET_ECHO_MANY, data=b"code")).code}
        if peer.has(c.GET_PROPERTIES):
            codes.add(peer.ask_many(peer.many(c.GET_PROPERTIES)).code)
            flags = c.FLAG_WRITE | c.FLAG_LAST
            codes.add(peer.ask_many(peer.many(c.GET_PROPERTIES, flags, 0, b"no")).code)
        wanted = {c.ECHO_MANY} | ({0x00, 0xFF} if peer.has(c.GET_PROPERTIES) else set())
        if codes != wanted:
            fail(f"inner codes {sorted(codes)} instead of {sorted(wanted)}")


_CALLS = (
    c.GET_MAPPING, c.MANY, c.GET_DEBUG, c.GET_ECHO,
    "getTime", "add", "ret", "delay", "sif", "sifPeriod", "overruns",
)  # fmt: skip


class WrongKind(Case):
    """Asks a2jMany for func 0, for itself, for functions that are not made for it, and for every
    index out of range.
    """

    ID = "many.wrong-function"
    EXPECTATION = "Error 0xF0 in the outer reply, and a device that goes on to answer."
    REQUIREMENTS = ("J2A-MANY-005",)
    LEVEL = "many"

    def _run(self, peer: Peer) -> None:
        known = [peer.opcode(name) for name in _CALLS if peer.has(name)]
        for func in (*known, *peer.out_of_range()):
            peer.ask(peer.many(func, c.FLAG_LAST, 0, b"x", code=c.ERR_OPCODE))
        for flags, data in ((0, b""), (c.FLAG_WRITE, bytes(249)), (0xFF, b"\x12" * 249)):
            peer.ask(peer.many(c.GET_ECHO, flags, 0x12, data, code=c.ERR_OPCODE))
        peer.barrier()


class CalledDirectly(Case):
    """Calls functions made for a2jMany, other than a2jGetProperties, by their opcode."""

    ID = "many.called-directly"
    EXPECTATION = "Error 0xF0."
    REQUIREMENTS = ("J2A-MANY-006",)
    LEVEL = "many"

    def _run(self, peer: Peer) -> None:
        names = [n for n in (c.GET_ECHO_MANY, "store") if peer.has(n)]
        for name in names:
            for payload in (b"", bytes(6), bytes(range(255))):
                peer.ask(peer.request(peer.opcode(name), payload, c.ERR_OPCODE))
        if not names:
            skip("the device has no function that is known to be made for a2jMany")


class FourBytes(Case):
    """Reads the properties at offsets behind their end that differ from good offsets in one of the
    upper three bytes only; the same with `store`.
    """

    ID = "many.four-offset-bytes"
    EXPECTATION = (
        "Nothing at these offsets: a device that looks at the lower bytes alone would send data."
    )
    REQUIREMENTS = ("J2A-MANY-007",)
    LEVEL = "many"
    NEEDS = (c.MANY,)

    def _run(self, peer: Peer) -> None:
        names = [n for n in (c.GET_PROPERTIES, "store") if peer.has(n)]
        for name in names:
            if name == "store":
                peer.ask(peer.many(name, c.FLAG_WRITE | c.FLAG_LAST, 0, b"0123456789"))
            size = len(peer.read_all(name))
            for low, upper in product((0, 1), (1 << 8, 1 << 16, 1 << 24, 1 << 31)):
                if upper + low < size:
                    continue
                reply = peer.ask_many(peer.many(name, offset=upper + low))
                if reply.data or not reply.flags & c.FLAG_LAST:
                    fail(f"{name} sends {len(reply.data)} bytes at offset {upper + low} of {size}")
                if reply.offset != upper + low:
                    fail(f"offset {reply.offset} in the reply, {upper + low} in the request")
        if not names:
            inform("no function of this device shows which offset it was given")


class StoreLarge(Case):
    """Writes 100 bytes to `store` in chunks of 7 and reads them from several offsets; then writes
    0, 1, 248, 249, 250, 498, 499, 600 and 70,000 bytes, as far as they fit, and reads them back.
    """

    ID = "many.store"
    EXPECTATION = "What was written, byte by byte, at every offset."
    REQUIREMENTS = ("J2A-MANY-001", "J2A-MANY-002", "J2A-MANY-007", "J2A-MANY-008")
    LEVEL = "many"
    NEEDS = (c.MANY, "store")

    def _run(self, peer: Peer) -> None:
        data = bytes(range(100))
        self._write(peer, data, 7)
        for offset in range(0, 100, 9):
            reply = peer.ask_many(peer.many("store", offset=offset))
            if not reply.data or not data.startswith(reply.data, offset):
                fail(f"a read of `store` at offset {offset} returns {reply}")
        # Of large amounts a lossy link changes a part without a trace: the checksum is short.
        large = () if peer.link.lossy else (70_000,)
        for size in (0, 1, 248, 249, 250, 498, 499, 600, *large):
            data = b"".join(n.to_bytes(4, "big") for n in range(size // 4 + 1))[:size]
            if not self._write(peer, data):
                peer.link.note(f"{size} bytes do not fit")
                break
            if peer.read_all("store", max(2 * size, 65536)) != data:
                fail(f"`store` does not return the {size} bytes that were written")

    @staticmethod
    def _write(peer: Peer, data: bytes, chunk: int = 0) -> bool:
        """Write `data` in chunks; tell whether it fits. 128 bytes fit in any case."""
        chunk = chunk or peer.longest_chunk
        chunks = range(0, max(len(data), 1), chunk)
        for offset in chunks:
            flags = c.FLAG_WRITE | (c.FLAG_LAST if offset == chunks[-1] else 0)
            part = data[offset : offset + chunk]
            reply = peer.ask_many(peer.many("store", flags, offset, part))
            if reply.offset != offset:
                fail(f"offset {reply.offset} in the reply, {offset} in the request")
            if reply.code == c.RET_FAILED and peer.link.lossy:
                # The chunk may have arrived before, and the reply that said so got lost.
                held = peer.ask_many(peer.many("store", offset=offset)).data
                if held and part.startswith(held):
                    continue
            if reply.code == c.RET_FAILED and offset + len(part) > 128:
                return False
            if reply.code > c.RET_MAX:
                fail(f"code 0x{reply.code:02X} for a chunk of {len(part)} bytes at {offset}")
        return True


class ReadRequests(Case):
    """Reads the properties with isLast set and not, with data and without."""

    ID = "many.read-requests"
    EXPECTATION = "The same first chunk each time."
    REQUIREMENTS = ("J2A-MANY-010", "J2A-MANY-009")
    LEVEL = "many"
    NEEDS = (c.GET_PROPERTIES,)

    def _run(self, peer: Peer) -> None:
        wanted = peer.ask_many(peer.many(c.GET_PROPERTIES))
        datas = (b"", b"data", bytes(peer.longest_chunk))
        for flags, data in product((0, c.FLAG_LAST, 0xFC, 0xFD), datas):
            if peer.ask_many(peer.many(c.GET_PROPERTIES, flags, 0, data)) != wanted:
                fail(f"another chunk for flags 0x{flags:02X} and {len(data)} bytes of data")


class ReplyFlags(Case):
    """Looks at the flags of replies to reads and writes."""

    ID = "many.reply-flags"
    EXPECTATION = "No bit but isLast is set."
    REQUIREMENTS = ("J2A-MANY-009", "J2A-MANY-002")
    LEVEL = "many"
    NEEDS = (c.MANY,)

    def _run(self, peer: Peer) -> None:
        for name in (c.GET_ECHO_MANY, c.GET_PROPERTIES, "store"):
            if not peer.has(name):
                continue
            for flags in (0, c.FLAG_LAST, c.FLAG_WRITE, c.FLAG_WRITE | c.FLAG_LAST, 0xFF):
                reply = peer.ask_many(peer.many(name, flags, 0, b"flags"))
                if reply.flags & ~c.FLAG_LAST:
                    fail(f"flags 0x{reply.flags:02X} in a reply of {name}")
