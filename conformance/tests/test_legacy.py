"""The profile legacy-2014: a device that does what the firmware of 2014 did is judged as one.

The device is made from what is known about that firmware, on top of the reference device.
"""

import pytest
from j2a_conformance import Rules, Verdict, load
from j2a_conformance import run as run_suite
from j2a_conformance.reports._console import report
from j2a_spec import constants as c
from j2a_transports import pair

LEGACY = Rules.of("legacy-2014")


class WedgedError(Exception):
    """The firmware called something that is no such function, and does nothing any more."""


class Firmware2014:
    """Deviates where that firmware did."""

    properties = (("serial", "0x012F0B04"), ("MACRO", "13"))
    wedged = False

    def byte(self, byte):
        if self.wedged:
            return
        if self.start is None:
            if byte == c.SOF:
                self.start, self.body, self.escaped = byte, b"", False
        elif self.escaped:  # whatever comes, also a start byte
            self.value((byte + 1) & 0xFF)
        elif byte == c.ESC:
            self.escaped = True
        elif byte in c.MARKERS:  # which begins nothing
            self.give_up(c.ERR_TIMEOUT, 0x0E)
        else:
            self.value(byte)

    def value(self, value):
        super().value(value)
        if self.start is not None and len(self.body) == 2 and self.name_of(self.body[1]) is None:
            self.give_up(c.ERR_OPCODE, 0)

    def pause(self):
        if self.start is not None:
            self.give_up(c.ERR_TIMEOUT, 0x0C)

    def give_up(self, code, seq):
        self.start = None
        self.error(self.body[0] if self.body else seq, code)

    def error(self, seq, code):
        self.reply(seq, code, (321).to_bytes(2, "big"))

    def request(self, seq, opcode, payload):
        try:
            super().request(seq, opcode, payload)
        except WedgedError:
            self.wedged = True

    def refuse(self, seq, opcode, payload):
        raise WedgedError

    def limited(self, code):
        return code

    def short_header(self, payload):
        return c.RET_FAILED, payload

    def many_name(self, func):
        name = super().many_name(func)
        if name is None:
            raise WedgedError
        return name

    def offset(self, four):
        return four[0]

    def do_sif(self, payload):
        return c.RET_FAILED, b""

    def periodic(self):
        if not self.wedged:
            super().periodic()


@pytest.fixture
def old(reference):
    return type("Old", (Firmware2014, reference), {})


def of(run, verdict):
    return {result.case: result.reason for result in run.with_verdict(verdict)}


def test_the_firmware_of_2014_conforms_by_its_profile(old, judged):
    run = judged(old, rules=LEGACY, timeout_scale=0.25)
    assert of(run, Verdict.FAILED) == {}
    assert run.conformant
    assert not run.stopped
    # Each deviation that this device can show was shown, and the report says why it is allowed.
    whys = {entry.case: entry.why for entry in LEGACY.allowed if entry.case not in LONG}
    assert of(run, Verdict.NON_STRICT) == whys
    assert all(run.levels().values())
    text = report(run)
    assert "The device is conformant by the profile legacy-2014" in text
    assert "non-strict: properties.version: it is older than the property j2a.spec" in text


LONG = {"properties.content", "properties.pairs", "properties.written", "many.store"}


def test_long_properties_have_no_end(old, judged):
    class Long(old):
        properties = tuple((f"key{n}", "x" * 20) for n in range(20))

        def read_properties(self, write, offset):
            part = self.property_bytes()[offset : offset + c.MANY_DATA]
            return (c.RET_FAILED, True, b"") if write else (0, len(part) < c.MANY_DATA, part)

    run = judged(Long, LONG | {"properties.behind-end"}, rules=LEGACY, timeout_scale=0.1)
    assert of(run, Verdict.NON_STRICT).keys() == LONG - {"many.store"} | {"properties.behind-end"}
    assert run.conformant


def test_a_large_store_is_read_wrongly(old, judged):
    class Keeps(old):
        def store(self, write, offset, data):
            if not write:
                return super().store(write, offset, data)
            self.stored = data if offset == 0 else self.stored + data
            return 0, True, b""

    run = judged(Keeps, ["many.store"], rules=LEGACY, timeout_scale=0.1)
    assert of(run, Verdict.NON_STRICT).keys() == {"many.store"}


def test_it_fails_by_this_version(old, judged):
    cases = ["frame.interrupted", "many.wrong-function", "properties.version", "mapping.names"]
    run = judged(old, cases, timeout_scale=0.1)
    assert of(run, Verdict.FAILED).keys() == set(cases[:3])
    assert not run.conformant
    assert "The device does not claim version 1.1: it has no property j2a.spec." in report(run)
    assert "--profile legacy-2014" in report(run)


class MarkerIsFatal:
    """Answers a start byte in a frame otherwise than the firmware of 2014 did."""

    def give_up(self, code, seq):
        super().give_up(0xF1 if code == c.ERR_TIMEOUT else code, seq)


class SilentOnChecksum:
    def abandon(self, code):
        self.start = None


class ReservedIsZero:
    def limited(self, code):
        return code if code <= c.RET_MAX else 0


class AnotherVersion:
    properties = (("j2a.spec", "1.2"),)


class OffsetIsNotSentBack:
    def many_reply(self, flags, offset, code, last, data):
        return super().many_reply(flags, b"\0\0\0\0", code, last, data)


@pytest.mark.parametrize(
    ("mixin", "case"),
    [
        (MarkerIsFatal, "frame.interrupted"),
        (SilentOnChecksum, "sum.flipped-bits"),
        (ReservedIsZero, "dispatch.reserved-values"),
        (AnotherVersion, "properties.version"),
        (OffsetIsNotSentBack, "many.offsets"),
    ],
)
def test_another_fault_still_fails(mixin, case, old, judged):
    run = judged(type("Worse", (mixin, old), {}), [case], rules=LEGACY, timeout_scale=0.1)
    assert of(run, Verdict.FAILED).keys() == {case}
    assert not run.conformant


def test_a_device_that_stays_wedged_ends_the_run(old):
    """Where opening the link does not reset the device, nothing is said about what is left."""
    links = []

    def opener():
        here, there = pair()
        if not links:
            old(there)
        links.append((here, there))
        return here

    cases = [case for case in load() if case.ID in ("many.wrong-function", "mapping.names")]
    run = run_suite(opener, reversed(cases), rules=LEGACY, timeout_scale=0.05)
    assert [result.verdict for result in run.results[-1:]] == [Verdict.NON_STRICT]
    assert run.stopped == "the device did not answer any more after many.wrong-function"
