"""Transfers in chunks (J2A-MANY); those that need large offsets of old devices are in `offsets`."""

from dataclasses import dataclass
from itertools import product

from j2a_spec import constants as c
from j2a_spec.requirements import Level

from j2a_conformance._judge import fail
from j2a_conformance.host._case import HostCase
from j2a_conformance.host._device import FETCH, STORE, chunk_reply, pattern
from j2a_conformance.host._host import Host
from j2a_conformance.host._outcomes import Request, difference, spell

_MANY = 1
_LARGE = 2**17 + 2000
_FAR = 2**24 + 594  # a multiple of 7, for `spelt`
_FAR_S = 600
_SIZES = tuple(
    zip(
        (1, 6, 7, 248, 249, 250, 254, 255, 256, 257, 497, 498, 499, 504, 746, 747, 748, 1245),
        5 * (0x12, 0xED, 0x7D, 0x61),
        strict=False,
    )
)
_FAILED = ("failed", "refused", "error")
_NOT_LAST = b"\x00"
_FLAGS = (bytes((c.FLAG_LAST,)), _NOT_LAST)
_SOME = (b"data", b"")  # on top of a reply to a read, and to a write


@dataclass(frozen=True, slots=True)
class Chunk:
    """A request to a2jMany, taken apart; offset in bytes."""

    request: Request
    func: int
    flags: int
    offset: int
    data: bytes


def chunk_of(request: Request) -> Chunk:
    """Take the request apart, and judge what holds for every one."""
    payload = request.payload
    if request.opcode != _MANY or len(payload) < c.MANY_HEADER:
        fail(f"a request to a2jMany was due, opcode {request.opcode} came (J2A-MANY-001)")
    if payload[1] & ~(c.FLAG_LAST | c.FLAG_WRITE):
        fail(f"the flags 0x{payload[1]:02X} have bits without meaning (J2A-MANY-009)")
    return Chunk(
        request, payload[0], payload[1], int.from_bytes(payload[2:6], "little"), payload[6:]
    )


def next_chunk(host: Host, name: str, offset: int, is_write: bool) -> Chunk:
    """Wait for a chunk of a transfer with a function and judge its header."""
    chunk = chunk_of(host.request())
    if chunk.func != host.device.opcode(name):
        fail(f"the chunk is for the function {chunk.func}, not for {name} (J2A-MANY-001)")
    if chunk.offset != offset:
        fail(f"the chunk has the offset {chunk.offset}, {offset} is due")
    if bool(chunk.flags & c.FLAG_WRITE) != is_write:
        fail(f"the flags are 0x{chunk.flags:02X} (J2A-MANY-001)")
    return chunk


def reply(host: Host, chunk: Chunk, flags: int = 0, data: bytes = b"", code: int = 0) -> None:
    """Answer a chunk as a device does."""
    host.reply(chunk.request, c.RET_OK, chunk_reply(code, flags, chunk.offset, data))


def serve_read(host: Host, content: bytes, sizes: tuple[int, ...], noise: int = 0) -> None:
    """Answer a read with chunks of these sizes, the last one again and again.

    Args:
        host: the host.
        content: what is read.
        sizes: of the chunks, in bytes; 0 behind the content is an empty last chunk.
        noise: further bits of the flags.
    """
    offset, index = 0, 0
    while True:
        size = sizes[min(index, len(sizes) - 1)]
        chunk = next_chunk(host, FETCH, offset, is_write=False)
        data = content[offset : offset + size]
        offset, index = offset + len(data), index + 1
        is_last = offset == len(content) and (sizes[-1] > 0 or not data)
        reply(host, chunk, noise | (c.FLAG_LAST if is_last else 0), data)
        if is_last:
            return


