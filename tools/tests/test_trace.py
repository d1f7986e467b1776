"""The summary of the trace: it changes with each link of the chain, and says where."""

import copy
import importlib.util
import json
import re
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
    assert set(found["testees"]) == {"avr", "posix"}
    assert set(found["areas"]) == {"FRAME", "SEQ"}
    assert tool.differences(found, tool.summary(copy.deepcopy(TRACE))) == []


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("text", "another", []),
        ("cases", ["a", "b", "c"], ["totals: cases: 2 -> 3"]),
    ],
)
def test_a_difference_is_named_with_its_area(key, value, said):
    changed = copy.deepcopy(TRACE)
    changed["J2A-FRAME-001"][key] = value
    found = tool.differences(tool.summary(TRACE), tool.summary(changed))
    assert found[:-1] == said
    assert found[-1].startswith("areas: FRAME: ")


def test_another_result_is_named_with_its_testee():
    changed = copy.deepcopy(TRACE)
    changed["J2A-FRAME-001"]["results"]["posix"] = "failed"
    summaries = tool.summary(TRACE), tool.summary(changed)
    (found,) = tool.differences(*summaries)
    assert found.startswith("testees: posix: ")
    assert tool.differences(*summaries, sampled={"avr"}) == [found]
    assert tool.differences(*summaries, sampled={"posix"}) == []


@pytest.mark.parametrize("sampled", [set(), {"avr"}])
def test_a_testee_without_a_report_is_named(sampled):
    changed = copy.deepcopy(TRACE)
    del changed["J2A-SEQ-001"]["results"]["avr"]
    (found,) = tool.differences(tool.summary(TRACE), tool.summary(changed), sampled)
    assert re.fullmatch("testees: avr: [0-9a-f]{16} -> None", found)


def test_a_run_of_some_cases_is_a_sample(tmp_path):
    for name, not_run in (("avr", {}), ("posix", {"frame.pieces": "frame"})):
        (tmp_path / f"{name}.json").write_text(json.dumps({"not_run": not_run}), "utf-8")
    assert tool.sampled(tmp_path) == {"posix"}


def test_no_summary_is_made_of_a_sample(tmp_path, monkeypatch, capsys):
    report = {"results": [], "not_run": {"frame.pieces": "frame"}}
    (tmp_path / "results").mkdir()
    (tmp_path / "results/avr.json").write_text(json.dumps(report), "utf-8")
    monkeypatch.setattr(tool, "SUMMARY", tmp_path / "trace.json")
    monkeypatch.setattr(tool, "TRACE", tmp_path / "traceability.json")
    monkeypatch.setattr("sys.argv", ["trace", "--results", str(tmp_path / "results")])
    with pytest.raises(SystemExit, match="2"):
        tool.main()
    assert "avr ran a sample" in capsys.readouterr().err
    assert not (tmp_path / "trace.json").exists()
