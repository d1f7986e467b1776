"""The dimensions of what a device sends: length, field, escapes, damage, place of the cut.

What flows in: a start byte, a seq and lengths. What flows out: frames that are right, however they
are escaped, and `Broken` ones with a word on what is wrong. Rules: seeded, so that each run sends
the same; no broken frame holds a good one.
"""

import random
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from itertools import product

from j2a_spec import constants as c
from j2a_spec.oracle import Frame, checksum

__all__ = [
    "LENGTHS",
    "SPECIAL",
    "Broken",
    "content",
    "cut_off",
    "escape_ff",
    "escaped",
    "frame",
    "interrupted",
    "places",
    "resembling",
    "with_sum",
    "wrong_sums",
]

LENGTHS = range(c.MAX_PAYLOAD + 1)
SPECIAL = bytes(sorted({*c.STUFFED, *(b - 1 for b in c.STUFFED), *(b + 1 for b in c.STUFFED)}))
_FIELDS = ("seq", "opcode", "length")
_EVERY_MASK = (0, 1, 17, 64, 255)  # lengths at which each wrong checksum there is comes
_ERRORS = tuple(sorted(c.ERRORS))
_ERROR_LENGTH = 2
_RETURNED = (*range(c.RET_MAX + 1), c.RET_FAILED)


@dataclass(frozen=True, slots=True)
class Broken:
    """A frame that no receiver may act on.

    Attributes:
        what: what is wrong with it, in words.
        wire: its bytes; they may end inside it, where a start byte must follow.
        code: its opcode, by which an outcome tells that it was taken.
        payload: as a host may read it that takes it.
    """

    what: str
    wire: bytes
    code: int
    payload: bytes


def _stuffed(data: bytes) -> bytes:
    """Do what `oracle.stuff` does, fast; the escape comes first, for it is in the rest."""
    for value in (c.ESC, *sorted(c.MARKERS)):
        data = data.replace(bytes((value,)), bytes((c.ESC, value - 1)))
    return data


@cache
def _table(salt: int) -> bytes:
    """Return a table that makes every third value, which ones depends on `salt`, a special one."""
    return bytes(SPECIAL[n % len(SPECIAL)] if (n + salt) % 3 == 0 else n for n in range(256))


@cache
def content(length: int, salt: int = 0) -> bytes:
    """Return a payload of this length, different for each salt; a third of it is special."""
    return random.Random(1000 * salt + length).randbytes(length).translate(_table(salt))


def with_sum(seq: int, code: int, payload: bytes, wanted: int) -> bytes:
    """Return the payload, of at least one byte, changed in a place so that the sum is `wanted`."""
    middle = len(payload) // 2
    byte = payload[middle] ^ checksum(seq, code, payload) ^ wanted
    return payload[:middle] + bytes((byte,)) + payload[middle + 1 :]


def _body(seq: int, code: int, payload: bytes, error: int = 0) -> bytes:
    check = checksum(seq, code, payload) ^ error
    return bytes((seq, code, len(payload))) + payload + bytes((check,))


def frame(start: int, seq: int, code: int, payload: bytes, error: int = 0) -> bytes:
    """Return the wire bytes of a frame whose checksum is wrong in the bits of `error`."""
    return bytes((start,)) + _stuffed(_body(seq, code, payload, error))


def escaped(start: int, seq: int, code: int, payload: bytes, at: set[int] | None = None) -> bytes:
    """Return a frame with needless escapes.

    Args:
        start, seq, code, payload: of the frame.
        at: indices of the bytes behind the start byte to escape, where they can be; None is all.
    """
    wire = bytearray((start,))
    for index, byte in enumerate(_body(seq, code, payload)):
        free = (byte - 1) % 256 not in (*c.MARKERS, 0xFF) and (at is None or index in at)
        wire += bytes((c.ESC, byte - 1)) if free or byte in c.STUFFED else bytes((byte,))
    return bytes(wire)


def places(length: int, rng: random.Random, first: int = 1) -> tuple[int, ...]:
    """Return indices of bytes of a frame behind its start byte: all of a short one, else some."""
    size = length + c.HEADER + 1
    if length <= 4:
        return tuple(range(first, size))
    return tuple(sorted({size - 1, rng.randrange(first, c.HEADER), rng.randrange(c.HEADER, size)}))


def resembling(token: str) -> tuple[str, ...]:
    """Return values of j2a.caps that hold a token, or nearly so, and do not announce it."""
    parts = (
        "x",
        "acme.",
        "x-",
        "2",
        "_",
        ".",
        "-",
        ",",
        "\n",
        "\t",
        "\u00a0",
        '"',
        "x,",
        "=",
        "\u00b5",
    )
    glued = [text for part in parts for text in (part + token, token + part, f"x {token}{part} x")]
    changed = [token[:-1], token[1:], token + token, token.upper(), token.capitalize()]
    return (*glued, *changed, *(f"{token}{more}" for more in ("s", "er", ".x", "-2", "2.0")))


def _named(index: int, length: int) -> str:
    if index < c.HEADER:
        return f"the {_FIELDS[index]}"
    return "the checksum" if index == length + c.HEADER else f"payload byte {index - c.HEADER}"


