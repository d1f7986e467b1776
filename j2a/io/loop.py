"""The asyncio client's engine: a session in an event loop.

What flows in: calls from the event loop, bytes from the transport. What flows out: replies to the
callers, SIFs to their handlers, which may be coroutines.
Rules: the session lives in the event loop and nowhere else; `links` brings the bytes there. The
link keeps the engine alive, but neither the client nor its handlers.
"""

import asyncio
import contextlib
import logging
import math
from collections import deque
from collections.abc import Awaitable, Iterable, Sequence
from contextvars import ContextVar
from typing import Any, Final, NoReturn

from j2a.errors import J2AError, LinkClosed, LinkError, LocalError
from j2a.events import Reply, Restart, Sif
from j2a.io.async_calls import AsyncCalls
from j2a.io.async_streams import AsyncSifStream
from j2a.io.engine_base import MAX_SIFS_WAITING, EngineBase
from j2a.io.links import ThreadedLink, WatchedLink, join_threads_in_loop
from j2a.io.threads import JOIN_S, LOOK_S, start_or_do
from j2a.protocol.session import Call, Event

__all__ = ["AsyncEngine"]

_TURN_S: Final = 0.005
"""For so long SIF handlers that never wait may keep the event loop for themselves."""

_logger = logging.getLogger("j2a")

_handled: Final[ContextVar[Sif | Restart | None]] = ContextVar("j2a_handled", default=None)
"""What the handler got that has begun the task, as `asyncio.wait_for` of Python 3.11 does."""


