"""Hosts that do what no honest one does: that is a failure, and no fault of the suite, or hang."""

import time

import pytest
from j2a_conformance import Verdict
from j2a_conformance.host import _host
from j2a_conformance.host._device import pattern
from j2a_conformance.host._outcomes import spell
from j2a_spec import constants as c


def failed(run, case, reason):
    result = run.results[-1]
    assert (result.case, result.verdict) == (case, Verdict.FAILED), result.reason
    assert reason in result.reason


@pytest.mark.parametrize("number", ["", " x", " -1", " " + "9" * 200, " \u0663"])
def test_a_number_that_is_none_is_a_failure(number, host_reference, host_judged):
    class Reports(host_reference):
        def job(self, text):
            return f"restarts{number}" if text == "restarts" else super().job(text)

    run = host_judged(Reports, ["host.boot.ends"])
    failed(run, "host.boot.ends", "`restarts` and a number")


@pytest.mark.parametrize(
    ("case", "opcode", "payload"),
    [
        ("host.seq.silence", 0, b""),  # what the device has, which it says at any time
        ("host.time.among-many", 6, b"\x01"),
    ],
)
def test_a_host_that_calls_without_end_fails(
    case, opcode, payload, host_reference, host_judged, monkeypatch
):
    class Calls(host_reference):
        def job(self, text):
            while text.startswith(("repeat", "together")) and not self.stopped:
                self.call(opcode, payload, 0.01)
                time.sleep(0.01)
            return super().job(text)

    monkeypatch.setattr(_host, "_JOB_S", 1.0)
    failed(host_judged(Calls, [case]), case, "does not report")


@pytest.mark.parametrize("item", [b"", bytes((c.CLOCK_ADJUST,)), bytes((c.CLOCK_EXCHANGE,))])
def test_a_request_to_the_clock_that_is_none_is_a_failure(item, host_reference, host_judged):
    class Asks(host_reference):
        def job(self, text):
            if text.startswith("clock-"):
                self.call(len(c.BUILTINS), item, 0.5)
                return "exchanged 1"
            return super().job(text)

    failed(host_judged(Asks, ["host.clock.asked"]), "host.clock.asked", "")


@pytest.mark.parametrize("payload", [b"", b"\x07"])
def test_a_chunk_of_no_function_is_a_failure(payload, host_reference, host_judged):
    class Asks(host_reference):
        def job(self, text):
            if text.startswith("read") and not self.stopped:
                self.call(1, payload, 0.5)
                return "restarted"
            return "restarts 0" if text == "restarts" else super().job(text)

    case = "host.boot.transfers"
    failed(host_judged(Asks, [case]), case, f"the chunk {payload.hex() or '-'} is not for fetch")


def test_data_that_nothing_was_read_of_is_a_failure(host_reference, host_judged):
    class Knows(host_reference):
        def job(self, text):
            return f"data {spell(pattern(700))}" if text.startswith("read") else super().job(text)

    failed(
        host_judged(Knows, ["host.offsets.honest"]), "host.offsets.honest", "before a read at 256"
    )


@pytest.mark.parametrize(
    "case",
    [
        "host.error.hint",
        "host.error.reserved-among",
        "host.limits.out-of-order",
        "host.time.queued",
    ],
)
def test_a_report_of_fewer_calls_is_a_failure(case, host_reference, host_judged):
    class Forgets(host_reference):
        def job(self, text):
            outcome = super().job(text)
            return outcome.partition(" ; ")[0] if text.startswith("together") else outcome

    failed(host_judged(Forgets, [case]), case, "outcomes")


def test_a_host_that_does_not_start_again_costs_no_verdict(host_reference, host_judged):
    class Once(host_reference):
        starts = 0

        def run(self):
            Once.starts += 1
            if Once.starts == 1:
                super().run()

        def outcome(self, call):
            return "timeout"  # which the case suspects to be a stall, so that it tries again

    run = host_judged(Once, ["host.time.slow"])
    failed(run, "host.time.slow", "the host reports `timeout`")
