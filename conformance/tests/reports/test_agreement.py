"""All reports of a run, and its exit code, say the same; so for each kind of run."""

import json
from xml.etree import ElementTree

import pytest
from j2a_conformance import Outcome, Result, Run, Verdict
from j2a_conformance.cli._exit import status
from j2a_conformance.reports import _badge, _console, _html, _json, _junit, _matrix

OK, FAILED, KNOWN = Verdict.OK, Verdict.FAILED, Verdict.KNOWN_DEVIATION
UNIMPLEMENTED, INFORMATIONAL = Verdict.UNIMPLEMENTED, Verdict.INFORMATIONAL


def run_of(*verdicts, **options):
    """Return a run of the smoke step, which is ok, and a case with each verdict."""
    results = (
        Result("smoke.answer", "", "", (), "frame", OK),
        *(
            Result(f"case.{index}", "", "", (), "frame", verdict, f"reason {index}")
            for index, verdict in enumerate(verdicts)
        ),
    )
    asked = tuple(result.case for result in results[1:])
    options = {"results": results, "asked": asked} | options
    return Run("link", "2026-01-02T03:04:05+00:00", 1.0, None, **options)


STALE = ("the known deviation of case.9 (why) is gone",)
BROKEN_OFF = {"stopped": "interrupted from the keyboard", "not_run": {"case.9": "frame"}}
KINDS = {
    "all ok": (run_of(OK), 0, "The device is conformant;", "all levels"),
    "a host": (run_of(OK, role="host"), 0, "The host is conformant;", "all levels"),
    "selection": (
        run_of(OK, not_run={"case.9": "core"}),
        0,
        "The device is conformant in what was run;",
        "frame",
    ),
    "older profile": (
        run_of(OK, Verdict.NON_STRICT, profile="old"),
        0,
        "The device is conformant by the profile old;",
        "all levels",
    ),
    "known deviation": (
        run_of(OK, KNOWN),
        0,
        "The device is conformant but for known deviations;",
        "no level reached",
    ),
    "only a known deviation": (
        run_of(KNOWN, not_run={"case.9": "core"}),
        0,
        "The device is conformant but for known deviations in what was run;",
        "no level reached",
    ),
    "lossy": (run_of(OK, lossy=100), 0, "The device is conformant;", "all levels, lossy link"),
    "failed": (
        run_of(OK, FAILED),
        1,
        "The device is NOT conformant: 1 of 3 cases failed;",
        "failed",
    ),
    "failed, then stopped": (
        run_of(FAILED, **BROKEN_OFF),
        1,
        "The device is NOT conformant: 1 of 2 cases failed;",
        "failed",
    ),
    "failed and stale": (
        run_of(FAILED, stale=STALE),
        1,
        "The device is NOT conformant: 1 of 2 cases failed; the list of known deviations is out of "
        "date;",
        "failed",
    ),
    "stale": (
        run_of(OK, stale=STALE),
        2,
        "The device is conformant; the list of known deviations is out of date;",
        "all levels",
    ),
    "stale, nothing tested": (
        run_of(UNIMPLEMENTED, stale=STALE),
        2,
        "Nothing was tested; the list of known deviations is out of date;",
        "nothing was tested",
    ),
    "stopped": (
        run_of(OK, **BROKEN_OFF),
        3,
        "The device is not judged: the run ended early;",
        "the run ended early",
    ),
    "stopped at once": (
        run_of(results=(), **BROKEN_OFF),
        3,
        "Nothing was tested: the run ended early;",
        "nothing was tested",
    ),
    "stopped after the smoke step": (
        run_of(asked=("case.9",), **BROKEN_OFF),
        3,
        "Nothing was tested: the run ended early;",
        "nothing was tested",
    ),
    "nothing claimed": (run_of(UNIMPLEMENTED), 4, "Nothing was tested;", "nothing was tested"),
    "nothing seen": (run_of(INFORMATIONAL), 4, "Nothing was tested;", "nothing was tested"),
}


@pytest.fixture(params=KINDS)
def kind(request):
    return KINDS[request.param]


def test_every_outcome_has_its_kinds():
    assert {run.outcome for run, *_ in KINDS.values()} == set(Outcome)
    assert {code for _, code, *_ in KINDS.values()} == set(range(5))


def test_the_console_says_what_the_exit_code_says(kind):
    run, code, sentence, _ = kind
    assert status(run) == code
    # What was not seen on the link, and how long it took, come after the sentence.
    assert f"{_console.report(run).splitlines()[-1]};".startswith(sentence)


def test_the_pages_say_what_the_console_says(kind):
    run, _, sentence, _ = kind
    words = sentence.removesuffix(";").removeprefix(f"The {run.role} is ").lower()
    assert f">{words}</span></p>" in _html.render(run).decode()
    assert f">{words}</span>" in _matrix.render([run]).decode()


def test_the_json_says_what_the_exit_code_says(kind):
    run, code, sentence, _ = kind
    found = json.loads(_json.render(run))
    assert found["conformant"] == run.conformant == (" is conformant" in sentence)
    assert (found["conformant"] and not found["stale"]) == (code == 0)


def test_the_badge_is_green_only_when_the_device_is_conformant(kind):
    run, _, _, badge = kind
    assert _badge.text(run).endswith(f": {badge}")
    green = "#1d6b43" in _badge.render(run).decode()
    assert green == badge.startswith(("all levels", "frame"))
    assert run.conformant or not green


def test_the_xml_is_green_only_when_the_exit_code_is_0(kind):
    run, code, *_ = kind
    xml = ElementTree.fromstring(_junit.render(run))
    counts = {name: int(xml.get(name)) for name in ("tests", "failures", "errors")}
    assert (counts["failures"] + counts["errors"] == 0) == (code == 0)
    assert counts["failures"] == len(run.with_verdict(FAILED)) + len(run.stale)
    assert counts["errors"] == (code in (3, 4) or bool(run.stopped))
    assert counts["tests"] == len(run.results) + len(run.stale) + counts["errors"]


def test_each_report_names_profile_and_lossy_link(kind):
    run, *_ = kind
    xml = ElementTree.fromstring(_junit.render(run))
    for suite in xml.iter("testsuite"):
        properties = {entry.get("name"): entry.get("value") for entry in suite.iter("property")}
        assert properties["profile"] == run.profile
        assert properties["lossy"] == str(run.lossy)
    found = json.loads(_json.render(run))
    assert (found["profile"], found["lossy"]) == (run.profile, run.lossy)
    page, text = _html.render(run).decode(), _console.report(run)
    assert f"profile {run.profile}" in page
    assert f"profile {run.profile}" in text
    assert ("declared lossy" in page) == ("declared lossy" in text) == bool(run.lossy)
    if run.profile != "strict":
        assert run.profile in _badge.text(run)


def test_the_xml_says_why(kind):
    run, *_ = kind
    xml = ElementTree.fromstring(_junit.render(run))
    messages = [entry.get("message") for entry in (*xml.iter("failure"), *xml.iter("error"))]
    for text in (*run.stale, run.stopped):
        assert not text or any(text in message for message in messages), text
