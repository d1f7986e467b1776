"""Server-initiated frames (J2A-SIF)."""

import random
from collections.abc import Sequence
from itertools import product

from j2a_spec import constants as c
from j2a_spec.oracle import checksum, stuff

from j2a_conformance._judge import fail
from j2a_conformance.host._case import HostCase
from j2a_conformance.host._dimensions import (
    LENGTHS,
    SPECIAL,
    content,
    escaped,
    frame,
    with_sum,
)
from j2a_conformance.host._host import Host
from j2a_conformance.host._outcomes import Sifs, explain_sifs, spell

from .received import largest

_HANDLED = 0x2A
"""The opcode that the handlers `a` and `b` of the host program are for."""


def handed(
    host: Host,
    sifs: Sifs,
    missing: int | None = 0,
    handler: str = "all",
    never: Sequence[tuple[int, tuple[int, bytes]]] = (),
) -> None:
    """Judge that a handler has got exactly these SIFs, and how many the host says are missing.

    Args:
        host: the host.
        sifs: those that were sent.
        missing: how many must be missing; None leaves it open.
        handler: `all`, `a` or `b`.
        never: broken ones, which a host may have handed over; see `explain_sifs`.
    """
    due = b"".join(bytes((opcode, len(payload))) + payload for opcode, payload in sifs)
    outcome, _ = host.do(f"sifs {handler} {len(sifs)} {host.limit_ms}", "sifs")
    count, _, data = outcome.rest.partition(" ")
    if data != spell(due):
        shown = ", ".join(f"0x{o:02X} {spell(p)}" for o, p in sifs[:8])
        more = f" and {len(sifs) - 8} more" if len(sifs) > 8 else ""
        host.link.record("expected", text=f"the SIFs {shown}{more}")
        where = explain_sifs(data, sifs, never)
        fail(f"the handler `{handler}` got {data} of {len(sifs)} SIFs, not {spell(due)}; {where}")
    if missing is not None and count != str(missing):
        fail(f"the host reports {count} missing SIFs, not {missing} (J2A-SIF-009)")


def anchor(host: Host) -> None:
    """Send a SIF from which the host can count on."""
    host.send(host.sif(0x30, b"anchor"))
    handed(host, [(0x30, b"anchor")], missing=None)


class AnyTime(HostCase):
    """Sends SIFs while nothing waits, before a reply, behind it, before and behind the next job,
    and behind each error reply.
    """

    ID = "host.sif.any-time"
    EXPECTATION = "Each SIF is handed over, in order, and each call gets its reply."
    REQUIREMENTS = ("J2A-SIF-003", "J2A-SIF-007", "J2A-SIF-004")
    LEVEL = "sif"

    def _run(self, host: Host) -> None:
        anchor(host)
        sent: Sifs = []

        def sif(payload: bytes) -> bytes:
            sent.append((0x31, payload))
            return host.sif(*sent[-1])

        host.send(sif(b"at rest"))
        request = host.asked()
        host.send(sif(b"before 1") + sif(b"before 2"))
        host.send(sif(b"directly before") + request.reply(3, b"own") + sif(b"behind"))
        host.replied(request)
        host.replied_with(3, b"own")
        before = sif(b"before a job")
        host.send(before + host.job_frame(f"call @6 - {host.limit_ms}") + sif(b"behind a job"))
        request = host.request(6, b"")
        host.reply(request, 4, b"next")
        host.replied_with(4, b"next")
        for code in (*sorted(c.ERRORS), c.RET_FAILED):
            request = host.asked()
            host.reply(request, code, b"\x01\x00")
            host.send(sif(b"behind 0x%02X" % code))
            host.outcome(f"error {code}" if code in c.ERRORS else f"reply {code} 0100")
        handed(host, sent)


class EveryOpcode(HostCase):
    """Sends SIFs with each opcode, empty and with 1 and 2 bytes, and so with each seq, while a call
    waits.
    """

    ID = "host.sif.every-opcode"
    EXPECTATION = "Each is handed over; none is taken for an error reply or for the reply."
    REQUIREMENTS = ("J2A-SIF-005", "J2A-SIF-003", "J2A-SEQ-004")
    LEVEL = "sif"

    def _run(self, host: Host) -> None:
        anchor(host)
        request = host.asked()
        sent: Sifs = [(opcode, bytes(n)) for n in range(3) for opcode in range(256)]
        host.send(b"".join(host.sif(*one) for one in sent))
        host.reply(request, 3, b"own")
        host.replied_with(3, b"own")
        handed(host, sent)


