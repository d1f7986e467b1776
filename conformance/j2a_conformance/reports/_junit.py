"""The report for build servers: JUnit XML, a suite for each level.

What flows in: a `Run`. What flows out: XML. Rules: it is green only where the exit code is 0, so
what is wrong with the run as a whole is a test case, too. JUnit knows no "informational": such a
case passes, with its reason in the output; an unimplemented one and one that is known to fail are
skipped.
"""

from collections.abc import Iterable, Iterator
from io import BytesIO
from typing import get_args

from j2a_spec import requirements
from j2a_spec.requirements import Level
from junitparser import Error, Failure, JUnitXml, Skipped, TestCase, TestSuite

from j2a_conformance._model import Outcome, Result, Run, Verdict

from ._console import evidence_lines
from ._summary import judgement
from ._text import file_text

__all__ = ["render"]


def render(run: Run) -> bytes:
    """Return the report as XML."""
    xml = JUnitXml("J2A conformance")
    for level in get_args(Level):
        if cases := [_case(result) for result in run.results if result.level == level]:
            xml.add_testsuite(_suite(run, level, cases))
    if whole := list(_whole(run)):
        xml.add_testsuite(_suite(run, "run", whole))
    xml.update_statistics()  # type: ignore[no-untyped-call]
    file = BytesIO()
    xml.write(file, pretty=True)
    return file.getvalue()


def _suite(run: Run, name: str, cases: Iterable[TestCase]) -> TestSuite:
    suite = TestSuite(f"J2A {name}")
    suite.timestamp = run.started
    for key, value in (("url", run.url), ("profile", run.profile), ("lossy", str(run.lossy))):
        suite.add_property(key, file_text(value))
    for case in cases:
        suite.add_testcase(case)
    return suite


def _whole(run: Run) -> Iterator[TestCase]:
    """Yield a test case for all that is wrong with the run and not with a case of it."""
    if run.stopped:
        yield _wrong("stopped", Error(file_text(f"the run ended early: {run.stopped}"), "stopped"))
    elif run.outcome is Outcome.NOTHING:
        yield _wrong("nothing", Error(judgement(run), "nothing"))
    for number, sentence in enumerate(run.stale, 1):
        yield _wrong(f"stale.{number}", Failure(file_text(sentence), "stale"))


def _wrong(name: str, what: Error | Failure) -> TestCase:
    case = TestCase(f"run.{name}", "j2a.run")
    case.result = [what]
    return case


def _case(result: Result) -> TestCase:
    case = TestCase(file_text(result.case), f"j2a.{result.level}", round(result.duration_s, 3))
    texts = requirements.load()
    rules = [f"{name}: {texts[name].text}" for name in result.requirements]
    if result.verdict is Verdict.FAILED:
        failure = Failure(file_text(result.reason), result.verdict.value)
        failure.text = file_text("\n".join((*rules, *evidence_lines(result))))
        case.result = [failure]
    elif result.verdict in (Verdict.UNIMPLEMENTED, Verdict.KNOWN_DEVIATION):
        case.result = [Skipped(file_text(result.reason), result.verdict.value)]
    about = [result.description, f"Expected: {result.expectation}", *rules]
    case.system_out = file_text("\n".join(filter(None, (*about, result.reason))))
    return case
