"""The common base of both kinds of fleet, without the waiting.

What flows in: the options of a fleet, and clients of boards that have come. What flows out: the
boards that are here as a mapping, and who takes samples and changes.
Rule: the lock guards the roster; nothing waits while it is held.
"""

import logging
import math
import threading
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping
from time import monotonic
from typing import Any, Generic, TypeVar

import j2a_transports
from j2a_spec.nearest import did_you_mean
from j2a_spec.printable import printable

from j2a.errors import (
    J2AError,
    LinkClosed,
    LocalError,
    OpenFailed,
    Outcome,
    UnknownTransducer,
)
from j2a.events import Sample
from j2a.io.client_base import ClientBase
from j2a.io.handlers import ErrorHook, Handlers, Reporter, Subscription
from j2a.io.opening import TRANSPORT_ERRORS, link_error
from j2a.io.samples import WantedSamples
from j2a.io.streams import MAX_SIFS, SifStreamBase, slice_of
from j2a.io.threads import start_thread
from j2a.protocol.arguments import check_timeout
from j2a.protocol.roster import BoardChange, Member, Roster

__all__ = ["FleetBase", "by_url"]

_logger = logging.getLogger("j2a")
_ClientT = TypeVar("_ClientT", bound=ClientBase[Any])
_MemberT = TypeVar("_MemberT", bound=Member[Any])
_StreamT = TypeVar("_StreamT", bound=SifStreamBase)


def by_url(client: ClientBase[Any]) -> str:
    """Return the URL of a board, which on the USB has its serial number or the path of ports."""
    return client.url


class FleetTransducers(dict[tuple[str, str], Any]):
    """The transducers of a fleet by the identity of the board and their name.

    Attributes:
        unknown: why boards are missing that are here: they did not tell what they have.
    """

    def __init__(self) -> None:
        super().__init__()
        self.unknown: dict[str, J2AError] = {}

    def __missing__(self, key: object) -> Any:
        """Say what is near a key that is not there.

        Raises:
            UnknownTransducer: always.
        """
        known = [f'["{board}", "{name}"]' for board, name in self]
        asked = ", ".join(f'"{part}"' for part in key) if isinstance(key, tuple) else repr(key)
        hint = did_you_mean(f"[{asked}]", known, most=3, cutoff=0.0) or "no board is here"
        board: Any = key[0] if isinstance(key, tuple) and key else None
        if (error := self.unknown.get(board)) is not None:
            hint = f"what {board} has is not known: {error}"
        raise UnknownTransducer(
            f"no board has the transducer {asked}, which is named by board and name; {hint}"
        )


