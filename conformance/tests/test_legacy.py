"""The profile legacy-2014: each build of the firmware of 2014 is judged as what it is.

The firmware is the imitation in `firmware_2014.py`; as a command:
`j2a-conform run --profile legacy-2014 "exec:python conformance/tests/firmware_2014.py usb"`.
"""

import importlib.util
import sys
import threading
from dataclasses import replace
from pathlib import Path

import pytest
from j2a_conformance import Rules, Verdict, load, run
from j2a_conformance.reports._console import report
from j2a_spec import constants as c
from j2a_spec.capabilities import ANNOUNCED
from j2a_transports import pair

_PATH = Path(__file__).parent / "firmware_2014.py"
_SPEC = importlib.util.spec_from_file_location("firmware_2014", _PATH)
firmware_2014 = sys.modules["firmware_2014"] = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(firmware_2014)
BUILDS, Firmware2014 = firmware_2014.BUILDS, firmware_2014.Firmware2014
LEGACY = Rules.of_profile("legacy-2014")
SLOW = (
    *("timing.", "scenario-", "frame.pieces", "frame.lengths", "frame.interrupted-anywhere"),
    *("frame.sos-to-device", "stuff.escape-ff-anywhere", "seq.", "limits.window"),
)
"""Cases that take long and that no option of a build changes."""


def judge(build, chosen=lambda case: True, device=Firmware2014, resets=True, scale=0.6):
    """Judge a build in this process by the profile; opening the link resets it unless told."""
    links = []

    def opener():
        here, there = pair()
        if resets or not links:
            served = device(there, BUILDS[build])
            threading.Thread(target=served.serve, daemon=True).start()
        links.append((here, there))
        return here

    cases = [case for case in load() if chosen(case)]
    return run(opener, cases, rules=LEGACY, timeout_scale=scale)


def of(found, verdict):
    return {result.case: result.reason for result in found.with_verdict(verdict)}


def test_the_firmware_of_2014_conforms_by_its_profile():
    found = judge("all")
    assert of(found, Verdict.FAILED) == {}
    assert found.conformant
    assert not found.stopped
    # Each deviation that this build can show was shown, and the report says why it is allowed.
    whys = {entry.case: entry.why for entry in LEGACY.allowed if entry.case not in NOT_SHOWN}
    assert of(found, Verdict.NON_STRICT) == whys
    assert all(reached for level, reached in found.levels().items() if level not in ANNOUNCED)
    text = report(found)
    assert "The device is conformant by the profile legacy-2014" in text
    assert "non-strict: properties.version: it is older than the property j2a.spec" in text


NOT_SHOWN = {
    "properties.content",  # it takes long properties to see one byte of the offset
    "properties.pairs",
    "properties.written",
    "properties.direct",
    "many.byte-order",
    "debug.nothing-pending",
    "debug.text",
}


@pytest.mark.sampled(4)
@pytest.mark.parametrize("build", [name for name in BUILDS if name != "all"])
def test_every_build_conforms(build):
    found = judge(build, lambda case: not case.ID.startswith(SLOW))
    assert of(found, Verdict.FAILED) == {}
    assert found.conformant
    assert not found.stopped


@pytest.mark.parametrize(
    ("build", "opcode"),
    [("no-map", 4), ("no-map-no-debug", 3), ("no-map-only-many", 2), ("nothing", 1)],
)
def test_echo_is_found_without_a_map(build, opcode):
    found = judge(build, lambda case: case.ID == "frame.layout")
    assert found.claims.functions.index(c.GET_ECHO) == opcode
    assert found.conformant


def test_long_properties_have_no_end():
    class Long(Firmware2014):
        pairs = tuple((f"key{n}", "x" * 20) for n in range(20))

    found = judge("all", lambda case: case.LEVEL == "properties", Long)
    shown = {"properties.content", "properties.pairs", "properties.written"}
    assert of(found, Verdict.NON_STRICT).keys() >= shown
    assert found.conformant


class Robot(Firmware2014):
    """Has the transducers of chapter 8 of the thesis: a2jGetTransds is of the application."""

    def __init__(self, link, build):
        super().__init__(link, build)
        self.names.append(c.GET_TRANSDS)


@pytest.mark.parametrize("build", ["time", "no-many", "no-properties"])
def test_the_transducers_of_the_thesis_are_no_capability(build):
    cases = ("dispatch.table-order", "transducers.announced", "mapping.content")
    found = judge(build, lambda case: case.ID in cases, Robot)
    assert of(found, Verdict.FAILED) == {}
    assert found.conformant
    assert not found.levels().get("transducers")
    assert found.claims.functions[-1] == ""


