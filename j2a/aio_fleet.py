"""Several boards in one event loop; `j2a.fleet` for asyncio.

What flows in: URLs, and what the USB tells about boards. What flows out: a client for each board
that is there, the samples of all of them, and who has come or gone.
Rules: each board has a task of its own, which opens it, watches it and opens it again, so that none
waits for another. Where a link has a descriptor it has no thread; only opening takes one.
"""

import asyncio
import inspect
import logging
from collections.abc import Awaitable, Callable, Coroutine
from contextlib import suppress
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any, Self, TypeVar

from j2a.aio import AsyncClient, aconnect
from j2a.errors import J2AError, LocalError, OpenFailed, Outcome
from j2a.events import Sample
from j2a.io.async_calls import AsyncCalls
from j2a.io.async_streams import AsyncSifStream, is_set_within
from j2a.io.async_transducers import AsyncActuator, AsyncSensor
from j2a.io.fleet_base import FleetBase, by_url
from j2a.io.handlers import ErrorHook
from j2a.io.links import join_threads_in_loop
from j2a.io.loop import AsyncEngine
from j2a.io.threads import JOIN_S, start_or_do
from j2a.protocol.arguments import check_timeout
from j2a.protocol.roster import BoardChange, Heartbeat, Member, wanted_boards

if TYPE_CHECKING:
    from j2a.timed import AsyncFleetAt

__all__ = ["AsyncFleet", "by_serial", "by_url"]

_CLOSE_S = 2 * JOIN_S + 1.0
"""A client that is closed waits for its handlers, and then for its threads."""
_told: ContextVar[object] = ContextVar("j2a_told", default=None)
"""What is being told by the task that runs, or by the one that has begun it."""
_logger = logging.getLogger("j2a")
_ResultT = TypeVar("_ResultT")


async def by_serial(client: AsyncClient) -> str:
    """Return the property `serial` of a board; its URL where it has none."""
    return (await client.properties()).get("serial") or client.url


class AsyncFleet(FleetBase[AsyncClient, "_Member", AsyncSifStream]):
    """The boards that are there, by their identity: `j2a.Fleet` for asyncio.

    Example::

        async with j2a.AsyncFleet(left_url, right_url) as fleet:
            await fleet.wait(2)
            async for sample in fleet.samples("quad"):
                print(sample.board, sample.values)

    All methods belong to the event loop in which the fleet was made. Handlers may be coroutine
    functions.

    Args:
        urls, usb, timeout, boot_time, retry, heartbeat, on_handler_error: as of `j2a.Fleet`.
        identify: returns the identity of a board, from its client; may be a coroutine function.
            `j2a.aio_fleet.by_serial` if not given, `j2a.fleet.by_url` is another one. Equal ones
            are told apart as by `j2a.Fleet`.

    Raises:
        BadUrl: a URL can never be opened.
        LocalError: another argument is wrong, or no event loop runs.
    """

    _stream_class = AsyncSifStream

    def __init__(
        self,
        *urls: str,
        usb: bool = False,
        identify: Callable[[AsyncClient], str | Awaitable[str]] = by_serial,
        timeout: float = 1.0,
        boot_time: float = 5.0,
        retry: float = 1.0,
        heartbeat: float | None = 5.0,
        on_handler_error: ErrorHook | None = None,
    ) -> None:
        super().__init__(timeout, boot_time, retry, heartbeat, on_handler_error)
        try:
            self._loop = asyncio.get_running_loop()
        except RuntimeError:
            raise LocalError("make a j2a.AsyncFleet in a coroutine: no event loop runs") from None
        self._now = self._loop.time
        self._identify = identify
        self._calls = AsyncCalls(self._handler_failed)
        self._changed = asyncio.Event()  # replaced when it is set
        self._tasks: dict[asyncio.Task[None], _Member] = {}
        try:
            for url in urls:
                self.add(url)
            if usb:
                self._watch_usb(self._run_in_loop)
        except BaseException:
            for member in self._roster.close():
                member.ask_to_stop()
            raise

    # ------------------------------------------------------------------ boards

    def add(self, url: str) -> None:
        """Take in a board; returns at once, and a task opens it.

        Raises:
            BadUrl: the URL can never be opened.
            LocalError: the fleet has the URL, or is closed.
        """
        self._check_new(url)
        member = self._roster.members[url] = _Member(self, url)
        self._tasks[member.task] = member
        member.task.add_done_callback(self._tasks.pop)

    @property
    def transducers(self) -> dict[tuple[str, str], AsyncSensor | AsyncActuator]:
        """The transducers of all boards that are here, by the board's identity and their name."""
        return self._transducers()

    def at(self, time_us: int, *, within_us: float = 10_000.0) -> "AsyncFleetAt":
        """Return what gives orders to several boards for a time; args as of `j2a.Fleet.at`."""
        from j2a.timed import AsyncFleetAt  # noqa: PLC0415 - few programs need it

        return AsyncFleetAt(self, time_us, within_us)

    async def wait(self, *boards: str | int, timeout: float = 10.0) -> None:
        """Wait until boards are here; args and raises as of `j2a.Fleet.wait`."""
        names, least = wanted_boards(boards)
        end = self._loop.time() + check_timeout(timeout)
        while missing := self._roster.missing(names, least):
            left_s = end - self._loop.time()
            if left_s <= 0:
                raise self._roster.late(missing, timeout)
            await is_set_within(self._changed, left_s)

    # ------------------------------------------------------------------ end

    async def close(self) -> None:
        """Close all boards. May be called twice, and by handlers."""
        if self._roster.is_closed:
            return
        members = self._roster.close()
        self._notify()
        for member in members:
            member.ask_to_stop()
        # A task that waits for this cannot end before.
        current = asyncio.current_task()
        busy = [
            task
            for task, one in self._tasks.items()
            if task is not current and not one.is_in_handler
        ]
        try:
            if self._usb is not None:
                closing = start_or_do(self._usb.close, "j2a fleet usb closer")
                await join_threads_in_loop(closing, _CLOSE_S)
            if busy:
                _, late = await asyncio.wait(busy, timeout=_CLOSE_S)
                for task in late:
                    _logger.warning("%s is still busy after close", task.get_name())
        finally:
            self._finish()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *exc_info: object) -> None:
        await self.close()

    # ------------------------------------------------------------------ machinery

    def _notify(self) -> None:
        changed, self._changed = self._changed, asyncio.Event()
        changed.set()

    def _run_in_loop(self, *call: Any) -> None:
        with suppress(RuntimeError):  # the loop is closed
            self._loop.call_soon_threadsafe(*call)

    def _deliver(self, sample: Sample) -> Awaitable[None] | None:
        return self._calls.call(self._takers(sample.name), sample)

    def _handler_failed(self, error: BaseException, event: Any) -> None:
        # A handler may meet a cancelled future; only cancelling its task ends that.
        if _is_cancelled():
            raise error
        self._reporter.report(error, event)

    async def _tell(self, change: BoardChange | None) -> None:
        if change is not None and (rest := self._calls.call(self._changes.matching(), change)):
            await rest


