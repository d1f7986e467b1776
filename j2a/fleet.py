"""Several boards at once, each known by its identity, which come and go.

What flows in: URLs, and what the USB tells about boards. What flows out: a client for each board
that is there, the samples of all of them, and who has come or gone.
Rules: each board has a thread of its own, which opens it, watches it and opens it again, so that
none waits for another (thesis section 9.4). Two boards never share an identity: the second one is
left out, and `problems` says why.
"""

import contextlib
import logging
import math
import threading
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from time import monotonic
from typing import Any, Final, Self

import j2a_transports

from j2a.client import Client, connect
from j2a.errors import (
    CallTimeout,
    J2AError,
    LinkClosed,
    LinkError,
    LocalError,
    OpenFailed,
    Outcome,
    UnknownBoard,
)
from j2a.events import Sample
from j2a.io.handlers import ErrorHook, Handlers, Reporter, Subscription
from j2a.io.opening import TRANSPORT_ERRORS, link_error
from j2a.io.samples import WantedSamples
from j2a.io.streams import MAX_SIFS, SifStream, slice_of
from j2a.io.threads import JOIN_S, join_threads, start_thread
from j2a.io.transducers import Actuator, Sensor
from j2a.protocol.arguments import check_timeout

__all__ = ["BoardChange", "Fleet", "by_serial", "by_url"]

_logger = logging.getLogger("j2a")
_SILENT_AFTER: Final = 2
"""So many echoes in a row that get no answer end a link."""


@dataclass(frozen=True, slots=True)
class BoardChange:
    """A board of a fleet has come or gone, or cannot be opened.

    Attributes:
        board: its identity; None where it never told one.
        url: of the board.
        is_here: it can be used now.
        reason: why it is not; None where it is, or was taken out of the fleet.
    """

    board: str | None
    url: str
    is_here: bool
    reason: J2AError | None = None


def by_serial(client: Client) -> str:
    """Return the property `serial` of a board; its URL where it has none."""
    return client.properties.get("serial") or client.url


def by_url(client: Client) -> str:
    """Return the URL of a board, which on the USB has its serial number or the path of ports."""
    return client.url