class LikeErrors(HostCase):
    """Sends SIFs with the opcodes 0xF0 to 0xFF, of every length and with the seq of the call that
    waits; and the same while none waits but that for the next job.
    """

    ID = "host.sif.like-errors"
    EXPECTATION = "Each is handed over, and the call gets its reply."
    REQUIREMENTS = ("J2A-SIF-005", "J2A-SEQ-004")
    LEVEL = "sif"

    def _run(self, host: Host) -> None:
        codes = (*sorted(c.ERRORS), *range(0xF0, 0x100))
        sent: Sifs = [(code, b"\x01\x00") for code in codes]
        sent += [(codes[n % len(codes)], content(n, 3)) for n in LENGTHS]

        def flood(seq: int) -> None:
            host.flood("SIFs like errors", b"".join(frame(c.SOS, seq, *one) for one in sent))
            host.reset_sifs((seq + 1) % 256)

        request = host.asked()
        flood(request.seq)
        host.reply(request, 3, b"own")
        host.replied_with(3, b"own")
        handed(host, sent, missing=None)
        flood(host.resting_seq)
        handed(host, sent, missing=None)


class Sizes(HostCase):
    """Sends SIFs with payloads of every size, of which most have a checksum that is escaped; with
    255 start bytes; and with each special byte as seq, opcode and length.
    """

    ID = "host.sif.sizes"
    EXPECTATION = "Each is handed over as it is."
    REQUIREMENTS = ("J2A-FRAME-005", "J2A-STUFF-005", "J2A-SIF-003", "J2A-SUM-001")
    LEVEL = "sif"

    def _run(self, host: Host) -> None:
        anchor(host)
        sent: Sifs = []
        stream = b""
        for size in LENGTHS:
            opcode, payload, seq = size * 7 % 256, content(size, 8), host.next_sif_seq()
            if size % 4:
                payload = with_sum(seq, opcode, payload, (c.SOF, c.SOS, c.ESC)[size % 4 - 1])
            sent.append((opcode, payload))
            stream += frame(c.SOS, seq, opcode, payload)
        host.flood("SIFs of every size", stream)
        more: Sifs = [(byte, bytes((byte,)) * 255) for byte in sorted(c.STUFFED)]
        host.send(b"".join(host.sif(*one) for one in more))
        handed(host, sent + more)
        for seq in SPECIAL:
            host.reset_sifs(seq)
            sent = [(opcode, content(length, 1)) for opcode in SPECIAL for length in SPECIAL]
            stream = b"".join(frame(c.SOS, seq, *one) for one in sent)
            stream += b"".join(escaped(c.SOS, seq, *one) for one in sent)
            host.flood("SIFs of special bytes", stream)
            handed(host, sent + sent, missing=None)
        for seq in sorted(c.STUFFED):
            payload = largest(seq, 0x12)
            host.reset_sifs(seq)
            host.send(host.sif(0x12, payload))
            handed(host, [(0x12, payload)], missing=None)


class Again(HostCase):
    """Sends SIFs with the seq of the one before, with seqs that go back, and such as come after a
    reset of the device, whose counter begins at 0; then a gap.
    """

    ID = "host.sif.again"
    EXPECTATION = "Each is handed over; from the new seq on the host counts as ever."
    REQUIREMENTS = ("J2A-SIF-003", "J2A-SIF-007", "J2A-SIF-009")
    LEVEL = "sif"

    def _run(self, host: Host) -> None:
        for seqs in ((7, 7, 7), (7, 6, 5), (3, 0), (0, 0), (255, 255), (200, 0, 0, 128)):
            sent: Sifs = [(0x2A, b"the same") for _ in seqs]
            host.send(b"".join(frame(c.SOS, seq, *sent[0]) for seq in seqs))
            handed(host, sent, missing=None)
            host.reset_sifs(seqs[-1] + 1)
            host.send(host.sif(0x2A, b"1") + host.sif(0x2A, b"2") + host.sif(0x2A, b"3", 5))
            handed(host, [(0x2A, b"1"), (0x2A, b"2"), (0x2A, b"3")], missing=5)


class First(HostCase):
    """Opens new links, on which the first SIF has the seq 77, 0, 1, 128 and 255: behind a broken
    one, and before anything else is sent.
    """

    ID = "host.sif.first"
    EXPECTATION = "The host counts from the first SIF of a link on; none before it is missing."
    REQUIREMENTS = ("J2A-SIF-010", "J2A-SIF-009")
    LEVEL = "sif"

    def _run(self, host: Host) -> None:
        for seq in (77, 0, 1, 128, 255):
            host.hang_up()
            host.outcome()  # the host is there
            host.reset_sifs(seq)
            broken = frame(c.SOS, (seq - 9) % 256, 0x30, b"broken", 0x10)
            host.send(broken + host.sif(0x30, b"first") + host.sif(0x30, b"third", 1))
            handed(host, [(0x30, b"first"), (0x30, b"third")], missing=1)
            host.hang_up(frame(c.SOS, seq, 0x30, b"first"))
            host.outcome()
            host.reset_sifs((seq + 1) % 256)
            host.send(host.sif(0x30, b"third", 1))
            # The first one may have come before the host had a handler for it.
            count = host.do(f"sifs all 1 {host.limit_ms}", "sifs")[0].rest.partition(" ")[0]
            if count != "1":
                fail(f"the host reports {count} missing SIFs, not 1, behind one that came first")


