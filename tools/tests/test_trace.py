"""The summary of the trace: it changes with each link of the chain, and says where."""

import copy
import importlib.util
from pathlib import Path

import pytest

SPEC = importlib.util.spec_from_file_location("trace_tool", Path(__file__).parents[1] / "trace.py")
tool = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(tool)

EMPTY = {"text": "", "vectors": [], "cases": [], "host_cases": [], "tests": [], "mutants": []}
TRACE = {
    "J2A-FRAME-001": {**EMPTY, "cases": ["a", "b"], "results": {"posix": "ok"}},
    "J2A-SEQ-001": {**EMPTY, "mutants": [{"id": "m"}], "results": {"avr": "ok", "posix": "ok"}},
}


def test_the_summary_counts_the_links():
    found = tool.summary(TRACE)
    assert found["totals"] == {
        "requirements": 2,
        "vectors": 0,
        "cases": 2,
        "host_cases": 0,
        "tests": 0,
        "mutants": 1,
    }
    assert found["testees"] == ["avr", "posix"]
    assert set(found["areas"]) == {"FRAME", "SEQ"}
    assert tool.differences(found, tool.summary(copy.deepcopy(TRACE))) == []


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("text", "another", []),
        ("cases", ["a", "b", "c"], ["totals: cases: 2 -> 3"]),
        ("results", {"posix": "failed"}, []),
    ],
)
def test_a_difference_is_named_with_its_area(key, value, said):
    changed = copy.deepcopy(TRACE)
    changed["J2A-FRAME-001"][key] = value
    found = tool.differences(tool.summary(TRACE), tool.summary(changed))
    assert found[:-1] == said
    assert found[-1].startswith("areas: FRAME: ")


def test_a_testee_without_a_report_is_named():
    changed = copy.deepcopy(TRACE)
    del changed["J2A-SEQ-001"]["results"]["avr"]
    found = tool.differences(tool.summary(TRACE), tool.summary(changed))
    assert found[-1] == "testees: no report of avr"


def test_a_hash_that_fits_nothing_is_a_difference():
    summary = tool.summary(TRACE)
    assert tool.differences({**summary, "sha256": ""}, summary) != []