class AsyncEngine(EngineBase[AsyncSifStream]):
    """The engine of the asyncio client; see `EngineBase`."""

    _stream_class = AsyncSifStream
    _link: WatchedLink | ThreadedLink

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self._loop = asyncio.get_running_loop()
        self._sifs: deque[Sif | Restart | None] = deque()  # None is the end
        self._came = asyncio.Event()
        self._delivered: Sif | Restart | None = None  # what the dispatcher calls handlers with
        self._calls = AsyncCalls(self._handler_failed)
        # The next time at which time limits are judged; nothing may be late then.
        self._timer: asyncio.TimerHandle | None = None
        self._timer_due = math.inf
        # While the time limits are judged: when that ends without an answer of the reading thread,
        # and when it ends although bytes come without end.
        self._look_limit: asyncio.TimerHandle | None = None
        self._flood_limit = math.inf
        self._looks: list[tuple[float, asyncio.Future[None]]] = []
        self.dispatcher = self._loop.create_task(self._dispatch())
        try:
            self._link = self._start_link()
        except LinkError as error:
            self._end(error)
            raise

    def _start_link(self) -> WatchedLink | ThreadedLink:
        arguments = (self._transport, self._loop, self._receive, self._looked, self._end)
        if self._transport.fileno() >= 0 and not self._is_simulated:
            watched = WatchedLink(*arguments)
            with contextlib.suppress(NotImplementedError):  # this kind of loop cannot watch
                watched.start()
                return watched
        threaded = self._link = ThreadedLink(*arguments)
        threaded.start()
        return threaded

    async def call(
        self,
        what: str,
        opcode: int,
        payload: bytes,
        limit_s: float,
        generation: int | None = None,
    ) -> Reply:
        """Make one call; see `AsyncClient.call` and `Session.start_call`."""
        self.check_process()
        if asyncio.get_running_loop() is not self._loop:
            self._refuse_loop()
        done: asyncio.Future[None] = asyncio.Future(loop=self._loop)
        try:
            call = self._session.start_call(
                what, opcode, payload, self.now(), limit_s, done, generation
            )
        except J2AError:
            # Repeated attempts must not block the event loop.
            await asyncio.sleep(0)
            raise
        finally:
            self._send()  # where the link is stalled, a barrier
        if call.deadline is not None and call.deadline < self._timer_due:
            self._judge_at(call.deadline)
        try:
            await done
        except asyncio.CancelledError:
            self._settle(self._session.cancel(done))
            raise
        if call.error is not None:
            raise call.error
        assert call.reply is not None
        return call.reply

    async def call_all(
        self, requests: Sequence[tuple[str, int, bytes, float]], generation: int | None = None
    ) -> list[Reply]:
        """Make calls at once, each with the arguments of `call`; return their replies in order.

        Raises: the first error, in this order, once all of them have ended.
        """
        if len(requests) == 1:
            return [await self.call(*requests[0], generation)]
        found = await asyncio.gather(
            *(self.call(*request, generation) for request in requests), return_exceptions=True
        )
        replies = []
        for result in found:
            if isinstance(result, BaseException):
                raise result
            replies.append(result)
        return replies

    def _refuse_loop(self) -> NoReturn:
        raise LocalError(
            f"{self._transport.url} was connected in another event loop; "
            "use the client there, or connect again"
        )

    async def close(self) -> None:
        """Deliver the SIFs that have come, then end all calls and the threads."""
        if self._is_inherited:
            return  # the link is the parent's
        reason = LinkClosed(f"{self._transport.url} was closed by this program")
        if self._loop.is_closed():
            self._session.close(reason)
            self._link.abandon("was closed by this program")
            await join_threads_in_loop(self._link.threads, JOIN_S)
            return
        if asyncio.get_running_loop() is not self._loop:
            self._refuse_loop()
        is_handler = self.is_in_handler
        try:
            if not is_handler:
                await self._deliver_what_came()
        finally:
            self._finish(reason)
        await join_threads_in_loop(self._link.threads, JOIN_S)
        if not is_handler and not self.dispatcher.done():
            _logger.warning(
                "a SIF handler of %s is cancelled: it waits after close", self._transport.url
            )
            self.dispatcher.cancel()

    @property
    def is_in_handler(self) -> bool:
        """Whether the handler that runs may wait for this task: it is the one, or has begun it."""
        return self._delivered is not None and _handled.get() is self._delivered

    async def _deliver_what_came(self) -> None:
        if not self._session.is_closed:
            looked: asyncio.Future[None] = self._loop.create_future()
            self._looks.append((self.now(), looked))
            await asyncio.wait([looked], timeout=self._link.look())
            self._finish_sifs()
        await asyncio.wait([self.dispatcher], timeout=JOIN_S)

    # ------------------------------------------------------------------ in the event loop

    def _settle(self, events: Iterable[Event]) -> None:
        """Wake the callers whose call has ended, queue SIFs, and send what is to be sent."""
        for event in events:
            if isinstance(event, Call):
                if event.has_ended and not event.waiter.done():
                    event.waiter.set_result(None)
            elif isinstance(event, Sif):
                if self._takes_sifs and len(self._sifs) < MAX_SIFS_WAITING:
                    self._sifs.append(event)
                else:
                    self._session.count("sifs_dropped")
            else:
                self._queue_restart(event)
        if self._sifs:
            self._came.set()
        self._send()

    def _send(self) -> None:
        data = self._session.data_to_send()
        if data:
            self._link.send(data)

    def _judge_at(self, due: float) -> None:
        """Have the time limits judged at that time, or before; they are not met too early."""
        if self._timer_due <= due or self._look_limit is not None:
            return
        self._timer_due = due
        if self._is_simulated:
            assert isinstance(self._link, ThreadedLink)
            self._link.judge_at(due)
            return
        if self._timer is not None:
            self._timer.cancel()
        self._timer = self._loop.call_later(due - self.now(), self._on_timer)

    def _on_timer(self) -> None:
        """Judge the time limits, but first take what has arrived."""
        self._timer, self._timer_due = None, math.inf
        due, now = self._session.next_timeout(), self.now()
        if due is None:
            return
        if due > now:
            self._judge_at(due)
            return
        self._flood_limit = now + LOOK_S
        self._look_limit = self._loop.call_later(self._link.look(), self._judge, math.inf)

    def _judge(self, now: float) -> None:
        """End the calls whose time was over at `now`; infinity is the present."""
        if self._look_limit is not None:
            self._look_limit.cancel()
            self._look_limit = None
        self._flood_limit = math.inf
        if self._is_simulated:
            self._timer_due = math.inf
        self._settle(self._session.handle_timeout(min(now, self.now())))
        due = self._session.next_timeout()
        if due is not None:
            self._judge_at(due)

    def _receive(self, piece: bytes) -> None:
        now = self.now()
        self._settle(self._session.receive(piece, now))
        if now >= self._flood_limit:
            self._judge(math.inf)

    def _looked(self, looked_at: float) -> None:
        self._judge(looked_at)
        for asked_at, looked in self._looks:
            if asked_at <= looked_at and not looked.done():
                looked.set_result(None)
        self._looks = [look for look in self._looks if not look[1].done()]

    def _queue(self, event: Sif | Restart | None) -> None:
        self._sifs.append(event)
        self._came.set()

    async def _dispatch(self) -> None:
        turn_ends = 0.0
        while True:
            while not self._sifs:
                self._came.clear()
                await self._came.wait()
            event = self._sifs.popleft()
            if event is None:
                break
            self._delivered = event
            _handled.set(event)
            if isinstance(event, Restart):
                await self._deliver_restart(event)
            elif (rest := self._deliver(event)) is not None:
                await rest
            self._delivered = None
            if self._loop.time() >= turn_ends:
                await asyncio.sleep(0)
                turn_ends = self._loop.time() + _TURN_S
        self._finish_streams()

    async def _deliver_restart(self, restart: Restart) -> None:
        restart, self._restart = self._restart or restart, None
        restarted = self._restarted()
        if restarted is None or self._calls.are_over:
            return
        restart, handlers = await restarted(restart)
        del restarted  # it keeps the client alive
        if (rest := self._calls.call(handlers.matching(), restart)) is not None:
            await rest

    def _handler_failed(self, error: BaseException, event: Sif | Restart) -> None:
        # A handler may meet a cancelled future; only cancelling this task ends it.
        if self.dispatcher.cancelling():
            raise error
        self._session.count("handler_errors")
        self._reporter.report(error, event)

    def _deliver(self, sif: Sif) -> Awaitable[None] | None:
        """Call the handlers of a SIF; return what is to be awaited, None where all have ended."""
        handlers = self._handlers()
        if handlers is None or self._calls.are_over:
            self._session.count("sifs_dropped")
            return None
        return self._calls.call(handlers.matching(sif.opcode, sif.epoch), sif)

    # ------------------------------------------------------------------ the end

    def _finish_sifs(self) -> None:
        """Let the dispatcher run out after the SIFs that wait."""
        if self._takes_sifs:
            self._takes_sifs = False
            self._queue(None)

    def _finish(self, reason: LinkClosed) -> None:
        """End what `close` ends: calls no handler any more after the one that runs."""
        self._calls.are_over = True
        self._end(reason)
        dropped = 0
        while self._sifs:
            dropped += isinstance(self._sifs.popleft(), Sif)
        self._queue(None)
        self._finish_streams()
        for _ in range(dropped):
            self._session.count("sifs_dropped")
        if dropped:
            _logger.warning(
                "%s was closed before %d SIFs reached their handlers", self._transport.url, dropped
            )

    def _end(self, reason: LinkError | LocalError) -> None:
        if self._session.is_closed:
            return
        self._settle(self._session.close(reason))
        for timer in (self._timer, self._look_limit):
            if timer is not None:
                timer.cancel()
        self._finish_sifs()
        self._link.stop()
        # Closing may wait, for a child process to end for example.
        name = f"j2a closer {self._transport.url}"
        self._link.threads += start_or_do(self._transport.close, name)