class _Member(Member[AsyncClient]):
    """One URL of a fleet, and the task that keeps it open.

    Attributes:
        task: does all this.
        engine: that of its client.
    """

    def __init__(self, fleet: AsyncFleet, url: str) -> None:
        super().__init__(url)
        self._fleet = fleet
        self._can_stop = False
        self.engine: AsyncEngine | None = None
        self._telling: object = None
        self.task = asyncio.create_task(self._run(), name=f"j2a fleet {url}")

    def ask_to_stop(self) -> None:
        # Neither a handler of the user nor the end of a client is cancelled.
        super().ask_to_stop()
        if self._can_stop:
            self._can_stop = False
            self.task.cancel()

    @property
    def is_in_handler(self) -> bool:
        """Whether a handler of the board may wait for this task, as in `AsyncEngine`."""
        if self._telling is not None and _told.get() is self._telling:
            return True
        return self.engine is not None and self.engine.is_in_handler

    async def _tell(self, change: BoardChange | None) -> None:
        telling = self._telling = object()
        before = _told.set(telling)
        try:
            await self._fleet._tell(change)
        finally:
            _told.reset(before)
            self._telling = None

    async def _until_stopped(self, work: Coroutine[Any, Any, _ResultT]) -> _ResultT | None:
        """Return the result of a coroutine; None when the member is to end."""
        if self.is_stopped:
            work.close()
            return None
        self._can_stop = True
        try:
            return await work
        except asyncio.CancelledError:
            if not self.is_stopped:
                raise
            self.task.uncancel()
            return None
        finally:
            self._can_stop = False

    async def _run(self) -> None:
        fleet = self._fleet
        while not self.is_stopped:
            board, reason = await self._keep()
            await self._tell(fleet._go(self, board, reason))
            await self._until_stopped(asyncio.sleep(fleet._retry_s))

    async def _keep(self) -> tuple[str | None, J2AError | None]:
        """Keep a link until it ends; return the identity of the board if it was here, and why."""
        board: str | None = None
        try:
            client = await self._until_stopped(self._connect())
            if client is None:
                return None, None
            async with client:
                self.engine = client._engine
                name = await self._until_stopped(self._identify(client))
                if name is None:
                    return None, None
                change = self._fleet._come(self, client, name)
                board = change.board
                await self._tell(change)
                return board, await self._until_stopped(self._watch(client))
        except J2AError as error:
            return board, error
        except (Exception, asyncio.CancelledError) as error:  # of `identify`, which is the user's
            if _is_cancelled():
                raise
            return board, LocalError(f"identify failed: {type(error).__name__}: {error}")
        finally:
            self.engine = None

    async def _connect(self) -> AsyncClient:
        fleet = self._fleet
        return await aconnect(self.url, timeout=fleet._timeout, boot_time=fleet._boot_time)

    async def _identify(self, client: AsyncClient) -> str:
        found = self._fleet._identify(client)
        return str(await found if inspect.isawaitable(found) else found)

    async def _watch(self, client: AsyncClient) -> J2AError:
        """Wait until the link has ended, or nothing comes; return why."""
        ended = asyncio.Event()
        client._handlers.at_end(lambda reason: ended.set())
        heartbeat = Heartbeat()
        while client.is_open:
            heartbeat.begin(client.counters.frames_received)
            if await is_set_within(ended, self._fleet._heartbeat_s):
                break
            if not heartbeat.is_silent(client.counters.frames_received):
                continue
            try:
                await client.echo(timeout=self._fleet._echo_s)
                heartbeat.answered()
            except J2AError as error:
                if heartbeat.failed(error, is_open=client.is_open):
                    return error
        return client._session.end_reason or OpenFailed("taken out", outcome=Outcome.NOT_SENT)


def _is_cancelled() -> bool:
    """Whether somebody has cancelled the task that runs."""
    task = asyncio.current_task()
    return task is not None and task.cancelling() > 0
