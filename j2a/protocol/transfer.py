"""Transfers of any size in chunks (a2jMany), without the link.

What flows in: data to send, replies. What flows out: calls of a2jMany to make, and the result.
Rules: each transfer is a generator that yields calls to make at once, is sent their replies or
thrown the first error, and returns its result; whoever drives it owns the waiting. Chunks follow
each other without gap or overlap; anything else that a device answers is an error, never a silent
loss.
"""

import struct
from collections.abc import Callable, Generator, Iterator, Sequence
from itertools import islice
from typing import Final, NamedTuple, TypeVar

from j2a_spec.constants import (
    ECHO_MANY,
    FLAG_LAST,
    FLAG_WRITE,
    MANY_HEADER,
    RET_MAX,
    RET_OK,
)

from j2a.errors import (
    FunctionFailed,
    J2AError,
    LegacyLimit,
    LocalError,
    OpcodeRefused,
    Outcome,
    ProtocolError,
    remote_error,
)
from j2a.events import Reply

__all__ = [
    "CallRequest",
    "Chunk",
    "OffsetCheck",
    "Progress",
    "TooMuchError",
    "Transfer",
    "echo_chunks",
    "read_chunks",
    "write_chunks",
]

Progress = Callable[[int, int | None], None]
"""Called after each chunk with the bytes done and the bytes in all, None if unknown."""

MAX_OFFSET: Final = 2**32 - 1
LEGACY_OFFSET: Final = 255
_HEADER: Final = struct.Struct("<BBL")


class TooMuchError(ProtocolError):
    """The device sends more than is taken."""


class Chunk(NamedTuple):
    """One reply of a2jMany: return value, isLast, offset in bytes, 0 to 249 bytes of data."""

    code: int
    is_last: bool
    offset: int
    data: bytes


class CallRequest(NamedTuple):
    """A call to make; an opcode of None is a2jMany, a limit of None that of the driver."""

    what: str
    payload: bytes
    opcode: int | None = None
    limit_s: float | None = None


_Result = TypeVar("_Result")
Transfer = Generator[tuple[CallRequest, ...], list[Reply], _Result]
"""Work under way: yields calls that may be on the wire together, is sent their replies in the same
order, or thrown the first error once all have ended; returns its result."""

OffsetCheck = Callable[[bytearray, Chunk], Transfer[None]]
"""Asked before the first offset above 255 is used; gets what has been read and the first chunk, and
raises `LegacyLimit` when the device cannot be trusted with it."""


def preparing(what: str, transfer: Transfer[_Result]) -> Transfer[_Result]:
    """Do what has to be done before a request; if that fails, the request was not sent."""
    try:
        return (yield from transfer)
    except LocalError:
        raise
    except J2AError as error:
        raise error.copy(f"{what} was not sent: {error}", Outcome.NOT_SENT) from None


def exchange(what: str, opcode: int, flags: int, offset: int, data: bytes) -> Transfer[Chunk]:
    """Send one chunk and return the reply, checked as far as every transfer needs it."""
    [chunk] = yield from exchange_all(what, opcode, [(flags, offset, data)])
    return chunk


def exchange_all(
    what: str, opcode: int, chunks: Sequence[tuple[int, int, bytes]]
) -> Transfer[list[Chunk]]:
    """Send chunks at once, each flags, offset and data; return their replies as `exchange` does."""
    requests = tuple(
        CallRequest(_place(what, offset), _HEADER.pack(opcode, flags, offset) + data)
        for flags, offset, data in chunks
    )
    try:
        replies = yield requests
    except OpcodeRefused as error:
        hint = "a function that is not made for transfers is called by `call`"
        raise error.copy(f"{error}; {hint}", error.outcome) from None
    except J2AError as error:
        raise _begun(error, len(chunks) > 1 or chunks[0][1] > 0) from None
    return [
        _checked(what, offset, reply) for (_, offset, _), reply in zip(chunks, replies, strict=True)
    ]


def _place(what: str, offset: int) -> str:
    return f"{what} at offset {offset}"


def _checked(what: str, offset: int, reply: Reply) -> Chunk:
    """Return the chunk that a reply to one at this offset brings."""
    where = _place(what, offset)
    if reply.code != RET_OK:
        raise remote_error(f"{where} (a2jMany itself)", reply.code, reply.payload)
    if len(reply.payload) < MANY_HEADER:
        raise ProtocolError(
            f"{where}: a2jMany sent {len(reply.payload)} bytes; its header alone is {MANY_HEADER}"
        )
    code, reply_flags, reply_offset = _HEADER.unpack_from(reply.payload)
    if code > RET_MAX:
        details = reply.payload[MANY_HEADER:]
        raise FunctionFailed(f"{where}: the function failed (code 0x{code:02X})", code, details)
    if reply_offset != offset:
        raise ProtocolError(
            f"{what}: the device answered offset {reply_offset} instead of {offset}"
        )
    return Chunk(code, bool(reply_flags & FLAG_LAST), offset, reply.payload[MANY_HEADER:])


def _begun(error: J2AError, has_begun: bool) -> J2AError:
    """Return the error of a transfer of which other chunks may have been executed, or none."""
    if not has_begun or error.outcome is not Outcome.NOT_SENT:
        return error
    return error.copy(f"{error}; what came before was executed", Outcome.MAYBE_EXECUTED)


