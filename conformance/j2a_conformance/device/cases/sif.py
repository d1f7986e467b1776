"""Server-initiated frames (J2A-SIF), caused by the demo functions `sif` and `sifPeriod`."""

import random
import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import pairwise

from j2a_spec import constants as c
from j2a_spec.oracle import Frame, encode
from j2a_transports import TransportError

from j2a_conformance._judge import Judged, fail, inform
from j2a_conformance.device._case import Case
from j2a_conformance.device._peer import MANY_ONLY, Expected, Peer, describe, refusal
from j2a_conformance.wire._dimensions import damaged, lengths, payload_of
from j2a_conformance.wire._expected import first_difference
from j2a_conformance.wire._link import Arrival

from .frame import patterns

PERIODIC = 0x20
_STOPS = 11


@contextmanager
def periodic(peer: Peer, ms: int) -> Iterator[None]:
    """Have the device send a SIF every `ms` milliseconds meanwhile.

    What ends the block is never replaced: behind an exception that is no judgement the answers may
    be out of step, and then nothing can be asked any more.
    """
    _period(peer, ms)
    try:
        yield
    except Judged:
        with suppress(Judged, TransportError):
            _period(peer, 0)
        raise
    _period(peer, 0)


def _period(peer: Peer, ms: int) -> None:
    """Have a SIF sent every `ms` milliseconds; 0 stops."""
    peer.ask(peer.request(peer.opcode("sifPeriod"), struct.pack("<H", ms), c.RET_OK))


def frames(arrivals: Sequence[Arrival]) -> list[Frame]:
    """Return the SIFs as frames."""
    return [a.event for a in arrivals if isinstance(a.event, Frame)]


def check_counter(peer: Peer, first: int = 0) -> None:
    """Fail when the seqs of the SIFs of this link, from `first` on, do not count up by one.

    On a lossy link only two at a time can be expected to arrive.
    """
    if peer.link.lossy and not first:
        return
    for before, after in pairwise(peer.link.sifs[first:]):
        old, new = frames([before, after])
        if new.seq != (old.seq + 1) % 256:
            show(peer, before, after)
            fail(f"a SIF with seq 0x{new.seq:02X} follows one with seq 0x{old.seq:02X}")


def show(peer: Peer, *sifs: Arrival) -> None:
    """End the evidence with the SIFs in question."""
    for sif in sifs:
        peer.link.record("sif", sif.raw, "the SIF in question:")


def compare(peer: Peer, index: int, opcode: int, payload: bytes) -> int:
    """Fail unless the SIF that was asked for came, as the bytes of the oracle; return its number.

    It is the first one with this content from number `index` of the link on: the application may
    send others whenever it likes.
    """
    index = _first_of(peer, index, opcode, payload)
    arrival = peer.link.sifs[index]
    wanted = encode(Frame(c.SOS, frames([arrival])[0].seq, opcode, payload))
    if arrival.raw != wanted:
        show(peer, arrival)
        peer.link.record("expected", wanted)
        where = first_difference(arrival.raw, wanted)
        fail(f"the bytes of the SIF are not those of the oracle: on the wire {where}")
    return index


def _first_of(peer: Peer, first: int, opcode: int, payload: bytes) -> int:
    """Return the number of the first SIF with this content from number `first` on, or fail."""
    end_s = peer.link.now_s() + peer.link.reply_timeout_s
    left_s, index = peer.link.reply_timeout_s, first
    while left_s > 0 and (arrival := peer.link.next_sif(index, left_s)) is not None:
        (sif,) = frames([arrival])
        if (sif.opcode, sif.payload) == (opcode, payload):
            return index
        index += 1
        left_s = end_s - peer.link.now_s()
    others = frames(peer.link.sifs[first:index])
    show(peer, *peer.link.sifs[first:index][:3])
    for sif in others:
        if sif.opcode == opcode:
            where = first_difference(sif.payload, payload)
            fail(f"{describe(sif)} is not the SIF that was asked for; payload: {where}")
    what = f"{describe(others[0])} came" if others else "the SIF did not come"
    return fail(f"{what}, opcode 0x{opcode:02X} was asked for")


class Start(Case):
    """Asks for SIFs and compares their bytes on the wire with the oracle."""

    ID = "sif.start"
    EXPECTATION = (
        "Each starts with SOS and is stuffed like any frame; the reply of the request that asked "
        "for it starts with SOF."
    )
    REQUIREMENTS = (
        "J2A-FRAME-003",
        "J2A-FRAME-001",
        "J2A-FRAME-002",
        "J2A-STUFF-001",
        "J2A-STUFF-002",
        "J2A-SUM-001",
        "J2A-SUM-002",
    )
    LEVEL = "sif"
    NEEDS = ("sif",)

    def _run(self, peer: Peer) -> None:
        for opcode, payload in ((0x21, b""), (0x12, b"abc"), (0xED, b"\x12\xed\x7d"), (0, b"\0")):
            peer.carried(lambda o=opcode, p=payload: self._sif(peer, o, p))  # type: ignore[misc]

    @staticmethod
    def _sif(peer: Peer, opcode: int, payload: bytes) -> None:
        before = len(peer.link.sifs)
        peer.ask(peer.request(peer.opcode("sif"), bytes((opcode,)) + payload, c.RET_OK, b""))
        compare(peer, before, opcode, payload)


