"""Runs cases against a device and makes a `Run` of it.

What flows in: a way to open the link, and cases. What flows out: a `Run`. Rules: after a failure
device and link are brought to rest, and where the device is gone the link is opened anew; which
failures are allowed or known is the business of `Rules`.
"""

from collections.abc import Callable, Collection, Iterable
from dataclasses import replace

from j2a_spec.requirements import Level
from j2a_transports import Transport, TransportError

from j2a_conformance._judge import Judged, give_up
from j2a_conformance._model import Claims, HarnessError, Result, Run, Verdict
from j2a_conformance._retry import Retry
from j2a_conformance._runner import ATTEMPTS, Testee, judge
from j2a_conformance.wire._link import Link

from ._case import Case
from ._deviations import Rules
from ._peer import Peer
from ._smoke import SMOKE
from .cases import load

__all__ = ["run"]

_LOSSY_ATTEMPTS = 10
_PAUSE_S = 1.0
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
    emulated: bool = False,
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
        emulated: a request without an answer is tried again, as the device may have given it up:
            its time went on while its processor waited for one of this machine.
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

    def opened() -> _Device:
        try:
            transport = opener()
        except (TransportError, OSError) as error:
            raise HarnessError(f"cannot open the link: {error}") from error
        link = Link(transport, timeout_scale, baud, lossy)
        return _Device(
            opener,
            link,
            title=title,
            rules=rules,
            fresh=fresh,
            emulated=emulated,
            builtins_only=builtins_only,
            claimed=claimed,
        )

    return judge(
        opened,
        cases,
        load(),
        url=url,
        stop_on_failure=stop_on_failure,
        on_result=on_result,
    )


class _Device(Testee[Case]):
    """The link and the peer while cases run."""

    start = SMOKE

    def __init__(
        self,
        opener: Callable[[], Transport],
        link: Link,
        *,
        title: str,
        rules: Rules,
        fresh: bool,
        emulated: bool,
        builtins_only: bool,
        claimed: Collection[Level],
    ) -> None:
        self.link = link
        lossy = bool(link.lossy)
        self.retry = Retry(_LOSSY_ATTEMPTS if lossy else ATTEMPTS, every=lossy)
        self.pause_s = 0.0 if lossy else _PAUSE_S
        self._opener = opener
        self._title = title
        self._rules = rules
        self._peer = Peer(link, Claims(mapped=False, functions=(), fresh=fresh), emulated)
        self._builtins_only = builtins_only
        self._claimed = claimed
        self._known = False

    def close(self) -> None:
        self.link.transport.close()

    def run(self, case: Case) -> None:
        try:
            case.run(self._peer)
        except Judged as judged:
            if judged.verdict is Verdict.FAILED:
                raise
            if judged.missing and case.LEVEL in self._claimed:
                give_up(f"{judged.reason}, and is said to reach the level {case.LEVEL}")
            if self._known:
                self._peer.barrier()
            raise
        except TransportError as error:
            if case is SMOKE[0]:
                raise HarnessError(f"the link failed before anything answered: {error}") from error
            raise
        if case not in SMOKE[:-1]:
            self._peer.barrier()
        if case is SMOKE[-1]:
            self._known = self._peer.strict = True
            if self._builtins_only:
                self._peer.hide_application()

    def recover(self, after: str) -> str:
        """Bring the device to rest; reopen the link where that is the only way."""
        for reopened in (False, True):
            try:
                if reopened:
                    self.link.replace(self._opener())
                if self._peer.resync():
                    return ""
            except (TransportError, OSError) as error:
                self.link.note(f"recovering: {error}")
        return f"the device did not answer any more after {after}"

    def leave(self, failed: str) -> str:
        return self.recover(failed) if failed else ""

    def excuse(self, result: Result) -> Result:
        return self._rules.judge(result)

    def complete(self, run: Run) -> Run:
        return replace(
            run,
            title=self._title,
            claims=self._peer.claims if self._known else None,
            profile=self._rules.profile,
            stale=self._rules.stale(run.results, run.asked),
            lossy=self.link.lossy,
        )
