"""The asyncio client's link to a transport: watched by the event loop, or read in a thread.

What flows in: bytes to send, bytes from the transport, questions whether something has arrived.
What flows out, in the event loop: received bytes in pieces, the time until which everything was
received, and the reason for which the link has ended.
Rules: the loop takes one piece a turn. A transport with a descriptor needs no thread, except for
what it does not take at once. Otherwise a thread reads, and waits while `IN_FLIGHT` bytes are not
taken, so a flood stays in the transport.
"""

import asyncio
import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Final

from j2a.errors import LinkClosed, LinkError, LocalError
from j2a.io.opening import WAIT_S, link_error
from j2a.io.threads import PIECE, LinkThreads, Writer, clock_of, join_threads

if TYPE_CHECKING:
    from j2a_transports import Transport

__all__ = [
    "IN_FLIGHT",
    "AsyncLink",
    "ThreadedLink",
    "WatchedLink",
    "join_threads_in_loop",
]

IN_FLIGHT: Final = 4 * PIECE
"""So many bytes may be on their way from the reading thread to the event loop."""

_LOOK_S: Final = 1.0
"""How long a look at a descriptor may take; it takes some turns of the event loop."""

_JOIN_STEP_S: Final = 0.002
"""An event loop that waits for threads looks at them so often."""

_Item = bytes | float | LinkError | LocalError
"""Received bytes, a time until which everything was received, or why the link has ended."""


class AsyncLink:
    """The common base of both kinds of link.

    Args:
        transport: an open byte stream.
        loop: the event loop, in which the methods are called.
        receive: called with 1 to `PIECE` bytes.
        looked: called with a time of `Transport.clock` once everything that had arrived by then was
            given to `receive`.
        ended: called with the reason when the link has ended; perhaps again.

    Attributes:
        threads: those that were started for the link.
    """

    def __init__(
        self,
        transport: "Transport",
        loop: asyncio.AbstractEventLoop,
        receive: Callable[[bytes], None],
        looked: Callable[[float], None],
        ended: Callable[[LinkError | LocalError], None],
    ) -> None:
        self._transport = transport
        self._loop = loop
        self._receive = receive
        self._looked = looked
        self._ended = ended
        self.threads: list[threading.Thread] = []


class WatchedLink(AsyncLink):
    """A transport with a descriptor that the event loop watches."""

    def start(self) -> None:
        """Begin to watch.

        Raises:
            NotImplementedError: this kind of event loop cannot.
        """
        self._fd = self._transport.fileno()
        self._now = clock_of(self._transport)
        self._unread = b""
        self._is_scheduled = False
        self._writer = Writer(self._transport, self._write_failed)
        self._has_stopped = False
        self._loop.add_reader(self._fd, self._step)

    def send(self, data: bytes) -> None:
        """Have bytes written; does not wait."""
        if self._writer.send(data) and self._writer.thread is None:
            try:
                self.threads.append(self._writer.start())
            except LinkError as error:
                self._loop.call_soon(self._ended, error)

    def look(self) -> float:
        """Take what has arrived, then call `looked`; returns how long to wait for that at most."""
        self._is_asked = True
        self._schedule()
        return _LOOK_S

    def stop(self) -> None:
        """Watch no more; the transport may be closed then."""
        if not self._has_stopped:
            self._has_stopped = True
            if not self._loop.is_closed():
                self._loop.remove_reader(self._fd)
            self._writer.stop()

    def abandon(self, what: str) -> None:
        """End the link without waiting; safe in a destructor and in a signal handler."""
        reason = LinkClosed(f"{self._transport.url} {what}")
        try:
            self._loop.call_soon_threadsafe(self._ended, reason)
        except RuntimeError:  # the event loop has been closed
            self._writer.stop()
            self._transport.close()

    _is_asked = False

    def _schedule(self) -> None:
        if not self._is_scheduled:
            self._is_scheduled = True
            self._loop.call_soon(self._go_on)

    def _go_on(self) -> None:
        self._is_scheduled = False
        if not self._has_stopped:
            self._step()

    def _step(self) -> None:
        now = self._now() if self._is_asked else 0.0
        try:
            data = self._unread or self._transport.read(0)
        except Exception as error:
            self._ended(link_error(error))
            return
        self._unread = data[PIECE:]
        if self._unread or (data and self._is_asked):
            self._schedule()
        if data:
            self._receive(data[:PIECE])
        elif self._is_asked:
            self._is_asked = False
            self._looked(now)

    def _write_failed(self, error: BaseException) -> None:
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._end_after_reading, error)

    def _end_after_reading(self, error: BaseException) -> None:
        """End the link; the other side may have answered before it went away."""
        if self._has_stopped:
            return
        with contextlib.suppress(Exception):
            for _ in range(IN_FLIGHT // PIECE):
                data = self._unread or self._transport.read(0)
                self._unread = data[PIECE:]
                if not data:
                    break
                self._receive(data[:PIECE])
        self._ended(link_error(error))


class ThreadedLink(AsyncLink):
    """A transport that threads read and write."""

    def start(self) -> None:
        """Start the threads.

        Raises:
            OpenFailed: the system has no thread to give.
        """
        self._changed = threading.Condition()
        self._items: deque[_Item] = deque()
        self._in_flight = 0
        self._has_stopped = False
        hand_over = self.hand_over
        self._link = LinkThreads(self._transport, hand_over, hand_over, hand_over)
        self.send, self.look = self._link.send, self._link.look
        self.threads = self._link.threads
        self._link.start()

    def judge_at(self, due: float) -> None:
        """Where time is simulated: have `looked` called at that time."""
        self._link.due = due

    def stop(self) -> None:
        """Let the threads run out; the reading one ends when the transport is closed."""
        self._has_stopped = True
        self._link.stop()
        with self._changed:
            self._changed.notify_all()

    def abandon(self, what: str) -> None:
        """End the link without waiting; safe in a destructor and in a signal handler."""
        self._link.abandon(what)

    def hand_over(self, item: _Item) -> None:
        """Give the event loop something to take; with bytes wait for room. Called by the threads.

        Raises:
            LinkClosed: this side has closed the link or the event loop.
        """
        with self._changed:
            if isinstance(item, bytes):
                while self._in_flight + len(item) > IN_FLIGHT and not self._is_over:
                    self._changed.wait(WAIT_S)
                if self._is_over:
                    raise LinkClosed(f"{self._transport.url} is closed")
                self._in_flight += len(item)
            self._items.append(item)
            if len(self._items) == 1:
                # A loop that has been closed needs to know nothing.
                with contextlib.suppress(RuntimeError):
                    self._loop.call_soon_threadsafe(self._take)

    @property
    def _is_over(self) -> bool:
        return self._has_stopped or self._loop.is_closed()

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
            self._receive(item)
        elif isinstance(item, float):
            self._looked(item)
        else:
            self._ended(item)


async def join_threads_in_loop(threads: Sequence[threading.Thread], limit_s: float) -> None:
    """Wait as `join_threads`, without the executor of the loop, which may be busy for ever."""
    end = time.monotonic() + limit_s
    while any(thread.is_alive() for thread in threads) and time.monotonic() < end:
        await asyncio.sleep(_JOIN_STEP_S)
    join_threads(threads, 0.0)
