"""Slow links and links that lose or damage bytes: no false failure, and no fault overlooked."""

import heapq
from itertools import count

import j2a_transports
import pytest
from j2a_conformance import HarnessError, Verdict, load, run
from j2a_conformance.cli import _target
from j2a_conformance.cli._exit import UsageError
from j2a_conformance.reports._console import report
from j2a_spec import constants as c
from j2a_transports import LinkClosed, OpenFailed, Transport, faults, pair

from tools.conformance import SWEEPS

LOSSY = 100
RATES = {"drop": 0.001, "flip": 0.001}


def of(found, verdict):
    return {result.case: result.reason for result in found.with_verdict(verdict)}


# Links that lose and damage bytes


# What takes longest on such a link; `j2a-conform run --lossy` plays it too.
LONG = (
    *("frame.lengths", "frame.largest", "frame.interrupted-anywhere", "stuff.escape-ff-anywhere"),
    *("many.echo-lengths", "many.store", "scenario-006"),
)


@pytest.mark.parametrize(
    ("seed", "levels"),
    [
        pytest.param(11, {"frame"}, marks=pytest.mark.exhaustive),
        (12, {"core", "mapping", "properties"}),
        pytest.param(13, {"many", "debug", "sif", "timing"}, marks=pytest.mark.exhaustive),
    ],
)
def test_a_lossy_link_makes_no_false_failure(seed, levels, build_firmware):
    url = f"faults:seed={seed},drop=0.001,flip=0.001:exec:{build_firmware('demo')}"
    cases = [case for case in load() if case.LEVEL in levels and case.ID not in LONG]
    found = run(lambda: j2a_transports.open(url), cases, lossy=LOSSY)
    assert of(found, Verdict.FAILED) == {}
    assert found.conformant
    assert not found.stopped
    repeated = sum(result.repeated for result in found.results)
    assert repeated > 20
    assert f"The link was declared lossy: each exchange had up to 100 attempts, and {repeated}" in (
        report(found)
    )


def test_a_good_link_repeats_nothing(reference, judged):
    found = judged(reference, ["frame.layout", "sif.counter", "debug.text"], lossy=LOSSY)
    assert of(found, Verdict.OK).keys() >= {"frame.layout", "sif.counter", "debug.text"}
    assert {(result.attempts, result.repeated) for result in found.results} == {(1, 0)}


class ShortEcho:
    def do_a2jEcho(self, payload):  # noqa: N802
        return c.ECHO, payload[:200]


class RefusesTwice:
    def error(self, seq, code):
        super().error(seq, code)
        super().error(seq, code)


class SkipsSifs:
    def sif(self, opcode, payload):
        self.sif_seq = (self.sif_seq + 1) % 256
        super().sif(opcode, payload)


class AnswersNoise:
    def outside(self, byte):
        self.error(byte, c.ERR_FRAMING)


class StoresNothing:
    def store(self, write, offset, data):
        return (0, True, b"") if write else super().store(write, offset, data)


class SilentOnChecksum:
    def error(self, seq, code):
        if code != c.ERR_CHECKSUM:
            super().error(seq, code)


@pytest.mark.parametrize(
    ("mixin", "case"),
    [
        (ShortEcho, "frame.layout"),
        (RefusesTwice, "error.only-once"),
        (SkipsSifs, "sif.counter"),
        (AnswersNoise, "frame.noise-behind"),
        (StoresNothing, "many.store"),
        (SilentOnChecksum, "sum.flipped-bits"),
    ],
)
def test_a_broken_device_fails_on_a_lossy_link(mixin, case, reference):
    device = type(mixin.__name__, (mixin, reference), {})

    def opener():
        here, there = pair()
        device(there)
        return faults.wrap(here, seed=5, **RATES)

    cases = [entry for entry in load() if case == entry.ID]
    found = run(opener, cases, lossy=20, timeout_scale=0.5)
    assert of(found, Verdict.FAILED).keys() == {case}


# Slow links


class SlowLink(Transport):
    """A device behind a line of `rate` bytes a second, in a time of its own."""

    is_simulated = True

    def __init__(self, make, rate):
        super().__init__("slow:", None)
        self.now_s = 0.0
        self.byte_s = 1 / rate
        self.sent_s = self.answered_s = 0.0  # when the line is free again, in each direction
        self.device = make(self)
        self.coming = []  # (time, order, byte) to the device
        self.order = count()
        self.answers = []
        self.heard_s = 0.0
        self._closed = False

    def clock(self):
        return self.now_s

    def write(self, data):
        if self._closed:
            raise LinkClosed("closed")
        for byte in bytes(data):
            self.sent_s = max(self.sent_s, self.now_s) + self.byte_s
            heapq.heappush(self.coming, (self.sent_s, next(self.order), byte))

    def answer(self, data):
        """What the device writes."""
        for byte in data:
            self.answered_s = max(self.answered_s, self.now_s) + self.byte_s
            self.answers.append((self.answered_s, byte))

    def sleep(self, seconds):
        self.pass_until(self.now_s + seconds)

    def pass_until(self, end_s):
        """Let the device see what arrives by then."""
        while self.step(end_s):
            pass
        self.now_s = max(self.now_s, end_s)

    def step(self, end_s):
        """Do the next thing that happens by `end_s`; tell whether there was one."""
        pause_s = self.heard_s + self.device.timeout_s
        gives_up = self.device.start is not None and pause_s <= end_s
        if self.coming and self.coming[0][0] <= (pause_s if gives_up else end_s):
            self.now_s, _, byte = heapq.heappop(self.coming)
            self.heard_s = self.now_s
            self.device.byte(byte)
            return True
        if gives_up:
            self.now_s = max(self.now_s, pause_s)
            self.device.pause()
        return gives_up

    def read(self, timeout_s):
        end_s = self.now_s + timeout_s
        while not self.answers and self.step(end_s):
            pass
        due_s = self.answers[0][0] if self.answers else end_s
        self.pass_until(min(due_s, end_s))
        found = bytes(byte for at_s, byte in self.answers if at_s <= self.now_s)
        del self.answers[: len(found)]
        return found

    @property
    def closed(self):
        return self._closed

    def close(self):
        self._closed = True


