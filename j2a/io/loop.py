"""The asyncio client's engine: a session in an event loop, a transport in two threads.

What flows in: calls from the event loop, bytes from the transport. What flows out: replies to the
callers, SIFs to their handlers, which may be coroutines.
Rules: the session lives in the event loop and nowhere else. The reading thread hands over bytes in
pieces and waits while `IN_FLIGHT` of them are not taken, so a flood stays in the transport; the
loop takes one piece a turn. The threads keep the engine alive, but neither the client nor its
handlers.
"""

import asyncio
import contextlib
import inspect
import logging
import math
import threading
import time
import weakref
from collections import deque
from collections.abc import Awaitable, Callable, Iterable
from typing import TYPE_CHECKING, Final

from j2a.errors import J2AError, LinkClosed, LinkError, LocalError
from j2a.events import Reply, Sif
from j2a.io.client_base import MAX_SIFS_WAITING, take_stale_input
from j2a.io.handlers import ErrorHook, Handlers, Reporter
from j2a.io.opening import WAIT_S
from j2a.io.threads import JOIN_S, LOOK_S, PIECE, LinkThreads, join_threads, start_thread
from j2a.protocol.session import Call, Session

if TYPE_CHECKING:
    from j2a_transports import Transport

__all__ = ["AsyncEngine", "AsyncHandler"]

AsyncHandler = Callable[[Sif], Awaitable[object] | object]
"""Called in the event loop with each SIF that it is registered for; may be a coroutine function."""

IN_FLIGHT: Final = 4 * PIECE
"""So many bytes may be on their way from the reading thread to the event loop."""

_TURN_S: Final = 0.005
"""For so long SIF handlers that never wait may keep the event loop for themselves."""

_Item = bytes | float | LinkError | LocalError
"""Received bytes, a time until which everything was received, or why the link has ended."""

_logger = logging.getLogger("j2a")


