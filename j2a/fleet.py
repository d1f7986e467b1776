"""Several boards at once, each known by its identity, which come and go.

What flows in: URLs, and what the USB tells about boards. What flows out: a client for each board
that is there, the samples of all of them, and who has come or gone.
Rules: each board has a thread of its own, which opens it, watches it and opens it again, so that
none waits for another (thesis section 9.4). Two boards never share an identity: that of the second
one has its place behind it, and a warning says so.
"""

import threading
from collections.abc import Callable
from time import monotonic
from typing import TYPE_CHECKING, Any, Self

from j2a.client import Client, connect
from j2a.errors import J2AError, LocalError, OpenFailed, Outcome
from j2a.events import Sample
from j2a.io.bell import Bell
from j2a.io.blocking_transducers import Actuator, Sensor
from j2a.io.fleet_base import FleetBase, by_url
from j2a.io.handlers import ErrorHook
from j2a.io.streams import SifStream, slice_of
from j2a.io.threads import JOIN_S, join_threads, process, start_thread
from j2a.protocol.arguments import check_timeout
from j2a.protocol.roster import BoardChange, Heartbeat, Member, wanted_boards

if TYPE_CHECKING:
    from j2a.timed import FleetAt

__all__ = ["BoardChange", "Fleet", "by_serial", "by_url"]


def by_serial(client: Client) -> str:
    """Return the property `serial` of a board; its URL where it has none."""
    return client.properties.get("serial") or client.url


class Fleet(FleetBase[Client, "_Member", SifStream]):
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
            `by_url` is another one. It runs in the thread of the board. Where another board here
            has the same one, "@" and the URL, on the USB the path of ports, follow it.
        timeout: the time limit of a call, in seconds; see `j2a.connect`.
        boot_time: for how long a board may take to answer when it is opened, in seconds.
        retry: seconds between two tries to open a board.
        heartbeat: seconds without any frame after which a board is asked for an echo; if it
            answers neither of two, it is taken for gone. None asks nothing.
        on_handler_error: called with an exception that a handler raised, and the sample or change;
            without it the exception is logged.

    Raises:
        BadUrl: a URL can never be opened.
        LocalError: another argument is wrong.
    """

    _stream_class = SifStream

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
        super().__init__(timeout, boot_time, retry, heartbeat, on_handler_error)
        self._identify = identify
        self._changed = threading.Condition(self._lock)
        self._threads: list[threading.Thread] = []
        self._running: dict[_Member, None] = {}  # also those that were taken out and still end
        self._process = process.pid
        try:
            for url in urls:
                self.add(url)
            if usb:
                self._threads.append(self._watch_usb(lambda function, *args: function(*args)))
        except BaseException:
            self.close()
            raise

    # ------------------------------------------------------------------ boards

    def add(self, url: str) -> None:
        """Take in a board; returns at once, and a thread opens it.

        Raises:
            BadUrl: the URL can never be opened.
            LocalError: the fleet has the URL, or is closed.
        """
        with self._lock:
            self._check_new(url)
            member = _Member(self, url)
            member.start()
            self._roster.members[url] = member

    @property
    def transducers(self) -> dict[tuple[str, str], Sensor | Actuator]:
        """The transducers of all boards that are here, by the board's identity and their name."""
        return self._transducers()

    def at(self, time_us: int, *, within_us: float = 10_000.0) -> "FleetAt":
        """Return what gives orders to several boards for a time, such as `at(t).set("lamp", True)`.

        Args:
            time_us: when, in microseconds since 1970 on the clock of this computer.
            within_us: by so much each board may be off at that time, in microseconds. Orders are
                refused where that is not sure: after few exchanges with a board nobody knows its
                rate, and it may be off by 1 % of the time until then.
        """
        from j2a.timed import FleetAt  # noqa: PLC0415 - few programs need it

        return FleetAt(self, time_us, within_us)

    def wait(self, *boards: str | int, timeout: float = 10.0) -> None:
        """Wait until boards are here.

        Args:
            boards: identities, or one number: of boards, whichever they are.
            timeout: the time limit in seconds.

        Raises:
            CallTimeout: not all are here in time; it says which, and why.
            LinkClosed: the fleet is closed.
        """
        names, least = wanted_boards(boards)
        deadline = monotonic() + check_timeout(timeout)
        with self._changed:
            while missing := self._roster.missing(names, least):
                left_s = deadline - monotonic()
                if left_s <= 0:
                    raise self._roster.late(missing, timeout)
                self._changed.wait(min(left_s, slice_of(is_simulated=False)))

    # ------------------------------------------------------------------ end

    def close(self) -> None:
        """Close all boards. May be called twice, and by handlers.

        A board that is just being opened is given up in its own thread, at the latest after
        `boot_time`. In a child process it does nothing: the boards are the parent's.
        """
        if process.pid != self._process:
            return  # another thread may have held the lock when the process was forked
        with self._lock:
            if self._roster.is_closed:
                return
            members = self._roster.close()
            self._notify()
        if self._usb is not None:
            self._usb.close()
        for member in members:
            member.ask_to_stop()
        # A thread that waits for this one cannot end before.
        current = threading.current_thread()
        running = list(self._running)
        boards = [one.thread for one in running if one.is_open and one.dispatcher is not current]
        join_threads([*self._threads, *boards], JOIN_S)
        self._finish()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()

    # ------------------------------------------------------------------ machinery

    def _notify(self) -> None:
        self._changed.notify_all()

    def _deliver(self, sample: Sample) -> None:
        for deliver in self._takers(sample.name):
            self._call(deliver, sample)

    def _tell(self, change: BoardChange | None) -> None:
        if change is not None:
            for deliver in self._changes.matching():
                self._call(deliver, change)

    def _call(self, handler: Callable[[Any], Any], event: Sample | BoardChange) -> None:
        try:
            handler(event)
        except BaseException as error:
            # Also sys.exit(): it would end the thread of the board, which nobody would open again.
            self._reporter.report(error, event)


