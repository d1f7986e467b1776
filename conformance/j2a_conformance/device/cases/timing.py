"""Pauses inside frames and between them (J2A-TIME).

Every pause is measured where it is made, from before the bytes in front of it are written to after
the bytes behind it are written. A refused pause only counts when this measure was within the limit,
and only when it is refused again and again: a stall between here and the device cannot be seen.
"""

from j2a_spec import constants as c
from j2a_spec.oracle import Frame, checksum, encode, stuff

from j2a_conformance._judge import Judged, fail, inform, skip
from j2a_conformance._model import Verdict
from j2a_conformance.device._case import Case
from j2a_conformance.device._paused import REFUSALS, TRIES, passes_in_pieces, send_paused
from j2a_conformance.device._peer import Expected, Peer, Request, many_payload
from j2a_conformance.wire._dimensions import lane_offset, lengths, payload_of, spread

from .frame import answers
from .sif import check_counter, periodic
from .stuffing import escapable

_ACCEPTED_S = c.BYTE_TIMEOUT_MIN_MS / 1e3
_GIVEN_UP_S = c.BYTE_TIMEOUT_MAX_MS / 1e3
_LONG_TRIES = 12
_SIF_BYTE_S = 0.0001  # so that a SIF of some bytes takes less than half of the shortest period
_PIECE_BYTE_S = 0.0005
_POWERS = (8, 16, 32, 64, 128, 256, 512)
_COUNTED = (100, 200, 250, 255, 258, 500, 510)


def accepts(
    peer: Peer,
    pieces: list[bytes],
    pause_s: float,
    *due: Expected,
    enough: int = 2,
    tries: int = TRIES,
    silent_s: float = 0.0,
) -> None:
    """Fail when the device refuses these pauses again and again.

    `enough` acceptances are asked for, more than one of a single pause: a device that stalls may
    see the bytes without it.
    """
    try:
        passed = passes_in_pieces(
            peer, pieces, pause_s, *due, enough=enough, tries=tries, silent_s=silent_s
        )
    except Judged as judged:
        if judged.final:
            raise
        fail(f"{judged.reason}, in {REFUSALS} attempts, with pauses of {pause_s * 1e3} ms")
    if not passed:
        inform("this machine is too busy to make a pause of less than 9 ms")


def awkward(peer: Peer) -> tuple[bytes, Expected]:
    """Return an echo that has escapes in seq and payload, and its due reply."""
    payload = bytes((0x12, 0x41, 0x7D))
    wire = encode(Frame(c.SOF, 0xED, peer.echo_opcode, payload))
    return wire, Expected(0xED, c.ECHO, payload)


def escaped(peer: Peer, payload: bytes = b"x") -> tuple[bytes, Expected]:
    """Return an echo in which each field is escaped, needed or not, and its due reply; only a
    length of 0 cannot be.
    """
    opcode = peer.echo_opcode
    seqs = range(0x41, 0x61)
    seq = next(seq for seq in seqs if escapable(checksum(seq, opcode, payload)))
    body = (seq, opcode, len(payload), *payload, checksum(seq, opcode, payload))
    assert all(map(escapable, filter(None, body)))
    wire = b"".join(bytes((c.ESC, value - 1)) if value else b"\0" for value in body)
    return bytes((c.SOF,)) + wire, Expected(seq, c.ECHO, payload)


def seq_known(wire: bytes, cut: int) -> bool:
    """Tell whether the first `cut` bytes of a frame hold its seq."""
    return cut >= (3 if wire[1] == c.ESC else 2)


class ShortPause(Case):
    """Pauses for 4 ms and for 8.5 ms after each byte of a frame, also inside escapes."""

    ID = "timing.short-pause"
    EXPECTATION = "The request is answered as if there was no pause."
    REQUIREMENTS = ("J2A-TIME-001", "J2A-STUFF-003")
    LEVEL = "timing"

    def _run(self, peer: Peer) -> None:
        frames = [(0.004, *awkward(peer)), (0.0085, *awkward(peer)), (0.0085, *escaped(peer))]
        for pause_s, wire, due in frames:
            for cut in range(1, len(wire)):
                accepts(peer, [wire[:cut], wire[cut:]], pause_s, due)


