"""The runner: devices that die, hang, stall or say nothing, and runs that end early."""

import threading
import time
from contextlib import suppress

import pytest
from j2a_conformance import HarnessError, Verdict, load, run
from j2a_conformance._judge import fail
from j2a_conformance.device._case import Case
from j2a_conformance.device._peer import Peer
from j2a_conformance.device.cases import sif
from j2a_conformance.reports._console import report
from j2a_spec import constants as c
from j2a_spec.oracle import Frame, encode
from j2a_transports import LinkClosed, LinkLost, OpenFailed, pair

QUICK = ["frame.layout", "many.echo-lengths", "mapping.names"]


def only(name):
    return next(case for case in load() if name == case.ID)


class Dies:
    """Hangs up at the first chunk of a2jEchoMany."""

    def many(self, name, last, write, offset, data):
        if name == c.GET_ECHO_MANY:
            self.link.close()
        return super().many(name, last, write, offset, data)


class Hangs:
    """Never answers again after the first chunk of a2jEchoMany."""

    hung = False

    def many(self, name, last, write, offset, data):
        self.hung = self.hung or name == c.GET_ECHO_MANY
        return super().many(name, last, write, offset, data)

    def send(self, start, seq, opcode, payload):
        if not self.hung:
            super().send(start, seq, opcode, payload)


@pytest.mark.parametrize("mixin", [Dies, Hangs])
def test_a_lost_device_fails_the_case_and_the_run_goes_on(mixin, reference, judged):
    device = type("Lost", (mixin, reference), {})
    found = judged(device, QUICK, timeout_scale=0.1)
    by_case = {result.case: result.verdict for result in found.results}
    assert by_case["many.echo-lengths"] is Verdict.FAILED
    assert by_case["frame.layout"] is by_case["mapping.names"] is Verdict.OK
    assert not found.stopped


def test_a_device_that_does_not_come_back_ends_the_run(reference):
    device = type("Lost", (Dies, reference), {})
    links = []

    def opener():
        if links:
            raise OpenFailed("it is gone")
        here, there = pair()
        links.append(device(there))
        return here

    found = run(opener, [only(name) for name in reversed(QUICK)])
    assert [r.case for r in found.results][-1] == "many.echo-lengths"
    assert found.stopped == "the device did not answer any more after many.echo-lengths"
    assert not found.conformant


class Stalls:
    """Is late once, as a busy machine makes it, in the middle of a frame."""

    stalled = False

    def request(self, seq, opcode, payload):
        if len(payload) == 255 and not self.stalled:
            self.stalled = True
            self.error(seq, c.ERR_TIMEOUT)
        else:
            super().request(seq, opcode, payload)


def test_a_stall_is_tried_again(reference, judged):
    found = judged(type("Stalls", (Stalls, reference), {}), ["frame.layout"])
    layout = found.results[-1]
    assert (layout.case, layout.verdict, layout.attempts) == ("frame.layout", Verdict.OK, 2)


@pytest.mark.parametrize(
    ("case", "is_meant"),
    [
        ("frame.layout", lambda payload: len(payload) == 255),
        ("smoke.echo", lambda payload: len(payload) == 6 and payload.isdigit()),  # a barrier
    ],
)
@pytest.mark.parametrize("emulated", [True, False])
def test_what_an_emulator_gave_up_without_a_word_is_tried_again(
    emulated, case, is_meant, reference, judged
):
    """A stall behind the start byte makes it give up a frame that it cannot answer."""

    class StallsOnce(reference):
        stalled = False

        def request(self, seq, opcode, payload):
            if is_meant(payload) and not StallsOnce.stalled:
                StallsOnce.stalled = True
            else:
                super().request(seq, opcode, payload)

    found = judged(StallsOnce, [case], emulated=emulated, timeout_scale=0.2)
    assert StallsOnce.stalled
    assert [r.case for r in found.results if r.attempts == 2] == [case] * emulated
    assert [r.case for r in found.results if r.verdict is Verdict.FAILED] == [case] * (not emulated)


