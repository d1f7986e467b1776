"""The report for build servers: JUnit XML, a suite for each level.

What flows in: a `Run`. What flows out: XML. JUnit knows no "informational": such a case passes,
with its reason in the output; an unimplemented one and one that is known to fail are skipped.
"""

from io import BytesIO
from typing import get_args

from j2a_spec import requirements
from j2a_spec.requirements import Level
from junitparser import Failure, JUnitXml, Skipped, TestCase, TestSuite

from ._console import evidence_lines
from ._model import Result, Run, Verdict
from ._printable import printable

__all__ = ["render"]


def render(run: Run) -> bytes:
    """Return the report as XML."""
    xml = JUnitXml("J2A conformance")
    for level in get_args(Level):
        results = [result for result in run.results if result.level == level]
        if not results:
            continue
        suite = TestSuite(f"J2A {level}")
        suite.timestamp = run.started
        suite.add_property("url", printable(run.url))
        for result in results:
            suite.add_testcase(_case(result))
        xml.add_testsuite(suite)
    xml.update_statistics()  # type: ignore[no-untyped-call]
    file = BytesIO()
    xml.write(file, pretty=True)
    return file.getvalue()


def _case(result: Result) -> TestCase:
    case = TestCase(printable(result.case), f"j2a.{result.level}", round(result.duration_s, 3))
    texts = requirements.load()
    rules = [f"{name}: {texts[name].text}" for name in result.requirements]
    if result.verdict is Verdict.FAILED:
        failure = Failure(printable(result.reason), result.verdict.value)
        failure.text = printable("\n".join((*rules, *evidence_lines(result))))
        case.result = [failure]
    elif result.verdict in (Verdict.UNIMPLEMENTED, Verdict.KNOWN_DEVIATION):
        case.result = [Skipped(printable(result.reason), result.verdict.value)]
    about = [result.description, f"Expected: {result.expectation}", *rules]
    case.system_out = printable("\n".join(filter(None, (*about, result.reason))))
    return case
