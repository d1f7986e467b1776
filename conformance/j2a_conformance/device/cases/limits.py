"""What a device has room for: j2a.rxbuf, j2a.room, and what happens beyond (J2A-LIMIT)."""

import struct

from j2a_spec import constants as c
from j2a_spec.oracle import Frame, checksum

from j2a_conformance._judge import fail, inform, skip
from j2a_conformance.device._case import Case
from j2a_conformance.device._peer import MANY_ONLY, Peer, Request, describe, many_payload, refusal
from j2a_conformance.wire._dimensions import payload_of

from .sums import with_sum

_DELAY_MS = 80
_LONG_MS = (300, 2050)
_LONG_ROOM = 2048
_REQUESTS = 200  # no seq stands for two
_FRAME = 5  # bytes of the shortest request
_ROOM = 32768  # less than pipes and sockets hold, so that nobody waits for the other side to read


def delay(peer: Peer, ms: int) -> list[Request]:
    """Return a request that keeps the device busy, or none where it has no `delay`."""
    if not peer.has("delay"):
        return []
    return [peer.request(peer.opcode("delay"), struct.pack("<H", ms), c.RET_OK)]


class Window(Case):
    """Sends requests of exactly j2a.rxbuf bytes without waiting: many small ones, few large ones,
    stuffed ones, ones of all lengths, and damaged and refused ones between them; each also while
    `delay` keeps the device busy.
    """

    ID = "limits.window"
    EXPECTATION = "Every request is answered, in order."
    REQUIREMENTS = ("J2A-LIMIT-001", "J2A-DISP-001", "J2A-ERR-012")
    LEVEL = "core"

    def _run(self, peer: Peer) -> None:
        if not peer.rxbuf:
            skip(f"the device announces no {c.PROP_RXBUF}")
        room = peer.room(_ROOM)
        for busy in (False, True) if peer.has("delay") else (False,):
            for kind in ("small", "large", "stuffed", "mixed", "small"):
                requests = delay(peer, _DELAY_MS) if busy else []
                fill(peer, requests, room, kind)
                size = sum(len(r.wire) for r in requests)
                peer.link.note(f"{len(requests)} requests, {size} bytes, {kind}, busy: {busy}")
                stream = b"".join(r.wire for r in requests)
                peer.play(stream, *(r.expected for r in requests), wait_s=_DELAY_MS / 1e3)
        peer.barrier()
        if peer.rxbuf > _ROOM and not peer.link.lossy:
            inform(f"{_ROOM} bytes were used of the {peer.rxbuf} that {c.PROP_RXBUF} announces")


