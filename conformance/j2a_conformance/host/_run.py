"""Runs cases against a host and makes a `Run` of it.

What flows in: where the host connects, and cases. What flows out: a `Run`, as for a device. Rules:
one host program for the whole run as long as it behaves; after a failure it is started anew.
"""

from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import replace

from j2a_transports import TransportError

from j2a_conformance._judge import Judged
from j2a_conformance._model import HarnessError, Result, Run
from j2a_conformance._retry import Retry
from j2a_conformance._runner import ATTEMPTS, Testee, judge

from ._case import HostCase
from ._device import DEMO
from ._host import Host
from ._program import Listening
from ._start import START
from .cases import load

__all__ = ["run"]


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
    return judge(
        lambda: _HostProgram(Host(place, DEMO, timeout_scale)),
        cases,
        load(),
        url=url,
        stop_on_failure=stop_on_failure,
        on_result=on_result,
    )


class _HostProgram(Testee[HostCase]):
    """The host program while cases run."""

    start = (START,)

    def __init__(self, host: Host) -> None:
        self.link = host.link
        self.retry = Retry(ATTEMPTS)
        self._host = host

    def close(self) -> None:
        self._host.close()

    def run(self, case: HostCase) -> None:
        case.run(self._host)

    def recover(self, after: str) -> str:
        """Start the program anew, or wait until the host connects again."""
        try:
            self._host.restart()
        except (Judged, TransportError, HarnessError) as error:
            return f"the host did not come back after {after}: {error}"
        return ""

    def leave(self, failed: str) -> str:
        if not failed:
            with suppress(Judged, TransportError):  # one that has gone already misses nothing
                self._host.job("bye")
        return ""

    def complete(self, run: Run) -> Run:
        return replace(run, title=self._host.title, role="host")
