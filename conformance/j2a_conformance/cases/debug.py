"""Debug text (J2A-DEBUG). `ret` of the demo application writes a line for each call."""

from j2a_spec import constants as c

from j2a_conformance._case import Case
from j2a_conformance._judge import fail, skip
from j2a_conformance._peer import Peer

_AT_MOST = 100_000
_SHIFTS = 10
_LOSSY_SHIFTS = 6  # more exchanges in a row than that hardly ever pass unharmed


def take(peer: Peer, payload: bytes = b"") -> tuple[bytes, int]:
    """Call a2jDebug; return the text and the code."""
    frame = peer.call(c.GET_DEBUG, payload)
    if frame.opcode & ~(c.DEBUG_MORE | c.DEBUG_LOST):
        fail(f"a2jDebug returns 0x{frame.opcode:02X}")
    return frame.payload, frame.opcode


def drain(peer: Peer) -> tuple[bytes, bool]:
    """Take all debug text; return it, and whether some was lost."""
    text, lost = b"", False
    while True:
        part, code = take(peer)
        text += part
        lost = lost or bool(code & c.DEBUG_LOST)
        if not code & c.DEBUG_MORE:
            return text, lost
        if not part:
            fail("a2jDebug says that more is pending and returns nothing")
        if len(text) > _AT_MOST:
            fail(f"a2jDebug has no end within {_AT_MOST} bytes")


def write_line(peer: Peer, code: int = 0x05) -> bytes:
    """Have the application write a line, and take it."""
    drain(peer)
    peer.call("ret", bytes((code,)))
    text, lost = drain(peer)
    if not text:
        skip("no function is known that writes debug text")
    if lost:
        fail("text was lost, though only one line was written")
    return text


class Nothing(Case):
    """Takes all debug text, then calls a2jDebug with payloads of several lengths."""

    ID = "debug.nothing-pending"
    EXPECTATION = "No text and the value 0 when none is pending and none was lost."
    REQUIREMENTS = ("J2A-DEBUG-003", "J2A-DEBUG-002")
    LEVEL = "debug"
    NEEDS = (c.GET_DEBUG,)

    def _run(self, peer: Peer) -> None:
        drain(peer)
        for payload in (b"", b"x", b"\xff" * peer.longest):
            if take(peer, payload) != (b"", 0):
                fail(f"text or a code for a request with {len(payload)} payload bytes")


class Text(Case):
    """Has one line written and takes it, by requests with and without payload; then has two
    different lines written and takes both.
    """

    ID = "debug.text"
    EXPECTATION = (
        "The text once, whatever the payload of the request is, and then no more; the older line "
        "before the newer one."
    )
    REQUIREMENTS = ("J2A-DEBUG-001", "J2A-DEBUG-002", "J2A-DEBUG-003")
    LEVEL = "debug"
    NEEDS = (c.GET_DEBUG, "ret")

    def _run(self, peer: Peer) -> None:
        line = peer.carried(lambda: write_line(peer))
        for payload in (b"", b"x", bytes(peer.longest)):
            peer.carried(lambda p=payload: self._taken(peer, line, p))  # type: ignore[misc]
        newer = peer.carried(lambda: write_line(peer, 0x06))
        peer.carried(lambda: self._in_order(peer, line + newer))

    @staticmethod
    def _taken(peer: Peer, line: bytes, payload: bytes) -> None:
        drain(peer)
        peer.call("ret", b"\x05")
        if (taken := take(peer, payload)) != (line, 0):
            fail(f"{taken} instead of {(line, 0)}")
        if take(peer) != (b"", 0):
            fail("text comes a second time")

    @staticmethod
    def _in_order(peer: Peer, lines: bytes) -> None:
        drain(peer)
        peer.call("ret", b"\x05")
        peer.call("ret", b"\x06")
        text, lost = drain(peer)
        if not _left_of(text, lines) or (text != lines and not lost):
            fail(f"{text!r} instead of {lines!r}")


class Overflow(Case):
    """Has lines written, 1, 2, 4 up to 512 without taking any, and then takes them all."""

    ID = "debug.more-and-lost"
    EXPECTATION = (
        "At most 255 bytes a time; bit 0 as long as more is pending; all text in order, or less of "
        "it and then bit 1 once."
    )
    REQUIREMENTS = ("J2A-DEBUG-001", "J2A-DEBUG-002")
    LEVEL = "debug"
    NEEDS = (c.GET_DEBUG, "ret")

    def _run(self, peer: Peer) -> None:
        line = peer.carried(lambda: write_line(peer))
        for shift in range(_LOSSY_SHIFTS if peer.link.lossy else _SHIFTS):
            if peer.carried(lambda n=1 << shift: self._lost(peer, line, n)):  # type: ignore[misc]
                return  # larger amounts show nothing new
        peer.link.note("no text was lost, so that bit 1 could not be seen set")

    @staticmethod
    def _lost(peer: Peer, line: bytes, lines: int) -> bool:
        """Have the lines written and take them; tell whether some were lost."""
        drain(peer)
        written = line * lines
        for _ in range(lines):
            peer.call("ret", b"\x05")
        text, lost = drain(peer)
        if lost != (text != written):
            fail(f"bit 1 is {int(lost)}, and {len(text)} of {len(written)} bytes came")
        if not _left_of(text, written):
            fail("the text is not what was written")
        if take(peer) != (b"", 0):
            fail("bit 1 is set a second time, or text follows though bit 0 was 0")
        return lost


def _left_of(text: bytes, written: bytes) -> bool:
    """Tell whether `text` is `written` with bytes left out."""
    rest = iter(written)
    return all(byte in rest for byte in text)