def fill(peer: Peer, requests: list[Request], room: int, kind: str) -> None:
    """Append requests of a kind until all are `room` bytes long, or nearly, with seqs of their own.

    Small ones are larger where there are not enough seqs to fill the room.
    """
    left = room - sum(len(r.wire) for r in requests)
    small = max(left // _REQUESTS - _FRAME, 2)
    while left >= _FRAME and len(requests) < _REQUESTS:
        n = len(requests)
        data = {
            "small": b"%02d" % (n % 100) + b"W" * (small - 2),
            "large": payload_of(min(255, max(left - _FRAME, 0)), n * 5 + 3),
            "stuffed": (b"\x12\xed\x7d" * 85)[: max(small // 2, 3)],
            "mixed": payload_of(n * 37 % (small * 2), n),
        }[kind]
        # Shorter where it would leave a rest that no request fits into.
        while (request := _one(peer, kind, n, data)) and (
            len(request.wire) > left or 0 < left - len(request.wire) < _FRAME
        ):
            if not data:
                break
            data = data[: -max((len(request.wire) - left) // 2, 1)]
        if len(request.wire) > left:
            return
        left -= len(request.wire)
        requests.append(request)


def _one(peer: Peer, kind: str, n: int, data: bytes) -> Request:
    """Return a request to a2jEcho; of the mixed ones some are damaged or refused."""
    if kind == "mixed" and n % 7 == 3:
        seq, opcode = peer.seq(), peer.echo_opcode
        wire = with_sum(seq, opcode, data, checksum(seq, opcode, data) ^ 0x08)
        return Request(wire, refusal(seq, c.ERR_CHECKSUM))
    if kind == "mixed" and n % 7 == 5 and (free := peer.out_of_range()):
        return peer.request(free[n % len(free)], data, c.ERR_OPCODE)
    return peer.echo(data)


class LongWait(Case):
    """Sends requests of j2a.rxbuf bytes while `delay` keeps the device busy, for 0.3 s and for more
    than 2 s.
    """

    ID = "limits.long-wait"
    EXPECTATION = "Every request is answered, in order, however long it has waited."
    REQUIREMENTS = ("J2A-LIMIT-001", "J2A-DISP-001")
    LEVEL = "core"
    NEEDS = ("delay",)

    def _run(self, peer: Peer) -> None:
        if not peer.rxbuf:
            skip(f"the device announces no {c.PROP_RXBUF}")
        for ms in _LONG_MS:
            requests = delay(peer, ms)
            fill(peer, requests, peer.room(_LONG_ROOM), "mixed")
            stream = b"".join(r.wire for r in requests)
            peer.play(stream, *(r.expected for r in requests), wait_s=ms / 1e3)


class CutFrame(Case):
    """Sends a request of the largest size while `delay` keeps the device busy."""

    ID = "limits.cut-frame"
    EXPECTATION = (
        "The echo, or error 0xF4 where bytes were lost: the seq came when there was room for it."
    )
    REQUIREMENTS = ("J2A-LIMIT-002",)
    LEVEL = "core"
    NEEDS = ("delay",)

    def _run(self, peer: Peer) -> None:
        if peer.link.lossy:
            inform("the link was declared lossy: what the device loses cannot be told from that")
        busy = delay(peer, _DELAY_MS)[0]
        request = peer.echo(b"\x12" * c.MAX_PAYLOAD)
        if peer.rxbuf < len(busy.wire) + len(request.wire[:2]):
            skip("the device announces no j2a.rxbuf that holds a request and the seq of another")
        peer.link.send(busy.wire + request.wire)
        peer.expect(busy.expected, wait_s=_DELAY_MS / 1e3)
        arrival = peer.next_frame(peer.link.reply_timeout_s)
        if arrival is None:
            fail("a request of which bytes were lost was not answered")
        event = arrival.event
        if isinstance(event, Frame) and request.expected.matches(event):
            inform("nothing was lost: device or link held the request")
        if not isinstance(event, Frame) or not refusal(request.seq, c.ERR_FRAMING).matches(event):
            peer.link.record("expected", text=f"{request.expected}, or error 0xF4")
            stalled = isinstance(event, Frame) and event.opcode == c.ERR_TIMEOUT
            fail(f"{describe(event)} came", suspect=stalled)


class Overrun(Case):
    """Sends 60 requests of many sizes without waiting, far more than a small device can hold,
    while `delay` keeps it busy.
    """

    ID = "limits.overrun"
    EXPECTATION = (
        "Each answer is the right echo or error 0xF4 for the frame that was cut, in order; what is "
        "lost is not answered, nothing is answered wrongly, and the device recovers."
    )
    REQUIREMENTS = ("J2A-LIMIT-002", "J2A-DISP-001")
    LEVEL = "core"

    def _run(self, peer: Peer) -> None:
        if peer.link.lossy:
            inform("the link was declared lossy: what the device loses cannot be told from that")
        rounds = [self._flood(peer, first) for first in (1, 7, 60)]
        if peer.has("overruns"):
            peer.link.note(f"overruns: {int.from_bytes(peer.call('overruns').payload, 'little')}")
        if not any(rounds):
            inform("nothing was lost: device or link held all requests back")

    @staticmethod
    def _flood(peer: Peer, size: int) -> int:
        """Send the requests; return how many were lost."""
        requests = delay(peer, _DELAY_MS)
        for index in range(60):
            length = (size * (index + 1)) % 120
            requests.append(peer.echo(b"%02d" % index + bytes((0x30 + index,)) * length))
        peer.link.send(b"".join(r.wire for r in requests))
        left = list(requests)
        # Replies come as fast as requests arrive: one request and its reply at a time.
        wait_s = (_DELAY_MS / 1e3 + 0.4) * peer.link.scale + c.MAX_WIRE * peer.link.byte_s
        answered = 0
        while left and (arrival := peer.next_frame(wait_s)) is not None:
            event = arrival.event
            if not isinstance(event, Frame):
                fail(f"{describe(event)} came")
            skipped = [r for r in left if r.seq == event.seq]
            if not skipped:
                fail(f"{describe(event)} answers no request that is still open, or out of order")
            request = skipped[0]
            if request.expected.matches(event):
                answered += 1
            elif event.opcode != c.ERR_FRAMING:
                peer.link.record("expected", text=f"{request.expected}, or error 0xF4")
                fail(f"{describe(event)} came", suspect=event.opcode == c.ERR_TIMEOUT)
            del left[: left.index(request) + 1]
        if not peer.resync():
            fail("the device does not recover from an overrun")
        return len(requests) - answered


class Room(Case):
    """Calls functions with payloads as long as the room of the device, and with longer ones up to
    255 bytes: a2jEcho, the other built-in functions, `ret`, `sif` and `store`; also with a wrong
    checksum and with opcodes that are refused.
    """

    ID = "limits.room"
    EXPECTATION = (
        "What fits is done. What does not is answered by 0xFF with an empty payload, and nothing "
        "of it is done; errors 0xF3 and 0xF0 come first."
    )
    REQUIREMENTS = ("J2A-LIMIT-005", "J2A-FRAME-005")
    LEVEL = "core"

    def _run(self, peer: Peer) -> None:
        room = peer.longest
        if room == c.MAX_PAYLOAD:
            skip("the device has room for every payload")
        for length in range(room - 1, min(room + 2, c.MAX_PAYLOAD + 1)):
            for value in (0x00, c.SOF, c.ESC):
                peer.ask_exact(peer.echo(bytes((value,)) * length))
        for length in range(room + 1, c.MAX_PAYLOAD + 1):
            peer.ask_exact(peer.echo(payload_of(length, length)))
        for length in sorted({room + 1, c.MAX_PAYLOAD}):
            self._others(peer, length)
            self._refused(peer, length)
        self._not_done(peer, room)
        peer.barrier()

    @staticmethod
    def _others(peer: Peer, length: int) -> None:
        """Call the other functions whose calls move nothing."""
        if peer.claims.mapped:
            peer.ask_exact(peer.request(0, bytes(length)))
        if peer.has(c.MANY):
            funcs = (0, peer.opcode(c.MANY), peer.opcode(c.GET_ECHO_MANY), 0xFF)
            for payload in (many_payload(func).ljust(length, b"m") for func in funcs):
                peer.ask_exact(peer.request(peer.opcode(c.MANY), payload))
        if peer.has("getTime"):
            peer.ask_exact(peer.request(peer.opcode("getTime"), bytes(length)))

    @staticmethod
    def _refused(peer: Peer, length: int) -> None:
        """Send what is refused for another reason first."""
        for opcode in peer.out_of_range()[-1:]:
            peer.ask(peer.request(opcode, bytes(length), c.ERR_OPCODE))
        for name in sorted(n for n in MANY_ONLY if peer.has(n)):
            peer.ask(peer.direct(name, bytes(length)))
        seq, opcode, payload = peer.seq(), peer.echo_opcode, b"w" * length
        wire = with_sum(seq, opcode, payload, checksum(seq, opcode, payload) ^ 0x04)
        peer.play(wire, refusal(seq, c.ERR_CHECKSUM), alone=True)

    @staticmethod
    def _not_done(peer: Peer, room: int) -> None:
        """Call functions whose calls leave something to be seen."""
        if peer.has("ret"):
            if peer.has(c.GET_DEBUG):
                while peer.call(c.GET_DEBUG).opcode & c.DEBUG_MORE:
                    pass
            peer.ask(peer.request(peer.opcode("ret"), b"\x05" * (room + 1)))
            if peer.has(c.GET_DEBUG):
                if peer.call(c.GET_DEBUG).payload:
                    fail("`ret` was executed with a payload that is longer than the room")
                peer.call("ret", b"\x05")
                peer.ask(peer.request(peer.opcode(c.GET_DEBUG), bytes(room + 1)))
                if not peer.call(c.GET_DEBUG).payload:
                    fail("debug text was taken by a request that is longer than the room")
        if peer.has("sif"):
            before = len(peer.link.sifs)
            peer.ask(peer.request(peer.opcode("sif"), b"\x35" * (room + 1)))
            peer.barrier()
            if any(frame.opcode == 0x35 for frame in _frames(peer, before)):
                fail("a SIF was sent for a request that is longer than the room")
        if peer.has(c.MANY) and peer.has("store"):
            flags = c.FLAG_WRITE | c.FLAG_LAST
            peer.ask(peer.many("store", flags, 0, b"kept"))
            peer.ask(peer.many("store", flags, 0, b"x" * (peer.longest_chunk + 1)))
            if (data := peer.read_all("store")) != b"kept":
                fail(f"`store` holds {data[:16].hex(' ')} after a write longer than the room")


def _frames(peer: Peer, first: int) -> list[Frame]:
    """Return the SIFs from number `first` on."""
    return [a.event for a in peer.link.sifs[first:] if isinstance(a.event, Frame)]
