"""What a run comes to in words: each judgement, and each standing of a level."""

from dataclasses import replace

import pytest
from j2a_conformance import Claims, Result, Run, Verdict
from j2a_conformance.reports._summary import Standing, judgement, levels, name, tone


def run_of(*verdicts, level="frame", **options):
    results = tuple(
        Result(f"case.{index}", "", "", (), level, verdict)
        for index, verdict in enumerate(verdicts)
    )
    options = {"url": "link", "claims": None} | options
    return Run(started="2026-01-02T03:04:05+00:00", duration_s=1.0, results=results, **options)


OK, FAILED, KNOWN = Verdict.OK, Verdict.FAILED, Verdict.KNOWN_DEVIATION
UNIMPLEMENTED, INFORMATIONAL = Verdict.UNIMPLEMENTED, Verdict.INFORMATIONAL


@pytest.mark.parametrize(
    ("run", "words", "colour"),
    [
        (run_of(OK), "conformant", "ok"),
        (run_of(OK, FAILED), "not conformant: 1 of 2 cases failed", "failed"),
        (run_of(FAILED, stopped="gone"), "not conformant: 1 of 1 case failed", "failed"),
        (run_of(), "nothing was tested", "not-run"),
        (run_of(UNIMPLEMENTED), "nothing was tested", "not-run"),
        (run_of(OK, UNIMPLEMENTED, asked=("case.1",)), "nothing was tested", "not-run"),
        (run_of(OK, stopped="interrupted"), "not judged: the run ended early", "not-run"),
        (run_of(stopped="interrupted"), "nothing was tested: the run ended early", "not-run"),
        (run_of(OK, KNOWN), "conformant but for known deviations", "known-deviation"),
        (run_of(OK, not_run={"b": "core"}), "conformant in what was run", "ok"),
        (run_of(OK, profile="old"), "conformant by the profile old", "ok"),
    ],
)
def test_the_judgement(run, words, colour):
    assert (judgement(run), tone(run)) == (words, colour)


@pytest.mark.parametrize(
    ("run", "standing"),
    [
        (run_of(OK, UNIMPLEMENTED), Standing.REACHED),
        (run_of(Verdict.NON_STRICT), Standing.REACHED),
        (run_of(OK, FAILED), Standing.FAILED),
        (run_of(OK, KNOWN), Standing.FAILED),
        (run_of(OK, not_run={"b": "frame"}), Standing.INCOMPLETE),
        (run_of(INFORMATIONAL), Standing.INCOMPLETE),
        (run_of(UNIMPLEMENTED), Standing.NOT_CLAIMED),
        (run_of(not_run={"b": "frame"}), Standing.NOT_RUN),
    ],
)
def test_the_standing_of_a_level(run, standing):
    assert levels(run)[0].standing is standing


def test_a_level_without_a_case_is_not_listed():
    assert [entry.level for entry in levels(run_of(OK, not_run={"b": "sif"}))] == ["frame", "sif"]


def test_a_level_is_not_reached_above_one_that_failed():
    good = run_of(OK, level="core")
    found = replace(good, results=run_of(FAILED).results + good.results)
    standings = {entry.level: entry.standing for entry in levels(found)}
    assert standings["frame"] is Standing.FAILED
    assert standings["core"] is Standing.NOT_REACHED


@pytest.mark.parametrize(
    ("options", "called"),
    [
        ({"title": "A title"}, "A title"),
        ({"claims": Claims(True, (), {"name": "its name"})}, "its name"),
        ({"claims": Claims(True, ())}, "link"),
        ({"url": "", "role": "host"}, "a host"),
    ],
)
def test_what_it_is_called(options, called):
    assert name(run_of(OK, **options)) == called