def read_chunks(
    what: str,
    opcode: int,
    *,
    max_bytes: int,
    offset_check: OffsetCheck,
    progress: Progress | None = None,
    advice: str = "pass a larger max_bytes if that is right",
) -> Transfer[bytes]:
    """Read until the device says that a chunk is the last (J2A-MANY-011).

    Args:
        what: how messages name the transfer.
        opcode: of the function that is read, 0..255.
        max_bytes: the most to accept, so that a device without an end cannot fill the memory.
        offset_check: see `OffsetCheck`.
        progress: see `Progress`.
        advice: what the message says about more data than that.

    Returns: all data.

    Raises:
        RemoteError: the device refused or failed.
        TooMuchError: the chunks are more than `max_bytes`.
        ProtocolError: they do not fit together.
    """
    content = bytearray()
    first: Chunk | None = None
    is_trusted = False
    while True:
        offset = len(content)
        if offset > LEGACY_OFFSET and first is not None and not is_trusted:
            try:
                yield from offset_check(content, first)
            except J2AError as error:
                raise _begun(error, offset > 0) from None
            is_trusted = True
        chunk = yield from exchange(what, opcode, 0, offset, b"")
        first = first or chunk
        content += chunk.data
        if len(content) > max_bytes:
            raise TooMuchError(f"{what}: the device sends more than {max_bytes} bytes; {advice}")
        if progress is not None:
            progress(len(content), len(content) if chunk.is_last else None)
        if chunk.is_last:
            return bytes(content)
        if not chunk.data:
            raise ProtocolError(
                f"{what}: an empty chunk at offset {offset} is not the last; this would never end"
            )


def write_chunks(
    what: str,
    opcode: int,
    data: bytes,
    *,
    chunk_size: int,
    progress: Progress | None = None,
) -> Transfer[int]:
    """Write all data in chunks; no data is one empty chunk (J2A-MANY-013, J2A-LIMIT-007).

    Args:
        what: how messages name the transfer.
        opcode: of the function that is written to, 0..255.
        data: up to 2**32-1 bytes.
        chunk_size: the most data of a chunk, 1..249 bytes.
        progress: see `Progress`.

    Returns: the return value of the function for the last chunk, 0..0xEF.

    Raises:
        RemoteError: the device refused or failed.
        ProtocolError: the device answered another offset.
    """
    code = RET_OK
    for offset, part, flags in _split(data, chunk_size):
        chunk = yield from exchange(what, opcode, flags | FLAG_WRITE, offset, part)
        code = chunk.code
        if progress is not None:
            progress(offset + len(part), len(data))
    return code


def echo_chunks(
    what: str,
    opcode: int,
    data: bytes,
    *,
    chunk_size: int,
    window: int = 1,
    progress: Progress | None = None,
) -> Transfer[bytes]:
    """Send data through a2jEchoMany and check that each chunk comes back as it was (J2A-ECHO-002).

    Args and raises: as `write_chunks`; `window` is how many chunks may be on their way, which a
    function without state allows. Returns: what came back.
    """
    content = bytearray()
    parts = _split(data, chunk_size)
    while group := list(islice(parts, window)):
        sent = [(flags | FLAG_WRITE, offset, part) for offset, part, flags in group]
        chunks = yield from exchange_all(what, opcode, sent)
        for (offset, part, flags), chunk in zip(group, chunks, strict=True):
            if chunk != (ECHO_MANY, bool(flags & FLAG_LAST), offset, part):
                raise ProtocolError(f"{what}: the chunk at offset {offset} came back changed")
            content += chunk.data
            if progress is not None:
                progress(len(content), len(data))
    return bytes(content)


def probe_offsets(
    what: str, opcode: int, content: bytes | bytearray, first: Chunk
) -> Transfer[None]:
    """Find out whether a device of version 1.0 honours offsets above 255 (J2A-MANY-014).

    Old devices look at the lowest byte of the offset only, so offset 256 gives what offset 0 gave.

    Args:
        what: how messages name the transfer.
        opcode: of the function that the transfer is with, 0..255.
        content: what was read so far, from offset 0 on.
        first: the chunk at offset 0.

    Raises:
        LegacyLimit: it does not, or this cannot be determined.
    """
    probe = yield from exchange(f"{what} (probe)", opcode, 0, LEGACY_OFFSET + 1, b"")
    common = min(len(first.data), len(probe.data))
    if probe.data[:common] == first.data[:common] and (common or not first.data):
        raise LegacyLimit(
            f"{what} needs offsets above {LEGACY_OFFSET}, but this device is of version 1.0 "
            "and sends its beginning again there, or looks as if it did"
        )
    known = content[LEGACY_OFFSET + 1 :]
    if known[: len(probe.data)] != probe.data[: len(known)]:
        raise LegacyLimit(
            f"{what} needs offsets above {LEGACY_OFFSET}, but this device is of version 1.0 "
            "and sends something else there than it sent before"
        )


def _split(data: bytes, size: int) -> Iterator[tuple[int, bytes, int]]:
    """Return offset, data and flags of each chunk, at least one."""
    starts = range(0, max(len(data), 1), size)
    for start in starts:
        yield start, data[start : start + size], FLAG_LAST if start == starts[-1] else 0