class FleetBase(Mapping[str, _ClientT], Generic[_ClientT, _MemberT, _StreamT]):
    """The boards that are here, by identity; each kind of fleet adds its own way of waiting."""

    _stream_class: type[_StreamT]

    def __init__(
        self,
        timeout: float,
        boot_time: float,
        retry: float,
        heartbeat: float | None,
        on_handler_error: ErrorHook | None,
    ) -> None:
        self._timeout = check_timeout(timeout)
        self._boot_time = check_timeout(boot_time)
        self._retry_s = check_timeout(retry)
        self._heartbeat_s = math.inf if heartbeat is None else check_timeout(heartbeat)
        self._reporter = Reporter(on_handler_error)
        self._lock = threading.RLock()
        self._now: Callable[[], float] = monotonic
        self._roster: Roster[_MemberT] = Roster()
        self._samples: dict[str | None, Handlers[Any]] = {}
        self._changes: Handlers[Any] = Handlers()
        self._usb: j2a_transports.UsbWatch | None = None
        self._end: LinkClosed | None = None
        # Where calls have no time limit, silence has one nevertheless.
        self._echo_s = self._heartbeat_s if self._timeout == math.inf else self._timeout

    # ------------------------------------------------------------------ boards

    def __getitem__(self, board: str) -> _ClientT:
        with self._lock:
            client: Any = self._roster.find(board).client
        found: _ClientT = client
        return found

    def __iter__(self) -> Iterator[str]:
        with self._lock:
            return iter(list(self._roster.here))

    def __len__(self) -> int:
        return len(self._roster.here)

    def __repr__(self) -> str:
        members = len(self._roster.members)
        return f"<j2a.{type(self).__name__} {len(self)} of {members} boards are here>"

    @property
    def problems(self) -> dict[str, J2AError]:
        """Why boards are not here, by URL."""
        with self._lock:
            return self._roster.problems

    def _transducers(self) -> "FleetTransducers":
        with self._lock:
            here = {board: one.client for board, one in self._roster.here.items() if one.client}
        found = FleetTransducers()
        for board, client in here.items():
            try:
                found.update({(board, name): one for name, one in client.transducers.items()})
            except J2AError as error:  # has just gone or restarted, or does not answer
                # Without the traceback, whose frames keep the client alive.
                found.unknown[board] = error.copy(str(error), error.outcome)
        return found

    def remove(self, board: str) -> None:
        """Close a board and try it no more; returns at once.

        Args:
            board: its identity or its URL.

        Raises:
            UnknownBoard: the fleet has no such board.
        """
        with self._lock:
            member = self._roster.remove(board)
            self._notify()
        member.ask_to_stop()

    def _check_new(self, url: str) -> None:
        """Refuse a URL that cannot be added.

        Raises:
            BadUrl: the URL can never be opened.
            LocalError: the fleet has the URL, or is closed.
        """
        if not isinstance(url, str):
            raise LocalError(f"a URL is a text such as 'serial:///dev/ttyACM0', not {url!r:.60}")
        try:
            j2a_transports.check(url)
        except j2a_transports.TransportError as error:
            raise link_error(error) from None
        with self._lock:
            self._roster.check_new(url)

    @abstractmethod
    def _notify(self) -> None:
        """Wake those who wait for boards; the lock is held."""

    # ------------------------------------------------------------------ handlers and streams

    def on_change(
        self, handler: Callable[[BoardChange], object]
    ) -> Subscription[Callable[[BoardChange], object]]:
        """Have a function called when a board has come or gone, or cannot be opened.

        It runs in the thread or task of the board. To hear of all, register it before `add`.

        Returns: an object whose `cancel()` ends it.
        """
        return self._changes.add(None, handler)

    def on_sample(
        self, handler: Callable[[Sample], object], name: str | None = None
    ) -> Subscription[Callable[[Sample], object]]:
        """Have a function called with each sample of each board.

        Samples of one board come in order, in the thread or task of its SIF handlers; those of
        several boards come side by side. A coroutine function of an `AsyncFleet` is awaited before
        the next one, which holds up no other board.

        Args:
            handler: takes a Sample.
            name: of the transducer; None for all.

        Returns: an object whose `cancel()` ends it.
        """
        with self._lock:
            return self._samples_of(name).add(None, handler)

    def samples(self, name: str | None = None, *, max_waiting: int = MAX_SIFS) -> _StreamT:
        """Return the samples of all boards that come from now on, to iterate over.

        The iteration ends when the fleet is closed, and not with a board.

        Args:
            name: of the transducer; None for all.
            max_waiting: so many may wait; then the oldest are dropped, and counted in `lost`.
        """
        with self._lock:
            return self._stream(self._samples_of(name), max_waiting)

    def _samples_of(self, name: str | None) -> Handlers[Any]:
        handlers = self._samples.setdefault(name, Handlers())
        if self._end is not None:
            handlers.finish(self._end)
        return handlers

    def changes(self, *, max_waiting: int = MAX_SIFS) -> _StreamT:
        """Return the changes from now on, to iterate over: `BoardChange`s, as of `on_change`."""
        return self._stream(self._changes, max_waiting)

    def _stream(self, handlers: Handlers[Any], max_waiting: int) -> _StreamT:
        return self._stream_class(
            handlers,
            None,
            self._now,
            max_waiting=max_waiting,
            dispatcher=None,
            slice_s=slice_of(is_simulated=False),
        )

    # ------------------------------------------------------------------ members

    def _come(self, member: _MemberT, client: _ClientT, board: str) -> BoardChange:
        """Let a board be here; what is told of it has its identity in the fleet.

        Raises:
            LocalError: another board has the same identity, even with the place.
            LinkClosed: it was taken out meanwhile.
        """
        with self._lock:
            is_new_twin = self._roster.is_new_twin(member, board)
            identity = client._source.board = self._roster.identity(member, board)
            change = self._roster.come(member, client, identity)
            client._handlers.add(WantedSamples(client._source), self._deliver)
            self._notify()
        if is_new_twin:
            _logger.warning(
                "%s has the identity %r of another board, and is called %r: give each board a "
                "serial number, or use identify=j2a.fleet.by_url",
                *(printable(text) for text in (member.url, board, identity)),
            )
        return change

    def _go(
        self, member: _MemberT, board: str | None, reason: J2AError | None
    ) -> BoardChange | None:
        """Let a board be gone; returns what is to be told."""
        with self._lock:
            change = self._roster.go(member, board, reason)
            self._notify()
        return change

    @abstractmethod
    def _deliver(self, sample: Sample) -> object:
        """Call the handlers of a sample."""

    def _takers(self, name: str) -> Iterator[Callable[[Any], Any]]:
        """Yield what is called with the samples of a transducer."""
        for key in (None, name):
            handlers = self._samples.get(key)
            if handlers is not None:
                yield from handlers.matching()

    def _finish(self) -> None:
        """Tell those who wait for samples or changes that none will come any more."""
        reason = LinkClosed("the fleet was closed", outcome=Outcome.NOT_SENT)
        with self._lock:
            self._end = reason
            handlers = [*self._samples.values(), self._changes]
        for one in handlers:
            one.finish(reason)

    # ------------------------------------------------------------------ USB

    def _watch_usb(self, run: Callable[..., object]) -> threading.Thread:
        """Watch the boards on the USB in a thread; libusb can only be asked.

        Args:
            run: calls a function with arguments, where `add` and `remove` may be called.

        Raises:
            OpenFailed: the USB cannot be watched.
        """
        try:
            watch = self._usb = j2a_transports.watch_usb()
        except TRANSPORT_ERRORS as error:
            raise link_error(error) from None

        def follow() -> None:
            try:
                for event in watch:
                    has_come = isinstance(event, j2a_transports.UsbArrived)
                    run(_try, self.add if has_come else self.remove, event.board.url)
            except TRANSPORT_ERRORS:
                if not self._roster.is_closed:
                    _logger.exception("the boards on the USB are watched no more")

        try:
            return start_thread(follow, "j2a fleet usb")
        except OpenFailed:
            watch.close()
            raise

    @abstractmethod
    def add(self, url: str) -> None:
        """Take in a board."""


def _try(change: Callable[[str], None], url: str) -> None:
    """Follow a board on the USB, unless the user has given its URL, too, or has removed it."""
    try:
        change(url)
    except LocalError:
        pass
    except OpenFailed as error:  # the system has no thread to give
        _logger.warning("%s was plugged in, but is not opened: %s", url, error)