class AsyncEngine:
    """Moves calls and SIFs between a session in the running event loop and a transport.

    Args:
        transport: is closed at the end.
        session: belongs to the engine from now on.
        handlers: of SIFs; the engine calls them as long as somebody else keeps them.
        on_handler_error: see `j2a.Client`.
    """

    def __init__(
        self,
        transport: "Transport",
        session: Session,
        handlers: Handlers[AsyncHandler],
        on_handler_error: ErrorHook | None,
    ) -> None:
        self._transport = transport
        self._session = session
        self._handlers = weakref.ref(handlers)
        self._reporter = Reporter(on_handler_error)
        self._loop = asyncio.get_running_loop()
        self._sifs: asyncio.Queue[Sif | None] = asyncio.Queue()
        self._takes_sifs = True
        self._drops_sifs = False
        self._timer: asyncio.TimerHandle | None = None
        # While the time limits are judged: when that ends without an answer of the reading thread,
        # and when it ends although bytes come without end.
        self._look_limit: asyncio.TimerHandle | None = None
        self._flood_limit = math.inf
        # Between the threads and the event loop.
        self._changed = threading.Condition()
        self._items: deque[_Item] = deque()
        self._in_flight = 0
        self._looks: list[tuple[float, asyncio.Future[None]]] = []
        take_stale_input(transport, session)
        self.dispatcher = self._loop.create_task(self._dispatch())
        self._link = LinkThreads(transport, self._hand_over, self._hand_over, self._hand_over)
        try:
            self._link.start()
        except LinkError as error:
            self._end(error)
            raise

    async def call(self, what: str, opcode: int, payload: bytes, limit_s: float) -> Reply:
        """Make one call; see `AsyncClient.call`."""
        self.check_process()
        self._check_loop()
        done: asyncio.Future[None] = self._loop.create_future()
        try:
            call = self._session.start_call(
                what, opcode, payload, now=self._loop.time(), timeout_s=limit_s, waiter=done
            )
        except J2AError:
            # Who tries again and again must not keep the event loop for itself.
            await asyncio.sleep(0)
            raise
        finally:
            self._flush()  # where the link is stalled, a barrier
        try:
            await done
        except asyncio.CancelledError:
            self._settle(self._session.cancel(done))
            raise
        if call.error is not None:
            raise call.error
        assert call.reply is not None
        return call.reply

    def check_process(self) -> None:
        """Refuse to work in a child process; see `LinkThreads.check_process`."""
        self._link.check_process()

    def _check_loop(self) -> None:
        if asyncio.get_running_loop() is not self._loop:
            raise LocalError(
                f"{self._transport.url} was connected in another event loop; "
                "use the client there, or connect again"
            )

    async def close(self) -> None:
        """Deliver the SIFs that have come, then end all calls and the threads."""
        if self._link.is_inherited:
            return  # the link is the parent's
        reason = LinkClosed(f"{self._transport.url} was closed by this program")
        if self._loop.is_closed():
            self._session.close(reason)
            self._link.abandon("was closed by this program")
            await asyncio.to_thread(join_threads, self._link.threads, JOIN_S)
            return
        self._check_loop()
        is_handler = asyncio.current_task() is self.dispatcher
        try:
            if not is_handler:
                await self._deliver_what_came()
        finally:
            self._finish(reason)
        await asyncio.to_thread(join_threads, self._link.threads, JOIN_S)
        if not is_handler and not self.dispatcher.done():
            _logger.warning(
                "a SIF handler of %s is cancelled: it waits after close", self._transport.url
            )
            self.dispatcher.cancel()

    def abandon(self) -> bool:
        """End the link without waiting, in a destructor; tell whether it was still there."""
        if self._link.is_inherited or self._session.is_closed:
            return False
        self._link.abandon("was dropped without close")
        return True

    async def _deliver_what_came(self) -> None:
        if not self._session.is_closed:
            looked: asyncio.Future[None] = self._loop.create_future()
            self._looks.append((time.monotonic(), looked))
            await asyncio.wait([looked], timeout=self._link.look())
            self._finish_sifs()
        await asyncio.wait([self.dispatcher], timeout=JOIN_S)

    # ------------------------------------------------------------------ in the event loop

    def _settle(self, events: Iterable[Call | Sif]) -> None:
        """Wake the callers whose call has ended, queue SIFs, and send what is to be sent."""
        for event in events:
            if isinstance(event, Sif):
                if self._takes_sifs and self._sifs.qsize() < MAX_SIFS_WAITING:
                    self._sifs.put_nowait(event)
                else:
                    self._session.count("sifs_dropped")
            elif event.has_ended and not event.waiter.done():
                event.waiter.set_result(None)
        self._flush()

    def _flush(self) -> None:
        data = self._session.data_to_send()
        if data:
            self._link.send(data)
        due = self._session.next_timeout()
        if due is None or self._look_limit is not None:
            return
        if self._timer is not None:
            if self._timer.when() <= due:
                return  # it finds out by itself that it is early
            self._timer.cancel()
        self._timer = self._loop.call_at(due, self._on_timer)

    def _on_timer(self) -> None:
        """Judge the time limits, but first take what has arrived."""
        self._timer = None
        due, now = self._session.next_timeout(), self._loop.time()
        if due is None or due > now:
            self._flush()
            return
        self._flood_limit = now + LOOK_S
        self._look_limit = self._loop.call_later(self._link.look(), self._judge, math.inf)

    def _judge(self, now: float) -> None:
        """End the calls whose time was over at `now`; infinity is the present."""
        if self._look_limit is not None:
            self._look_limit.cancel()
            self._look_limit = None
        self._flood_limit = math.inf
        self._settle(self._session.handle_timeout(min(now, self._loop.time())))

    def _take(self) -> None:
        """Take what the threads have handed over, one item a turn of the event loop."""
        with self._changed:
            item = self._items.popleft()
            if isinstance(item, bytes):
                if self._in_flight + PIECE > IN_FLIGHT:
                    self._changed.notify_all()
                self._in_flight -= len(item)
            if self._items:
                self._loop.call_soon(self._take)
        if isinstance(item, bytes):
            now = self._loop.time()
            self._settle(self._session.receive(item, now))
            if now >= self._flood_limit:
                self._judge(math.inf)
        elif isinstance(item, float):
            self._judge(item)
            for asked_at, looked in self._looks:
                if asked_at <= item and not looked.done():
                    looked.set_result(None)
            self._looks = [look for look in self._looks if not look[1].done()]
        else:
            self._end(item)

    async def _dispatch(self) -> None:
        turn_ends = 0.0
        while (sif := await self._sifs.get()) is not None:
            await self._deliver(sif)
            if self._loop.time() >= turn_ends:
                await asyncio.sleep(0)
                turn_ends = self._loop.time() + _TURN_S

    async def _deliver(self, sif: Sif) -> None:
        handlers = self._handlers()
        if handlers is None or self._drops_sifs:
            self._session.count("sifs_dropped")
            return
        for handler in handlers.of(sif.opcode):
            try:
                result = handler(sif)
                if inspect.isawaitable(result):
                    await result
            except (Exception, asyncio.CancelledError) as error:
                # A handler may meet a cancelled future; only cancelling this task ends it.
                if self.dispatcher.cancelling():
                    raise
                self._session.count("handler_errors")
                self._reporter.report(error, sif)
            if self._drops_sifs:
                return

    # ------------------------------------------------------------------ the end

    def _finish_sifs(self) -> None:
        """Let the dispatcher run out after the SIFs that wait."""
        if self._takes_sifs:
            self._takes_sifs = False
            self._sifs.put_nowait(None)

    def _finish(self, reason: LinkClosed) -> None:
        """End what `close` ends: calls no handler any more after the one that runs."""
        self._drops_sifs = True
        self._end(reason)
        dropped = 0
        while not self._sifs.empty():
            dropped += self._sifs.get_nowait() is not None
        self._sifs.put_nowait(None)
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
        with self._changed:
            self._changed.notify_all()
        # Closing may wait, for a child process to end for example.
        name = f"j2a closer {self._transport.url}"
        try:
            self._link.threads.append(start_thread(self._transport.close, name))
        except LinkError:  # better late than open for ever
            self._transport.close()

    # ------------------------------------------------------------------ in threads

    def _hand_over(self, item: _Item) -> None:
        """Give the event loop something to take; with bytes wait for room.

        Raises:
            LinkClosed: this side has closed the link or the event loop.
        """
        with self._changed:
            if isinstance(item, bytes):
                while self._in_flight + len(item) > IN_FLIGHT and not self._has_ended:
                    self._changed.wait(WAIT_S)
                if self._has_ended:
                    raise LinkClosed(f"{self._transport.url} is closed")
                self._in_flight += len(item)
            self._items.append(item)
            if len(self._items) == 1:
                # A loop that has been closed needs to know nothing.
                with contextlib.suppress(RuntimeError):
                    self._loop.call_soon_threadsafe(self._take)

    @property
    def _has_ended(self) -> bool:
        return self._loop.is_closed() or self._session.is_closed