def long_frames(peer: Peer) -> list[Request]:
    """Return long requests of several functions, and one that is refused, with their replies."""
    found = [peer.echo(payload_of(length, n)) for n, length in enumerate((255, 100, 40))]
    if peer.has(c.MANY):
        data = payload_of(peer.longest_chunk, 2)
        answer = many_payload(c.ECHO_MANY, 0, lane_offset(5), data)
        many = peer.many(c.GET_ECHO_MANY, c.FLAG_WRITE, lane_offset(5), data)
        found.append(Request(many.wire, Expected(many.seq, c.RET_OK, answer)))
    free = peer.out_of_range()[-1:]
    return found + [peer.request(o, payload_of(70, 1), c.ERR_OPCODE) for o in free]


def _need_long_frames(peer: Peer) -> None:
    """End a case that says nothing where long frames seldom arrive whole."""
    if peer.link.lossy:
        inform("a lossy link seldom carries a long frame whole")


class LongFrames(Case):
    """Pauses for 8.5 ms at many places in long requests, and twice for 7 ms in requests of each
    length, of which some begin in one piece with the one before.
    """

    ID = "timing.pause-in-long-frame"
    EXPECTATION = "Each request is answered as if there was no pause."
    REQUIREMENTS = ("J2A-TIME-001", "J2A-FRAME-005")
    LEVEL = "timing"

    def _run(self, peer: Peer) -> None:
        _need_long_frames(peer)
        for n, request in enumerate(long_frames(peer)):
            wire = request.wire
            ends = {len(wire) - 2, len(wire) - 1}
            for cut in sorted({*spread(len(wire) - 1, 97, 1)[n % 3 :: 5], *ends}):
                accepts(peer, [wire[:cut], wire[cut:]], 0.0085, request.expected)
        for length in range(peer.longest + 1):
            request = peer.echo(payload_of(length, length))
            wire = request.wire
            # Never before the length has come, which a device may judge by.
            first = min(6, len(wire) - 2) + length * 7 % max(len(wire) - 7, 1)
            second = first + 1 + length * 3 % (len(wire) - first - 1)
            good = peer.probe()
            if length % 3 == 0 and len(good.wire + wire) <= peer.room(512):
                due = [good.expected, request.expected]
                accepts(peer, [good.wire + wire[:first], wire[first:]], 0.007, *due, enough=1)
                continue
            parts = [wire[:first], wire[first:second], wire[second:]]
            accepts(peer, parts, 0.007, request.expected, enough=1)


class AnyPiece(Case):
    """Sends requests of the largest size in two pieces with 4 ms between them, behind a silence:
    cut at the first and at the last bytes, and where the first piece is of as many bytes as devices
    count or take at a time, one more, or one less.
    """

    ID = "timing.any-piece"
    EXPECTATION = "Each request is answered: the pause began with the last byte."
    REQUIREMENTS = ("J2A-TIME-001", "J2A-FRAME-005")
    LEVEL = "timing"

    def _run(self, peer: Peer) -> None:
        _need_long_frames(peer)
        if peer.link.byte_s > _PIECE_BYTE_S:
            inform("on a link as slow as this no bytes come at once")
        for payload in (b"W", b"\x12"):  # of the latter two bytes each
            request = peer.echo(payload * peer.longest)
            wire = request.wire
            sizes = {n for m in (*_POWERS, *_COUNTED) for n in (m - 1, m, m + 1)}
            for cut in sorted({1, 2, 3, 4, 5, *sizes, len(wire) - 2, len(wire) - 1}):
                if 0 < cut < len(wire):
                    parts = [wire[:cut], wire[cut:]]
                    accepts(peer, parts, 0.004, request.expected, enough=1, silent_s=_GIVEN_UP_S)


class Trickle(Case):
    """Sends a frame byte by byte with 4 ms between them, longer than 20 ms in all."""

    ID = "timing.trickle"
    EXPECTATION = "The request is answered: only the pause between two bytes counts."
    REQUIREMENTS = ("J2A-TIME-001",)
    LEVEL = "timing"

    def _run(self, peer: Peer) -> None:
        wire, due = awkward(peer)
        accepts(peer, [bytes((byte,)) for byte in wire], 0.004, due)


class TrickleLong(Case):
    """Sends one of the longest requests in pieces of four bytes with 4 ms between them; of two
    bytes in simulated time, where nothing stalls, so that it takes a second.
    """

    ID = "timing.trickle-long"
    EXPECTATION = "The request is answered, however long its frame takes in all."
    REQUIREMENTS = ("J2A-TIME-001", "J2A-FRAME-005")
    LEVEL = "timing"

    def _run(self, peer: Peer) -> None:
        longest = peer.echo(b"\x12" * peer.longest)
        wire = longest.wire
        size = 2 if peer.link.transport.is_simulated else 4
        parts = [wire[n : n + size] for n in range(0, len(wire), size)]
        accepts(peer, parts, 0.004, longest.expected, enough=1, tries=_LONG_TRIES)


