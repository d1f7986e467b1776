"""Runs cases against a testee and makes a `Run` of it, whether it is a device or a host.

What flows in: a `Testee`, and cases. What flows out: a `Run`. Rules: a failed case never spoils the
next one: the testee is brought to rest between them; a failure that a stall of this machine or a
lossy link may have caused is tried again.
"""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from contextlib import suppress
from datetime import datetime
from typing import Generic, TypeVar

from j2a_transports import TransportError

from ._case import BaseCase
from ._judge import Judged, give_up
from ._model import STOPPED_BY_USER, HarnessError, Result, Run, Verdict
from ._retry import Retry
from .wire._link import Link

__all__ = ["ATTEMPTS", "Testee", "judge"]

ATTEMPTS = 3
"""How often a case is run at most."""

_AnyCase = TypeVar("_AnyCase", bound=BaseCase)


class Testee(ABC, Generic[_AnyCase]):
    """A device or a host while cases run.

    Attributes:
        link: the link to it.
        start: the cases that come first in each run; if one fails, nothing else can be judged.
        retry: how often a case is tried.
        pause_s: how long one waits before the second attempt, and four times as long before each
            further one: what made the machine stall often goes on for seconds.
    """

    link: Link
    start: tuple[_AnyCase, ...]
    retry: Retry
    pause_s: float = 0.0

    @abstractmethod
    def run(self, case: _AnyCase) -> None:
        """Run a case once.

        Raises:
            Judged: the verdict is not OK.
            HarnessError: nothing can be said about the testee.
            TransportError: the link ended.
        """

    @abstractmethod
    def recover(self, after: str) -> str:
        """Bring it to rest after a case that failed; return why the run ends there, or ""."""

    @abstractmethod
    def leave(self, failed: str) -> str:
        """Take leave after the last case, which may have failed; return what went wrong, or ""."""

    @abstractmethod
    def close(self) -> None:
        """Close the link."""

    @abstractmethod
    def complete(self, run: Run) -> Run:
        """Return the run with what only this side knows."""

    def excuse(self, result: Result) -> Result:
        """Return the result with its final verdict: some failures may be allowed."""
        return result


def judge(
    opener: Callable[[], Testee[_AnyCase]],
    cases: Iterable[_AnyCase],
    every: Iterable[_AnyCase],
    *,
    url: str,
    stop_on_failure: bool,
    on_result: Callable[[Result], None],
) -> Run:
    """Judge the testee that `opener` returns.

    Args:
        opener: opens the link.
        cases: the cases to run after those of the start; these run once.
        every: all cases that there are for such a testee.
        url: its name for the reports.
        stop_on_failure: leave out what comes after the first failed case.
        on_result: called with each result as it comes.

    Returns:
        The run; also when it was interrupted or the testee was lost.

    Raises:
        HarnessError: the link cannot be opened, or nothing answers; later it only ends the run.
        Exception: a fault of the suite; a note names the case.
    """
    began, began_s = datetime.now().astimezone(), time.monotonic()
    testee = opener()
    cases = tuple(cases)
    results: list[Result] = []
    failed = stopped = ""
    try:
        for case in (*testee.start, *(case for case in cases if case not in testee.start)):
            if failed and (stopped := testee.recover(failed)):
                break
            found = _judge(testee, case)
            result = testee.excuse(found)
            results.append(result)
            on_result(result)
            failed = case.ID if found.verdict is Verdict.FAILED else ""
            if failed and case in testee.start:
                stopped = f"{case.ID} failed, so nothing else can be judged"
            elif stop_on_failure and result.verdict is Verdict.FAILED:
                stopped = f"stopped at the first failed case, {case.ID}"
            if stopped:
                break
        else:
            stopped = testee.leave(failed)
    except KeyboardInterrupt:
        stopped = STOPPED_BY_USER
    except HarnessError as error:
        if case in testee.start:
            raise
        # A testee that does not come back costs nothing of what was judged by then.
        stopped = f"after {case.ID}: {error}"
    except Exception as error:
        error.add_note(f"in the case {case.ID}")
        raise
    finally:
        with suppress(TransportError):
            testee.close()
    ran = {result.case for result in results}
    run = Run(
        url=url,
        started=began.isoformat(timespec="seconds"),
        duration_s=time.monotonic() - began_s,
        claims=None,
        results=tuple(results),
        stopped=stopped,
        asked=tuple(case.ID for case in cases),
        not_run={case.ID: case.LEVEL for case in (*testee.start, *every) if case.ID not in ran},
    )
    return testee.complete(run)


def _judge(testee: Testee[_AnyCase], case: _AnyCase) -> Result:
    """Run one case, repeated if it needs that, and return its result."""
    link, attempts = testee.link, 0

    def attempt(number: int) -> None:
        nonlocal attempts
        attempts = number
        try:
            testee.run(case)
        except TransportError as error:
            give_up(f"the link ended: {error}")

    def rest(judged: Judged) -> bool:
        link.wait_until(link.now_s() + testee.pause_s * 4 ** (attempts - 1))
        if testee.recover(case.ID):
            return False
        link.note(f"another attempt: {judged.reason}")
        return True

    began_s = time.monotonic()
    link.begin()
    verdict, reason = Verdict.OK, ""
    try:
        testee.retry.run(attempt, rest)
    except Judged as judged:
        verdict, reason = judged.verdict, judged.reason
    evidence, left_out = link.evidence()
    return Result(
        case=case.ID,
        description=case.DESCRIPTION,
        expectation=case.EXPECTATION,
        requirements=case.REQUIREMENTS,
        level=case.LEVEL,
        verdict=verdict,
        reason=reason,
        evidence=evidence,
        left_out=left_out,
        attempts=attempts,
        repeated=link.repeated,
        duration_s=time.monotonic() - began_s,
    )