class EveryLength(Case):
    """Asks for a SIF of every length that the room of the device allows, up to 254 bytes, with
    another opcode each and with payloads of many kinds.
    """

    ID = "sif.every-length"
    EXPECTATION = "The SIF that was asked for, as the bytes of the oracle, and a reply of its own."
    REQUIREMENTS = (
        "J2A-FRAME-001",
        "J2A-FRAME-003",
        "J2A-FRAME-004",
        "J2A-FRAME-010",
        "J2A-STUFF-001",
        "J2A-STUFF-002",
        "J2A-SUM-001",
        "J2A-SUM-002",
        "J2A-SIF-001",
        "J2A-SIF-002",
    )
    LEVEL = "sif"
    NEEDS = ("sif",)

    def _run(self, peer: Peer) -> None:
        for length in lengths(peer.longest - 1):
            peer.carried(lambda n=length: self._sif(peer, n))  # type: ignore[misc]

    @staticmethod
    def _sif(peer: Peer, length: int) -> None:
        before = len(peer.link.sifs)
        opcode, payload = length * 29 % 256, payload_of(length, length + 1)
        asked = bytes((opcode,)) + payload
        reply = peer.ask_exact(peer.request(peer.opcode("sif"), asked))
        if reply.opcode == c.RET_FAILED:
            return  # `sif.during-request` says what a device may refuse
        compare(peer, before, opcode, payload)
        check_counter(peer, max(before - 1, 0))


