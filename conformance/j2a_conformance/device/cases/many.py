"""a2jMany: the header, the kinds of functions, all four bytes of the offset (J2A-MANY)."""

from collections.abc import Iterator
from itertools import product

from j2a_spec import constants as c
from j2a_spec.capabilities import FUNCTIONS

from j2a_conformance._judge import fail, inform, skip
from j2a_conformance.device._case import Case
from j2a_conformance.device._contents import ends_early
from j2a_conformance.device._peer import Expected, ManyReply, Peer, Request, many_payload
from j2a_conformance.wire._dimensions import lane_offset, payload_of, spread

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


def echoed(peer: Peer, flags: int, offset: int, data: bytes) -> Request:
    """Return a request to a2jEchoMany with its whole reply."""
    request = peer.many(c.GET_ECHO_MANY, flags, offset, data)
    if peer.is_too_long(peer.opcode(c.MANY), many_payload(0, 0, 0, data)):
        return request
    answer = many_payload(c.ECHO_MANY, flags & c.FLAG_LAST, offset, data)
    return Request(request.wire, Expected(request.seq, c.RET_OK, answer))


class EchoLengths(Case):
    """Sends chunks of every length from 0 to 249, or what fits into the room of the device, through
    a2jEchoMany, as reads and as writes, with other flags and another offset each time: over the
    case, each of the four bytes of the offset takes every value.
    """

    ID = "many.echo-lengths"
    EXPECTATION = "Data, offset and isLast come back, with 0xBE inside and 0x00 outside."
    REQUIREMENTS = (
        "J2A-MANY-001",
        "J2A-MANY-002",
        "J2A-MANY-004",
        "J2A-MANY-008",
        "J2A-MANY-009",
        "J2A-MANY-021",
        "J2A-ECHO-002",
        "J2A-FRAME-005",
    )
    LEVEL = "many"

    def _run(self, peer: Peer) -> None:
        peer.ask_all(self._requests(peer))

    @staticmethod
    def _requests(peer: Peer) -> Iterator[Request]:
        most = peer.longest_chunk
        for n in range(256):
            length = n % (most + 1)
            # Three of four are known flags only: 0 to 3.
            flags = n % 4 if n % 3 else (n * 7) % 256
            yield echoed(peer, flags, lane_offset(n), payload_of(length, n))
        for n in range(256):  # the same offsets with the other direction, and little data
            flags = (n % 4 ^ c.FLAG_WRITE) | (n * 7 & 0xFC if n % 3 == 0 else 0)
            yield echoed(peer, flags, lane_offset(n), payload_of(n % 5, n))
        for value in sorted(c.STUFFED):
            yield echoed(peer, c.FLAG_LAST, value * 0x01010101, bytes((value,)) * most)


class Offsets(Case):
    """Sends chunks with offsets that use each of the four bytes and each of the 32 bits through
    a2jEchoMany, as reads and as writes.
    """

    ID = "many.offsets"
    EXPECTATION = "The offset of the reply is that of the request."
    REQUIREMENTS = (
        "J2A-MANY-001",
        "J2A-MANY-002",
        "J2A-MANY-008",
        "J2A-MANY-021",
        "J2A-ECHO-002",
    )
    LEVEL = "many"

    def _run(self, peer: Peer) -> None:
        bits = [1 << bit for bit in range(32)]
        for offset in (*OFFSETS, *bits, *(bit - 1 for bit in bits), *(2**32 - bit for bit in bits)):
            for flags in (c.FLAG_LAST, c.FLAG_WRITE, c.FLAG_WRITE | c.FLAG_LAST):
                echo_many(peer, flags, offset, b"offset")


class Flags(Case):
    """Sends chunks with all 256 values of the flags, with and without data."""

    ID = "many.flags"
    EXPECTATION = (
        "isLast comes back as it was, every other flag as 0, and unknown flags are ignored."
    )
    REQUIREMENTS = ("J2A-MANY-009", "J2A-MANY-010", "J2A-ECHO-002")
    LEVEL = "many"

    def _run(self, peer: Peer) -> None:
        peer.ask_all(
            echoed(peer, flags, offset, data)
            for flags in range(256)
            for offset, data in ((7, b""), (lane_offset(flags), b"f"))
        )


class ShortHeader(Case):
    """Calls a2jMany with 0 to 5 bytes of payload."""

    ID = "many.short-header"
    EXPECTATION = "The code 0xFF, and never a call of the function."
    REQUIREMENTS = ("J2A-MANY-003",)
    LEVEL = "many"

    def _run(self, peer: Peer) -> None:
        header = bytes((peer.opcode(c.GET_ECHO_MANY), 1, 2, 3, 4))
        short = [payload_of(length, n) for n in range(5) for length in range(c.MANY_HEADER)]
        for payload in (*(header[:n] for n in range(6)), b"\xff", b"\0\0\0", *short):
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
    *(function.name for function in FUNCTIONS if function.kind == "call"),
    "getTime", "add", "ret", "delay", "sif", "sifPeriod", "overruns", "divide",
    "echoNumbers", "echoShapes", "echoWords", "echoFirst",
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
        funcs = [0, *known, *peer.out_of_range()]
        for n, length in enumerate(spread(c.MANY_DATA, 13)):
            func = funcs[n * 5 % len(funcs)]
            data = payload_of(length, n)
            request = peer.many(func, n * 3 % 256, lane_offset(n), data, code=c.ERR_OPCODE)
            peer.ask_exact(request)
        peer.barrier()


