"""The badge: what it says, that it is sound, and that its text fits."""

from dataclasses import replace
from xml.etree import ElementTree

import pytest
from j2a_conformance import Result, Run, Verdict
from j2a_conformance.reports._badge import render, text
from j2a_conformance.reports._pages import data_url
from j2a_spec import SPEC_VERSION
from j2a_spec.requirements import Level, get_args

SVG = "{http://www.w3.org/2000/svg}"


def run_of(verdicts, **options):
    """Return a run with a case of each level that `verdicts` names; the others were not run."""
    results = tuple(
        Result(f"{level}.case", "", "", (), level, verdict) for level, verdict in verdicts.items()
    )
    rest = {f"{level}.rest": level for level in get_args(Level) if level not in verdicts}
    options = {"not_run": rest} | options
    return Run("loopback", "2026-01-02T03:04:05+00:00", 1.0, None, results, **options)


ALL = dict.fromkeys(get_args(Level), Verdict.OK)
SOME = ALL | {"debug": Verdict.UNIMPLEMENTED, "sif": Verdict.UNIMPLEMENTED}
RUNS = [
    (run_of(ALL), "all levels"),
    (run_of(SOME), ", ".join(level for level in ALL if level not in ("debug", "sif"))),
    (run_of({"frame": Verdict.OK, "core": Verdict.NON_STRICT}), "frame, core"),
    (
        run_of(ALL, not_run={"many.other": "many"}),
        ", ".join(level for level in ALL if level != "many"),
    ),
    (run_of(ALL | {"sif": Verdict.FAILED}), "failed"),
    (run_of(ALL | {"frame": Verdict.KNOWN_DEVIATION}), "no level reached"),
    (run_of({}), "nothing was tested"),
    (run_of(ALL, stopped="interrupted"), "the run ended early"),
    (run_of(ALL, lossy=100), "all levels, lossy link"),
    (run_of({"frame": Verdict.OK}, lossy=100), "frame, lossy link"),
    (run_of(ALL | {"sif": Verdict.FAILED}, lossy=100), "failed"),
]


@pytest.mark.parametrize(("run", "says"), RUNS, ids=[says for _, says in RUNS])
def test_what_it_says(run, says):
    svg = ElementTree.fromstring(render(run))
    assert svg.get("role") == "img"
    whole = f"J2A {SPEC_VERSION}: {says}"
    assert svg.findtext(f"{SVG}title") == text(run) == whole
    assert [entry.text for entry in svg.iter(f"{SVG}text")] == [f"J2A {SPEC_VERSION}", says]


def test_the_profile_is_named_and_texts_are_escaped():
    svg = ElementTree.fromstring(render(run_of(ALL, profile="<old>\x00")))
    assert svg.findtext(f"{SVG}title") == f"J2A {SPEC_VERSION} <old>\\x00: all levels"


def test_a_host_is_called_so():
    assert text(run_of(ALL, role="host")) == f"J2A {SPEC_VERSION} host: all levels"


def test_nothing_is_loaded():
    data = render(run_of(ALL)).decode()
    assert "href" not in data
    assert "@import" not in data
    assert data.count("http") == 1  # the name space


@pytest.mark.parametrize(("run", "says"), RUNS, ids=[says for _, says in RUNS])
def test_the_text_fits(browser, run, says):
    browser.show(data_url(render(run)), 600)
    # The length that the text would have by itself, to that which it is given.
    ratios = browser.value(
        "[...document.querySelectorAll('text')].map((e) => { const given = e.textLength.baseVal"
        ".value; e.removeAttribute('textLength'); return e.getComputedTextLength() / given; })"
    )
    assert len(ratios) == 2
    assert all(0.85 < ratio < 1.15 for ratio in ratios), (says, ratios)
    inside = browser.value(
        "(() => { const all = document.documentElement.getBoundingClientRect(); return "
        "[...document.querySelectorAll('text')].every((e) => { const r = e.getBoundingClientRect();"
        " return r.left > all.left && r.right < all.right; }) })()"
    )
    assert inside


def test_a_run_that_failed_gets_no_level():
    run = run_of(ALL)
    failed = replace(
        run, results=(*run.results[:-1], replace(run.results[-1], verdict=Verdict.FAILED))
    )
    assert "levels" in text(run)
    assert "levels" not in text(failed)
