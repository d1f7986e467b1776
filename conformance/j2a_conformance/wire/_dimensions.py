"""What cases vary: lengths, payloads, places in a frame, pieces, offsets.

What flows in: numbers. What flows out: test data, the same for the same numbers. Rules: a rule that
holds for one value of a dimension says nothing of the next, so a case walks over all of a cheap
dimension and takes from the others a different value at each step; strides are odd and differ, so
that no two dimensions stay in step.
"""

import random
from collections.abc import Iterator, Sequence
from functools import cache
from typing import Final

from j2a_spec import constants as c
from j2a_spec.oracle import checksum, stuff

__all__ = [
    "SPECIAL",
    "damaged",
    "lane_offset",
    "lengths",
    "misread",
    "payload_of",
    "pieces",
    "places",
    "spread",
]

SPECIAL: Final = bytes(
    (0x12, 0xED, 0x7D, 0x11, 0xEC, 0x7C, 0x13, 0xEE, 0x7E, 0x00, 0x01, 0x7F, 0x80, 0xFE, 0xFF)
)
"""Bytes with a meaning, those beside them, and the ends of the range."""

_EDGES: Final = (0, 1, 2, 12, 17, 18, 31, 32, 33, 63, 64, 65, 100, 125, 127, 128, 129, 200)
_EDGES_ABOVE: Final = (236, 237, 238, 248, 249, 250, 253, 254, 255)


@cache
def payload_of(length: int, n: int = 0) -> bytes:
    """Return `length` bytes of the kind that `n` chooses.

    In turn: all values in a row from another first value, special bytes in disorder, runs of
    special bytes between others, noise, and one special byte only.
    """
    kind, salt = n % 5, n // 5 + length * 7
    rng = random.Random(length << 16 | n)
    if kind == 0:
        return bytes((salt + index * (1 + 2 * (n // 5 % 4))) % 256 for index in range(length))
    if kind == 1:
        return bytes(rng.choices(SPECIAL, k=length))
    if kind == 2:
        data = b""
        while len(data) < length:
            run = bytes((rng.choice(SPECIAL),)) * rng.randint(1, 9)
            data += run + rng.randbytes(rng.randint(0, 3))
        return data[:length]
    if kind == 3:
        return rng.randbytes(length)
    return bytes((SPECIAL[salt % len(SPECIAL)],)) * length


def lengths(at_most: int = c.MAX_PAYLOAD) -> range:
    """Return every length of a payload, up to `at_most` bytes."""
    return range(at_most + 1)


def spread(at_most: int = c.MAX_PAYLOAD, step: int = 29, first: int = 0) -> list[int]:
    """Return some numbers from `first` to `at_most`: every `step`-th, and those beside limits."""
    found = {*range(first, at_most + 1, step), *_EDGES, *_EDGES_ABOVE, at_most}
    return sorted(number for number in found if first <= number <= at_most)


def places(wire: bytes) -> range:
    """Return every place inside a frame: numbers of bytes that came, of 1 up to all but one."""
    return range(1, len(wire))


def pieces(data: bytes, n: int) -> list[bytes]:
    """Return `data` in two to four pieces, cut at other places for each `n`."""
    rng = random.Random(len(data) << 16 | n)
    most = min(3, len(data) - 1)
    cuts = sorted(rng.sample(range(1, len(data)), min(1 + n % 3, most))) if most else []
    return [data[a:b] for a, b in zip([0, *cuts], [*cuts, len(data)], strict=True)]


def lane_offset(n: int) -> int:
    """Return an offset; over 256 numbers `n` each of its four bytes takes each value once."""
    lanes = (n, n * 5 + 0x12, n * 11 + 0x7D, n * 23 + 0xED)
    return int.from_bytes(bytes(lane % 256 for lane in lanes), "little")


def damaged(opcode: int, n: int) -> tuple[bytes, int]:
    """Return a short request with a wrong checksum, and its seq."""
    seq, data = 0x20 + n % 0x40, b"wrong"[: n % 6]
    body = bytes((seq, opcode, len(data))) + data
    return bytes((c.SOF,)) + stuff(body + bytes((checksum(seq, opcode, data) ^ 1,))), seq


def misread(
    opcode: int, kinds: Sequence[tuple[bytes, int | None]]
) -> Iterator[tuple[bytes, tuple[int, int]]]:
    """Yield requests of every length that are whole for a device that misreads a few bytes.

    Args:
        opcode: of the requests.
        kinds: what stands in a field or between two, and the value as which it is misread, None
            for nothing at all.

    Yields:
        The wire bytes, and the seq and how many bytes of the frame precede what is misread.
    """
    for length in lengths():
        size = length + c.HEADER + 1
        short = length <= 4 or length in (0x12, 0x13, 0xED, 0xEE, 0xFF)
        some = kinds if short else [kinds[(length + n) % len(kinds)] for n in range(2)]
        for n, (sent, value) in enumerate(some):
            for index in range(size) if short else ((length * 7 + n * 3) % size, length % 3):
                if length > 0x13 and short and index >= c.HEADER and index % len(kinds) != n:
                    continue  # in long payloads each place once
                body = bytearray((length * 3 % 256, opcode, length, *payload_of(length, length), 0))
                if value is not None:
                    if 0 < index < c.HEADER and body[index] != value:
                        continue  # another opcode or length would be another request
                    body[index] = value
                seq, code, payload = body[0], body[1], bytes(body[c.HEADER : -1])
                body[-1] = checksum(seq, code, payload)
                if index == size - 1 and value is not None:
                    if not payload:
                        continue
                    body[-2] ^= body[-1] ^ value
                    body[-1] = value
                rest = body[index + (value is not None) :]
                wire = bytes((c.SOF,)) + stuff(bytes(body[:index])) + sent + stuff(bytes(rest))
                yield wire, (seq, index)
