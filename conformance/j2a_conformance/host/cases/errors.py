"""Error replies (J2A-ERR)."""

import time

from j2a_spec import constants as c
from j2a_spec.oracle import Frame, encode

from j2a_conformance.host._case import HostCase
from j2a_conformance.host._device import PING
from j2a_conformance.host._host import Host, spell


class Payloads(HostCase):
    """Answers with each error code, with the payloads that devices know and with others of 0, 1,
    2 and 255 bytes.
    """

    ID = "host.error.payloads"
    EXPECTATION = "The host reports the code, whatever the payload is."
    REQUIREMENTS = ("J2A-ERR-007",)
    LEVEL = "core"

    def _run(self, host: Host) -> None:
        known = [bytes((site, 0)) for site in range(c.SITE_LOST + 1)]
        for code in sorted(c.ERRORS):
            for payload in (*known, b"", b"\xff", b"\xff\xff", bytes(range(255))):
                host.reply(host.asked(), code, payload)
                host.outcome(f"error {code}")


class ByName(HostCase):
    """Refuses a function that is in the mapping."""

    ID = "host.error.by-name"
    EXPECTATION = "The host reports the error, and can call the function again."
    REQUIREMENTS = ("J2A-ERR-007", "J2A-SEQ-003")
    LEVEL = "core"

    def _run(self, host: Host) -> None:
        for code, outcome in ((c.ERR_OPCODE, "error 240"), (0, "reply 0 -")):
            host.job(f"call {PING} - {host.limit_ms}")
            host.reply(host.request(host.device.opcode(PING), b""), code)
            host.outcome(outcome)


class Failed(HostCase):
    """Answers with the code 0xFF, by which a function says that it failed, and a payload."""

    ID = "host.error.failed-is-a-reply"
    EXPECTATION = "It is a reply like any other, not one of the errors 0xF0 to 0xF4."
    REQUIREMENTS = ("J2A-ERR-007",)
    LEVEL = "core"

    def _run(self, host: Host) -> None:
        host.reply(host.asked(), c.RET_FAILED, b"why")
        host.outcome(f"reply 255 {spell(b'why')}")


class Early(HostCase):
    """Refuses a request of 255 bytes as soon as its seq has come, before all of it was read."""

    ID = "host.error.early"
    EXPECTATION = "The error reply is taken, and the next call is like any other."
    REQUIREMENTS = ("J2A-ERR-008",)
    LEVEL = "core"

    def _run(self, host: Host) -> None:
        # A host may ask for the properties before its first long request, and for nothing later.
        host.do(f"call @6 255*12 {host.limit_ms}", f"reply 0 {spell(bytes((0x12,)) * 255)}")
        for code in (c.ERR_FRAMING, c.ERR_TIMEOUT):
            host.job(f"call @6 255*12 {host.limit_ms}")
            seq = host.early_request()
            host.send(encode(Frame(c.SOF, seq, code, b"\x05\x00")))
            time.sleep(0.002)
            host.replied(host.request(6, b"\x12" * 255), code)
            host.outcome(f"error {code}")
            host.reply(host.asked(), 1, b"next")
            host.outcome(f"reply 1 {spell(b'next')}")


class AfterErrors(HostCase):
    """Sends an error reply and, behind it, the reply to the same request."""

    ID = "host.error.then-reply"
    EXPECTATION = "The first answer ends the call, the second one is dropped."
    REQUIREMENTS = ("J2A-SEQ-005", "J2A-ERR-007")
    LEVEL = "core"

    def _run(self, host: Host) -> None:
        request = host.asked()
        host.send(request.reply(c.ERR_CHECKSUM, b"\x04\x00") + request.reply(1, b"second"))
        host.replied(request)
        host.outcome("error 243")
        host.reply(host.asked(), 2, b"next")
        host.outcome(f"reply 2 {spell(b'next')}")