class Fleet(Mapping[str, Client]):
    """The boards that are there, by their identity: a mapping from it to each one's client.

    Example::

        with j2a.Fleet(left_url, right_url) as fleet:
            fleet.wait(2)
            for sample in fleet.samples("quad"):
                print(sample.board, sample.values)

    A board that is not there, that falls silent or is unplugged is tried again for as long as the
    fleet is open. `Sample.board` is the identity. All methods may be called from any thread.

    Args:
        urls: of the boards; `add` takes more.
        usb: take in every J2A board on the USB, and those that are plugged in later.
        identify: returns the identity of a board, from its client; `by_serial` if not given,
            `by_url` is another one. It runs in the thread of the board.
        timeout: the time limit of a call, in seconds; see `j2a.connect`.
        boot_time: for how long a board may take to answer when it is opened, in seconds.
        retry: seconds between two tries to open a board.
        heartbeat: seconds without any frame after which a board is asked for an echo; one that
            answers to none of two is taken for gone. None asks nothing.
        on_handler_error: called with an exception that a handler raised, and the sample or change;
            without it the exception is logged.

    Raises:
        BadUrl: a URL is of no scheme that is known.
        LocalError: another argument is wrong.
    """

    def __init__(
        self,
        *urls: str,
        usb: bool = False,
        identify: Callable[[Client], str] = by_serial,
        timeout: float = 1.0,
        boot_time: float = 5.0,
        retry: float = 1.0,
        heartbeat: float | None = 5.0,
        on_handler_error: ErrorHook | None = None,
    ) -> None:
        self._identify = identify
        self._timeout = check_timeout(timeout)
        self._boot_time = check_timeout(boot_time)
        self._retry_s = check_timeout(retry)
        self._heartbeat_s = math.inf if heartbeat is None else check_timeout(heartbeat)
        self._reporter = Reporter(on_handler_error)
        self._changed = threading.Condition()
        self._members: dict[str, _Member] = {}  # by URL
        self._here: dict[str, _Member] = {}  # by identity, those with a client
        self._samples: defaultdict[str | None, Handlers[Any]] = defaultdict(Handlers)
        self._changes: Handlers[Any] = Handlers()
        self._is_closed = False
        self._usb: j2a_transports.UsbWatch | None = None
        self._threads: list[threading.Thread] = []
        try:
            for url in urls:
                self.add(url)
            if usb:
                self._watch_usb()
        except BaseException:
            self.close()
            raise

    # ------------------------------------------------------------------ boards

    def add(self, url: str) -> None:
        """Take in a board; returns at once, and a thread opens it.

        Raises:
            BadUrl: the URL is of no scheme that is known.
            LocalError: the fleet has the URL, or is closed.
        """
        if not isinstance(url, str):
            raise LocalError(f"a URL is a text such as 'serial:///dev/ttyACM0', not {url!r:.60}")
        try:
            j2a_transports.innermost(url)
        except j2a_transports.TransportError as error:
            raise link_error(error) from None
        member = _Member(self, url)
        with self._changed:
            if self._is_closed:
                raise LocalError("the fleet is closed")
            if url in self._members:
                raise LocalError(f"the fleet has {url}; remove it first to open it anew")
            member.start()
            self._members[url] = member

    def remove(self, board: str) -> None:
        """Close a board and try it no more; its thread does so at once.

        Args:
            board: its identity or its URL.

        Raises:
            UnknownBoard: the fleet has no such board.
        """
        with self._changed:
            here = self._here.pop(board, None)
            member = self._members.pop(board if here is None else here.url, None)
            self._changed.notify_all()
        if member is None:
            raise UnknownBoard(f"the fleet has no board {board!r:.80}")
        member.ask_to_stop()

    def __getitem__(self, board: str) -> Client:
        with self._changed:
            member = self._here.get(board)
            if member is not None and member.client is not None:
                return member.client
            here = ", ".join(sorted(self._here)) or "none"
        raise UnknownBoard(f"board {board!r:.80} is not here, but {here}; `problems` may say why")

    def __iter__(self) -> Iterator[str]:
        with self._changed:
            return iter(list(self._here))

    def __len__(self) -> int:
        return len(self._here)

    @property
    def problems(self) -> dict[str, J2AError]:
        """Why boards are not here, by URL."""
        with self._changed:
            members = list(self._members.values())
        return {one.url: one.problem for one in members if one.problem is not None}

    @property
    def transducers(self) -> dict[tuple[str, str], Sensor | Actuator]:
        """The transducers of all boards that are here, by the board's identity and their name."""
        with self._changed:
            here = {board: one.client for board, one in self._here.items() if one.client}
        found: dict[tuple[str, str], Sensor | Actuator] = {}
        for board, client in here.items():
            with contextlib.suppress(LinkError):  # has just gone
                found |= {(board, name): one for name, one in client.transducers.items()}
        return found

    def wait(self, *boards: str | int, timeout: float = 10.0) -> None:
        """Wait until boards are here.

        Args:
            boards: identities, or one number: of boards, whichever they are.
            timeout: the time limit in seconds.

        Raises:
            CallTimeout: not all are here in time; it says which, and why.
            LinkClosed: the fleet is closed.
        """
        numbers = [one for one in boards if isinstance(one, int)]
        names = [one for one in boards if isinstance(one, str)]
        if len(numbers) + len(names) != len(boards) or len(numbers) > 1:
            raise LocalError(f"wait takes identities, or one number of boards, not {boards!r:.80}")
        deadline = monotonic() + check_timeout(timeout)
        least = numbers[0] if numbers else 0
        with self._changed:
            while True:
                if self._is_closed:
                    raise LinkClosed("the fleet is closed", outcome=Outcome.NOT_SENT)
                missing = [name for name in names if name not in self._here]
                if not missing and len(self._here) >= least:
                    return
                left_s = deadline - monotonic()
                if left_s <= 0:
                    break
                self._changed.wait(min(left_s, slice_of(is_simulated=False)))
            count = len(self._here)
        what = f"no board {', '.join(missing)}" if missing else f"{count} of {least} boards"
        why = "".join(f"; {url}: {error}" for url, error in self.problems.items())
        raise CallTimeout(f"{what} within {timeout:g} s{why}", outcome=Outcome.NOT_SENT)

    def on_change(
        self, handler: Callable[[BoardChange], object]
    ) -> Subscription[Callable[[BoardChange], object]]:
        """Have a function called when a board has come or gone, or cannot be opened.

        It runs in the thread of the board. To hear of all, register it before `add`.

        Returns: an object whose `cancel()` ends it.
        """
        return self._changes.add(None, handler)

    # ------------------------------------------------------------------ samples

    def on_sample(
        self, handler: Callable[[Sample], object], name: str | None = None
    ) -> Subscription[Callable[[Sample], object]]:
        """Have a function called with each sample of each board.

        Samples of one board come in order, in the thread of its SIF handlers; those of several
        boards come side by side.

        Args:
            handler: takes a Sample.
            name: of the transducer; None for all.

        Returns: an object whose `cancel()` ends it.
        """
        with self._changed:
            return self._samples[name].add(None, handler)

    def samples(self, name: str | None = None, *, max_waiting: int = MAX_SIFS) -> SifStream:
        """Return the samples of all boards that come from now on, to iterate over.

        The iteration ends when the fleet is closed, and not with a board.

        Args:
            name: of the transducer; None for all.
            max_waiting: so many may wait; then the oldest are dropped, and counted in `lost`.
        """
        with self._changed:
            handlers = self._samples[name]
        return SifStream(
            handlers,
            None,
            monotonic,
            came=threading.Event(),
            max_waiting=max_waiting,
            dispatcher=None,
            slice_s=slice_of(is_simulated=False),
        )

    # ------------------------------------------------------------------ end

    def close(self) -> None:
        """Close all boards. May be called twice.

        A board that is just being opened is given up in its own thread, at the latest after
        `boot_time`.
        """
        with self._changed:
            if self._is_closed:
                return
            self._is_closed = True
            members = list(self._members.values())
            self._members.clear()
            self._changed.notify_all()
        if self._usb is not None:
            self._usb.close()
        for member in members:
            member.ask_to_stop()
        join_threads([*self._threads, *(one.thread for one in members if one.is_open)], JOIN_S)
        reason = LinkClosed("the fleet was closed", outcome=Outcome.NOT_SENT)
        with self._changed:
            handlers = [*self._samples.values(), self._changes]
        for one in handlers:
            one.finish(reason)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<j2a.Fleet {len(self)} of {len(self._members)} boards are here>"

    # ------------------------------------------------------------------ machinery

    def _watch_usb(self) -> None:
        try:
            self._usb = j2a_transports.watch_usb()
        except TRANSPORT_ERRORS as error:
            raise link_error(error) from None
        self._threads.append(start_thread(self._follow_usb, "j2a fleet usb"))

    def _follow_usb(self) -> None:
        watch = self._usb
        assert watch is not None
        try:
            for event in watch:
                with contextlib.suppress(LocalError):  # given as a URL, too, or gone already
                    if isinstance(event, j2a_transports.UsbArrived):
                        self.add(event.board.url)
                    else:
                        self.remove(event.board.url)
        except TRANSPORT_ERRORS:
            if not self._is_closed:
                _logger.exception("the boards on the USB are watched no more")

    def _join(self, member: "_Member", client: Client) -> str:
        """Let a board be here; returns its identity.

        Raises:
            LocalError: another board has the same identity.
        """
        board = str(self._identify(client))
        client._source.board = board
        with self._changed:
            other = self._here.get(board)
            if other is not None:
                raise LocalError(
                    f"{other.url} has the identity {board!r} already: give each board a serial "
                    "number, or use identify=j2a.fleet.by_url"
                )
            if member.is_stopped:
                raise LinkClosed("taken out of the fleet", outcome=Outcome.NOT_SENT)
            client._handlers.add(WantedSamples(client._source), self._deliver)
            member.client = client
            self._here[board] = member
            self._changed.notify_all()
        self._tell(BoardChange(board, member.url, is_here=True))
        return board

    def _leave(self, member: "_Member", board: str | None, reason: J2AError | None) -> None:
        with self._changed:
            if board is not None and self._here.get(board) is member:
                del self._here[board]
            member.client = None
            self._changed.notify_all()
        self._tell(BoardChange(board, member.url, is_here=False, reason=reason))

    def _deliver(self, sample: Sample) -> None:
        for name in (None, sample.name):
            handlers = self._samples.get(name)
            for deliver in handlers.matching() if handlers is not None else ():
                self._call(deliver, sample)

    def _tell(self, change: BoardChange) -> None:
        for deliver in self._changes.matching():
            self._call(deliver, change)

    def _call(self, handler: Callable[[Any], Any], event: Sample | BoardChange) -> None:
        try:
            handler(event)
        except Exception as error:  # a handler of the user may raise anything
            self._reporter.report(error, event)


