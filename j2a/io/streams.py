"""SIFs as iterators, for those who wait for them in place of being called.

What flows in: SIFs from the handlers' thread or task. What flows out: the same, in order.
Rules: so many SIFs wait at most; beyond that the oldest are dropped, or the newest, and counted. A
stream that nobody uses any more ends its subscription. A lost link is an error, a closed one the
end.
"""

import threading
import weakref
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from typing import Any, Final, Self

from j2a.errors import CallTimeout, J2AError, LinkClosed, LocalError, Outcome
from j2a.events import Sif
from j2a.io.bell import Bell
from j2a.io.handlers import Handlers, Wanted
from j2a.io.opening import WAIT_S
from j2a.io.threads import process
from j2a.protocol.arguments import check_timeout

__all__ = ["MAX_SIFS", "SifStream", "SifStreamBase", "slice_of"]

MAX_SIFS: Final = 4096
"""So many SIFs wait in a stream unless its user says otherwise."""

_SLICE_S: Final = 0.01
"""Where time is simulated, a wait looks at it so often, in seconds of real time."""


class SifStreamBase(ABC):
    """What both kinds have in common: the SIFs that wait, and the subscription.

    Args:
        handlers, wanted: which SIFs.
        now: the time of the link, in seconds.
        max_waiting: so many SIFs wait at most.
        dispatcher: the thread or task of the SIF handlers.
        slice_s: a wait looks at the time so often, in seconds.
        drops_newest: if too many wait, the newest are dropped in place of the oldest.

    Attributes:
        lost: SIFs that were dropped because too many waited.
    """

    def __init__(
        self,
        handlers: Handlers[Any],
        wanted: Wanted,
        now: Callable[[], float],
        *,
        max_waiting: int,
        dispatcher: object,
        slice_s: float,
        drops_newest: bool = False,
    ) -> None:
        if not isinstance(max_waiting, int) or max_waiting < 1:
            raise LocalError(f"max_waiting is a number of SIFs from 1 on, not {max_waiting!r}")
        self.lost = 0
        self._pid = process.pid
        self._dispatcher = dispatcher
        self._slice_s = slice_s
        self._now = now
        self._sifs: deque[Sif] = deque()
        self._max_waiting = max_waiting
        self._drops_newest = drops_newest
        self._reason: J2AError | None = None
        stream = weakref.ref(self)
        subscription = handlers.add(wanted, lambda sif: _put(stream, sif))
        forget = handlers.at_end(lambda reason: _end(stream, reason))
        self._release = weakref.finalize(self, _release, subscription.cancel, forget)

    def close(self) -> None:
        """Take no more SIFs. Those that have come can still be read; may be called twice."""
        self._release()
        self._end(LinkClosed("the stream was closed"))

    @abstractmethod
    def _tell(self) -> None:
        """Wake who waits: a SIF has come, or none will come any more."""

    def _put(self, sif: Sif) -> None:
        if len(self._sifs) >= self._max_waiting:
            self.lost += 1
            if self._drops_newest:
                return
            self._sifs.popleft()
        self._sifs.append(sif)
        self._tell()

    def _end(self, reason: J2AError) -> None:
        self._reason = self._reason or reason
        self._tell()

    def _take(self) -> Sif | None:
        """Return the next SIF, or None if none has come.

        Raises:
            J2AError: none will come any more, also in a process that was forked since.
        """
        if process.pid != self._pid:
            raise LocalError(
                "what is iterated here was made before this process was forked, and nothing comes "
                "in the child: connect again there"
            )
        try:
            return self._sifs.popleft()
        except IndexError:
            if self._reason is not None:
                raise self._reason.copy(str(self._reason), self._reason.outcome) from None
            return None

    def _check_time(self, timeout: float, deadline: float) -> float:
        left_s = deadline - self._now()
        if left_s <= 0:
            raise CallTimeout(f"no SIF came within {timeout:g} s", outcome=Outcome.NOT_SENT)
        return left_s


def _put(stream: weakref.ref[SifStreamBase], sif: Sif) -> None:
    if (one := stream()) is not None:
        one._put(sif)


def _end(stream: weakref.ref[SifStreamBase], reason: J2AError) -> None:
    if (one := stream()) is not None:
        one._end(reason)


def _release(*releases: Callable[[], None]) -> None:
    for release in releases:
        release()


class SifStream(SifStreamBase):
    """SIFs of a blocking client; see `Client.sifs`."""

    def __init__(
        self, handlers: Handlers[Any], wanted: Wanted, now: Callable[[], float], **options: Any
    ) -> None:
        self._bell = Bell()
        super().__init__(handlers, wanted, now, **options)

    def _tell(self) -> None:
        self._bell.ring()

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> Sif:
        """Wait for the next SIF; the iteration ends when this program closes the client.

        Raises:
            LinkError: the link is lost.
        """
        try:
            return self.wait(float("inf"))
        except LinkClosed:
            raise StopIteration from None

    def wait(self, timeout: float) -> Sif:
        """Return the next SIF.

        Args:
            timeout: the time limit in seconds; `math.inf` waits for ever.

        Raises:
            CallTimeout: none came in time.
            LinkError: the link is lost, or closed.
        """
        if threading.current_thread() is self._dispatcher:
            raise LocalError("a SIF handler cannot wait for a SIF, which comes when it has ended")
        deadline = self._now() + check_timeout(timeout)
        try:
            while (sif := self._take()) is None:
                self._bell.wait(min(self._check_time(timeout, deadline), self._slice_s))
            return sif
        finally:
            if self._sifs or self._reason is not None:
                self._bell.ring()  # another thread may wait for the next one, or for the end

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()


def slice_of(is_simulated: bool) -> float:
    """Return how long a wait may last before it looks at the time, in seconds."""
    return _SLICE_S if is_simulated else WAIT_S