def _fields(start: int, seq: int, number: int) -> tuple[int, int]:
    """Return seq and opcode of a frame: of a SIF any, of a reply its own and any return value.

    Each fifth reply is an error reply.
    """
    if start == c.SOS:
        return (seq + number * 3) % 256, (number * 7) % 256
    if number % 5 == 4:
        return seq, _ERRORS[number // 5 % len(_ERRORS)]
    return seq, _RETURNED[number % len(_RETURNED)]


def wrong_sums(start: int, seq: int, lengths: Iterable[int] = LENGTHS) -> Iterator[Broken]:
    """Yield frames of these lengths whose checksum is wrong; of some lengths, in every way.

    Those of 2 bytes look like error replies of each code, wrong in each bit.

    Args:
        start: SOF or SOS.
        seq: of replies; SIFs have every seq there is.
        lengths: of the payloads.
    """
    for length in lengths:
        masks = range(1, 256) if length in _EVERY_MASK else (1 << length % 8, 0x80, 1 + length)
        for mask in masks:
            payload, fields = content(length, mask % 4), _fields(start, seq, length + mask)
            wire, code = frame(start, *fields, payload, mask), fields[1]
            yield Broken(f"the checksum wrong by 0x{mask:02X}", wire, code, payload)
        for bit, code in product(range(8), _ERRORS if length == _ERROR_LENGTH else ()):
            payload, mask = content(length, bit), 1 << bit
            wire = frame(start, seq, code, payload, mask)
            yield Broken(f"the checksum wrong by 0x{mask:02X}", wire, code, payload)


def escape_ff(start: int, seq: int, lengths: Iterable[int] = LENGTHS) -> Iterator[Broken]:
    """Yield frames with ESC 0xFF in a field, or between two; see `wrong_sums`.

    Each is whole for a host that reads ESC 0xFF as 0x00 or as 0xFF, or that leaves it out.
    """
    kinds = ((b"\x7d\xff", 0x00), (b"\x7d\xff", 0xFF), (b"\x7d\xff", None))
    return _everywhere(start, seq, lengths, kinds)


def interrupted(start: int, seq: int, lengths: Iterable[int] = LENGTHS) -> Iterator[Broken]:
    """Yield frames with a raw start byte in a field, or between two; see `wrong_sums`.

    Each is whole for a host that takes the start byte for a value, leaves it out, or takes it as
    escaped where ESC stands before it, or ESC and it for the start byte.
    """
    kinds: list[tuple[bytes, int | None]] = []
    for value in sorted(c.MARKERS):
        raw, pair = bytes((value,)), bytes((c.ESC, value))
        kinds += [(raw, value), (raw, None), (pair, value + 1), (pair, value)]
    return _everywhere(start, seq, lengths, tuple(kinds))


def _everywhere(
    start: int, seq: int, lengths: Iterable[int], kinds: tuple[tuple[bytes, int | None], ...]
) -> Iterator[Broken]:
    first = 0 if start == c.SOS else 1  # another seq is no reply in any case
    for length in lengths:
        rng = random.Random(len(kinds) + length)
        payload = range(c.HEADER, length + c.HEADER)
        for index in places(length, rng, first):
            is_thorough = length < 30 or length > 250 or index in payload
            some = kinds if is_thorough else rng.sample(kinds, 2)
            fields = _fields(start, seq, length + index)
            whole = Frame(start, *fields, content(length, index % 5))
            misread = (_misread(whole, index, *kind) for kind in some)
            yield from (broken for broken in misread if broken is not None)


def _misread(whole: Frame, index: int, sent: bytes, read_as: int | None) -> Broken | None:
    """Return a frame that is whole if `sent`, at `index`, is read as one value or as none."""
    seq, code, payload = whole.seq, whole.opcode, whole.payload
    last = len(payload) + c.HEADER
    if read_as is not None:
        if (index == c.HEADER - 1 and len(payload) != read_as) or (index == last and not payload):
            return None
        if index == last:
            payload = with_sum(seq, code, payload, read_as)
        elif index >= c.HEADER:
            at = index - c.HEADER
            payload = payload[:at] + bytes((read_as,)) + payload[at + 1 :]
        seq, code = read_as if index == 0 else seq, read_as if index == 1 else code
    body = _body(seq, code, payload)
    behind = body[index + (read_as is not None) :]
    wire = bytes((whole.start,)) + _stuffed(body[:index]) + sent + _stuffed(behind)
    if sent[-1] in c.MARKERS and _begins_good(behind):
        return None
    place = "before" if read_as is None else "at"
    what = f"{sent.hex(' ')} {place} {_named(index, len(payload))}"
    return Broken(what, wire, code, payload)


def _begins_good(body: bytes) -> bool:
    """Tell whether what follows a start byte is a frame that is right."""
    if len(body) <= c.HEADER or len(body) <= body[2] + c.HEADER:
        return False
    end = body[2] + c.HEADER
    return checksum(body[0], body[1], body[c.HEADER : end]) == body[end]


def cut_off(start: int, seq: int, lengths: Iterable[int] = LENGTHS) -> Iterator[Broken]:
    """Yield frames that are cut off; those of a few lengths everywhere; see `wrong_sums`."""
    for length in lengths:
        rng, payload = random.Random(length), content(length, 9)
        own, code = _fields(start, seq, length)
        wire = frame(start, own, code, payload)
        every = range(1, len(wire)) if length in (0, 6, 20) else {1, 4, len(wire) - 1}
        for end in (*every, rng.randrange(1, len(wire))):
            yield Broken(f"cut off behind {end} bytes", wire[:end], code, payload)