class CalledDirectly(Case):
    """Calls functions made for a2jMany, other than a2jGetProperties, by their opcode."""

    ID = "many.called-directly"
    EXPECTATION = "Error 0xF0."
    REQUIREMENTS = ("J2A-MANY-006",)
    LEVEL = "many"
    NEEDS = (c.MANY,)  # else what is named like them is made for single frames

    def _run(self, peer: Peer) -> None:
        names = [n for n in (c.GET_ECHO_MANY, "store") if peer.has(n)]
        for name in names:
            several = (payload_of(length, n) for n, length in enumerate(spread(step=67)))
            peer.ask_all(peer.direct(name, payload) for payload in (bytes(6), *several))
        if not names:
            skip("the device has no function that is known to be made for a2jMany")


class FourBytes(Case):
    """Reads the properties at offsets behind their end that differ from good offsets in the upper
    three bytes only, in each bit of them; the same with `store`, and writes to it there.
    """

    ID = "many.four-offset-bytes"
    EXPECTATION = (
        "Nothing at these offsets, and a write to them changes nothing of what is stored: a device "
        "that looks at some of the bytes alone would send data, or replace it."
    )
    REQUIREMENTS = ("J2A-MANY-007", "J2A-MANY-008", "J2A-MANY-019")
    LEVEL = "many"
    NEEDS = (c.MANY,)

    def _run(self, peer: Peer) -> None:
        names = [n for n in (c.GET_PROPERTIES, "store") if peer.has(n)]
        for name in names:
            if name == "store":
                peer.ask(peer.many(name, c.FLAG_WRITE | c.FLAG_LAST, 0, _STORED))
            size = len(peer.read_all(name))
            for upper, low in product((*_UPPER, 0xFFFFFF00), (0, 1, 9, 0xFE, 0xFF)):
                if upper + low >= size:
                    self._read(peer, name, upper + low, size)
            if name == "store":
                self._write(peer)
        if not names:
            inform("no function of this device shows which offset it was given")

    @staticmethod
    def _read(peer: Peer, name: str, offset: int, size: int) -> None:
        reply = peer.ask_many(peer.many(name, offset=offset))
        if reply.data or not reply.flags & c.FLAG_LAST:
            fail(f"{name} sends {len(reply.data)} bytes at offset {offset} of {size}")
        if reply.offset != offset:
            fail(f"offset {reply.offset} in the reply, {offset} in the request")

    @staticmethod
    def _write(peer: Peer) -> None:
        for upper, low in product(_UPPER, (0, len(_STORED))):
            offset = upper + low
            flags = c.FLAG_WRITE | (c.FLAG_LAST if low else 0)
            reply = peer.ask_many(peer.many("store", flags, offset, b"elsewhere"))
            if reply.offset != offset:
                fail(f"offset {reply.offset} in the reply, {offset} in the request")
            found = peer.ask_many(peer.many("store")).data[: len(_STORED) + 1]
            if not found.startswith(_STORED) or (reply.code > c.RET_MAX and found != _STORED):
                fail(
                    f"a write to `store` at offset {offset} changes what is at offset 0: {found!r}"
                )


_STORED = b"0123456789"
_UPPER = tuple(1 << bit for bit in range(8, 32))


