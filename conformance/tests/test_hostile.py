"""Testees that say what no honest one says, and outputs that cannot be written: no run is lost."""

import gc
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from j2a_conformance import HarnessError, Outcome, Run, Verdict
from j2a_conformance.cli._repeat import repeat
from j2a_conformance.device import _selftest
from j2a_conformance.device.cases import frame
from j2a_conformance.faults._rules import Rules
from j2a_conformance.faults._soak import _until_barrier
from j2a_conformance.reports._json import parse, render
from j2a_conformance.wire._expected import number
from j2a_spec import constants as c
from j2a_spec import selftest

ROOT = Path(__file__).parents[2]
FULL = Path("/dev/full")
MANY_DIGITS = "9" * 5000  # `int` refuses more than 4300


def known(reference, *properties):
    """Return a device with other properties than the reference device."""
    return type("Known", (reference,), {"properties": properties})


@pytest.mark.parametrize(
    ("value", "due"),
    [("1", 1), ("9999999999", 9999999999), ("064", 0), ("\u0663", 0), (MANY_DIGITS, 0), ("", 0)],
)
def test_only_what_a_host_takes_is_a_number(value, due):
    assert number(value) == due


@pytest.mark.parametrize("key", [c.PROP_ROOM, c.PROP_RXBUF])
def test_a_number_without_end_is_none(key, reference, judged):
    device = known(reference, (c.PROP_SPEC, c.SPEC_VERSION), (key, MANY_DIGITS))
    found = judged(device, ["frame.layout", "limits.window"])
    assert not found.with_verdict(Verdict.FAILED)
    assert found.claims is not None
    assert Rules(found.claims).room == 0


@pytest.mark.parametrize("digits", [MANY_DIGITS, None])
def test_a_result_of_a_self_test_has_plain_digits(digits):
    vectors = selftest.load()
    right = str(len(vectors))
    strange = digits or "".join(chr(0x660 + int(digit)) for digit in right)
    text = f"ok {{0}}/{{0}} {selftest.digest(vectors):08x}"
    assert _selftest.read(text.format(right)).is_ours
    assert _selftest.read(text.format(strange)) is None


@pytest.mark.parametrize("digits", [MANY_DIGITS, "9" * 400])
def test_a_report_with_a_number_without_end_is_none(digits, reference, judged):
    text = render(judged(reference, ["frame.layout"])).decode()
    broken = text.replace('"rtt_s": ', f'"rtt_s": {digits}, "x": ', 1)
    assert broken != text
    with pytest.raises(HarnessError, match="digits"):
        parse(broken)


def test_what_ends_a_run_does_not_cost_what_was_judged(reference, judged, monkeypatch):
    def breaks(*_):
        raise HarnessError("the program cannot be started again")

    monkeypatch.setattr(frame.Lengths, "_run", breaks)
    found = judged(reference, ["frame.layout", "frame.lengths", "mapping.names"])
    assert [result.case for result in found.results][-1] == "frame.layout"
    assert "frame.lengths" in found.stopped
    assert "cannot be started again" in found.stopped
    assert {"frame.lengths", "mapping.names"} <= set(found.not_run)
    assert not found.conformant


def test_a_series_keeps_the_last_run_only(reference, judged, capsys):
    held = []

    def once():
        gc.collect()
        held.append(sum(isinstance(thing, Run) for thing in gc.get_objects()))
        return judged(reference, ["frame.layout"])

    last, code = repeat(4, once)
    assert (code, last.outcome) == (0, Outcome.CONFORMANT)
    assert held[-1] <= held[0] + 1
    assert "The verdicts of 4 runs are the same" in capsys.readouterr().out


def test_a_soak_keeps_no_flood(reference):
    came = []

    def read(_timeout_s):
        came.append(1 << 20)
        assert sum(came) < 1 << 25, "a device can fill the memory"
        return bytes(came[-1])

    link = SimpleNamespace(now_s=lambda: 0.0, transport=SimpleNamespace(read=read))
    barrier = SimpleNamespace(expected=SimpleNamespace(wire=b"due"))
    peer, player = SimpleNamespace(link=link), SimpleNamespace(scale=1.0)
    assert not _until_barrier(player, peer, barrier).endswith(b"due")


def test_an_escape_that_only_chunks_have_is_found(reference, judged):
    """The echoes are compared byte by byte anyway; what a2jMany reads is only known to the device.

    (J2A-STUFF-002)
    """

    class Needless(reference):
        def wire(self, start, seq, opcode, payload):
            wire = super().wire(start, seq, opcode, payload)
            is_chunk = not opcode and len(payload) > c.MANY_HEADER and not payload[0]
            return wire[:3] + bytes((c.ESC, wire[3] - 1)) + wire[4:] if is_chunk else wire

    found = judged(Needless, ["properties.content", "frame.layout"])
    by_case = {result.case: result.verdict for result in found.results}
    assert by_case["frame.layout"] is Verdict.OK
    assert by_case["properties.content"] is Verdict.FAILED


# The program


@pytest.fixture
def program(tmp_path):
    """Return the command that judges a device with a property in Greek, and its JSON report."""
    testee, report = tmp_path / "testee.py", tmp_path / "report.json"
    testee.write_text(GREEK)
    url = f"exec:{sys.executable} {testee}"
    words = ("run", url, "--case", "frame.layout", "-v", "--json", str(report))
    return [sys.executable, "-m", "j2a_conformance", *words], report


GREEK = f"""
import sys, threading
sys.path.insert(0, {str(ROOT)!r})
import j2a_transports
from conformance.tests.conftest import ReferenceDevice

class Greek(ReferenceDevice):
    properties = (*ReferenceDevice.properties, ("place", chr(0x39C) + chr(0x3CD)))

Greek(j2a_transports.open("stdio:"))
threading.Event().wait()
"""


def test_text_that_the_output_has_no_letters_for(program):
    command, report = program
    env = {**os.environ, "PYTHONIOENCODING": "latin-1"}
    done = subprocess.run(command, env=env, capture_output=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    assert rb"property place = \u039c\u03cd" in done.stdout
    assert parse(report.read_text()).conformant


@pytest.mark.skipif(not FULL.exists(), reason="there is no /dev/full")
def test_reports_are_written_where_the_output_is_full(program):
    command, report = program
    with FULL.open("w") as full:
        done = subprocess.run(
            command, stdout=full, stderr=subprocess.PIPE, timeout=120, check=False
        )
    assert done.returncode == 3
    assert b"cannot write the output" in done.stderr
    assert parse(report.read_text()).conformant


def test_reports_are_written_where_nobody_reads_the_output(program):
    command, report = program
    reader, writer = os.pipe()
    os.close(reader)
    try:
        done = subprocess.run(command, stdout=writer, timeout=120, check=False)
    finally:
        os.close(writer)
    assert done.returncode == 3
    assert parse(report.read_text()).conformant
