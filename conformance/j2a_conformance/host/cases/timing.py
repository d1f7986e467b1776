"""Every call ends (J2A-TIME-006)."""

from collections.abc import Callable
from dataclasses import replace

from j2a_spec.requirements import Level

from j2a_conformance._judge import fail, inform, skip
from j2a_conformance.host._case import HostCase
from j2a_conformance.host._device import DEMO, FETCH, PING, ROOMY, STORE
from j2a_conformance.host._host import Host
from j2a_conformance.host._outcomes import Outcome, spell

from .many import chunk_of, next_chunk, reply, spelt

_LONG = (0, 3, 4)
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
        host.replied_with(8, b"next")


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
        limit_ms = 8 * host.silence_ms
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
        # With a limit so far away, the calls can only end by the end of the link.
        host.job("together " + " ; ".join(3 * [f"call @6 01 {10 * host.limit_ms}"]))
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


class Queued(_Ends):
    """Has the host make six calls at once, with time limits from 5 ms to 10 s, to a device that
    takes one at a time and answers the first one late.
    """

    ID = "host.time.queued"
    EXPECTATION = (
        "The calls whose time is over while they wait for their turn are not sent; the others are, "
        "and get their replies."
    )
    REQUIREMENTS = ("J2A-TIME-006", "J2A-LIMIT-003")

    def _run(self, host: Host) -> None:
        long_ms = 10 * host.silence_ms
        limits = (10_000, 5, host.silence_ms // 2, long_ms, 10_000, 20)
        calls = [f"call @6 0{n} {limit_ms}" for n, limit_ms in enumerate(limits)]
        host.job(" ; ".join([f"together {calls[0]}", *calls[1:]]))
        began_s = host.link.now_s()
        first = host.request(6)
        host.link.wait_until(began_s + 2 * host.silence_ms / 1e3)
        host.reply(first, 1, first.payload)
        if first.payload != b"\x00":
            host.serve()
            inform("the host did not send the first call first")
        for _ in _LONG[1:]:
            request = host.request(6)
            late = host.link.now_s() - began_s > long_ms / 1e3
            if request.payload not in [bytes((n,)) for n in _LONG]:
                call = spell(request.payload)
                fail(f"the call with {call} was sent, whose time limit was over", suspect=True)
            host.reply(request, 1, request.payload)
        for n, part in enumerate(host.outcomes(len(limits))):
            due = f"reply 1 0{n}" if n in _LONG else "timeout"
            if part.text != due:
                fail(f"the call {n} ended as `{part.whole}`, expected `{due}`", suspect=late)


class QueuedThenSilent(_Ends):
    """Has the host make two calls at once to a device that takes one at a time; answers the first
    one after 0.6 of the time limit and the second one never.
    """

    ID = "host.time.queued-then-silent"
    EXPECTATION = "The second call ends by its time limit, in which it waited for its turn."
    REQUIREMENTS = ("J2A-TIME-006", "J2A-TIME-008")

    def _run(self, host: Host) -> None:
        limit_ms = 6 * host.silence_ms
        host.job(f"together call @6 01 {limit_ms} ; call @6 02 {limit_ms}")
        began_s = host.link.now_s()
        first = host.request(6)
        host.link.wait_until(began_s + 0.6 * limit_ms / 1e3)
        host.reply(first, 1, first.payload)
        host.request_or_end()
        ends_within(host, began_s, limit_ms, 1.5)


class AmongMany(_Ends):
    """Leaves two calls without a reply, while the host makes 100 others at the same time, which are
    answered.
    """

    ID = "host.time.among-many"
    EXPECTATION = "Each of the two ends by its time limit, however many calls end before."
    DEVICE = ROOMY

    def _run(self, host: Host) -> None:
        count, limit_ms = 100, 12 * host.silence_ms
        unanswered = (f"call @6 02 {limit_ms}", f"call @6 03 {limit_ms + 1}")
        host.job(" ; ".join((f"together repeat {count} call @6 01 {host.limit_ms}", *unanswered)))
        began_s = host.link.now_s()
        while (request := host.request_or_end()) is not None:
            if request.payload == b"\x01":
                host.reply(request, 1, b"\x01")
        took_ms = (host.link.now_s() - began_s) * 1e3
        ends = [outcome.text for outcome in host.outcomes(3)]
        if "unsupported" in ends:
            skip("the host program repeats no call beside others")
        if ends != ["reply 1 01", "timeout", "timeout"]:
            fail(f"the calls ended as {ends}", suspect=ends[0] == "timeout")
        if took_ms > 2.5 * limit_ms:
            fail(f"the calls with a limit of {limit_ms} ms took {took_ms:.0f} ms", suspect=True)
        self.next_call(host)


def ends_within(host: Host, began_s: float, limit_ms: int, factor: float) -> Outcome:
    """Judge that the job ends by its time limit, and return its outcome."""
    request = host.request_or_end()
    took_ms = (host.link.now_s() - began_s) * 1e3
    if took_ms > factor * limit_ms:
        what = "ended" if request is None else "sent another request"
        fail(f"the job {what} after {took_ms:.0f} ms, its limit is {limit_ms} ms", suspect=True)
    return host.outcome(wait_ms=2 * limit_ms)


class SlowTransfers(_Ends):
    """Answers each chunk of a read and of a write after a third of the time limit, and never the
    last.
    """

    ID = "host.time.slow-transfers"
    EXPECTATION = "The transfer ends by its time limit, which is one for all chunks."
    REQUIREMENTS = ("J2A-TIME-008", "J2A-TIME-006")
    LEVEL = "many"

    def _run(self, host: Host) -> None:
        for verb, data in (("read", ""), ("write", f" {spelt(2520)}")):
            limit_ms = 3 * host.silence_ms
            host.job(f"{verb} {FETCH if data == '' else STORE}{data} {limit_ms}")
            began_s = host.link.now_s()
            for _ in range(7):
                if (request := host.request_or_end()) is None:
                    break
                host.link.wait_until(host.link.now_s() + limit_ms / 3e3)
                reply(host, chunk_of(request), 0, b"" if data else bytes(10))
            outcome = ends_within(host, began_s, limit_ms, 2.2)
            if outcome.word not in ("timeout", "failed"):
                fail(f"the host reports `{outcome.whole}`")
            self.next_call(host)


class SlowProperties(_Ends):
    """Is a device that takes a third of the time limit for each chunk of its properties, which are
    many; has the host send 100 bytes.
    """

    ID = "host.time.slow-properties"
    EXPECTATION = "The call ends by its time limit, which covers the properties."
    REQUIREMENTS = ("J2A-TIME-008", "J2A-TIME-006")

    def _run(self, host: Host) -> None:
        limit_ms = 3 * host.silence_ms
        host.become_shy(replace(DEMO, chunk=4))
        host.slow_s = limit_ms / 3e3
        try:
            host.job(f"call {PING} 100*61 {limit_ms}")
            began_s = host.link.now_s()
            ends_within(host, began_s, limit_ms, 2.2)
        finally:
            host.slow_s = 0.0
        self.next_call(host)
