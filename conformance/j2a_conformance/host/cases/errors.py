"""Error replies (J2A-ERR)."""

import time
from dataclasses import replace
from itertools import product

from j2a_spec import constants as c
from j2a_spec.oracle import Frame, encode

from j2a_conformance._judge import fail, inform
from j2a_conformance.host._case import HostCase
from j2a_conformance.host._device import DEMO, FETCH, PING, ROOMY, STORE, pattern
from j2a_conformance.host._dimensions import LENGTHS, content, frame
from j2a_conformance.host._host import Host
from j2a_conformance.host._outcomes import Request, spell
from j2a_conformance.wire._expected import DAMAGE

from .limits import together
from .many import spelt

_CODES = tuple(sorted(c.ERRORS))
_UNANSWERED = 4  # times the limit of a call that is not answered, for three of them


class Payloads(HostCase):
    """Answers with each error code: with the payloads that devices know, and with one of every
    length from 0 to 255 bytes.
    """

    ID = "host.error.payloads"
    EXPECTATION = "The host reports the code, whatever the payload is."
    REQUIREMENTS = ("J2A-ERR-007", "J2A-SUM-001")
    LEVEL = "core"

    def _run(self, host: Host) -> None:
        known = [bytes((site, 0)) for site in range(c.SITE_LOST + 1)]
        plans = [(code, payload) for code in _CODES for payload in known]
        plans += [(_CODES[n % 4], content(n, 2)) for n in LENGTHS]
        for code, payload in plans:
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
        host.replied_with(255, b"why")


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
            host.replied_with(1, b"next")


class Foreign(HostCase):
    """Sends error replies of each code with each of the 255 other seqs, and then the reply; and the
    same while several calls wait.
    """

    ID = "host.error.foreign"
    EXPECTATION = "They are dropped, and each call gets its own reply."
    REQUIREMENTS = ("J2A-SEQ-004", "J2A-SEQ-005")
    LEVEL = "core"
    DEVICE = ROOMY

    def _run(self, host: Host) -> None:
        request = host.asked(limit_ms=10 * host.limit_ms)
        self.errors(host, {request.seq})
        host.reply(request, 2, b"mine")
        host.replied_with(2, b"mine")
        host.job("together " + " ; ".join(f"call @6 0{n} {host.limit_ms}" for n in range(1, 4)))
        waiting = host.waiting(3)
        self.errors(host, {one.seq for one in waiting})
        for one in waiting:
            host.reply(one, 1, one.payload)
        for _ in range(3 - len(waiting)):
            late = host.request()
            host.reply(late, 1, late.payload)
        host.outcome("reply 1 01 ; reply 1 02 ; reply 1 03")

    @staticmethod
    def errors(host: Host, own: set[int]) -> None:
        """Send error replies with every seq but these."""
        others = [
            frame(c.SOF, n, code, b"\x01\x00") for code in _CODES for n in LENGTHS if n not in own
        ]
        host.flood("error replies with other seqs", b"".join(others))


class Reserved(HostCase):
    """Answers with the reserved codes 0xF1 and 0xF5 to 0xFE, with payloads and without, calls alone
    and the first of two that take turns.
    """

    ID = "host.error.reserved"
    EXPECTATION = "The host reports that the device breaks the protocol: no result, no error reply."
    REQUIREMENTS = ("J2A-ERR-011",)
    LEVEL = "core"

    def _run(self, host: Host) -> None:
        for code in (0xF1, *range(0xF5, 0xFF)):
            for payload in (b"", b"\x01\x00", content(code, 1)):
                host.reply(host.asked(), code, payload)
                host.outcome("failed")
            together(host, "01", "02")
            first = host.request()
            host.reply(first, code, b"")
            host.reply(host.request(), 1, b"other")
            parts = [part.word for part in host.outcomes(2)]
            if parts != (due := ["failed", "reply"][:: 1 if first.payload == b"\x01" else -1]):
                fail(f"the calls ended as {parts}, not {due}, behind the code 0x{code:02X}")
        host.reply(host.asked(), 0xEF, b"next")
        host.replied_with(0xEF, b"next")


