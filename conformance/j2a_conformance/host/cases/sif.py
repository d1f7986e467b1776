"""Server-initiated frames (J2A-SIF)."""

import random

from j2a_spec import constants as c
from j2a_spec.oracle import checksum, stuff

from j2a_conformance._judge import fail
from j2a_conformance.host._case import HostCase
from j2a_conformance.host._host import Host, spell

from .received import largest

_HANDLED = 0x2A
"""The opcode that the handlers `a` and `b` of the host program are for."""

Sifs = list[tuple[int, bytes]]


def handed(host: Host, sifs: Sifs, missing: int | None = 0, handler: str = "all") -> None:
    """Judge that a handler has got exactly these SIFs, and how many the host says are missing."""
    content = b"".join(bytes((opcode, len(payload))) + payload for opcode, payload in sifs)
    outcome, _ = host.do(f"sifs {handler} {len(sifs)} {host.limit_ms}", "sifs")
    count, _, data = outcome.rest.partition(" ")
    if data != spell(content):
        shown = content.hex(" ") if len(content) <= 40 else spell(content)
        host.link.record("expected", text=f"{len(sifs)} SIFs: {shown}")
        fail(f"the host reports the SIFs {data}, not {spell(content)}")
    if missing is not None and count != str(missing):
        fail(f"the host reports {count} missing SIFs, not {missing} (J2A-SIF-009)")


def anchor(host: Host) -> None:
    """Send a SIF from which the host can count on."""
    host.send(host.sif(0x30, b"anchor"))
    handed(host, [(0x30, b"anchor")], missing=None)


class AnyTime(HostCase):
    """Sends SIFs while nothing waits, before a reply, behind it, and before and behind the next
    job.
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
        host.outcome(f"reply 3 {spell(b'own')}")
        before = sif(b"before a job")
        host.send(before + host.job_frame(f"call @6 - {host.limit_ms}") + sif(b"behind a job"))
        request = host.request(6, b"")
        host.reply(request, 4, b"next")
        host.outcome(f"reply 4 {spell(b'next')}")
        handed(host, sent)


class EveryOpcode(HostCase):
    """Sends 256 SIFs, one with each opcode and one with each seq, while a call waits."""

    ID = "host.sif.every-opcode"
    EXPECTATION = "Each is handed over; none is taken for an error reply or for the reply."
    REQUIREMENTS = ("J2A-SIF-005", "J2A-SIF-003", "J2A-SEQ-004")
    LEVEL = "sif"

    def _run(self, host: Host) -> None:
        anchor(host)
        request = host.asked()
        sent: Sifs = [(opcode, b"\x01") for opcode in range(256)]
        host.send(b"".join(host.sif(*one) for one in sent))
        host.reply(request, 3, b"own")
        host.outcome(f"reply 3 {spell(b'own')}")
        handed(host, sent)


class LikeErrors(HostCase):
    """Sends SIFs that look like error replies to the call that waits, its seq included."""

    ID = "host.sif.like-errors"
    EXPECTATION = "Each is handed over, and the call gets its reply."
    REQUIREMENTS = ("J2A-SIF-005", "J2A-SEQ-004")
    LEVEL = "sif"

    def _run(self, host: Host) -> None:
        for code in sorted(c.ERRORS):
            request = host.asked()
            host.reset_sifs(request.seq)
            host.send(host.sif(code, b"\x01\x00"))
            host.reply(request, 3, b"own")
            host.outcome(f"reply 3 {spell(b'own')}")
            handed(host, [(code, b"\x01\x00")], missing=None)


class Sizes(HostCase):
    """Sends SIFs with payloads of every size, with 255 start bytes, and of the largest size, with
    every byte escaped but the length.
    """

    ID = "host.sif.sizes"
    EXPECTATION = "Each is handed over as it is."
    REQUIREMENTS = ("J2A-FRAME-005", "J2A-STUFF-005", "J2A-SIF-003")
    LEVEL = "sif"

    def _run(self, host: Host) -> None:
        anchor(host)
        sent: Sifs = [(size, bytes((size,)) * size) for size in range(256)]
        sent += [(byte, bytes((byte,)) * 255) for byte in sorted(c.STUFFED)]
        host.send(b"".join(host.sif(*one) for one in sent))
        handed(host, sent)
        for seq in sorted(c.STUFFED):
            payload = largest(seq, 0x12)
            host.reset_sifs(seq)
            host.send(host.sif(0x12, payload))
            handed(host, [(0x12, payload)], missing=None)


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
            host.outcome(f"reply 3 {spell(b'own')}")
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
            host.outcome(f"reply 3 {spell(b'reply')}")
            request = host.asked()
            seq = host.next_sif_seq()
            host.reset_sifs(seq)  # the same SIF comes again, whole
            host.send(host.sif(0x51, b"whole")[:cut])
            host.reset_sifs(seq)
            host.reply(request, 4, b"reply")
            host.outcome(f"reply 4 {spell(b'reply')}")
            host.send(host.sif(0x51, b"whole"))
            handed(host, [(0x50, b"SIF"), (0x51, b"whole")])


class Missing(HostCase):
    """Leaves 1, 2, 100 and 254 SIFs out, and lets the counter run over."""

    ID = "host.sif.missing"
    EXPECTATION = "The host counts exactly those that are missing."
    REQUIREMENTS = ("J2A-SIF-009",)
    LEVEL = "sif"

    def _run(self, host: Host) -> None:
        anchor(host)
        for skipped in (0, 1, 2, 100, 254, 0, 0):
            host.send(host.sif(0x60, b"gap", skipped) + host.sif(0x61, b"next"))
            handed(host, [(0x60, b"gap"), (0x61, b"next")], skipped)
        for _ in range(3):
            sent: Sifs = [(0x62, b"%d" % n) for n in range(100)]
            host.send(b"".join(host.sif(*one) for one in sent))
            handed(host, sent)
        host.send(host.sif(0x63, b"1", 3) + host.sif(0x63, b"2", 4) + host.sif(0x63, b"3"))
        handed(host, [(0x63, b"1"), (0x63, b"2"), (0x63, b"3")], 7)


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
        host.outcome(f"reply 3 {spell(b'own')}")
        handed(host, sent)