def serve_write(host: Host, content: bytes, flags: int = 0, data: bytes = b"") -> None:
    """Take a write and judge its chunks; answer each with these flags and data."""
    offset = 0
    for _ in range(2 * len(content) // c.MANY_DATA + 8):
        chunk = next_chunk(host, STORE, offset, is_write=True)
        if chunk.data != content[offset : offset + len(chunk.data)]:
            where = difference(chunk.data, content[offset : offset + len(chunk.data)])
            fail(f"the chunk at {offset} has other data than those at this place: {where}")
        offset += len(chunk.data)
        is_last = bool(chunk.flags & c.FLAG_LAST)
        if is_last and offset != len(content):
            fail(f"isLast is set after {offset} of {len(content)} bytes")
        reply(host, chunk, flags, data)
        if is_last:
            return
    fail("isLast was never set")


def spelt(size: int) -> str:
    """Return `pattern(size)`, for a multiple of 7 bytes, as a job spells it."""
    return f"{size // 7}*{pattern(7).hex()}" if size else "-"


class Read(HostCase):
    """Has the host read 0 to 133072 bytes, in chunks of many sizes."""

    ID = "host.many.read"
    EXPECTATION = "Each request asks for what follows the data received so far, up to isLast."
    REQUIREMENTS = (
        "J2A-MANY-011",
        "J2A-MANY-001",
        "J2A-MANY-009",
        "J2A-MANY-020",
        "J2A-MANY-021",
    )
    LEVEL = "many"

    def _run(self, host: Host) -> None:
        plans: tuple[tuple[int, tuple[int, ...]], ...] = (
            (0, (249,)),
            (1, (249,)),
            (249, (249,)),
            (250, (249,)),
            (498, (249, 249, 0)),
            (600, (1, 249, 10, 200)),
            (sum(range(1, 250)), tuple(range(1, 250))),
            (_LARGE, (249,)),
        )
        for size, sizes in plans:
            content = pattern(size)
            host.job(f"read {FETCH} {10 * host.limit_ms}")
            serve_read(host, content, sizes)
            host.outcome(f"data {spell(content)}", due=content)


class ByOpcode(HostCase):
    """Has the host read and write a function by its opcode."""

    ID = "host.many.by-opcode"
    EXPECTATION = "The header names this opcode."
    REQUIREMENTS = ("J2A-MANY-001", "J2A-DISP-007", "J2A-MANY-011", "J2A-MANY-013")
    LEVEL = "many"

    def _run(self, host: Host) -> None:
        host.job(f"read @{host.device.opcode(FETCH)} {host.limit_ms}")
        serve_read(host, b"by opcode", (4,))
        host.outcome(f"data {spell(b'by opcode')}")
        host.job(f"write @{host.device.opcode(STORE)} 2*6162 {host.limit_ms}")
        serve_write(host, b"abab")
        host.outcome("written")


class Write(HostCase):
    """Has the host write 0 to 255 bytes, and up to 133070."""

    ID = "host.many.write"
    EXPECTATION = (
        "The chunks follow each other; the last one alone, if only an empty one, has isLast."
    )
    REQUIREMENTS = ("J2A-STUFF-001", "J2A-MANY-013", "J2A-MANY-001", "J2A-MANY-009", "J2A-MANY-021")
    LEVEL = "many"

    def _run(self, host: Host) -> None:
        for data, content in (
            ("-", b""),
            *((f"{size}*{size:02x}", bytes((size,)) * size) for size in range(1, 256)),
            *((f"{size}*{byte:02x}", bytes((byte,)) * size) for size, byte in _SIZES),
            (spelt(1001), pattern(1001)),
            (spelt(_LARGE - _LARGE % 7), pattern(_LARGE - _LARGE % 7)),
        ):
            host.job(f"write {STORE} {data} {10 * host.limit_ms}")
            serve_write(host, content)
            host.outcome("written")


class Far(HostCase):
    """Has the host read and write 16 MiB and some bytes, so that offsets need more than 24 bits."""

    ID = "host.many.beyond-24-bits"
    EXPECTATION = "No bit of an offset is lost."
    REQUIREMENTS = ("J2A-MANY-001", "J2A-MANY-011", "J2A-MANY-013", "J2A-MANY-021")
    LEVEL = "many"
    ON_DEMAND = True

    def _run(self, host: Host) -> None:
        content = pattern(_FAR)
        host.job(f"read {FETCH} {_FAR_S * 1000}", _FAR_S)
        serve_read(host, content, (c.MANY_DATA,))
        host.outcome(f"data {spell(content)}", due=content)
        host.job(f"write {STORE} {spelt(_FAR)} {_FAR_S * 1000}", _FAR_S)
        serve_write(host, content)
        host.outcome("written")


class ReplyFlags(HostCase):
    """Sets bits without meaning in the flags of its replies, each alone and all of them."""

    ID = "host.many.reply-flags"
    EXPECTATION = "They are ignored."
    REQUIREMENTS = ("J2A-MANY-009",)
    LEVEL = "many"

    def _run(self, host: Host) -> None:
        for noise in (0xFE, *(1 << bit for bit in range(1, 8))):
            host.job(f"read {FETCH} {host.limit_ms}")
            serve_read(host, pattern(30), (7,), noise)
            host.outcome(f"data {spell(pattern(30))}", due=pattern(30))
            host.job(f"write {STORE} {spelt(700)} {host.limit_ms}")
            serve_write(host, pattern(700), noise)
            host.outcome("written")


class WriteReplies(HostCase):
    """Answers the chunks of writes with data of 0 to 249 bytes, with isLast set where it is not due
    and not set where it is, and with return values of the function up to 0xEF.
    """

    ID = "host.many.write-replies"
    EXPECTATION = "Both are ignored: the host goes on to the end, unless it reports a failure."
    REQUIREMENTS = ("J2A-MANY-016", "J2A-MANY-013")
    LEVEL = "many"

    def _run(self, host: Host) -> None:
        for size in (0, 1, 6, 7, 100, 248, 249):
            for flags in (0, c.FLAG_LAST):
                host.job(f"write {STORE} {spelt(700)} {host.limit_ms}")
                serve_write(host, pattern(700), flags, pattern(size))
                host.outcome("written")
        for code, flags in product((1, 0x7F, c.RET_MAX), (0, c.FLAG_LAST)):
            host.job(f"write {STORE} {spelt(700)} {host.limit_ms}")
            came = 0
            while (request := host.request_or_end()) is not None:
                came += len(chunk_of(request).data)
                reply(host, chunk_of(request), flags, b"", code)
            outcome = host.outcome("written", *_FAILED)
            if outcome.word == "written" and came != 700:
                fail(f"{came} of 700 bytes were written, behind a return value of {code}")


class _Broken(HostCase):
    """A transfer that a reply spoils, at its first or at its second chunk, with isLast and without:
    a host may look only at what ends a transfer, or only at what does not.
    """

    EXPECTATION = "The host reports that the transfer failed, and sends no further chunk."
    REQUIREMENTS: tuple[str, ...] = ("J2A-MANY-012",)
    LEVEL: Level = "many"

    error = 0

    def spoil(self, host: Host, verb: str, position: int, code: int, payload: bytes) -> None:
        """Answer the chunk number `position` with this code and payload.

        The payload may leave out the offset that is right: `OFFSET` stands for it, and `WRONG` for
        one that is wrong in the bits of `error`. In place of the flags stands `FLAGS`, see `both`.
        """
        data = "" if verb == "read" else f" {spelt(700)}"
        name = FETCH if verb == "read" else STORE
        host.job(f"{verb} {name}{data} {host.limit_ms}")
        offset = 0
        for index in range(position + 1):
            chunk = next_chunk(host, name, offset, is_write=verb == "write")
            offset += len(chunk.data) if verb == "write" else 50
            if index < position:
                reply(host, chunk, 0, b"" if verb == "write" else pattern(50))
        right, wrong = (n.to_bytes(4, "little") for n in (chunk.offset, chunk.offset ^ self.error))
        payload = payload.replace(b"OFFSET", right).replace(b"WRONG", wrong)
        host.reply(chunk.request, code, payload)
        host.outcome(*_FAILED)

    def both(self, host: Host, code: int, payload: bytes, data: bytes = b"") -> None:
        """Spoil reads and writes, with each of `_FLAGS` in place of `FLAGS`.

        Args:
            host: the host.
            code: of the reply.
            payload: as of `spoil`.
            data: what a reply to a read holds on top.
        """
        for whole in dict.fromkeys(payload.replace(b"FLAGS", flags) for flags in _FLAGS):
            for position in (0, 1, 6):
                self.spoil(host, "read", position, code, whole + data)
            for position in (0, 1, 2):  # the last one is the last chunk of the write
                self.spoil(host, "write", position, code, whole)

    def one(self, host: Host, number: int, code: int, payload: bytes) -> None:
        """Spoil a read or a write: which, where, and with which flags depends on `number`."""
        whole = payload.replace(b"FLAGS", _FLAGS[number // 2 % len(_FLAGS)])
        self.spoil(host, ("read", "write")[number % 2], number // 2 % 3, code, whole)


class OuterCode(_Broken):
    """Answers chunks with a return value of a2jMany other than 0x00."""

    ID = "host.many.outer-code"

    def _run(self, host: Host) -> None:
        for code in (0x01, c.RET_FAILED):
            self.both(host, code, b"\x00FLAGSOFFSET", b"data")
        for number, code in enumerate((*range(2, 0xF0, 9), c.ECHO_MANY, c.RET_MAX)):
            self.one(host, number, code, b"\x00FLAGSOFFSET" + _SOME[number % 2])
        self.both(host, c.RET_FAILED, b"")


class ErrorReply(_Broken):
    """Answers chunks with error replies."""

    ID = "host.many.error-reply"
    REQUIREMENTS = ("J2A-MANY-012", "J2A-ERR-007")

    def _run(self, host: Host) -> None:
        for code in sorted(c.ERRORS):
            self.both(host, code, b"\x01\x00")


class ShortReply(_Broken):
    """Answers chunks with fewer than the 6 bytes of the header."""

    ID = "host.many.short-reply"

    def _run(self, host: Host) -> None:
        for size in range(6):
            for short in dict.fromkeys((b"\x00" + flags + bytes(3))[:size] for flags in _FLAGS):
                self.both(host, c.RET_OK, short)


class WrongOffset(_Broken):
    """Answers chunks with another offset than that of the request: each of its 32 bits wrong."""

    ID = "host.many.wrong-offset"

    def _run(self, host: Host) -> None:
        for bit in range(32):
            self.error = 1 << bit
            for verb in ("read", "write"):
                for flags in _FLAGS:
                    data = b"data" if verb == "read" and flags == _NOT_LAST else b""
                    self.spoil(host, verb, bit % 3, c.RET_OK, b"\x00" + flags + b"WRONG" + data)


class InnerCode(_Broken):
    """Answers chunks with a return value of the function of 0xF0 or above."""

    ID = "host.many.inner-code"

    def _run(self, host: Host) -> None:
        for code in (0xF0, 0xFF):
            self.both(host, c.RET_OK, bytes((code,)) + b"FLAGSOFFSET", b"data")
        for number in range(2 * (0xFF - 0xF1)):
            code = 0xF1 + number // 2
            self.one(host, number, c.RET_OK, bytes((code,)) + b"FLAGSOFFSET" + _SOME[number % 2])


class EmptyChunk(_Broken):
    """Answers reads with chunks that hold no data, though isLast is not set."""

    ID = "host.many.empty-chunk"

    def _run(self, host: Host) -> None:
        for position in (0, 1, 2, 6):
            self.spoil(host, "read", position, c.RET_OK, b"\x00\x00OFFSET")


class InnerSuccess(HostCase):
    """Answers chunks with return values of the function from 0x01 to 0xEF."""

    ID = "host.many.inner-success"
    EXPECTATION = "The transfer is as good as with 0x00."
    REQUIREMENTS = ("J2A-MANY-011", "J2A-MANY-013")
    LEVEL = "many"

    def _run(self, host: Host) -> None:
        for code in (0x01, c.ECHO_MANY, c.RET_MAX):
            host.job(f"read {FETCH} {host.limit_ms}")
            for offset in (0, 4):
                chunk = next_chunk(host, FETCH, offset, is_write=False)
                reply(host, chunk, c.FLAG_LAST if offset else 0, b"data", code)
            host.outcome(f"data {spell(b'datadata')}")
            host.job(f"write {STORE} 64 {host.limit_ms}")
            reply(host, next_chunk(host, STORE, 0, is_write=True), c.FLAG_LAST, b"", code)
            host.outcome("written")
