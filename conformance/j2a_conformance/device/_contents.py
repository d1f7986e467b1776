"""What every function that is read through a2jMany and cannot be written has to do.

What flows in: the name of the function, and offsets. What flows out: nothing, or `Judged`. The
properties and the interface are such contents.
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import product

from j2a_spec import constants as c

from j2a_conformance._judge import fail
from j2a_conformance.wire._dimensions import payload_of

from ._peer import Peer

__all__ = ["check_all_or_none", "check_end", "check_offsets", "check_writes", "ends_early"]


def check_all_or_none(has: Mapping[str, bool]) -> None:
    """Fail where a device has one thing that belongs together with others, and not these."""
    if len(set(has.values())) > 1:
        there = [what for what, is_there in has.items() if is_there]
        missing = [what for what, is_there in has.items() if not is_there]
        fail(f"there is {' and '.join(there)}, but not {' and '.join(missing)}")


def check_offsets(peer: Peer, name: str, whole: bytes, offsets: Sequence[int]) -> None:
    """Read from each offset, some with data, which mean nothing (J2A-MANY-010); what comes must be
    that part of `whole`, the first read.
    """
    early = ends_early(peer, name, len(whole))
    for flags, offset, data in _reads(peer, offsets):
        reply = peer.ask_many(peer.many(name, flags, offset, data))
        if not reply.data or whole[offset : offset + len(reply.data)] != reply.data:
            fail(f"a read at offset {offset} returns other bytes than the first read")
        if (reply.code, reply.offset) != (c.RET_OK, offset):
            fail(f"{reply} in a read at offset {offset}")
        is_last = early and offset + len(reply.data) == len(whole)
        if is_last != bool(reply.flags & c.FLAG_LAST):
            not_ = "" if reply.flags & c.FLAG_LAST else "not "
            fail(f"isLast is {not_}set in the chunk at {offset}, the end is {len(whole)}")


def ends_early(peer: Peer, name: str, size: int) -> bool:
    """Tell whether the chunk with the last byte is the last one; else an empty chunk behind it has
    to be (J2A-MANY-020). A device does the one or the other, whatever the offset.
    """
    if peer.ask_many(peer.many(name, offset=size - 1)).flags & c.FLAG_LAST:
        return True
    reply = peer.ask_many(peer.many(name, offset=size))
    if reply.data or not reply.flags & c.FLAG_LAST:
        fail(f"isLast is set neither in the chunk at {size - 1} nor at the end, {size}")
    return False


def _reads(peer: Peer, offsets: Sequence[int]) -> Iterator[tuple[int, int, bytes]]:
    """Yield flags, offset and data: at the ends and in the middle each flag with no data, one byte
    and most, and at each offset data of another length, every fourth time of many bytes.
    """
    most = peer.longest_chunk
    for offset in sorted({offsets[0], offsets[len(offsets) // 2], offsets[-1]}):
        for number, length in enumerate((0, 1, most)):
            for flags in (0, c.FLAG_LAST):
                yield flags, offset, payload_of(length, number)
    for number, offset in enumerate(offsets):
        many = number // 4 * 77 % (most + 1)  # in the end each length
        yield offset % 2, offset, payload_of((0, 1, 0, many)[number % 4], number)


def check_writes(peer: Peer, name: str, what: str, content: bytes) -> None:
    """Write nothing, a byte and some content at each of several offsets, and a whole chunk; all of
    it must fail and change nothing.
    """
    before = peer.read_all(name)
    writes = [*product((0, 3, len(before), 2**31), (b"", b"x", content))]
    for offset, data in (*writes, (3, bytes(peer.longest_chunk))):
        for flags in (c.FLAG_WRITE, c.FLAG_WRITE | c.FLAG_LAST):
            reply = peer.ask_many(peer.many(name, flags, offset, data))
            if reply.code != c.RET_FAILED:
                fail(f"code 0x{reply.code:02X} for a write to the {what}")
    if peer.read_all(name) != before:
        fail(f"a write has changed the {what}")


def check_end(peer: Peer, name: str) -> None:
    """Read at the end and at many offsets behind it, with and without data; an empty last chunk
    must come, with the code 0x00 as in each read.
    """
    size = len(peer.read_all(name))
    ends = [size + (1 << shift) for shift in range(31)]
    # Where offsets of fewer bits would be in the contents.
    cut = [(1 << shift) + at for shift in range(8, 32) for at in (0, size // 2, size - 1)]
    behind = (*ends, *cut, 0xFFFFFFFF - 255, 0xFFFFFFFE, 0xFFFFFFFF)
    for flags, offset, data in _reads(peer, (size, *(each for each in behind if each > size))):
        reply = peer.ask_many(peer.many(name, flags, offset, data))
        if reply.data or not reply.flags & c.FLAG_LAST or reply.offset != offset:
            fail(f"{reply} in a read at offset {offset}, the end is {size}")
        if reply.code != c.RET_OK:
            fail(f"code 0x{reply.code:02X} in a read behind the end")
