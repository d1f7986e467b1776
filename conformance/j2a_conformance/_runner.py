"""Runs cases against a device and makes a `Run` of it.

What flows in: a way to open the link, and cases. What flows out: a `Run`. Rules: a failed case
never spoils the next one: device and link are brought to rest, and where the device is gone the
link is opened anew; a failure that a stall of this machine or a lossy link may have caused is tried
again; which failures are allowed or known is the business of `Rules`.
"""

import time
from collections.abc import Callable, Collection, Iterable
from datetime import datetime

from j2a_spec.requirements import Level
from j2a_transports import Transport, TransportError

from ._case import Case
from ._deviations import Rules
from ._judge import Judged
from ._model import STOPPED_BY_USER, Claims, HarnessError, Result, Run, Verdict
from ._peer import Peer
from ._smoke import SMOKE
from ._wire import Link
from .cases import load

__all__ = ["run"]

_ATTEMPTS = 3
_LOSSY_ATTEMPTS = 10
_STRICT = Rules()


def run(
    opener: Callable[[], Transport],
    cases: Iterable[Case],
    *,
    url: str = "",
    title: str = "",
    rules: Rules = _STRICT,
    timeout_scale: float = 1.0,
    baud: int = 0,
    lossy: int = 0,
    fresh: bool = False,
    builtins_only: bool = False,
    claimed: Collection[Level] = (),
    stop_on_failure: bool = False,
    on_result: Callable[[Result], None] = lambda _: None,
) -> Run:
    """Judge the device that `opener` connects to.

    Args:
        opener: opens the link; called again when the link ends in mid run.
        cases: the cases to run after the smoke step; those of the smoke step itself run once.
        url: the link's name for the reports.
        title: what the device is, for the reports.
        rules: which failures are allowed, and which are known.
        timeout_scale: factor for every wait, above 1 for slow links.
        baud: rate of the link in bits a second, from which the first waits are computed; 0 where it
            is not known. Later waits fit the rate that was measured, too.
        lossy: the link loses or damages bytes, so an exchange fails only when it does so in this
            many attempts, and a case in 10; 0: the link is good.
        fresh: opening the link resets the device, so its first SIF has the seq 0.
        builtins_only: do not use functions of the application, whatever their names.
        claimed: the levels that the device is said to reach. A function that one of their cases
            needs and the device lacks is a failure then, and not unimplemented.
        stop_on_failure: leave out what comes after the first failed case.
        on_result: called with each result as it comes.

    Returns:
        The run; also when it was interrupted or the device was lost.

    Raises:
        HarnessError: the link cannot be opened, or nothing answers.
    """
    began, began_s = datetime.now().astimezone(), time.monotonic()
    try:
        transport = opener()
    except (TransportError, OSError) as error:
        raise HarnessError(f"cannot open {url or 'the link'}: {error}") from error
    cases = tuple(cases)
    asked = tuple(case.ID for case in cases)
    session = _Session(
        opener, Link(transport, timeout_scale, baud, lossy), fresh, builtins_only, claimed
    )
    results: list[Result] = []
    stopped = ""
    try:
        for case in (*SMOKE, *(case for case in cases if case not in SMOKE)):
            found = session.judge(case)
            result = rules.judge(found)
            results.append(result)
            on_result(result)
            if found.verdict is Verdict.FAILED:
                if case in SMOKE:
                    stopped = f"{case.ID} failed, so nothing else can be judged"
                elif stop_on_failure and result.verdict is Verdict.FAILED:
                    stopped = f"stopped at the first failed case, {case.ID}"
                elif not session.recover():
                    stopped = f"the device did not answer any more after {case.ID}"
            if stopped:
                break
    except KeyboardInterrupt:
        stopped = STOPPED_BY_USER
    finally:
        session.close()
    ran = {result.case for result in results}
    return Run(
        url=url,
        started=began.isoformat(timespec="seconds"),
        duration_s=time.monotonic() - began_s,
        claims=session.peer.claims if session.known else None,
        results=tuple(results),
        stopped=stopped,
        title=title,
        profile=rules.profile,
        stale=rules.stale(results, asked),
        asked=asked,
        lossy=lossy,
        not_run={case.ID: case.LEVEL for case in (*SMOKE, *load()) if case.ID not in ran},
    )


class _Session:
    """The link and the peer while cases run."""

    def __init__(
        self,
        opener: Callable[[], Transport],
        link: Link,
        fresh: bool,
        builtins_only: bool,
        claimed: Collection[Level],
    ) -> None:
        self.opener = opener
        self.link = link
        self.peer = Peer(link, Claims(mapped=False, functions=(), fresh=fresh))
        self.builtins_only = builtins_only
        self.claimed = claimed
        self.known = False

    def close(self) -> None:
        self.link.transport.close()

    def judge(self, case: Case) -> Result:
        """Run one case and return its result."""
        smoke = case in SMOKE
        began_s = time.monotonic()
        self.link.begin()
        verdict, reason, attempts = self._attempts(case, barrier=not smoke or case is SMOKE[-1])
        evidence, left_out = self.link.evidence()
        result = Result(
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
            repeated=self.link.repeated,
            duration_s=time.monotonic() - began_s,
        )
        if case is SMOKE[-1] and verdict is Verdict.OK:
            self.known = self.peer.strict = True
            if self.builtins_only:
                self.peer.hide_application()
        return result

    def _attempts(self, case: Case, barrier: bool) -> tuple[Verdict, str, int]:
        most = _LOSSY_ATTEMPTS if self.link.lossy else _ATTEMPTS
        for attempt in range(1, most + 1):
            verdict, reason, again = self._once(case, barrier)
            if not again or attempt == most or not self.recover():
                break
            self.link.note(f"another attempt: {reason}")
        return verdict, reason, attempt

    def _once(self, case: Case, barrier: bool) -> tuple[Verdict, str, bool]:
        """Run the case; return verdict and reason, and whether it deserves another attempt."""
        try:
            case.run(self.peer)
            if barrier:
                self.peer.barrier()
        except Judged as judged:
            if judged.verdict is Verdict.FAILED:
                return judged.verdict, judged.reason, self._again(judged)
            if judged.missing and case.LEVEL in self.claimed:
                reason = f"{judged.reason}, and is said to reach the level {case.LEVEL}"
                return Verdict.FAILED, reason, False
            try:
                if self.known:
                    self.peer.barrier()
            except Judged as late:
                return late.verdict, late.reason, self._again(late)
            return judged.verdict, judged.reason, False
        except TransportError as error:
            if case is SMOKE[0]:
                raise HarnessError(f"the link failed before anything answered: {error}") from error
            return Verdict.FAILED, f"the link ended: {error}", False
        return Verdict.OK, "", False

    def _again(self, judged: Judged) -> bool:
        return not judged.final and (judged.suspect or bool(self.link.lossy))

    def recover(self) -> bool:
        """Bring the device to rest; reopen the link where that is the only way."""
        for reopened in (False, True):
            try:
                if reopened:
                    self.link.replace(self.opener())
                if self.peer.resync():
                    return True
            except (TransportError, OSError) as error:
                self.link.note(f"recovering: {error}")
        return False