class StoreLarge(Case):
    """Writes as much to `store` as fits, up to 249 bytes, in chunks of 1, 3, 7 bytes and as a
    whole, and reads it from every offset; then writes 0, 1, 248, 249, 250, 498, 499, 600 and
    70,000 bytes, as far as they fit, and reads them back.
    """

    ID = "many.store"
    EXPECTATION = (
        "What was written, byte by byte, at every offset, and as many bytes however they are cut."
    )
    REQUIREMENTS = (
        "J2A-MANY-001",
        "J2A-MANY-002",
        "J2A-MANY-007",
        "J2A-MANY-008",
        "J2A-MANY-009",
        "J2A-MANY-021",
    )
    LEVEL = "many"
    NEEDS = (c.MANY, "store")

    def _run(self, peer: Peer) -> None:
        held = self._small(peer)
        # Of large amounts a lossy link changes a part without a trace: the checksum is short.
        large = () if peer.link.lossy else (70_000,)
        for n, size in enumerate((0, 1, 248, 249, 250, 498, 499, 600, *large)):
            data = b"".join(n.to_bytes(4, "big") for n in range(size // 4 + 1))[:size]
            taken = self._write(peer, data, unknown=n)
            if taken < size:
                self._full(peer, data, taken, held)
                break
            if peer.read_all("store", max(2 * size, 65536)) != data:
                fail(f"`store` does not return the {size} bytes that were written")

    def _small(self, peer: Peer) -> int:
        """Write and read within the first 249 bytes; return how many fit in one chunk."""
        data = payload_of(peer.longest_chunk, 3)
        held = self._write(peer, data)
        if held < min(len(data), 128):
            fail(f"`store` takes {held} bytes; there is room for 128 in any case")
        data = data[:held]
        for chunk in (7, 3, 1) if not peer.link.lossy else (7,):
            if (taken := self._write(peer, data, chunk, chunk)) < held:
                fail(f"`store` holds {held} bytes, but only {taken} of them in chunks of {chunk}")
            if peer.read_all("store") != data:
                fail(f"`store` does not return what was written in chunks of {chunk}")
        early = ends_early(peer, "store", held)
        for offset in range(held):
            reply = peer.ask_many(peer.many("store", offset=offset))
            if not reply.data or not data.startswith(reply.data, offset):
                fail(f"a read of `store` at offset {offset} returns {reply}")
            if offset + len(reply.data) == held and early != bool(reply.flags & c.FLAG_LAST):
                not_ = "not " if early else ""
                fail(f"isLast is {not_}set in the last chunk, read from offset {offset}")
        return held

    def _full(self, peer: Peer, data: bytes, taken: int, held: int) -> None:
        """A write was refused: the same number of bytes fits, whatever the chunks are."""
        limits = {}
        for chunk in (64, 249, 100):
            limits[chunk] = self._last(peer, data, self._write(peer, data, chunk))
        peer.link.note(f"`store` holds {max(limits.values())} bytes")
        if peer.link.lossy:
            return
        if len(set(limits.values())) > 1 or max(limits.values()) < max(taken, held):
            fail(f"`store` holds another number of bytes with each length of the chunks: {limits}")

    @staticmethod
    def _last(peer: Peer, data: bytes, taken: int) -> int:
        """Fill what is left byte by byte; return how much was taken then."""
        while taken < len(data):
            chunk = peer.many("store", c.FLAG_WRITE, taken, data[taken : taken + 1])
            if peer.ask_many(chunk).code > c.RET_MAX:
                break
            taken += 1
        return taken

    @staticmethod
    def _write(peer: Peer, data: bytes, chunk: int = 0, unknown: int = 0) -> int:
        """Write `data` in chunks; return how many bytes were taken.

        Flag bits without a meaning, which `unknown` chooses, make no difference (J2A-MANY-009).
        """
        chunk = min(chunk or peer.longest_chunk, peer.longest_chunk)
        chunks = range(0, max(len(data), 1), chunk)
        for n, offset in enumerate(chunks):
            flags = c.FLAG_WRITE | (c.FLAG_LAST if offset == chunks[-1] else 0)
            flags |= (unknown * 0x24 + n * 0x14) & 0xFC if unknown else 0
            part = data[offset : offset + chunk]
            reply = peer.ask_many(peer.many("store", flags, offset, part))
            if reply.offset != offset:
                fail(f"offset {reply.offset} in the reply, {offset} in the request")
            if reply.code == c.RET_FAILED and peer.link.lossy:
                # The chunk may have arrived before, and the reply that said so got lost.
                held = peer.ask_many(peer.many("store", offset=offset)).data
                if held and part.startswith(held):
                    continue
            if reply.code == c.RET_FAILED:
                return offset
            if reply.code > c.RET_MAX:
                fail(f"code 0x{reply.code:02X} for a chunk of {len(part)} bytes at {offset}")
        return len(data)


class WriteFlags(Case):
    """Writes to `store`, and reads from it, with every value of the flags."""

    ID = "many.write-flags"
    EXPECTATION = "Bit 1 alone says whether it is a write; isLast and unknown bits change nothing."
    REQUIREMENTS = ("J2A-MANY-009", "J2A-MANY-010")
    LEVEL = "many"
    NEEDS = (c.MANY, "store")

    def _run(self, peer: Peer) -> None:
        data = b"first"
        peer.ask(peer.many("store", c.FLAG_WRITE | c.FLAG_LAST, 0, data))
        for flags in range(256):
            part = b"flags %03d" % flags
            reply = peer.ask_many(peer.many("store", flags, 0, part))
            if flags & c.FLAG_WRITE:
                data = part
            elif reply.data != data:
                fail(
                    f"a read with the flags 0x{flags:02X} returns {reply.data[:20]!r}, not {data!r}"
                )
            found = peer.ask_many(peer.many("store", flags & ~c.FLAG_WRITE)).data
            if found != data:
                kind = "write" if flags & c.FLAG_WRITE else "read"
                fail(f"`store` holds {found[:20]!r} behind a {kind} with the flags 0x{flags:02X}")


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
                self._ask(peer, name, flags, b"flags")
            for n, length in enumerate(spread(peer.longest_chunk, 47)):
                self._ask(peer, name, (2, 0xFE, 0, 3, 0xFC)[n % 5], payload_of(length, n))

    @staticmethod
    def _ask(peer: Peer, name: str, flags: int, data: bytes) -> None:
        reply = peer.ask_many(peer.many(name, flags, 0, data))
        if reply.flags & ~c.FLAG_LAST:
            fail(f"flags 0x{reply.flags:02X} in a reply of {name} to {len(data)} bytes of data")
