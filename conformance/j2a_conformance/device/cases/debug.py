"""Debug text (J2A-DEBUG). `ret` of the demo application writes a line for each call."""

from collections.abc import Iterable

from j2a_spec import constants as c

from j2a_conformance._judge import fail, inform
from j2a_conformance.device._case import Case
from j2a_conformance.device._peer import Peer
from j2a_conformance.wire._dimensions import lengths, payload_of
from j2a_conformance.wire._expected import first_difference

_AT_MOST = 100_000
_SHIFTS = 10
_SAME_SEQ = 9  # calls
_QUICK_BYTE_S = 0.0005  # at which hundreds of lines take a few seconds
_LOSSY_SHIFTS = 6  # more exchanges in a row than that hardly ever pass unharmed
_TARGETS = (1, 8, 9, 31, 32, 33, 63, 64, 65, 126, 127, 128, 129, 253, 254, 255, 256, 257, 509, 510,
            511, 512, 513)  # fmt: skip


def line_of(code: int) -> bytes:
    """Return the line that `ret` of the demo application writes for a code."""
    return b"ret 0x%02X\n" % code


LINE = len(line_of(0))


def take(peer: Peer, payload: bytes = b"") -> tuple[bytes, int]:
    """Call a2jDebug; return the text and the code."""
    frame = peer.call(c.GET_DEBUG, payload)
    if frame.opcode & ~(c.DEBUG_MORE | c.DEBUG_LOST):
        fail(f"a2jDebug returns 0x{frame.opcode:02X}")
    return frame.payload, frame.opcode


def drain(peer: Peer, at_most: int = _AT_MOST) -> tuple[bytes, bool]:
    """Take all debug text and judge the bits of each call; return it, and whether some was lost."""
    text, lost, calls = b"", False, 0
    while True:
        part, code = take(peer)
        calls += 1
        text += part
        if calls > 1 and not part:  # the call before said that there is more
            fail(f"bit 0 is 1 behind {len(text)} bytes, and the next call returns no text")
        if code & c.DEBUG_LOST and calls > 1:
            fail("bit 1 is set again, though nothing was written since the last call")
        lost = lost or bool(code & c.DEBUG_LOST)
        if not code & c.DEBUG_MORE:
            if (again := take(peer)) != (b"", 0):
                fail(f"bit 0 is 0, and the next call returns {again} behind {len(text)} bytes")
            return text, lost
        if len(text) > at_most:
            fail(f"a2jDebug has no end within {at_most} bytes")


def write(peer: Peer, codes: Iterable[int]) -> bytes:
    """Have the application write a line for each code; return the text.

    To be called within `Peer.attempts`, behind a drain: a batch that a stall spoiled and that went
    out again on its own would write its lines twice.
    """
    codes = tuple(codes)
    peer.ask_all(peer.request(peer.opcode("ret"), bytes((n,)), n, b"") for n in codes)
    return b"".join(map(line_of, codes))


def fill(peer: Peer, codes: Iterable[int]) -> tuple[bytes, bytes, bool]:
    """Have the application write lines where no text is pending, and take all there is.

    Returns: what was written, what came, and whether some was lost.
    """
    drain(peer)
    written = write(peer, codes)
    return written, *drain(peer)


def check_text(text: bytes, written: bytes, lost: bool) -> None:
    """Fail unless `text` is what was written, or less of it where text was lost."""
    if lost != (text != written):
        where = "" if lost else f": {first_difference(text, written)}"
        fail(f"bit 1 is {int(lost)}, and {len(text)} of {len(written)} bytes came{where}")
    if not _left_of(text, written):
        fail("the text is not what was written")


class Nothing(Case):
    """Takes all debug text, then calls a2jDebug with payloads of every length."""

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
        opcode = peer.opcode(c.GET_DEBUG)
        peer.ask_all(peer.request(opcode, payload_of(n, n), 0, b"") for n in lengths(peer.longest))