class _Member:
    """One URL of a fleet, and the thread that keeps it open.

    Attributes:
        url: of the board.
        problem: why the board is not here; None where it is, or was not tried yet.
        client: of the board; None where it is not here.
        is_stopped: it shall end.
        is_open: it is not just being opened.
        thread: does all this.
    """

    def __init__(self, fleet: Fleet, url: str) -> None:
        self.url = url
        self.problem: J2AError | None = None
        self._fleet = fleet
        self._wake = threading.Event()  # the link has ended, or the member shall
        self.is_stopped = False
        self.client: Client | None = None
        self.is_open = False
        self.thread = threading.current_thread()

    def start(self) -> None:
        self.thread = start_thread(self._run, f"j2a fleet {self.url}")

    def ask_to_stop(self) -> None:
        self.is_stopped = True
        self._wake.set()

    def _run(self) -> None:
        while not self.is_stopped:
            board: str | None = None
            reason: J2AError | None = None
            try:
                with self._connect() as client:
                    self.is_open = True
                    board = self._fleet._join(self, client)
                    self.problem = None
                    reason = self._watch(client)
            except J2AError as error:
                reason = error
            except Exception as error:  # of `identify`, which is the user's
                reason = LocalError(f"identify failed: {type(error).__name__}: {error}")
            self.is_open = False
            is_new = board is not None or str(reason) != str(self.problem)
            self.problem = reason
            if is_new:
                self._fleet._leave(self, board, None if self.is_stopped else reason)
            self._wake.clear()  # the end of that client has set it
            if not self.is_stopped:
                self._wake.wait(min(self._fleet._retry_s, threading.TIMEOUT_MAX))

    def _connect(self) -> Client:
        client = connect(self.url, timeout=self._fleet._timeout, boot_time=self._fleet._boot_time)
        client._handlers.at_end(lambda reason: self._wake.set())
        return client

    def _watch(self, client: Client) -> J2AError:
        """Wait until the link has ended, or nothing comes; return why."""
        silent = 0
        while not self.is_stopped and client.is_open:
            received = client.counters.frames_received
            if self._wake.wait(min(self._fleet._heartbeat_s, threading.TIMEOUT_MAX)):
                if not self.is_stopped and client.is_open:
                    self._wake.clear()
                continue
            if client.counters.frames_received != received:
                silent = 0
                continue
            try:
                client.echo()
                silent = 0
            except CallTimeout as error:
                silent += 1
                if silent == _SILENT_AFTER:
                    return error
            except J2AError as error:
                if not client.is_open:
                    return error
                silent = 0  # refused, so it is there
        return client._session.end_reason or OpenFailed("taken out", outcome=Outcome.NOT_SENT)
