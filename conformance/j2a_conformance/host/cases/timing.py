"""Every call ends (J2A-TIME-006)."""

from collections.abc import Callable

from j2a_spec.requirements import Level

from j2a_conformance._judge import fail
from j2a_conformance.host._case import HostCase
from j2a_conformance.host._device import STORE
from j2a_conformance.host._host import Host, spell

from .many import next_chunk, reply, spelt

_ENDED = ("lost", "timeout", "failed")


class _Ends(HostCase):
    """A call that the time limit ends, and a call that is answered."""

    EXPECTATION = "The call ends by its time limit, and the next one is like any other."
    REQUIREMENTS: tuple[str, ...] = ("J2A-TIME-006",)
    LEVEL: Level = "timing"

    @staticmethod
    def next_call(host: Host) -> None:
        """Judge that a call is answered as ever."""
        host.reply(host.asked(b"next"), 8, b"next")
        host.outcome(f"reply 8 {spell(b'next')}")


class NoReply(_Ends):
    """Leaves a call without a reply."""

    ID = "host.time.no-reply"
    REQUIREMENTS = ("J2A-TIME-006", "J2A-FRAME-010")

    def _run(self, host: Host) -> None:
        for _ in range(2):
            host.asked(limit_ms=host.silence_ms)
            host.outcome("timeout", wait_ms=host.silence_ms)
        self.next_call(host)


class HalfReply(_Ends):
    """Sends the beginning of a reply, cut off at several places, and nothing more."""

    ID = "host.time.half-reply"
    REQUIREMENTS = ("J2A-TIME-006", "J2A-FRAME-007", "J2A-FRAME-009")

    def _run(self, host: Host) -> None:
        for cut in (1, 2, 4, 8):
            request = host.asked(limit_ms=host.silence_ms // 2)
            host.send(request.reply(3, b"half a reply")[:cut])
            host.outcome("timeout", wait_ms=host.silence_ms)
            self.next_call(host)


class HalfSif(_Ends):
    """Sends the beginning of a SIF, which ends in an escape, and nothing more."""

    ID = "host.time.half-sif"
    REQUIREMENTS = ("J2A-TIME-006", "J2A-FRAME-007")

    def _run(self, host: Host) -> None:
        host.asked(limit_ms=host.silence_ms)
        host.send(b"\xed\x00\x20\x30half\x7d")
        host.outcome("timeout", wait_ms=host.silence_ms)
        self.next_call(host)


class _Chatter(_Ends):
    """Something comes all the time, but not the reply."""

    @staticmethod
    def chatter(host: Host, piece: Callable[[], bytes]) -> None:
        """Send pieces at short intervals for much longer than the time limit."""
        host.asked(limit_ms=host.silence_ms)
        deadline_s = host.link.now_s() + 10 * host.silence_ms / 1e3
        while not host.has_sent(host.silence_ms / 12e3):
            if host.link.now_s() > deadline_s:
                fail("the call went on for ten times its time limit", suspect=True)
            host.send(piece())
        host.outcome("timeout")


class SifsOnly(_Chatter):
    """Sends twelve SIFs in each time limit, but no reply."""

    ID = "host.time.sifs-only"
    REQUIREMENTS = ("J2A-TIME-006", "J2A-SIF-003")

    def _run(self, host: Host) -> None:
        self.chatter(host, lambda: host.sif(0x20, b"tick"))
        self.next_call(host)


class NoiseOnly(_Chatter):
    """Sends bytes that start no frame, twelve times in each time limit, but no reply."""

    ID = "host.time.noise-only"
    REQUIREMENTS = ("J2A-TIME-006", "J2A-FRAME-006")

    def _run(self, host: Host) -> None:
        self.chatter(host, lambda: b"noise\x7d")
        self.next_call(host)


class Slow(HostCase):
    """Answers after half of the time limit."""

    ID = "host.time.slow"
    EXPECTATION = "The reply is taken: the time limit is that of the call."
    REQUIREMENTS = ("J2A-TIME-006",)
    LEVEL = "timing"

    def _run(self, host: Host) -> None:
        limit_ms = 4 * host.silence_ms
        request = host.asked(limit_ms=limit_ms)
        host.link.wait_until(host.link.now_s() + limit_ms / 2e3)
        host.reply(request, 3, b"slow")
        outcome = host.outcome()
        if outcome.text != f"reply 3 {spell(b'slow')}":
            fail(f"the host reports `{outcome.text}`", suspect=outcome.word == "timeout")


class Closed(_Ends):
    """Closes the link while a call waits whose time limit is far away."""

    ID = "host.time.link-closed"
    EXPECTATION = "The call ends by the end of the link, and the next one over the new link."

    def _run(self, host: Host) -> None:
        for half in (0, 5):
            request = host.asked()
            if half:
                host.send(request.reply(3, b"half")[:half])
            host.hang_up()
            host.outcome(*_ENDED, wait_ms=host.limit_ms)
            self.next_call(host)


class ClosedWhileOthersWait(_Ends):
    """Closes the link while several calls wait, for their reply or for their turn."""

    ID = "host.time.link-closed-among-calls"
    EXPECTATION = "Each ends by the end of the link, and the next one over the new link."

    def _run(self, host: Host) -> None:
        host.job("together " + " ; ".join(3 * [f"call @6 01 {host.limit_ms}"]))
        host.request(6, b"\x01")
        # The other two are to wait for their turn by then, also where the machine is busy.
        host.link.wait_until(host.link.now_s() + 0.1)
        host.hang_up()
        outcome = host.outcome(wait_ms=host.limit_ms)
        if any(part.split(" ")[0] not in _ENDED for part in outcome.text.split(" ; ")):
            fail(f"the host reports `{outcome.text}` of calls that waited when the link ended")
        self.next_call(host)


class ClosedInTransfer(_Ends):
    """Closes the link in the middle of a transfer."""

    ID = "host.time.link-closed-in-transfer"
    EXPECTATION = "The transfer fails; it does not go on over the new link."
    LEVEL = "many"

    def _run(self, host: Host) -> None:
        host.job(f"write {STORE} {spelt(700)} {host.limit_ms}")
        reply(host, next_chunk(host, STORE, 0, is_write=True))
        next_chunk(host, STORE, 249, is_write=True)
        host.hang_up()
        host.outcome(*_ENDED, wait_ms=host.limit_ms)
        self.next_call(host)


class NoReplyInTransfer(_Ends):
    """Leaves the second chunk of a transfer without a reply."""

    ID = "host.time.no-reply-in-transfer"
    EXPECTATION = "The transfer ends by the time limit, and the next call is like any other."
    LEVEL = "many"

    def _run(self, host: Host) -> None:
        host.job(f"write {STORE} {spelt(700)} {host.silence_ms * 3}")
        reply(host, next_chunk(host, STORE, 0, is_write=True))
        next_chunk(host, STORE, 249, is_write=True)
        host.outcome("timeout", "failed", wait_ms=3 * host.silence_ms)
        self.next_call(host)
