"""Topics, right ones and wrong ones (J2A-TRANS-013)."""

from collections.abc import Iterable, Iterator
from typing import Final

from j2a_spec import constants as c


def _characters() -> Iterator[str]:
    """Yield the first and the last character for each first byte of UTF-8 above 0x7F."""
    for first in range(0xC2, 0xE0):
        yield from (chr((first & 0x1F) << 6 | rest) for rest in (0, 0x3F))
    for first in range(0xE0, 0xF0):
        low, high = ((first & 0xF) << 12 | rest for rest in (0, 0xFFF))
        yield from (chr(max(low, 0x800)), chr(0xD7FF if first == 0xED else high))
    for first in range(0xF0, 0xF5):
        low, high = ((first & 7) << 18 | rest for rest in (0, 0x3FFFF))
        yield from (chr(max(low, 0x10000)), chr(min(high, 0x10FFFF)))


def _joined(characters: Iterable[str]) -> list[bytes]:
    """Return topics that consist of these characters."""
    topics = [b""]
    for character in characters:
        if len(topics[-1]) + len(character.encode()) > c.TRANSD_MAX_TOPIC:
            topics.append(b"")
        topics[-1] += character.encode()
    return topics


WRONG_TOPICS: Final = (
    *(bytes((byte,)) for byte in (*range(0x20), *range(0x7F, 0x100))),
    *(b"a" + bytes((byte,)) + b"b" for byte in (0, 9, 10, 31, 127, 128, 0xBF, 0xC0, 0xFE, 0xFF)),
    *(text + b"\x80" for text in (b"\xc0", b"\xc1", b"\xe0\x80", b"\xe0\x9f", b"\xed\xa0")),
    b"\xe0\x84\x80",
    *(b"a" * 20 + text for text in (b"\xc3", b"\xe2\x82", b"\xf0\x9f\xa4", b"\xc3a", b"\xe2\x82a")),
    *(  # characters that end too early, at the end of topics of each length
        (b"a" * length)[: -len(text)] + text
        for n, text in enumerate(
            (b"\xc3", b"\xe2", b"\xe2\x82", b"\xf0", b"\xf0\x9f", b"\xf0\x9f\xa4")
        )
        for length in (*range(4 + n, 32, 6), 32)
    ),
    *(text + b"\x80\x80" for text in (b"\xf0\x80", b"\xf0\x8f", b"\xf4\x90", b"\xf5\x80")),
    b"\xff\x80\x80\x80",
    "\u00e4".encode() + b"\x84",
    *(  # each byte of a character but the first one: a wrong one in its place, and the end
        text
        for char in ("\u00e4", "\u20ac", "\U0001f916")
        for at in range(1, len(char.encode()))
        for head, rest in ((char.encode()[:at], char.encode()[at + 1 :]),)
        for text in (head, *(head + bytes((byte,)) + rest + b"b" for byte in b" a~\xc2\xf0"))
    ),
    *(char.encode()[:-1] + b"\x7f" for char in _characters()),
    *(b"a" * (length - 1) + b"\xff" for length in range(2, 33)),
    *(
        before + wrong + behind
        for wrong in (
            b"\xc0\xaf", b"\xc1\xbf", b"\xe0\x9f\xbf", b"\xed\xa0\x80", b"\xed\xbf\xbf",
            b"\xf0\x8f\xbf\xbf", b"\xf4\x90\x80\x80", b"\xe2\x82", b"\x7f", b"\x1f",
        )
        for before, behind in (
            (b"", b"b"), (b"a", b""), ("\u00e4".encode(), b""), (b"a" * 27, b"b")
        )
    ),
)  # fmt: skip
RIGHT_TOPICS: Final = (
    b"a", b"left/wheel", bytes(range(0x20, 0x40)), bytes(range(0x5F, 0x7F)), b"~" * 32,
    "\u00e4".encode(), "\u07ff".encode(), "\u0800".encode(), "\ud7ff\ue000".encode(),
    "\uffff".encode(), "\U00010000\U0010ffff".encode(), ("\u00e4" * 16).encode(),
    ("\U0001f916" * 8).encode(), b" a", b"a ", b" ", b" " * 32, b"x", *_joined(_characters()),
    *(b"t" * length for length in range(32, 0, -1)),  # each one behind a longer one
    *(b"u" * at + b"t" * (32 - at) for at in range(33)),  # each differs from another in one byte
)  # fmt: skip
