"""Recovery of a host from noise, incomplete frames, and resets of the device."""

import random

from j2a_spec import constants as c
from j2a_spec.oracle import Frame, decode

from j2a_conformance.host._case import HostCase
from j2a_conformance.host._host import Host

from .received import behind_an_error

_BOOT = b"\r\nboot v1.0 (7) \xf0\x00\xff\xff\x7d ready\r\n"


def noise(rng: random.Random, size: int, markers: bool) -> bytes:
    """Return bytes that hold no good frame; without `markers` also no start byte."""
    while True:
        data = bytes(rng.choice(b"\x7d\xff\x11\xec\x00a" + rng.randbytes(6)) for _ in range(size))
        if not markers:
            data = bytes(byte for byte in data if byte not in c.MARKERS)
        if all(not isinstance(event, Frame) for event in decode(data)):
            return data


class Noise(HostCase):
    """Sends 1 to 256 bytes that start no frame, each value as the last of them, before a reply and
    behind it, with a SIF behind half of them, in one piece; some after an error.
    """

    ID = "host.recovery.noise"
    EXPECTATION = "They are skipped without an answer, and the reply is taken."
    REQUIREMENTS = ("J2A-FRAME-006", "J2A-FRAME-009")
    LEVEL = "frame"

    def _run(self, host: Host) -> None:
        rng = random.Random(6)
        clean = bytes(value for value in range(256) if value not in c.MARKERS)
        for number in range(256):
            junk = bytes(rng.choices(clean, k=number)) + clean[number * 37 % len(clean) :][:1]
            request = host.asked() if number % 32 else behind_an_error(host)
            code = number % (c.RET_MAX + 1)
            sif = host.sif(0x30, junk[:7]) if number % 2 else b""
            host.send(junk + request.reply(code, b"reply") + junk[number // 2 :] + sif)
            host.replied(request)
            host.replied_with(code, b"reply")


class NoiseAtRest(HostCase):
    """Sends bytes that start no frame, and pieces of frames, while no call but that for the next
    job waits.
    """

    ID = "host.recovery.noise-at-rest"
    EXPECTATION = "They are skipped without an answer."
    REQUIREMENTS = ("J2A-FRAME-006", "J2A-FRAME-009", "J2A-FRAME-010")
    LEVEL = "frame"

    def _run(self, host: Host) -> None:
        rng = random.Random(60)
        for markers in (False, True, True, True):
            host.send(noise(rng, 60, markers))
            host.reply(host.asked(), 3, b"rest")
            host.replied_with(3, b"rest")


class Cut(HostCase):
    """Sends a reply cut off behind each of its bytes, also inside an escape, and at once the whole
    one.
    """

    ID = "host.recovery.cut"
    EXPECTATION = "The start byte of the whole reply ends the piece before it; the reply is taken."
    REQUIREMENTS = ("J2A-FRAME-007", "J2A-FRAME-009")
    LEVEL = "frame"

    def _run(self, host: Host) -> None:
        payload = b"\x12whole\x7d\xed"
        for cut in range(1, 16):
            request = host.asked()
            wire = request.reply(9, payload)
            host.send(wire[: min(cut, len(wire) - 1)] + wire)
            host.replied(request)
            host.replied_with(9, payload)


class AfterEscape(HostCase):
    """Sends ESC inside a reply and directly behind it the start byte of the whole one."""

    ID = "host.recovery.start-after-escape"
    EXPECTATION = "The start byte begins the frame that follows; the reply is taken."
    REQUIREMENTS = ("J2A-FRAME-007", "J2A-STUFF-003")
    LEVEL = "frame"

    def _run(self, host: Host) -> None:
        for cut in range(1, 6):
            request = host.asked()
            wire = request.reply(9, b"whole")
            plain = wire[:cut] if wire[cut - 1] != c.ESC else wire[: cut - 1]
            host.send(plain + b"\x7d" + wire)
            host.replied(request)
            host.replied_with(9, b"whole")


class Announced(HostCase):
    """Sends the beginning of a frame that announces 255 bytes, and then the reply."""

    ID = "host.recovery.long-announcement"
    EXPECTATION = "The announced bytes are not waited for: the reply is taken."
    REQUIREMENTS = ("J2A-FRAME-007", "J2A-FRAME-009")
    LEVEL = "frame"

    def _run(self, host: Host) -> None:
        for start in sorted(c.MARKERS):
            request = host.asked()
            host.send(bytes((start, 0x30, 0x00, 0xFF)) + b"half")
            host.reply(request, 5, b"taken")
            host.replied_with(5, b"taken")


class Storm(HostCase):
    """Sends 60 pieces of noise with start bytes, broken frames and escapes, each before a reply."""

    ID = "host.recovery.storm"
    EXPECTATION = "Each reply is taken, and the noise is neither answered nor handed over."
    REQUIREMENTS = (
        "J2A-FRAME-006",
        "J2A-FRAME-007",
        "J2A-FRAME-009",
        "J2A-FRAME-010",
        "J2A-SUM-003",
    )
    LEVEL = "frame"

    def _run(self, host: Host) -> None:
        rng = random.Random(2014)
        for count in range(60):
            request = host.asked()
            reply = request.reply(count, b"storm")
            while True:
                junk = noise(rng, rng.randrange(1, 80), markers=True)
                # The noise must not make a frame of the reply's first bytes: it never does, since
                # the start byte ends it; but a frame before that would be one.
                events = decode(junk + reply)
                if sum(isinstance(event, Frame) for event in events) == 1:
                    break
            host.send(junk + reply)
            host.replied(request)
            host.replied_with(count, b"storm")


class Reset(HostCase):
    """Resets the device in mid call: half a reply, the text that a board prints when it boots, a
    SIF that begins to count anew, and no reply.
    """

    ID = "host.recovery.reset-in-call"
    EXPECTATION = "The call ends by its time limit, and the next one is like any other."
    REQUIREMENTS = ("J2A-TIME-006", "J2A-FRAME-009", "J2A-SIF-003")
    LEVEL = "core"

    def _run(self, host: Host) -> None:
        for half in (0, 4, 8):
            request = host.asked(limit_ms=host.silence_ms)
            host.reset_sifs()
            # It announces so much that no byte of the boot text can be taken for its end.
            piece = request.reply(c.RET_OK, b"half a reply" + bytes(200))[:half]
            host.send(piece + _BOOT + host.sif(0x42, b"booted") + _BOOT)
            host.outcome("timeout", wait_ms=host.silence_ms)
            host.reply(host.asked(), 8, b"again")
            host.replied_with(8, b"again")


class Greeting(HostCase):
    """Closes the link, and greets the host on the new one with boot text, the beginning of a frame
    and a SIF.
    """

    ID = "host.recovery.greeting"
    EXPECTATION = "The host connects, and its calls are answered as ever."
    REQUIREMENTS = ("J2A-FRAME-006", "J2A-FRAME-009", "J2A-SIF-003")
    LEVEL = "core"

    def _run(self, host: Host) -> None:
        host.hang_up(_BOOT + b"\x12\x05" + host.sif(0x42, b"hello") + _BOOT)
        host.reply(host.asked(), 4, b"greeted")
        host.replied_with(4, b"greeted")