class Hint(HostCase):
    """Answers calls by the errors 0xF2, 0xF3 and 0xF4: one alone with its reply behind; and each of
    three that wait in turn, with its reply behind, and without one where the others get theirs.
    """

    ID = "host.error.hint"
    EXPECTATION = (
        "The host waits on for the reply, or reports an error, of which it does not say that the "
        "request was not executed; the other calls get their replies."
    )
    REQUIREMENTS = ("J2A-ERR-010",)
    LEVEL = "core"
    DEVICE = Foreign.DEVICE

    def _run(self, host: Host) -> None:
        said = False
        for code in sorted(DAMAGE):
            request = host.asked(b"one")
            host.send(request.reply(code, b"\x04\x00") + request.reply(1, b"one"))
            host.replied(request)
            outcome = host.outcome(f"error {code}", f"reply 1 {spell(b'one')}")
            said |= self.judge(outcome.text, outcome.fate)
            for place, is_answered in product(range(3), (True, False)):
                waiting = self._three(host, is_answered)
                said |= self._among_others(host, code, waiting, place, is_answered)
                if len(waiting) < 3:  # it makes one call at a time
                    break
        if not said:
            inform("the host program does not say whether a request was executed")

    @staticmethod
    def _three(host: Host, is_answered: bool) -> list[Request]:
        """Have the host make three calls at once; return those that wait."""
        # The end of this time is what a call waits for whose reply does not come.
        limit_ms = host.limit_ms if is_answered else _UNANSWERED * host.silence_ms
        host.job("together " + " ; ".join(f"call @6 0{n} {limit_ms}" for n in range(1, 4)))
        waiting = host.waiting(3)
        if not is_answered and len(waiting) < 3:
            host.serve()
            fail("not all of three calls came at once, as they did before", suspect=True)
        return waiting

    def _among_others(
        self, host: Host, code: int, waiting: list[Request], place: int, is_answered: bool
    ) -> bool:
        """Refuse one of three calls; judge how they end, and tell whether something was said."""
        hinted = waiting[min(place, len(waiting) - 1)]
        host.send(hinted.reply(code, b"\x04\x00"))
        for one in waiting:
            if is_answered or one is not hinted:
                host.reply(one, 1, one.payload)
        for _ in range(3 - len(waiting)):
            late = host.request()
            host.reply(late, 1, late.payload)
        said = False
        for n, part in enumerate(host.outcomes(3), start=1):
            is_hinted = hinted.payload == bytes((n,))
            accepted = {f"reply 1 0{n}"} if is_answered or not is_hinted else {"timeout"}
            accepted |= {f"error {code}"} if is_hinted else set()
            if part.text not in accepted:
                fail(f"the call with 0{n} ended as `{part.text}`", suspect=part.text == "timeout")
            said |= self.judge(part.text, part.fate)
        return said

    @staticmethod
    def judge(text: str, fate: str) -> bool:
        """Judge what is said of a request; tell whether something was."""
        if fate == "not-sent" or "not executed" in text:
            fail(f"`{text} {fate}` says of a request that was sent that it was not executed")
        return text.startswith("reply") or fate != ""


class AfterErrors(HostCase):
    """Sends an error reply and, behind it, the reply to the same request."""

    ID = "host.error.then-reply"
    EXPECTATION = "One of them ends the call, and neither the next one."
    REQUIREMENTS = ("J2A-SEQ-005", "J2A-ERR-007")
    LEVEL = "core"

    def _run(self, host: Host) -> None:
        request = host.asked()
        host.send(request.reply(c.ERR_CHECKSUM, b"\x04\x00") + request.reply(1, b"second"))
        host.replied(request)
        host.outcome("error 243", f"reply 1 {spell(b'second')}")
        host.reply(host.asked(), 2, b"next")
        host.replied_with(2, b"next")


class HintTransfers(HostCase):
    """Answers the first, the second and the last request of reads and writes by the errors 0xF2,
    0xF3 and 0xF4, with its reply behind.
    """

    ID = "host.error.hint-transfers"
    EXPECTATION = "The transfer goes on, or ends by an error that does not say it was not executed."
    REQUIREMENTS = ("J2A-ERR-010",)
    LEVEL = "many"
    DEVICE = replace(DEMO, content=pattern(600))

    def _run(self, host: Host) -> None:
        for code, job in product(sorted(DAMAGE), (f"read {FETCH}", f"write {STORE} {spelt(602)}")):
            for place in range(3):
                host.job(f"{job} {host.limit_ms}")
                number = 0
                while (request := host.request_or_end()) is not None:
                    reply = request.reply(*host.device.answer(request.opcode, request.payload))
                    hint = request.reply(code, b"\x04\x00") if number == place else b""
                    host.send(hint + reply)
                    host.replied(request)
                    number += 1
                outcome = host.outcome()
                Hint.judge(outcome.text, outcome.fate)