class _Member(Member[Client]):
    """One URL of a fleet, and the thread that keeps it open.

    Attributes:
        is_open: it is not just being opened.
        thread: does all this.
        dispatcher: the thread of the SIF handlers of its client.
    """

    def __init__(self, fleet: Fleet, url: str) -> None:
        super().__init__(url)
        self._fleet = fleet
        self._wake = Bell()  # the link has ended, or the member shall
        self.is_open = False
        self.thread = threading.current_thread()
        self.dispatcher: object = None

    def start(self) -> None:
        self.thread = start_thread(self._work, f"j2a fleet {self.url}")

    def ask_to_stop(self) -> None:
        super().ask_to_stop()
        self._wake.ring()

    def _work(self) -> None:
        self._fleet._running[self] = None
        try:
            self._run()
        finally:
            del self._fleet._running[self]

    def _run(self) -> None:
        fleet = self._fleet
        while not self.is_stopped:
            board: str | None = None
            reason: J2AError | None = None
            try:
                with self._connect() as client:
                    self.dispatcher = client._engine.dispatcher
                    self.is_open = True
                    change = fleet._come(self, client, str(fleet._identify(client)))
                    board = change.board
                    fleet._tell(change)
                    reason = self._watch(client)
            except J2AError as error:
                reason = error
            except BaseException as error:  # of `identify`, which is the user's; also sys.exit()
                reason = LocalError(f"identify failed: {type(error).__name__}: {error}")
            fleet._tell(fleet._go(self, board, reason))
            self._wake.wait(0)  # the end of that client has rung it
            if not self.is_stopped:
                self._wake.wait(min(fleet._retry_s, threading.TIMEOUT_MAX))

    def _connect(self) -> Client:
        self.is_open = False
        client = connect(self.url, timeout=self._fleet._timeout, boot_time=self._fleet._boot_time)
        client._handlers.at_end(lambda reason: self._wake.ring())
        return client

    def _watch(self, client: Client) -> J2AError:
        """Wait until the link has ended, or nothing comes; return why."""
        heartbeat = Heartbeat()
        while not self.is_stopped and client.is_open:
            heartbeat.begin(client.counters.frames_received)
            if self._wake.wait(min(self._fleet._heartbeat_s, threading.TIMEOUT_MAX)):
                continue
            if not heartbeat.is_silent(client.counters.frames_received):
                continue
            try:
                client.echo(timeout=self._fleet._echo_s)
                heartbeat.answered()
            except J2AError as error:
                if heartbeat.failed(error, is_open=client.is_open):
                    return error
        return client._session.end_reason or OpenFailed("taken out", outcome=Outcome.NOT_SENT)
