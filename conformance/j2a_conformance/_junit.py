"""The report for build servers: JUnit XML, a suite for each level.

What flows in: a `Run`. What flows out: a file. JUnit knows no "informational": such a case passes,
with its reason in the output; an unimplemented one is skipped.
"""

from pathlib import Path
from typing import get_args

from j2a_spec import requirements
from j2a_spec.requirements import Level
from junitparser import Failure, JUnitXml, Skipped, TestCase, TestSuite

from ._console import evidence_lines
from ._model import Result, Run, Verdict

__all__ = ["write"]


def write(run: Run, path: Path) -> None:
    """Write the report.

    Raises:
        OSError: the file cannot be written.
    """
    xml = JUnitXml("J2A conformance")
    for level in get_args(Level):
        results = [result for result in run.results if result.level == level]
        if not results:
            continue
        suite = TestSuite(f"J2A {level}")
        suite.timestamp = run.started
        suite.add_property("url", run.url)
        for result in results:
            suite.add_testcase(_case(result))
        xml.add_testsuite(suite)
    xml.update_statistics()  # type: ignore[no-untyped-call]
    xml.write(str(path), pretty=True)


def _case(result: Result) -> TestCase:
    case = TestCase(result.case, f"j2a.{result.level}", round(result.duration_s, 3))
    texts = requirements.load()
    rules = [f"{name}: {texts[name].text}" for name in result.requirements]
    if result.verdict is Verdict.FAILED:
        failure = Failure(result.reason, result.verdict.value)
        failure.text = "\n".join((*rules, *evidence_lines(result)))
        case.result = [failure]
    elif result.verdict is Verdict.UNIMPLEMENTED:
        case.result = [Skipped(result.reason, result.verdict.value)]
    about = [result.description, f"Expected: {result.expectation}", *rules]
    case.system_out = "\n".join(about + ([result.reason] if result.reason else []))
    return case
