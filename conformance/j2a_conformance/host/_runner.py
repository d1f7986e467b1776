"""Runs cases against a host and makes a `Run` of it.

What flows in: where the host connects, and cases. What flows out: a `Run`, as for a device. Rules:
one host program for the whole run as long as it behaves; after a failure it is started anew, so
that a failed case never spoils the next one; a failure that a stall of this machine may have
caused is tried again.
"""

import time
from collections.abc import Callable, Iterable
from datetime import datetime

from j2a_transports import TransportError

from j2a_conformance._judge import Judged
from j2a_conformance._model import STOPPED_BY_USER, Result, Run, Verdict

from ._case import HostCase
from ._device import DEMO
from ._host import Host
from ._program import Listening
from ._start import START
from .cases import load

__all__ = ["run"]

_ATTEMPTS = 3


def run(
    place: Listening,
    cases: Iterable[HostCase],
    *,
    url: str = "",
    timeout_scale: float = 1.0,
    stop_on_failure: bool = False,
    on_result: Callable[[Result], None] = lambda _: None,
) -> Run:
    """Judge the host that connects to `place`.

    Args:
        place: where the host connects; the caller closes it.
        cases: the cases to run after the start, which is always run.
        url: what the reports call the host: its command, or where it was waited for.
        timeout_scale: factor for every wait and every time limit, above 1 for slow hosts.
        stop_on_failure: leave out what comes after the first failed case.
        on_result: called with each result as it comes.

    Returns:
        The run; also when it was interrupted or the host was lost.

    Raises:
        HarnessError: the host does not start or does not connect.
    """
    began, began_s = datetime.now().astimezone(), time.monotonic()
    cases = tuple(cases)
    host = Host(place, DEMO, timeout_scale)
    results: list[Result] = []
    stopped = ""
    try:
        for case in (START, *(case for case in cases if case is not START)):
            if results and results[-1].verdict is Verdict.FAILED and (gone := _restart(host)):
                stopped = f"the host did not come back after {results[-1].case}: {gone}"
                break
            result = _judge(host, case)
            results.append(result)
            on_result(result)
            if result.verdict is Verdict.FAILED and case is START:
                stopped = f"{case.ID} failed, so nothing else can be judged"
            elif result.verdict is Verdict.FAILED and stop_on_failure:
                stopped = f"stopped at the first failed case, {case.ID}"
            if stopped:
                break
        if results[-1].verdict is not Verdict.FAILED:
            host.job("bye")
    except KeyboardInterrupt:
        stopped = STOPPED_BY_USER
    finally:
        host.close()
    ran = {result.case for result in results}
    return Run(
        url=url,
        started=began.isoformat(timespec="seconds"),
        duration_s=time.monotonic() - began_s,
        claims=None,
        results=tuple(results),
        stopped=stopped,
        title=host.title,
        role="host",
        asked=tuple(case.ID for case in cases),
        not_run={case.ID: case.LEVEL for case in (START, *load()) if case.ID not in ran},
    )


def _judge(host: Host, case: HostCase) -> Result:
    """Run one case and return its result."""
    began_s = time.monotonic()
    host.link.begin()
    for attempts in range(1, _ATTEMPTS + 1):
        verdict, reason, suspect = _once(host, case)
        if not suspect or attempts == _ATTEMPTS or _restart(host):
            break
        host.link.note(f"another attempt: {reason}")
    evidence, left_out = host.link.evidence()
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
        duration_s=time.monotonic() - began_s,
    )


def _once(host: Host, case: HostCase) -> tuple[Verdict, str, bool]:
    try:
        case.run(host)
    except Judged as judged:
        return judged.verdict, judged.reason, judged.suspect
    except TransportError as error:
        return Verdict.FAILED, f"the link ended: {error}", False
    return Verdict.OK, "", False


def _restart(host: Host) -> str:
    """Bring the host to rest; return why that is not possible, or ""."""
    try:
        host.restart()
    except Judged as judged:
        return judged.reason
    except TransportError as error:
        return str(error)
    return ""