class NoAnswer(HostCase):
    """Sends SIFs, whole, damaged and cut off, while only the call for the next job waits."""

    ID = "host.sif.no-answer"
    EXPECTATION = "Nothing answers them."
    REQUIREMENTS = ("J2A-SIF-004",)
    LEVEL = "sif"

    def _run(self, host: Host) -> None:
        anchor(host)
        whole = host.sif(0x10, b"whole")
        host.send(whole + damaged(host, 0x11, b"damaged") + host.sif(0x13, b"cut off")[:6])
        handed(host, [(0x10, b"whole")], missing=None)


def damaged(host: Host, opcode: int, payload: bytes, error: int = 0x20) -> bytes:
    """Return a SIF, the next one by its seq, whose checksum is wrong."""
    seq = host.next_sif_seq()
    body = bytes((seq, opcode, len(payload))) + payload
    return bytes((c.SOS,)) + stuff(body + bytes((checksum(seq, opcode, payload) ^ error,)))


class Handlers(HostCase):
    """Sends SIFs of an opcode that has two handlers beside that for all, and of others; some are
    like the one before.
    """

    ID = "host.sif.handlers"
    EXPECTATION = "Every handler gets the SIFs of its opcode, all of them, in order."
    REQUIREMENTS = ("J2A-SIF-007",)
    LEVEL = "sif"

    def _run(self, host: Host) -> None:
        anchor(host)
        rng = random.Random(7)
        for handler in ("a", "b"):
            host.do(f"sifs {handler} 0 0", "sifs")
        sent: Sifs = [(rng.choice((_HANDLED, 0x2B, 0x00)), b"%d" % (n // 2)) for n in range(60)]
        sent += 3 * [(_HANDLED, b"the same")]
        host.send(b"".join(host.sif(*one) for one in sent))
        handed(host, sent)
        for handler in ("a", "b"):
            handed(host, [s for s in sent if s[0] == _HANDLED], None, handler)


class Damaged(HostCase):
    """Sends a SIF with a wrong checksum while a call waits, then a good one and the reply."""

    ID = "host.sif.damaged"
    EXPECTATION = (
        "The damaged one is dropped, the others are handed over; the call does not suffer."
    )
    REQUIREMENTS = ("J2A-SIF-008", "J2A-SUM-002", "J2A-SUM-003", "J2A-FRAME-009")
    LEVEL = "sif"

    def _run(self, host: Host) -> None:
        for error in (0x01, 0x80, 0xFF, c.SOS):
            anchor(host)
            request = host.asked()
            host.send(damaged(host, 0x44, b"damaged", error))
            good = host.sif(0x45, b"good")
            host.send(good + request.reply(3, b"own"))
            host.replied(request)
            host.replied_with(3, b"own")
            handed(host, [(0x45, b"good")], missing=1)


class Cuts(HostCase):
    """Cuts replies by SIFs and SIFs by replies, behind each of their bytes."""

    ID = "host.sif.cuts"
    EXPECTATION = "What is whole is taken; what is cut is given up."
    REQUIREMENTS = ("J2A-FRAME-007", "J2A-FRAME-009", "J2A-SIF-003")
    LEVEL = "sif"

    def _run(self, host: Host) -> None:
        anchor(host)
        for cut in range(1, 8):
            request = host.asked()
            reply = request.reply(3, b"reply")
            host.send(reply[:cut] + host.sif(0x50, b"SIF") + reply)
            host.replied(request)
            host.replied_with(3, b"reply")
            request = host.asked()
            seq = host.next_sif_seq()
            host.reset_sifs(seq)  # the same SIF comes again, whole
            host.send(host.sif(0x51, b"whole")[:cut])
            host.reset_sifs(seq)
            host.reply(request, 4, b"reply")
            host.replied_with(4, b"reply")
            host.send(host.sif(0x51, b"whole"))
            handed(host, [(0x50, b"SIF"), (0x51, b"whole")])


class Missing(HostCase):
    """Leaves 0 to 254 SIFs out, one by one and summed up, before a SIF of each opcode, also such as
    look like boot SIFs, and lets the counter run over.
    """

    ID = "host.sif.missing"
    EXPECTATION = "The host counts exactly those that are missing."
    REQUIREMENTS = ("J2A-SIF-009",)
    LEVEL = "sif"

    def _run(self, host: Host) -> None:
        anchor(host)
        gaps = [(7 + number * 101) % 255 for number in range(256)]
        sifs: Sifs = [(opcode, content(opcode, 7)) for opcode in range(256)]
        for some in (slice(None), slice(None, None, -1)):
            host.send(b"".join(host.sif(*s, n) for s, n in zip(sifs[some], gaps, strict=True)))
            handed(host, sifs[some], sum(gaps))
        for gap in (1, 2, 77, 254):
            host.reset_sifs(255 - gap)
            host.send(host.sif(0x65, b"before"))
            handed(host, [(0x65, b"before")], missing=None)
            host.send(host.sif(0x66, b"seq 0", gap))
            handed(host, [(0x66, b"seq 0")], gap)
        for skipped in (0, 1, 2, 100, 127, 128, 129, 254, 0, 0):
            host.send(host.sif(0x60, b"gap", skipped) + host.sif(0x61, b"next"))
            handed(host, [(0x60, b"gap"), (0x61, b"next")], skipped)
        boots: Sifs = [(c.BOOT, bytes(n)) for n in (0, c.BOOT_BYTES - 1, c.BOOT_BYTES, 8)]
        for boot, gap in product(boots, (1, 0, 2, 254)):
            host.send(host.sif(*boot, gap) + host.sif(0x69, b"behind"))
            handed(host, [boot, (0x69, b"behind")], gap)
        for _ in range(3):
            sent: Sifs = [(0x62, b"%d" % n) for n in range(100)]
            host.send(b"".join(host.sif(*one) for one in sent))
            handed(host, sent)
        host.send(host.sif(0x63, b"1", 3) + host.sif(0x63, b"2", 4) + host.sif(0x63, b"3"))
        handed(host, [(0x63, b"1"), (0x63, b"2"), (0x63, b"3")], 7)


class Noise(HostCase):
    """Sends SIFs of every length, with and without escapes, before and behind 1 to 64 bytes that
    start no frame, each value there is as the first and as the last of them: before another SIF, a
    reply and the end of what is sent in one piece.
    """

    ID = "host.sif.noise"
    EXPECTATION = "The bytes are skipped; each SIF is handed over, and each call gets its reply."
    REQUIREMENTS = ("J2A-FRAME-006", "J2A-FRAME-009", "J2A-SIF-003")
    LEVEL = "sif"

    def _run(self, host: Host) -> None:
        anchor(host)
        clean = bytes(value for value in range(256) if value not in c.MARKERS)
        plain = bytes(value for value in clean if value != c.ESC)
        rng = random.Random(9)
        for values, special in product((plain, clean), (False, True)):
            sent, stream = [], b""
            for number in LENGTHS:
                payload = content(number, 4) if special else bytes(rng.choices(plain, k=number))
                sent.append((number * 3 % 256, payload))
                stream += host.sif(*sent[-1]) + _no_frame(values, number, rng)
            host.flood("SIFs and bytes that are no frames", stream)
            handed(host, sent)
        sent = []
        for number in range(64):
            request = host.asked()
            first, last = (_no_frame((plain, clean)[number % 2], number + n, rng) for n in (1, 64))
            sent += [(0x67, content(number, 4)), (0x68, b"%d" % number)]
            before, behind = (host.sif(*sif) for sif in sent[-2:])
            host.send(before + first + request.reply(3, b"own") + last + behind + first)
            host.replied(request)
            host.replied_with(3, b"own")
        handed(host, sent)


def _no_frame(values: bytes, number: int, rng: random.Random) -> bytes:
    """Return 1 to 64 of these values, which one is the first and the last by a number."""
    first, last = values[number % len(values)], values[number * 37 % len(values)]
    inner = bytes(rng.choices(values, k=max(number * 5 % 64 - 1, 0)))
    return bytes((first,)) + inner + bytes((last,) * (number % 64 > 0))


class Burst(HostCase):
    """Sends 400 SIFs of 100 bytes while a call waits, and then the reply."""

    ID = "host.sif.burst"
    EXPECTATION = "Each is handed over, in order, and the call gets its reply."
    REQUIREMENTS = ("J2A-SIF-003", "J2A-SIF-007")
    LEVEL = "sif"

    def _run(self, host: Host) -> None:
        anchor(host)
        rng = random.Random(400)
        request = host.asked()
        sent: Sifs = [(n % 256, rng.randbytes(100)) for n in range(400)]
        host.send(b"".join(host.sif(*one) for one in sent))
        host.reply(request, 3, b"own")
        host.replied_with(3, b"own")
        handed(host, sent)