@pytest.mark.parametrize("nth", [3, 8, 21, 60, 100, 200])
@pytest.mark.parametrize("case", ["debug.text", "debug.boundaries", "debug.more-and-lost"])
def test_a_stall_among_calls_about_debug_text_is_tried_again(case, nth, reference, judged):
    """Text that was written before the stall is no second text of the next attempt."""

    class StallsOnce(reference):
        debug_size = 600
        calls = 0

        def request(self, seq, opcode, payload):
            type(self).calls += self.names[opcode] in {"ret", c.GET_DEBUG}
            if self.calls != nth:
                super().request(seq, opcode, payload)
            else:
                type(self).calls += 1
                self.error(seq, c.ERR_TIMEOUT)

    found = judged(StallsOnce, [case])
    assert StallsOnce.calls > nth
    assert [r.reason for r in found.results if r.verdict is not Verdict.OK] == []
    assert [r.attempts for r in found.results] == [1] * len(found.results)


class SlowLink:
    """Takes 0.7 ms for a byte, so that the largest exchange takes longer than the first timeout."""

    names = c.BUILTINS

    def received(self, data):
        time.sleep(len(data) * 7e-4)
        return data

    def wire(self, start, seq, opcode, payload):
        wire = super().wire(start, seq, opcode, payload)
        time.sleep(len(wire) * 7e-4)
        return wire


def test_a_slow_link_gets_the_time_that_it_needs(reference, judged):
    found = judged(type("Slow", (SlowLink, reference), {}), ["frame.layout"], timeout_scale=0.1)
    assert [r.reason for r in found.results if r.verdict is not Verdict.OK] == []


def test_an_unfinished_reply_names_the_option(reference, judged):
    class Stops(reference):
        def wire(self, start, seq, opcode, payload):
            return super().wire(start, seq, opcode, payload)[: 100 if len(payload) == 255 else None]

    found = judged(Stops, ["frame.layout"], timeout_scale=0.1)
    assert "--baud" in found.results[-1].reason


class SilentDevice:
    def __init__(self, link):
        self.link = link


class Noise(SilentDevice):
    def __init__(self, link):
        super().__init__(link)
        link.write(b"\x00\x80\xff" * 5)


class Babbles(SilentDevice):
    """Sends frames and noise for ever, whatever it is asked."""

    text = encode(Frame(c.SOF, 0xFE, 0x33, b"log")) + b"log\n"

    def __init__(self, link):
        super().__init__(link)
        threading.Thread(target=self.babble, daemon=True).start()

    def babble(self):
        with suppress(LinkLost, LinkClosed):
            while True:
                self.link.write(self.text)
                time.sleep(0.001)


class Logs(Babbles):
    text = b"temperature 21 C\n" * 20


@pytest.mark.parametrize(
    ("device", "words"),
    [
        (SilentDevice, "nothing answers"),
        (Noise, "baud rate"),
        (Babbles, "without end"),
        (Logs, "without end"),
    ],
)
def test_no_device_is_a_fault_of_the_harness(device, words, judged):
    with pytest.raises(HarnessError, match=words):
        judged(device, timeout_scale=0.02)


def test_a_device_that_begins_to_babble_fails(reference, judged):
    class Breaks(reference):
        text = b"panic " * 50

        def do_a2jEcho(self, payload):  # noqa: N802
            if len(payload) > 6:
                Babbles.babble(self)
            return super().do_a2jEcho(payload)

    found = judged(Breaks, ["frame.layout", "mapping.names"], timeout_scale=0.1)
    by_case = {result.case: result.verdict for result in found.results}
    assert by_case["frame.layout"] is Verdict.FAILED


def test_what_a_device_prints_while_it_boots_is_harmless(reference, judged):
    class Boots(reference):
        def serve(self):
            self.link.write(b"boot 1.0\n" * 9)
            super().serve()

    found = judged(Boots, ["J2A-FRAME-010", "sif.start"])
    assert [r.reason for r in found.results if r.verdict is not Verdict.OK] == []


class BootsSlowly:
    """Is deaf for some time, and then answers all that has come meanwhile."""

    def serve(self):
        time.sleep(0.5)
        super().serve()