class Counter(Case):
    """Asks for 300 SIFs, with every opcode; each request follows what is refused, skipped or given
    up, in turn.
    """

    ID = "sif.counter"
    EXPECTATION = (
        "Their seqs count up by one, over 255 to 0; the first one after a reset has the seq 0."
    )
    REQUIREMENTS = ("J2A-SIF-001",)
    LEVEL = "sif"
    NEEDS = ("sif",)

    def _run(self, peer: Peer) -> None:
        reserved = {c.BOOT} if peer.announces(c.CAP_BOOT) else {}
        for n in range(300):
            if n % 256 not in reserved:
                peer.attempts(lambda n=n: self._sif(peer, n))  # type: ignore[misc]
        check_counter(peer)
        first = frames(peer.link.sifs[:1])[0].seq
        if not peer.claims.fresh or peer.link.lossy:
            peer.link.note("whether this is the first SIF after a reset is not known")
        elif first != 0:
            show(peer, peer.link.sifs[0])
            fail(f"the first SIF after the reset has the seq 0x{first:02X}")

    @staticmethod
    def _sif(peer: Peer, n: int) -> None:
        before, value = len(peer.link.sifs), n % 256
        if n % _STOPS == 0:
            _stop(peer, n // _STOPS)
        stream, due = _disturbed(peer, n)
        request = peer.request(peer.opcode("sif"), bytes((value, value)))
        peer.play(stream + request.wire, *due, Expected(request.seq, c.RET_OK))
        compare(peer, before, value, bytes((value,)))
        check_counter(peer, max(before - 1, 0))


def _disturbed(peer: Peer, n: int) -> tuple[bytes, list[Expected]]:
    """Return what goes ahead of a good request, of the kind that `n` chooses, and its replies."""
    broken = peer.probe()
    wire, seq, opcode = broken.wire, broken.seq, peer.echo_opcode
    wrong, its_seq = damaged(opcode, n)
    kinds = [
        (wire[:4], [refusal(seq, c.ERR_FRAMING)]),
        (wrong, [refusal(its_seq, c.ERR_CHECKSUM)]),
        (wire[:5] + b"\x7d\xff", [refusal(seq, c.ERR_FRAMING)]),
        (wire[:1], []),
        (encode(Frame(c.SOS, seq, opcode, b"foreign")), []),
        (encode(Frame(c.SOS, seq, opcode, b"foreign"))[:6], []),
        (b"\x00\x7d\x55", []),
        (wire, [broken.expected]),
    ]
    refused = [peer.request(free, b"x", c.ERR_OPCODE) for free in peer.out_of_range()[-1:]]
    refused += [peer.direct(name) for name in sorted(MANY_ONLY) if peer.has(name)][:1]
    if peer.longest < c.MAX_PAYLOAD:
        refused.append(peer.echo(bytes(peer.longest + 1)))
    kinds += [(request.wire, [request.expected]) for request in refused]
    return kinds[n % len(kinds)]


def _stop(peer: Peer, n: int) -> None:
    """Have the device give up a frame: a request with and without its seq, or another frame."""
    broken = peer.probe()
    foreign = encode(Frame(c.SOS, broken.seq, peer.echo_opcode, b"foreign"))
    if n % 3 == 0:
        peer.play(broken.wire[: 3 + n % 7], Expected(broken.seq, c.ERR_TIMEOUT))
    else:
        peer.link.send(broken.wire[:1] if n % 3 == 1 else foreign[:-1])
        peer.silence(0.03 * max(peer.link.scale, 1.0), "for a frame without a seq, or with SOS")


class Whole(Case):
    """Has the device send a SIF each millisecond while it echoes payloads of up to 255 bytes, and
    asks for SIFs of all lengths meanwhile.
    """

    ID = "sif.whole"
    EXPECTATION = "Every SIF and every reply is whole: none begins inside another."
    REQUIREMENTS = ("J2A-SIF-002", "J2A-SIF-001")
    LEVEL = "sif"
    NEEDS = ("sif", "sifPeriod")

    def _run(self, peer: Peer) -> None:
        before = len(peer.link.sifs)
        rng = random.Random(4)
        with periodic(peer, 1):
            end_s = peer.link.now_s() + 0.3
            while peer.link.now_s() < end_s or len(peer.link.sifs) < before + 20:
                echoed = rng.choice(patterns(rng.choice((1, 30, 254, 255))))
                peer.ask(peer.echo(echoed[: peer.longest]))
                payload = rng.choice(patterns(rng.choice((0, 9, 254))))[: peer.longest - 1]
                peer.ask(peer.request(peer.opcode("sif"), b"\x44" + payload))
                if peer.link.now_s() > end_s + 5 * peer.link.reply_timeout_s:
                    fail("no SIFs come, though `sifPeriod` was asked for them")
        check_counter(peer)


class DuringRequest(Case):
    """Asks for SIFs of many lengths, each by a request that is still in work then."""

    ID = "sif.during-request"
    EXPECTATION = "The SIF comes if the function returned 0x00, and does not come if it did not."
    REQUIREMENTS = ("J2A-SIF-006", "J2A-SIF-002")
    LEVEL = "sif"
    NEEDS = ("sif",)

    def _run(self, peer: Peer) -> None:
        refused = 0
        most = peer.longest - 1
        lengths = (0, 1, 2, 17, 60, 61, 62, 63, 64, 100, 253, 254)
        for length in (n for n in lengths if n <= most):
            for payload in patterns(length)[:8:3]:
                refused += peer.carried(lambda p=payload: self._refused(peer, p))  # type: ignore[misc]
        if refused:
            inform(f"{refused} SIFs were refused to the application, which is allowed")

    @staticmethod
    def _refused(peer: Peer, payload: bytes) -> bool:
        """Ask for a SIF; tell whether it was refused."""
        before = len(peer.link.sifs)
        reply = peer.call("sif", b"\x22" + payload)
        taken = reply.opcode == c.RET_OK
        if taken:
            compare(peer, before, 0x22, payload)
        peer.barrier()
        every = peer.link.sifs[before:]
        wanted = 0x22, payload
        asked = [sif for sif in frames(every) if (sif.opcode, sif.payload) == wanted]
        if len(asked) != taken:
            show(peer, *every)
            fail(f"{len(asked)} SIFs for code 0x{reply.opcode:02X}")
        return not taken


class DuringDelay(Case):
    """Has SIFs become due every 2 ms while a request is in work for 60 ms."""

    ID = "sif.during-delay"
    # Periods that the application itself leaves out cannot be told from SIFs that were dropped, so
    # J2A-SIF-006 is for `DuringRequest`, where each SIF is asked for.
    EXPECTATION = "No gap in the seqs, and none repeated."
    REQUIREMENTS = ("J2A-SIF-001",)
    LEVEL = "sif"
    NEEDS = ("sifPeriod", "delay")

    def _run(self, peer: Peer) -> None:
        before = len(peer.link.sifs)
        with periodic(peer, 2):
            for _ in range(3):
                delay = peer.request(peer.opcode("delay"), struct.pack("<H", 60), c.RET_OK)
                peer.play(delay.wire, delay.expected, wait_s=0.06)
                peer.next_sif(len(peer.link.sifs))
        check_counter(peer)
        every = peer.link.sifs[before:]
        counted = [a for a in every if frames([a])[0].opcode == PERIODIC]
        for old, new in pairwise(counted):
            earlier, later = (int.from_bytes(f.payload, "little") for f in frames([old, new]))
            if later <= earlier:
                show(peer, old, new)
                fail(f"the counter in the periodic SIFs goes from {earlier} to {later}")