class GivesUp(Case):
    """Sends the beginning of a frame, up to each of its bytes, and no more."""

    ID = "timing.gives-up"
    EXPECTATION = "Error 0xF2 with the seq of the frame, not before 9 ms and within 20 ms."
    REQUIREMENTS = ("J2A-TIME-002", "J2A-TIME-001", "J2A-ERR-005", "J2A-ERR-009")
    LEVEL = "timing"

    def _run(self, peer: Peer) -> None:
        plain = peer.echo(b"abc")
        for wire, seq in ((plain.wire, plain.seq), (awkward(peer)[0], 0xED)):
            for cut in range(1, len(wire)):
                if seq_known(wire, cut):
                    peer.attempts(lambda w=wire, n=cut, s=seq: self.cut(peer, w[:n], s))  # type: ignore[misc]
        for cut in (2, 3, 4, 6, 7):  # with an escape that does not end, in every field
            part = plain.wire[:cut] + bytes((c.ESC,))
            peer.attempts(lambda p=part: self.cut(peer, p, plain.seq))  # type: ignore[misc]
        for value in (*sorted(c.STUFFED), c.ESC + 1):  # in the place of a checksum of this value
            filler = checksum(plain.seq, peer.echo_opcode, b"\0") ^ value
            whole = peer.echo(bytes((filler,)), plain.seq).wire
            part = whole[: -2 if value in c.STUFFED else -1] + bytes((c.ESC,))
            peer.attempts(lambda p=part: self.cut(peer, p, plain.seq))  # type: ignore[misc]
        peer.barrier()

    @staticmethod
    def cut(peer: Peer, part: bytes, seq: int) -> None:
        """Send a part of a frame, and judge the answer and when it comes."""
        # Counted from the end of the last byte, which may still be on its way.
        allowed_s = _GIVEN_UP_S + peer.claims.rtt_s + 0.002 + len(part) * peer.link.byte_s
        before_s = peer.link.now_s()
        peer.link.send(part)
        sent_s = peer.link.now_s()
        arrival = peer.next_frame(peer.link.reply_timeout_s)
        due = Expected(seq, c.ERR_TIMEOUT)
        if arrival is None or not isinstance(arrival.event, Frame):
            peer.link.record("expected", due.wire, str(due))
            fail("a frame that stopped was not answered")
        if not due.matches(arrival.event):
            peer.link.record("expected", due.wire, str(due))
            fail(f"error 0xF2 was due, code 0x{arrival.event.opcode:02X} came")
        if arrival.at_s - before_s < _ACCEPTED_S:
            fail(f"given up after {(arrival.at_s - before_s) * 1e3:.1f} ms")
        if arrival.at_s - sent_s > allowed_s:
            fail(f"given up after {(arrival.at_s - sent_s) * 1e3:.1f} ms", suspect=True)


class AmidSifs(Case):
    """Stops within requests, and pauses for 8.5 ms within others, while the device sends SIFs."""

    ID = "timing.amid-sifs"
    EXPECTATION = (
        "Error 0xF2 not before 9 ms and within 20 ms, and the echoes of the others: what the "
        "device sends meanwhile begins and ends no pause."
    )
    REQUIREMENTS = ("J2A-TIME-001", "J2A-TIME-002", "J2A-SIF-001", "J2A-SIF-002")
    LEVEL = "timing"

    def _run(self, peer: Peer) -> None:
        if not peer.has("sifPeriod"):
            skip("the device has no function sifPeriod")
        if peer.link.byte_s > _SIF_BYTE_S:
            inform("on a link as slow as this the device would send all the time")
        first = max(len(peer.link.sifs) - 1, 0)
        wire, due = awkward(peer)
        for period_ms in (2, 5, 9):
            with periodic(peer, period_ms):
                peer.next_sif(len(peer.link.sifs))
                for cut in (3, 5, len(wire) - 1):
                    peer.attempts(lambda n=cut: GivesUp.cut(peer, wire[:n], due.seq))  # type: ignore[misc]
                    accepts(peer, [wire[:cut], wire[cut:]], 0.0085, due, enough=1)
        check_counter(peer, first)