def test_a_device_that_boots_slowly_is_waited_for(reference, judged):
    device = type("Slow", (BootsSlowly, reference), {})
    found = judged(device, QUICK, timeout_scale=0.1)
    assert not found.with_verdict(Verdict.FAILED), report(found)


def test_a_link_that_cannot_be_opened_is_a_fault_of_the_harness():
    def opener():
        raise OpenFailed("there is no such port")

    with pytest.raises(HarnessError, match="no such port"):
        run(opener, load())


def test_an_interrupted_run_is_reported(reference, judged):
    seen = []

    def interrupt(result):
        seen.append(result)
        if len(seen) == 5:
            raise KeyboardInterrupt

    found = judged(reference, on_result=interrupt)
    assert list(found.results) == seen
    assert found.stopped == "interrupted"
    assert "ended early: interrupted" in report(found)


@pytest.mark.parametrize("name", ["sif.whole", "sif.during-delay"])
@pytest.mark.parametrize("error", [KeyboardInterrupt, ZeroDivisionError])
def test_an_exception_within_a_case_is_no_verdict(name, error, reference, judged, monkeypatch):
    """The answer that was waited for comes late; no later request may take it for its own."""
    armed = []

    def period(peer, ms):
        started(peer, ms)
        armed.append(ms)

    def expect(peer, *expected, **options):
        if armed == [1] or armed == [2]:
            armed.append("only once")
            raise error
        return expected_before(peer, *expected, **options)

    started, expected_before = sif._period, Peer.expect
    monkeypatch.setattr(sif, "_period", period)
    monkeypatch.setattr(Peer, "expect", expect)
    if error is KeyboardInterrupt:
        found = judged(reference, [name])
        assert found.stopped.startswith("interrupted")
        assert name not in {result.case for result in found.results}
    else:
        with pytest.raises(error):
            judged(reference, [name])
    assert armed[1:] == ["only once"]


def test_the_first_failure_within_a_case_is_the_reason(reference, judged):
    class Forgets(reference):
        """Has no answers any more once SIFs have come for a while."""

        def do_sif(self, payload):
            self.stopped = True
            return super().do_sif(payload)

        def send(self, start, seq, opcode, payload):
            if getattr(self, "stopped", False):
                start, opcode = c.SOF, 0x77
            super().send(start, seq, opcode, payload)

    found = judged(Forgets, ["sif.whole"], timeout_scale=0.1)
    assert found.results[-1].verdict is Verdict.FAILED
    assert "code 0x77" in found.results[-1].reason


class AnotherStore:
    """Has an application with functions of the demo's names that do something else."""

    def many(self, name, last, write, offset, data):
        if name == "store":
            raise AssertionError("the store was touched")
        return super().many(name, last, write, offset, data)

    def do_ret(self, payload):
        raise AssertionError("ret was called")


def test_builtins_only_leaves_the_application_alone(reference, judged):
    device = type("Other", (AnotherStore, reference), {})
    cases = ["many.store", "dispatch.return-values", "many.wrong-function", "J2A-ERR-001"]
    found = judged(device, cases, builtins_only=True)
    verdicts = {result.case: result.verdict for result in found.results}
    assert verdicts["many.store"] is Verdict.UNIMPLEMENTED
    assert verdicts["dispatch.return-values"] is Verdict.UNIMPLEMENTED
    assert verdicts["error.opcode-out-of-range"] is Verdict.OK
    assert found.conformant


def test_late_answers_to_the_failed_case_do_not_reach_the_next(reference):
    class Late(reference):
        def do_a2jEcho(self, payload):  # noqa: N802
            if payload == b"late":
                time.sleep(0.3)
            return super().do_a2jEcho(payload)

    class First(Case):
        """Sends a request that is answered late, and gives up."""

        ID = "first"
        EXPECTATION = "Nothing."
        REQUIREMENTS = ("J2A-DISP-001",)
        LEVEL = "core"

        def _run(self, peer):
            peer.link.send(peer.echo(b"late").wire)
            fail("on purpose")

    def opener():
        here, there = pair()
        Late(there)
        return here

    found = run(opener, [First(), only("mapping.names")])
    assert [r.verdict for r in found.results[-2:]] == [Verdict.FAILED, Verdict.OK]
    assert not found.stopped