class EndAsAsked(Firmware2014):
    """Where a read at the end fails, flags and data stay those of the request."""

    def chunk(self, name, flags, offset, data):
        code, last, found = super().chunk(name, flags, offset, data)
        if name == c.GET_PROPERTIES and code == c.RET_FAILED:
            return code, flags & c.FLAG_LAST, data
        return code, last, found


def test_a_read_at_the_end_may_leave_the_request_as_it_is():
    found = judge("usb", lambda case: case.LEVEL == "properties", EndAsAsked)
    assert of(found, Verdict.FAILED) == {}
    assert "properties.behind-end" in of(found, Verdict.NON_STRICT)


class PlainStore(Firmware2014):
    """Has no a2jMany, so its `store` is a function like any other."""

    def __init__(self, link, build):
        super().__init__(link, build)
        self.names.append("store")

    def execute(self, name, payload):
        return (0, payload) if name == "store" else super().execute(name, payload)


def test_without_a2jmany_there_is_no_function_for_it():
    found = judge("no-many", lambda case: case.LEVEL == "many", PlainStore)
    assert set(of(found, Verdict.UNIMPLEMENTED)) == {case.case for case in found.results[3:]}
    assert not found.levels().get("many")


class Worse(Firmware2014):
    """Breaks what that firmware kept."""


class MarkerIsFatal(Worse):
    def give_up(self, code, seq):
        super().give_up(0xF1 if code == c.ERR_TIMEOUT else code, seq)


class TakesWrongChecksums(Worse):
    def sum_is_wrong(self, seq, opcode, payload):
        return len(payload) < 12 and super().sum_is_wrong(seq, opcode, payload)


class ReservedIsZero(Worse):
    def do_ret(self, payload):
        code, text = super().do_ret(payload)
        return code if code <= c.RET_MAX else 0, text


class AnotherVersion(Worse):
    pairs = (("j2a.spec", "1.2"),)


class HasNoToken(Robot, Worse):
    pairs = (("j2a.spec", "1.1"),)


class OffsetIsNotSentBack(Worse):
    def do_a2jMany(self, payload):  # noqa: N802
        code, answer = super().do_a2jMany(payload)
        return code, answer[:2] + b"\0\0\0\0" + answer[6:] if len(answer) >= 6 else answer


class DoesNotStuffLongReplies(Worse):
    def wire(self, frame):
        wire = super().wire(frame)
        return wire.replace(b"\x7d\x7c", b"\x7d") if len(frame.payload) > 64 else wire


class AnswersWithItsOwnSeq(Worse):
    def wire(self, frame):
        if frame.start == c.SOF and frame.seq == 0xED:
            frame = replace(frame, seq=0xEE)
        return super().wire(frame)


class EchoLosesAByte(Worse):
    def do_a2jEcho(self, payload):  # noqa: N802
        return c.ECHO, payload if len(payload) < 200 else payload[:-1]


@pytest.mark.parametrize(
    ("device", "case"),
    [
        (MarkerIsFatal, "frame.interrupted"),
        (TakesWrongChecksums, "sum.every-length"),
        (ReservedIsZero, "dispatch.reserved-values"),
        (AnotherVersion, "properties.version"),
        (HasNoToken, "transducers.announced"),
        (OffsetIsNotSentBack, "many.offsets"),
        (DoesNotStuffLongReplies, "frame.lengths"),
        (AnswersWithItsOwnSeq, "seq.every-value"),
        (EchoLosesAByte, "frame.lengths"),
    ],
)
def test_another_fault_still_fails(device, case):
    found = judge("all", lambda known: case == known.ID, device)
    assert of(found, Verdict.FAILED).keys() == {case}
    assert not found.conformant


def test_it_fails_by_this_version():
    here, there = pair()
    threading.Thread(target=Firmware2014(there, BUILDS["all"]).serve, daemon=True).start()
    cases = [case for case in load() if case.ID in ("properties.version", "mapping.names")]
    found = run(lambda: here, cases, timeout_scale=0.1)
    assert of(found, Verdict.FAILED).keys() == {"properties.version"}
    assert "The device does not claim version 1.1: it has no property j2a.spec." in report(found)
    assert "--profile legacy-2014" in report(found)


def test_a_device_that_stays_wedged_ends_the_run():
    """Where opening the link does not reset the device, nothing is said about what is left."""
    found = judge("all", lambda case: case.ID == "many.wrong-function", resets=False)
    assert [result.verdict for result in found.results[-1:]] == [Verdict.NON_STRICT]
    assert found.stopped == "the device did not answer any more after many.wrong-function"