class Text(Case):
    """Has `ret` write a line for each of its codes and takes it, by requests with payloads of every
    length, several with the same seq; then has several lines written and takes them together.
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
        payloads = (b"", b"x", bytes(peer.longest), b"\x00", b"\xff" * 9)
        for n, code in enumerate((0x05, 0x12, 0x7D, 0xED, 0x00, 0xEF, 0xAB, 0x06)):
            payload = payloads[n % len(payloads)]
            peer.attempts(lambda v=code, p=payload: self._taken(peer, v, p))  # type: ignore[misc]
        some = 1 if peer.link.lossy else 32  # a group that suffered is written anew
        for first in range(0, peer.longest + 1, some):
            group = range(first, min(first + some, peer.longest + 1))
            peer.attempts(lambda g=group: self._by_lengths(peer, g))  # type: ignore[misc]
        peer.attempts(lambda: self._in_order(peer))

    @staticmethod
    def _by_lengths(peer: Peer, group: Iterable[int]) -> None:
        """Have a line written and taken for each length of the request, many with one seq."""
        drain(peer)
        requests = []
        for length in group:
            code, seq = length % c.RET_MAX, length // _SAME_SEQ
            requests.append(peer.request(peer.opcode("ret"), bytes((code,)), code, b""))
            data, line = payload_of(length, length), line_of(code)
            requests.append(peer.request(peer.opcode(c.GET_DEBUG), data, 0, line, seq))
            if length % 3:
                requests.append(peer.request(peer.opcode(c.GET_DEBUG), b"", 0, b"", seq))
        peer.ask_all(requests)

    @staticmethod
    def _taken(peer: Peer, code: int, payload: bytes) -> None:
        drain(peer)
        line = write(peer, [code])
        if (taken := take(peer, payload)) != (line, 0):
            fail(f"{taken} instead of {(line, 0)}")
        if take(peer) != (b"", 0):
            fail("text comes a second time")

    @staticmethod
    def _in_order(peer: Peer) -> None:
        lines, text, lost = fill(peer, [0x05, 0x06])
        check_text(text, lines, lost)


class Boundaries(Case):
    """Has so many lines written that 254, 255, 256, 510 bytes and the like are pending, as far as
    the device keeps that much, and as many as it keeps, and takes them; what a call left over is
    pending, too.
    """

    ID = "debug.boundaries"
    EXPECTATION = (
        "All of the text in order; bit 0 in each call after which some is pending, and in no "
        "other; bit 1 only where some of the text is missing."
    )
    REQUIREMENTS = ("J2A-DEBUG-001", "J2A-DEBUG-002")
    LEVEL = "debug"
    NEEDS = (c.GET_DEBUG, "ret")

    def _run(self, peer: Peer) -> None:
        if peer.link.lossy:
            inform("the link was declared lossy: too many exchanges in a row")
        piece = peer.attempts(lambda: self._piece(peer))
        held = self._overflow(peer)
        targets = (*_TARGETS, *([held] if held else []))
        reached = [
            target
            for target in targets
            if peer.attempts(lambda n=target: self._pending(peer, n, piece, held))  # type: ignore[misc]
        ]
        peer.link.note(f"pending were {', '.join(map(str, reached))} bytes")

    @staticmethod
    def _piece(peer: Peer) -> int:
        """Return how much text one call takes, or 0 where that was not seen."""
        drain(peer)
        write(peer, [0x05] * (c.MAX_PAYLOAD // LINE + 2))
        part, code = take(peer)
        return len(part) if code & c.DEBUG_MORE else 0

    @staticmethod
    def _overflow(peer: Peer) -> int:
        """Have more written than the device keeps; return how much that is, or 0 if unknown."""
        for shift in range(3, _SHIFTS):
            _, text, lost = peer.attempts(lambda n=1 << shift: fill(peer, [0x05] * n))  # type: ignore[misc]
            if lost:
                return len(text)
        return 0

    @staticmethod
    def _pending(peer: Peer, target: int, piece: int, held: int) -> bool:
        """Have exactly `target` bytes pending, and take them; tell whether that was possible."""
        # A line has always 9 bytes; what calls of a longer text leave over shifts the sum, and so
        # does a text of which the device could not keep all.
        starts = [*range(0, 6 * piece, LINE), *([held] if held and piece else [])]
        plans = (
            (start, calls, start - calls * piece)
            for start in starts
            for calls in range(1, start // piece + 1)
        )
        fitting = (
            plan for plan in plans if 0 < plan[2] <= target and (target - plan[2]) % LINE == 0
        )
        start, calls, left = next(fitting, (0, 0, 0))
        if not calls and target % LINE:
            return False
        drain(peer)
        is_whole = start % LINE == 0
        written = write(peer, (n % 240 for n in range(start // LINE + (0 if is_whole else 9))))
        for n in range(calls):
            part, code = take(peer)
            written = written[len(part) :]
            if len(part) != piece or (n == 0) < bool(code & c.DEBUG_LOST):
                fail(f"{len(part)} bytes and the code 0x{code:02X} in call {n + 1} of {calls}")
            if is_whole and code & c.DEBUG_LOST:
                drain(peer)
                return False  # it does not keep so much
        new = write(peer, (n % 240 for n in range(60, 60 + (target - left) // LINE)))
        rest, lost = drain(peer)
        if lost and (len(rest) < target or not rest.endswith(new)):
            return False
        if lost:
            fail(f"bit 1 is 1, and all {target} bytes that were pending came")
        if len(rest) != target or not rest.endswith(new):
            fail(f"{len(rest)} bytes came, {target} were pending, of which the last {len(new)} new")
        if is_whole:
            check_text(rest, written + new, lost)
        return True


class Overflow(Case):
    """Has lines written, 1, 2, 4 up to 512 without taking any, and then takes them all; where some
    are lost, also so that 256 of them or a multiple of 256 bytes are, and again before all that was
    kept has been taken.
    """

    ID = "debug.more-and-lost"
    EXPECTATION = (
        "At most 255 bytes a time; bit 0 as long as more is pending; all text in order, or less of "
        "it and then bit 1 once, in the first call."
    )
    REQUIREMENTS = ("J2A-DEBUG-001", "J2A-DEBUG-002")
    LEVEL = "debug"
    NEEDS = (c.GET_DEBUG, "ret")

    def _run(self, peer: Peer) -> None:
        for shift in range(_LOSSY_SHIFTS if peer.link.lossy else _SHIFTS):
            if (held := peer.attempts(lambda n=1 << shift: self._held(peer, n))) is not None:  # type: ignore[misc]
                if not peer.link.lossy:
                    self._around(peer, held)
                return  # larger amounts show nothing new
        peer.link.note("no text was lost, so that bit 1 could not be seen set")

    def _around(self, peer: Peer, held: int) -> None:
        """Fill what the device keeps all but, exactly, and a little over; and again at once. Then
        so much over that what counts lost lines or bytes in one byte has wrapped.
        """
        kept = held // LINE
        counts = [kept - 1, kept, kept + 1, kept + 9, 1]
        if peer.link.byte_s < _QUICK_BYTE_S:
            bytes_wrap = (n for n in range(kept + 1, kept + 257) if (n * LINE - held) % 256 == 0)
            counts += [*bytes_wrap, kept + 256]
        for lines in counts:
            peer.attempts(lambda n=lines: self._held(peer, n))  # type: ignore[misc]
        for calls in (1, 2, 3) if peer.link.byte_s < _QUICK_BYTE_S else ():
            peer.attempts(lambda n=calls: self._again(peer, kept, n))  # type: ignore[misc]

    @staticmethod
    def _again(peer: Peer, kept: int, calls: int) -> None:
        """Have text lost, take some in so many calls, and have text lost again, twice."""
        drain(peer)
        write(peer, [0x05] * (kept + 9))
        for _ in range(2):
            for n in range(calls):
                _, code = take(peer)
                if bool(code & c.DEBUG_LOST) != (n == 0):
                    fail(f"bit 1 is {code >> 1 & 1} in call {n + 1} since text was lost")
                if not code & c.DEBUG_MORE:
                    drain(peer)
                    return  # it keeps no more than these calls take
            write(peer, [0x06] * (kept + 9))
        if not drain(peer)[1]:
            fail("bit 1 is 0, though text was lost again before all of it was taken")

    @staticmethod
    def _held(peer: Peer, lines: int) -> int | None:
        """Have the lines written and take them; return how much came where some was lost."""
        written, text, lost = fill(peer, (n % 240 for n in range(lines)))
        check_text(text, written, lost)
        return len(text) if lost else None


def _left_of(text: bytes, written: bytes) -> bool:
    """Tell whether `text` is `written` with bytes left out."""
    rest = iter(written)
    return all(byte in rest for byte in text)
