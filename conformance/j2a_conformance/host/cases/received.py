"""Reception by a host: every valid frame, however it is escaped, and no broken one."""

import random

from j2a_spec import constants as c
from j2a_spec.oracle import checksum

from j2a_conformance._judge import inform
from j2a_conformance.host._case import HostCase
from j2a_conformance.host._dimensions import LENGTHS, content, escaped, frame, with_sum
from j2a_conformance.host._host import Host
from j2a_conformance.host._outcomes import Request


def behind_an_error(host: Host) -> Request:
    """Refuse a call by an error reply, and return the next one: nothing has come in between."""
    host.job(f"repeat 2 call @6 - {10 * host.limit_ms}")  # what is sent then takes its time
    host.reply(host.request(6, b""), c.ERR_CHECKSUM, b"\x04\x00")
    return host.request(6, b"")


def largest(seq: int, code: int) -> bytes:
    """Return a payload with which a frame of this seq and code, both escaped, has 518 bytes.

    There is one for each seq that is escaped, where the code is SOF.
    """
    payloads = (bytes((unit,)) * c.MAX_PAYLOAD for unit in sorted(c.STUFFED))
    return next(p for p in payloads if checksum(seq, code, p) in c.STUFFED)


class Sizes(HostCase):
    """Answers with payloads of every size from 0 to 255 bytes; two of three replies have a checksum
    that is escaped, and some come behind an error.
    """

    ID = "host.received.sizes"
    EXPECTATION = "Each reply is handed over as it is."
    REQUIREMENTS = ("J2A-FRAME-005", "J2A-STUFF-005", "J2A-STUFF-003", "J2A-SUM-001")
    LEVEL = "frame"

    def _run(self, host: Host) -> None:
        for size in LENGTHS:
            request = behind_an_error(host) if size % 32 == 9 else host.asked()
            payload = content(size)
            if size % 3 and size:
                wanted = (c.SOF, c.SOS, c.ESC)[size // 3 % 3]
                payload = with_sum(request.seq, size % 0xF0, payload, wanted)
            host.reply(request, size % 0xF0, payload)
            host.replied_with(size % 0xF0, payload)


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
            host.replied_with(0, payload)


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
            host.replied_with(c.SOF, payload)


class Codes(HostCase):
    """Answers with every return value that a function can have, 0x00 to 0xEF and 0xFF."""

    ID = "host.received.codes"
    EXPECTATION = "Each is handed over as the return value of the function."
    REQUIREMENTS = ("J2A-FRAME-005", "J2A-STUFF-005")
    LEVEL = "core"

    def _run(self, host: Host) -> None:
        for code in (*range(c.RET_MAX + 1), c.RET_FAILED):
            request, payload = host.asked(), content(code * 37 % 64, 1)
            host.reply(request, code, payload)
            host.replied_with(code, payload)


class NeedlessEscapes(HostCase):
    """Answers with frames of every length in which one byte, some bytes or all are escaped that can
    be, ESC ESC among them: each byte of short ones alone, and of each value; some behind an error.
    """

    ID = "host.received.needless-escapes"
    EXPECTATION = "ESC and x are taken as x + 1 wherever they stand."
    REQUIREMENTS = ("J2A-STUFF-003", "J2A-STUFF-005")
    LEVEL = "frame"

    def _run(self, host: Host) -> None:
        rng = random.Random(125)
        plans: list[tuple[bytes, set[int] | None]] = []
        for payload in (b"needless", b"\x7e\x12~\x7d"):
            plans += [(payload, {index}) for index in range(len(payload) + 4)]
        plans += [(bytes(range(s, s + 64)), set(range(3, 67))) for s in range(0, 256, 64)]
        for length in LENGTHS:  # one byte, and no other needs it, in the payload and anywhere
            place = length * 7 % max(length, 1)
            data = bytearray(b"x" * length)
            data[place : place + 1] = bytes((length,)) if length else b""
            twice = bytes(data[:place]) + b"\x7e" + bytes(data[place + 1 :])
            plans += [(twice[:length], {3 + place}), (b"x" * length, {3 + length})]
            plans += [(bytes(data), {3 + place}), (b"x" * length, {length * 5 % (length + 4)})]
        plans += [(bytes(range(start, start + 128)), None) for start in (0, 128)]
        for length in range(0, 256, 3):
            most = rng.choice((1, 2, 7, 8, 9, length))
            some = {rng.randrange(length + 4) for _ in range(most)}
            plans.append((bytes(rng.choice((0x7E, 0x7D, 0x61)) for _ in range(length)), some))
        plans += [(b"\x7e" * length, None) for length in (0, 1, 2, 0x7E, 255)]
        for n, (planned, at) in enumerate(plans):
            request = host.asked() if n % 32 else behind_an_error(host)
            code = 0x7E if len(planned) % 2 else 0x21
            payload = planned
            if planned and at == {3 + len(planned)}:  # the checksum as ESC ESC
                payload = with_sum(request.seq, code, planned, c.ESC + 1)
            is_escape = at is not None and request.seq == c.ESC + 1  # its seq as ESC ESC
            host.send(escaped(c.SOF, request.seq, code, payload, {0} if is_escape else at))
            host.replied(request)
            host.replied_with(code, payload)


class OnlyWrongSum(HostCase):
    """Sends a reply with a wrong checksum and nothing else."""

    ID = "host.received.nothing-but-damage"
    EXPECTATION = "The call ends by its time limit, and the next one is like any other."
    REQUIREMENTS = ("J2A-SUM-003", "J2A-TIME-006")
    LEVEL = "frame"

    def _run(self, host: Host) -> None:
        request = host.asked(limit_ms=host.silence_ms)
        host.send(frame(c.SOF, request.seq, c.RET_OK, b"wrong", 0x10))
        host.outcome("timeout", wait_ms=host.silence_ms)
        host.reply(host.asked(), 7, b"next")
        host.replied_with(7, b"next")
