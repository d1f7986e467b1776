"""What a host receives: every frame, however it is escaped, and nothing that is broken."""

import time

from j2a_spec import constants as c
from j2a_spec.oracle import checksum, stuff

from j2a_conformance._judge import inform
from j2a_conformance.host._case import HostCase
from j2a_conformance.host._host import Host, Request, spell


def wrong_sum(request: Request, payload: bytes, error: int) -> bytes:
    """Return a reply whose checksum is wrong in the bits of `error`."""
    body = bytes((request.seq, c.RET_OK, len(payload))) + payload
    check = checksum(request.seq, c.RET_OK, payload) ^ error
    return bytes((c.SOF,)) + stuff(body + bytes((check,)))


def escape_all(wire: bytes) -> bytes:
    """Return a frame with every byte escaped that can be."""
    found, is_escaped = bytearray(wire[:1]), False
    for byte in wire[1:]:
        free = not is_escaped and byte != c.ESC and (byte - 1) % 256 not in (*c.MARKERS, 0xFF)
        found += bytes((c.ESC, byte - 1)) if free else bytes((byte,))
        is_escaped = not is_escaped and byte == c.ESC
    return bytes(found)


def largest(seq: int, code: int) -> bytes:
    """Return a payload with which a frame of this seq and code, both escaped, has 518 bytes.

    There is one for each seq that is escaped, where the code is SOF.
    """
    payloads = (bytes((unit,)) * c.MAX_PAYLOAD for unit in sorted(c.STUFFED))
    return next(p for p in payloads if checksum(seq, code, p) in c.STUFFED)


class Sizes(HostCase):
    """Answers with payloads of every size from 0 to 255 bytes."""

    ID = "host.received.sizes"
    EXPECTATION = "Each reply is handed over as it is."
    REQUIREMENTS = ("J2A-FRAME-005", "J2A-STUFF-005")
    LEVEL = "frame"

    def _run(self, host: Host) -> None:
        for size in range(256):
            payload = bytes((size,)) * size
            host.reply(host.asked(), c.RET_OK, payload)
            host.outcome(f"reply 0 {spell(payload)}")


