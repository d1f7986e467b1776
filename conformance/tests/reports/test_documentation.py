"""What docs/conformance/reports.md shows is what the program prints."""

from pathlib import Path

from j2a_conformance import Claims, Result, Run, Verdict
from j2a_conformance.reports._compare import compare, report
from j2a_conformance.reports._json import FORMAT
from j2a_conformance.reports._views import _LINES_OF_A_PASS

PAGE = Path(__file__).parents[3] / "docs/conformance/reports.md"


def thermometer(day, version, *verdicts):
    cases = ("frame.layout", "frame.lengths", "frame.interrupted")
    results = tuple(
        Result(
            case, "", "", (), "frame", v, "no answer within 2.0 s" if v is Verdict.FAILED else ""
        )
        for case, v in zip(cases, verdicts, strict=True)
    )
    claims = Claims(True, (), {"name": "Thermometer", "version": version})
    return Run("tcp://127.0.0.1:5000", f"2026-01-0{day}T03:04:05+00:00", 1.0, claims, results)


def test_the_comparison():
    ok = Verdict.OK
    before, after = thermometer(2, "1.0", ok, ok, ok), thermometer(3, "1.1", ok, ok, Verdict.FAILED)
    assert f"```\n{report(compare(before, after))}\n```" in PAGE.read_text("utf-8")


def test_figures():
    text = " ".join(PAGE.read_text("utf-8").split())
    assert f"`{FORMAT}`" in text
    assert f"the last {_LINES_OF_A_PASS} lines are shown" in text