@pytest.fixture
def slow(reference):
    class Slow(reference):
        names = c.BUILTINS

        def serve(self):
            """Whatever comes is handed over in the time of the link."""

        def send(self, start, seq, opcode, payload):
            self.link.answer(self.wire(start, seq, opcode, payload))

    return Slow


# Hundreds of exchanges that take no longer than those of other cases.
SAME_AGAIN = (
    *("frame.lengths", "frame.garbage", "frame.interrupted-anywhere", "frame.sos-to-device"),
    *("frame.noise", "seq.every-value", "error.seq", "error.opcode-out-of-range"),
    *("stuff.needless", "stuff.replies", "stuff.escape-ff-anywhere"),
    *("sum.every-length", "sum.every-wrong-value"),
)


@pytest.mark.parametrize("baud", [1200, pytest.param(9600, marks=pytest.mark.exhaustive)])
def test_a_slow_link_makes_no_false_failure(baud, slow):
    cases = [case for case in load() if case.LEVEL != "many" and case.ID not in SAME_AGAIN]
    found = run(lambda: SlowLink(slow, baud / 10), cases, baud=baud)
    assert of(found, Verdict.FAILED) == {}
    assert found.conformant
    assert not found.stopped
    assert of(found, Verdict.OK).keys() >= {"frame.largest", "timing.gives-up", "limits.window"}


def test_without_its_rate_a_very_slow_link_names_the_option(slow):
    class Long(slow):
        names = (*c.BUILTINS, *(f"a_function_with_a_very_long_name_{n}" for n in range(5)))

    with pytest.raises(HarnessError, match=r"later than .* --baud"):
        run(lambda: SlowLink(Long, 120), [], timeout_scale=0.4)
    found = run(lambda: SlowLink(Long, 120), [load()[0]], baud=1200)
    assert of(found, Verdict.FAILED) == {}


def test_a_link_that_does_not_open_is_named_once():
    url = "tcp://127.0.0.1:1"

    def opener():
        raise OpenFailed(f"{url}: nothing listens there")

    with pytest.raises(HarnessError) as error:
        run(opener, [], url=url)
    assert str(error.value) == f"cannot open the link: {url}: nothing listens there"


def test_a_broken_device_fails_on_a_slow_link(slow):
    class Patient(slow):
        timeout_s = 0.2

    cases = [case for case in load() if case.ID == "timing.gives-up"]
    found = run(lambda: SlowLink(Patient, 240), cases, baud=2400)
    assert of(found, Verdict.FAILED).keys() == {"timing.gives-up"}


@pytest.mark.avr
@pytest.mark.parametrize(
    ("baud", "left_out"), [pytest.param(2400, (), marks=pytest.mark.exhaustive), (9600, SWEEPS)]
)
def test_a_slow_avr_makes_no_false_failure(baud, left_out, build_firmware, missing):
    url = f"sim:{build_firmware('demo', 'avr-serial', BAUD=baud)}"
    chosen = ("frame.layout", "mapping.content", "properties.content", "sif.during-delay")
    named = [case for case in load() if case.ID.startswith(("timing", "limits", *chosen))]
    cases = [case for case in named if case.ID not in left_out]

    def opener():
        try:
            return j2a_transports.open(url)
        except j2a_transports.OpenFailed as error:
            missing(str(error))

    found = run(opener, cases, fresh=True)
    assert of(found, Verdict.FAILED) == {}
    assert found.conformant
    assert not found.stopped


@pytest.mark.parametrize(
    ("url", "keywords"),
    [
        ("serial:///dev/ttyX", {"baud": 2400}),
        ("serial:COM3?parity=E", {"baud": 2400}),
        ("serial:///dev/ttyX?boot=2&baud=2400", {}),
        ("faults:seed=1:serial:///dev/ttyX", {"baud": 2400}),
        ("tcp://127.0.0.1:5000", {}),
        ("sim:demo.elf", {}),
    ],
)
def test_the_rate_sets_a_serial_port(url, keywords, monkeypatch):
    opened = []
    monkeypatch.setattr(j2a_transports, "open", lambda url, **given: opened.append((url, given)))
    with _target.reach(url, 2400) as target:
        target.opener()
    assert opened == [(url, keywords)]


def test_two_rates_are_refused():
    with (
        pytest.raises(UsageError, match="not the same"),
        _target.reach("serial:///dev/ttyX?baud=9600", 2400),
    ):
        pass
