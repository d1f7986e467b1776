"""Which levels a device reaches, by the verdicts of a run."""

from dataclasses import replace
from typing import get_args

import pytest
from j2a_conformance import Result, Run, Verdict
from j2a_conformance.host import START
from j2a_conformance.host import load as load_host
from j2a_conformance.reports._console import report
from j2a_spec.requirements import Level

OK, FAILED = Verdict.OK, Verdict.FAILED


def run_of(*verdicts, **fields):
    """Return a run of a suite that has cases of all levels; those of the rest were not run."""
    results = tuple(
        Result(f"case.{number}", "Does.", "Expects.", ("J2A-FRAME-001",), level, verdict)
        for number, (level, verdict) in enumerate(verdicts)
    )
    rest = {f"rest.{level}": level for level in get_args(Level) if level not in dict(verdicts)}
    fields["not_run"] = rest | fields.get("not_run", {})
    return Run(url="", started="", duration_s=0.0, claims=None, results=results, **fields)


@pytest.mark.parametrize(
    ("verdicts", "reached"),
    [
        ([("frame", OK), ("core", OK)], {"frame": True, "core": True, "many": None}),
        ([("frame", FAILED), ("core", OK)], {"frame": False, "core": False, "many": False}),
        ([("frame", OK), ("core", FAILED), ("many", OK)], {"core": False, "many": False}),
        ([("frame", OK), ("core", OK), ("core", FAILED)], {"frame": True, "core": False}),
        ([("frame", OK), ("core", OK), ("many", FAILED)], {"core": True, "many": False}),
        ([("frame", OK), ("core", OK), ("sif", Verdict.UNIMPLEMENTED)], {"sif": None}),
        ([("frame", OK), ("core", OK), ("sif", Verdict.INFORMATIONAL)], {"sif": None}),
        ([("frame", Verdict.NON_STRICT), ("core", OK)], {"frame": True, "core": True}),
        ([("frame", Verdict.KNOWN_DEVIATION), ("core", OK)], {"frame": False, "core": False}),
        ([("core", OK), ("many", OK)], {"frame": None, "core": None, "many": None}),
    ],
)
def test_levels_rest_on_each_other(verdicts, reached):
    levels = run_of(*verdicts).levels()
    assert {level: levels[level] for level in reached} == reached


def test_a_level_that_was_run_in_part_is_neither_reached_nor_missed():
    verdicts = [("frame", OK), ("core", OK)]
    assert run_of(*verdicts, not_run={"other": "core"}).levels()["core"] is None
    assert run_of(*verdicts, ("core", FAILED), not_run={"other": "core"}).levels()["core"] is False


def _level(case):
    return case.LEVEL


def test_a_level_that_the_suite_has_no_case_of_is_not_listed():
    cases = [case for case in (START, *load_host()) if case.LEVEL != "frame"]
    run = replace(run_of(("frame", FAILED)), role="host")
    run = replace(run, not_run={case.ID: case.LEVEL for case in cases})
    listed = [level for level in get_args(Level) if level in {"frame", *map(_level, cases)}]
    assert list(run.levels()) == listed
    assert "debug" not in listed
    assert f"; not {', '.join(listed)}.\n" in report(run)


def test_the_report_ends_with_the_levels():
    text = report(run_of(("frame", OK), ("core", OK), ("mapping", OK), ("many", FAILED)))
    assert "\nLevels: reaches frame, core, mapping; not many.\n" in text
    assert "reaches none; not frame" in report(run_of(("frame", FAILED)))
    assert "Levels" not in report(run_of(("core", Verdict.UNIMPLEMENTED)))


@pytest.mark.parametrize("verdict", list(Verdict))
def test_what_counts_as_tested(verdict):
    run = run_of(("frame", OK), ("many", verdict), asked=("case.1",))
    seen = verdict not in (Verdict.UNIMPLEMENTED, Verdict.INFORMATIONAL)
    assert run.tested == seen
    assert run_of(("frame", verdict)).tested == seen


def test_a_function_that_a_claimed_level_needs_is_missing(reference, judged):
    class Lacks(reference):
        names = tuple(name for name in reference.names if name not in ("sif", "delay"))

    found = judged(Lacks, ["sif.every-length", "limits.cut-frame"], claimed=["sif"])
    by_case = {result.case: result for result in found.results}
    assert by_case["sif.every-length"].verdict is Verdict.FAILED
    assert by_case["sif.every-length"].reason == (
        "the device has no function sif, and is said to reach the level sif"
    )
    assert by_case["limits.cut-frame"].verdict is Verdict.UNIMPLEMENTED
    assert not found.conformant


def test_a_missing_property_is_no_missing_function(reference, judged):
    found = judged(reference, ["properties.selftest"], claimed=["properties"])
    assert found.results[-1].verdict is Verdict.UNIMPLEMENTED