class GivesUpLong(Case):
    """Sends the beginning of long requests, up to many of their bytes, and no more; after some of
    them the rest. Does the same with a request of every length, with every seq, in one piece, in
    two, and in one piece with the request before.
    """

    ID = "timing.gives-up-long"
    EXPECTATION = (
        "Error 0xF2 with the seq of the frame, not before 9 ms and within 20 ms; what comes of the "
        "frame after that is skipped."
    )
    REQUIREMENTS = ("J2A-TIME-002", "J2A-TIME-003", "J2A-ERR-005", "J2A-ERR-009")
    LEVEL = "timing"

    def _run(self, peer: Peer) -> None:
        self._silent(peer)
        for n, request in enumerate(long_frames(peer)):
            wire = request.wire
            cuts = {*spread(len(wire) - 1, 53, 2)[n % 4 :: 4], len(wire) - 1}
            for k, cut in enumerate(sorted(cuts)):
                part, rest = wire[:cut], wire[cut:] if k % 3 == 0 else b""
                peer.attempts(lambda a=part, b=rest, r=request: self._cut(peer, a, b, r.seq))  # type: ignore[misc]
        for length in spread(step=61) if peer.link.lossy else lengths():
            seq, data = (length + 0x85) % 256, payload_of(length, length)
            wire = encode(Frame(c.SOF, seq, peer.echo_opcode, data))
            cut = len(wire) - 1 - length * 11 % (len(wire) - 4)
            peer.attempts(lambda w=wire, n=cut, s=seq: self._stopped(peer, w[:n], w[n:], s))  # type: ignore[misc]

    @staticmethod
    def _cut(peer: Peer, part: bytes, rest: bytes, seq: int) -> None:
        GivesUp.cut(peer, part, seq)
        if rest:
            peer.play(rest, alone=True)

    @staticmethod
    def _stopped(peer: Peer, part: bytes, rest: bytes, seq: int) -> None:
        due, good = Expected(seq, c.ERR_TIMEOUT), peer.probe()
        if seq % 4 == 0:
            send_paused(peer, [part[: len(part) // 2], part[len(part) // 2 :]], 0.001)
            peer.expect(due)
        elif seq % 4 == 1 and len(good.wire + part) <= peer.room(512):
            peer.play(good.wire + part, good.expected, due)
        else:
            peer.play(part, due)
        peer.play(rest, alone=True)

    @staticmethod
    def _silent(peer: Peer) -> None:
        """Frames that start with SOS are given up, too, and nothing says so."""
        for length in (0, 30, 90, 200):
            frame = encode(Frame(c.SOS, 0x57, peer.echo_opcode, payload_of(length, 2)))
            peer.link.send(frame[:-1])
            peer.silence(0.03 * max(peer.link.scale, 1.0), "for a frame that starts with SOS")
            peer.play(frame[-1:], alone=True)


class SeqUnknown(Case):
    """Sends the beginning of a frame up to its seq, waits 30 ms and sends the rest."""

    ID = "timing.seq-unknown"
    EXPECTATION = "No answer: the seq of the frame is not known, and the rest is skipped."
    REQUIREMENTS = ("J2A-ERR-005", "J2A-TIME-002", "J2A-TIME-003")
    LEVEL = "timing"

    def _run(self, peer: Peer) -> None:
        plain = peer.echo(b"abc").wire
        stuffed = awkward(peer)[0]
        for first, rest in ((plain[:1], plain[1:]), (stuffed[:1], b""), (stuffed[:2], stuffed[2:])):
            peer.attempts(lambda a=first, b=rest: self._late(peer, a, b))  # type: ignore[misc]

    @staticmethod
    def _late(peer: Peer, first: bytes, rest: bytes) -> None:
        peer.link.send(first)
        # Counted from the end of the last byte, which may still be on its way.
        sending_s = len(first) * peer.link.byte_s
        peer.silence(
            0.03 * max(peer.link.scale, 1.0) + sending_s, "for a frame whose seq had not come"
        )
        if rest:
            peer.link.send(rest)
        try:
            peer.barrier()
        except Judged as judged:
            # A device that was stalled for 30 ms takes both parts for one frame, rightly.
            raise Judged(Verdict.FAILED, judged.reason, suspect=True) from judged


class BehindInterruption(Case):
    """Interrupts a request behind each of its bytes by the start of another one, and pauses for
    7 ms before that and within it; then lets the other one stop behind each of its bytes.
    """

    ID = "timing.behind-interruption"
    EXPECTATION = (
        "Error 0xF4 for the first one if its seq had come; the other one is answered where its own "
        "pauses are short, and gets 0xF2 where it stops, if its own seq has come."
    )
    REQUIREMENTS = ("J2A-TIME-001", "J2A-TIME-002", "J2A-FRAME-007", "J2A-ERR-005", "J2A-ERR-009")
    LEVEL = "timing"

    def _run(self, peer: Peer) -> None:
        old, (new, due) = awkward(peer)[0], escaped(peer)
        for n in range(max(len(old), len(new)) - 1):
            first = old[: 1 + n % (len(old) - 1)]
            ahead = answers(first + bytes((c.SOF,)))
            for at in {1, 1 + n % (len(new) - 1)}:
                parts = [first, new[:at], new[at:]]
                accepts(peer, parts, 0.007, *ahead, due, enough=1)
                stops = [*ahead, Expected(due.seq, c.ERR_TIMEOUT)] if seq_known(new, at) else ahead
                self._stops(peer, first + new[:at], new[at:], stops)

    @staticmethod
    def _stops(peer: Peer, stream: bytes, rest: bytes, due: list[Expected]) -> None:
        """Send a request and the beginning of another one, and its rest after a while."""

        def body() -> None:
            peer.play(stream, *due)
            # Counted from the end of the last byte, which may still be on its way.
            wait_s = 0.03 * max(peer.link.scale, 1.0) + len(stream) * peer.link.byte_s
            peer.silence(wait_s, "behind a frame that interrupted another one and stopped")
            peer.play(rest, alone=True)

        peer.attempts(body)


class RestSkipped(Case):
    """Has the device give up a frame, and then sends the rest of it: frames of 0 to 3 bytes of
    payload, also such in which each byte is escaped, cut after each of their bytes.
    """

    ID = "timing.rest-skipped"
    EXPECTATION = "Error 0xF2 once; the rest is skipped, and the next frame is answered."
    REQUIREMENTS = ("J2A-TIME-003", "J2A-TIME-002", "J2A-FRAME-006", "J2A-ERR-009")
    LEVEL = "timing"

    def _run(self, peer: Peer) -> None:
        payloads = (b"", b"x", b"\x12\x7d")
        for wire, due in (awkward(peer), *(escaped(peer, payload) for payload in payloads)):
            for cut in range(3, len(wire)):
                part, rest = wire[:cut], wire[cut:]
                peer.attempts(lambda a=part, b=rest, s=due.seq: self._cut(peer, a, b, s))  # type: ignore[misc]

    @staticmethod
    def _cut(peer: Peer, first: bytes, rest: bytes, seq: int) -> None:
        peer.play(first, Expected(seq, c.ERR_TIMEOUT))
        peer.play(rest, alone=True)


class LongLength(Case):
    """Sends a frame whose length field is larger than the payload that follows."""

    ID = "timing.long-length"
    EXPECTATION = "Error 0xF2: the rest never comes."
    REQUIREMENTS = ("J2A-TIME-002", "J2A-FRAME-004")
    LEVEL = "timing"

    def _run(self, peer: Peer) -> None:
        opcode = peer.echo_opcode
        for length, extra in ((10, 1), (10, 2), (10, 100), (0, 1), (0, 255), (64, 3), (200, 55)):
            seq, data = peer.seq(), payload_of(length, 2)
            body = bytes((seq, opcode, length + extra, *data, checksum(seq, opcode, data)))
            due = Expected(seq, c.ERR_TIMEOUT)
            peer.play(bytes((c.SOF,)) + stuff(body), due, exact=True)


class BetweenFrames(Case):
    """Pauses for up to 1.1 s after a good frame, after an error reply, after bytes that start no
    frame, and after SOS.
    """

    ID = "timing.between-frames"
    EXPECTATION = "Nothing comes in the pause, and the next frame is answered."
    REQUIREMENTS = ("J2A-TIME-007", "J2A-FRAME-008")
    LEVEL = "timing"

    def _run(self, peer: Peer) -> None:
        for pause_ms in (1, 5, 9, 11, 15, 25, 50, 200):
            peer.ask(peer.probe())
            self._quiet(peer, pause_ms)
        wire, due = awkward(peer)
        peer.play(wire[:5] + b"\x7d\xff", Expected(due.seq, c.ERR_FRAMING))
        self._quiet(peer, 50)
        for noise in (b"\x00\x7d", b"\xed", b"\xed\x01\x02\x03"):
            self._quiet(peer, 50, noise)
        if not peer.link.lossy:
            self._quiet(peer, 1100)

    @staticmethod
    def _quiet(peer: Peer, pause_ms: int, noise: bytes = b"") -> None:
        def body() -> None:
            peer.link.send(noise)
            peer.silence(pause_ms / 1e3, f"in a pause of {pause_ms} ms between two frames")
            peer.barrier()

        peer.attempts(body)