class Values(HostCase):
    """Answers with 255 start bytes, with 255 escapes, and with every byte value."""

    ID = "host.received.values"
    EXPECTATION = "Each reply is handed over as it is; the largest is 518 bytes long."
    REQUIREMENTS = ("J2A-FRAME-005", "J2A-STUFF-003", "J2A-STUFF-005")
    LEVEL = "frame"

    def _run(self, host: Host) -> None:
        units = (b"\x12", b"\xed", b"\x7d", b"\xff", b"\x00", b"\x7d\x11", b"\x11\xec\x7c")
        payloads = [unit * (255 // len(unit)) for unit in units]
        payloads += [bytes(range(255)), bytes(range(1, 256))]
        for payload in payloads:
            host.reply(host.asked(), c.RET_OK, payload)
            host.outcome(f"reply 0 {spell(payload)}")


class Largest(HostCase):
    """Answers with the largest frame, in which every byte is escaped but the length."""

    ID = "host.received.largest"
    EXPECTATION = "The 518 bytes are one frame, whose payload is handed over."
    REQUIREMENTS = ("J2A-FRAME-005", "J2A-STUFF-005")
    LEVEL = "frame"

    def _run(self, host: Host) -> None:
        for seq in sorted(c.STUFFED):
            if count := (seq - host.resting_seq - 2) % 256:  # two calls for jobs come between
                host.job(f"repeat {count} call @6 - {host.limit_ms}")
                for _ in range(count):
                    host.reply(host.request(6, b""))
                host.outcome("reply 0 -")
            request = host.asked()
            if request.seq != seq:
                inform("the host takes seqs of which the suite does not know")
            payload = largest(seq, c.SOF)
            host.reply(request, c.SOF, payload)
            host.outcome(f"reply {c.SOF} {spell(payload)}")


class Codes(HostCase):
    """Answers with every return value that a function can have, 0x00 to 0xEF and 0xFF."""

    ID = "host.received.codes"
    EXPECTATION = "Each is handed over as the return value of the function."
    REQUIREMENTS = ("J2A-FRAME-005", "J2A-STUFF-005")
    LEVEL = "core"

    def _run(self, host: Host) -> None:
        for code in (*range(c.RET_MAX + 1), c.RET_FAILED):
            host.reply(host.asked(), code, b"\x01")
            host.outcome(f"reply {code} 01")


class NeedlessEscapes(HostCase):
    """Answers with frames in which every byte is escaped that can be."""

    ID = "host.received.needless-escapes"
    EXPECTATION = "ESC and x are taken as x + 1 wherever they stand."
    REQUIREMENTS = ("J2A-STUFF-003", "J2A-STUFF-005")
    LEVEL = "frame"

    def _run(self, host: Host) -> None:
        for payload in (b"", b"needless", bytes(range(128)), bytes(range(128, 256))):
            request = host.asked()
            host.send(escape_all(request.reply(0x21, payload)))
            host.replied(request)
            host.outcome(f"reply 33 {spell(payload)}")


class EscapeFF(HostCase):
    """Sends a reply with ESC 0xFF in each of its fields, such that ESC 0xFF read as 0x00 would make
    it whole, then the right one.
    """

    ID = "host.received.escape-ff"
    EXPECTATION = "The broken frame is given up and the right reply is taken."
    REQUIREMENTS = ("J2A-STUFF-004", "J2A-FRAME-009")
    LEVEL = "frame"

    def _run(self, host: Host) -> None:
        for payload in (b"\x00", b"\x01\x00", b"\x00" * 9, b""):
            request = host.asked()
            right = request.reply(c.RET_OK, b"right")
            if payload:
                broken = request.reply(0x22, payload)
                cut = broken.rindex(b"\x00", 0, -1)
            else:
                broken = request.reply(c.RET_OK, b"")  # the opcode is the 0x00
                cut = 3 if broken[1] == c.ESC else 2
            host.send(broken[:cut] + b"\x7d\xff" + broken[cut + 1 :] + right)
            host.replied(request)
            host.outcome(f"reply 0 {spell(b'right')}")


class WrongSum(HostCase):
    """Sends replies with each bit of the checksum wrong, with payloads that were damaged, and with
    checksums that have other bytes in them, then the right one, each alone and all in one piece.
    """

    ID = "host.received.wrong-checksum"
    EXPECTATION = "Nothing of a damaged reply is handed over; the right reply is taken."
    REQUIREMENTS = ("J2A-SUM-003", "J2A-SUM-002", "J2A-FRAME-009", "J2A-FRAME-010")
    LEVEL = "frame"

    def _run(self, host: Host) -> None:
        for bit in range(8):
            request = host.asked()
            for payload in (b"", b"wrong"):
                host.send(wrong_sum(request, payload, 1 << bit))
            host.reply(request, c.RET_OK, b"right")
            host.outcome(f"reply 0 {spell(b'right')}")
        for error in (c.CHK_OPCODE, c.CHK_LENGTH, c.SOF):
            request = host.asked()
            host.send(wrong_sum(request, b"", error) + request.reply(c.RET_OK, b"right"))
            host.replied(request)
            host.outcome(f"reply 0 {spell(b'right')}")


class OnlyWrongSum(HostCase):
    """Sends a reply with a wrong checksum and nothing else."""

    ID = "host.received.nothing-but-damage"
    EXPECTATION = "The call ends by its time limit, and the next one is like any other."
    REQUIREMENTS = ("J2A-SUM-003", "J2A-TIME-006")
    LEVEL = "frame"

    def _run(self, host: Host) -> None:
        request = host.asked(limit_ms=host.silence_ms)
        host.send(wrong_sum(request, b"wrong", 0x10))
        host.outcome("timeout", wait_ms=host.silence_ms)
        host.reply(host.asked(), 7, b"next")
        host.outcome(f"reply 7 {spell(b'next')}")


class Pieces(HostCase):
    """Sends replies in pieces: byte by byte, and cut inside escapes."""

    ID = "host.received.pieces"
    EXPECTATION = "How a link cuts the stream makes no difference."
    REQUIREMENTS = ("J2A-FRAME-005", "J2A-STUFF-003")
    LEVEL = "frame"

    def _run(self, host: Host) -> None:
        payload = b"a\x12b\x7dc\xed"
        for size in (1, 2, 3, 5):
            request = host.asked()
            wire = request.reply(0x7D, payload)
            for start in range(0, len(wire), size):
                host.send(wire[start : start + size])
                time.sleep(0.001)
            host.replied(request)
            host.outcome(f"reply 125 {spell(payload)}")
