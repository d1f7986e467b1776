"""The threads that move bytes between a client and its transport.

What flows in: bytes to send, bytes from the transport, questions whether a reply has arrived. What
flows out: received bytes in small pieces, and the reason for which the link has ended.
Rules: one thread reads, one writes what the link does not take at once; they know no frame. Pieces
are handed over one after the other and nothing is read meanwhile, so a flood waits in the
transport. A time limit is judged only after a look: what had arrived by then was taken.

Waking a thread costs more than a call. So where the transport has a descriptor, a caller that waits
reads for itself for a moment (it leads), and the reading thread lets callers do so as long as they
call one after the other.
"""

import contextlib
import logging
import math
import os
import queue
import threading
import time
from collections.abc import Callable, Iterable
from typing import Final

from j2a_transports import Transport, TransportError

from j2a.errors import LinkClosed, LinkError, LocalError, OpenFailed
from j2a.io.bell import Bell
from j2a.io.opening import link_error

__all__ = [
    "JOIN_S",
    "LEAD_S",
    "LOOK_S",
    "PIECE",
    "LinkThreads",
    "Writer",
    "clock_of",
    "join_threads",
    "process",
    "start_or_do",
    "start_thread",
]

PIECE: Final = 4096
"""Bytes handed over at once; the worst ones take about 10 ms to parse."""

LOOK_S: Final = 0.02
"""Where bytes never end, a look is over after so many seconds."""

LEAD_S: Final = 0.005
"""For so long a caller reads for itself before it leaves that to the reading thread."""

_LINGER_S: Final = 0.005
"""So long after a caller has read, the reading thread begins; a SIF may wait for that."""

_SLICE_S: Final = 0.01
"""Where time is simulated, time limits are judged after a read of so many simulated seconds."""

_UNSURE_S: Final = 0.04
"""How long bytes may take through the thread of a transport that has one of its own."""

_PATIENCE_S: Final = 1.0
"""How long a reading thread that was woken may take to be scheduled."""

JOIN_S: Final = 5.0
"""How long a client that is closed waits for its SIF handlers, and then for its threads."""

_logger = logging.getLogger("j2a")


class _Process:
    """This process; `pid` is `os.getpid()` without the system call, which each call would make."""

    def __init__(self) -> None:
        self.update()
        if hasattr(os, "register_at_fork"):
            os.register_at_fork(after_in_child=self.update)

    def update(self) -> None:
        """Ask the system for the number."""
        self.pid = os.getpid()


process: Final = _Process()


class Writer:
    """Writes what the link does not take at once, in a thread.

    Args:
        transport: where to.
        failed: called by the thread when writing has failed, or with what `abandon` was given.
    """

    def __init__(self, transport: Transport, failed: Callable[[BaseException], None]) -> None:
        self._transport = transport
        self._failed = failed
        self._outgoing: queue.SimpleQueue[bytes | LinkClosed | None] = queue.SimpleQueue()
        # Pieces that were queued, and those of them that were written.
        self._queued = self._written = 0
        self.thread: threading.Thread | None = None

    def start(self) -> threading.Thread:
        """Start the thread, and return it.

        Raises:
            OpenFailed: the system has no thread to give.
        """
        self.thread = start_thread(self._write, f"j2a writer {self._transport.url}")
        return self.thread

    def send(self, data: bytes) -> bool:
        """Have bytes written; does not wait. For one thread at a time.

        If nothing waits for the thread, what the link takes at once needs no other thread.

        Returns: whether something was left for the thread.
        """
        if self._written == self._queued:
            data = data[self._transport.try_write(data) :]
        if data:
            self._queued += 1
            self._outgoing.put(data)
        return bool(data)

    def stop(self) -> None:
        """Let the thread run out."""
        self._outgoing.put(None)

    def abandon(self, reason: LinkClosed) -> None:
        """End the link without waiting; safe in a destructor and in a signal handler."""
        self._outgoing.put(reason)

    def _write(self) -> None:
        try:
            while (data := self._outgoing.get()) is not None:
                if isinstance(data, LinkClosed):
                    self._failed(data)
                    return
                self._transport.write(data)
                self._written += 1
        except BaseException as error:  # also sys.exit(): nobody else writes
            self._failed(error)


class LinkThreads:
    """Reads and writes a transport in two threads.

    Args:
        transport: is closed when a thread fails.
        receive: called by the thread that reads with 1 to `PIECE` bytes; may wait.
        looked: called by the thread that reads with a time (`Transport.clock`) once everything that
            had arrived by then was given to `receive`.
        ended: called by a thread that ends, with the reason; perhaps by both.

    Attributes:
        due: where time is simulated: when `looked` is to be called without being asked.
    """

    def __init__(
        self,
        transport: Transport,
        receive: Callable[[bytes], None],
        looked: Callable[[float], None],
        ended: Callable[[LinkError | LocalError], None],
    ) -> None:
        self._transport = transport
        self._receive = receive
        self._looked = looked
        self._ended = ended
        self._clock = clock_of(transport)
        self._is_simulated = transport.is_simulated
        self._can_lead = transport.fileno() >= 0 and not self._is_simulated
        self.due = math.inf
        self._writer = Writer(transport, self._write_failed)
        self.send = self._writer.send
        self._changed = threading.Condition()
        self._asked = self._answered = 0
        self._asked_at = math.inf
        self._is_reading = True
        self._is_stopped = False
        # Held by the thread that reads; only an RLock can tell which.
        self._reading = threading.RLock()
        self._led_at = -math.inf
        self._bell = Bell()  # of the reading thread
        self._ring = self._bell.ring
        self._unread = b""
        self.threads: list[threading.Thread] = []

    def start(self) -> None:
        """Start both threads."""
        self.threads += [
            start_thread(self._read, f"j2a reader {self._transport.url}"),
            self._writer.start(),
        ]

    def stop(self) -> None:
        """Let the writing thread run out; the reading one ends when the transport is closed."""
        self._writer.stop()
        self._is_stopped = True
        self._led_at = -math.inf
        self._ring()

    def abandon(self, what: str) -> None:
        """End the link without waiting; `what` happened to it.

        Safe in a destructor, which any thread may run anywhere, and in a signal handler.
        """
        self._writer.abandon(LinkClosed(f"{self._transport.url} {what}"))

    def look(self) -> float:
        """Ask the reading thread to take what has arrived; it calls `looked` then.

        Returns: for how many seconds the answer is worth waiting for. Some transports have a thread
            of their own between the link and `read`, which cannot be asked: without an answer, what
            had arrived has come through by then.
        """
        with self._changed:
            if self._asked == self._answered:
                self._asked_at = self._clock()
            self._asked += 1
        self._ring()
        if self._transport.wake_reader():
            return _PATIENCE_S
        return _UNSURE_S

    def wait_for_look(self) -> None:
        """Wait until what has arrived was taken, or for as long as `look` says."""
        if self.is_leading:  # this is a signal handler, so nobody else will take it
            end = self._clock() + LOOK_S
            with contextlib.suppress(TransportError):
                while self.wait(0) and self._clock() < end:
                    self.step()
            return
        limit_s = self.look()
        asked = self._asked
        with self._changed:
            self._changed.wait_for(
                lambda: self._answered >= asked or not self._is_reading, timeout=limit_s
            )

    # ------------------------------------------------------------------ in a caller

    def start_leading(self) -> bool:
        """Become the reading thread, if the transport allows it and no other thread reads.

        A signal handler may raise behind `acquire`; `is_leading` is true then.
        """
        if not self._can_lead:
            return False
        if self._reading.acquire(False):
            return True
        self._led_at = time.monotonic()  # the next caller may
        return False

    @property
    def is_leading(self) -> bool:
        """The thread that asks is the one that reads."""
        return self._reading._is_owned()  # type: ignore[attr-defined, no-any-return]

    def wait(self, limit_s: float) -> bool:
        """Wait for something that `step` can take; only who leads does this."""
        if self._unread or self._asked != self._answered:
            return True
        return self._transport.wait(limit_s) or self._asked != self._answered

    def stop_leading(self, is_awaited: bool) -> None:
        """Leave reading to others; at once to the reading thread, where somebody waits."""
        self._led_at = time.monotonic()
        self._reading.release()
        if is_awaited:
            self._ring()

    def step(self, limit_s: float | None = 0) -> None:
        """Read once and hand over what came, at most one piece; for who reads.

        Args:
            limit_s: how long to wait for something, in seconds; None is for ever.
        """
        asked = self._asked
        is_asked = asked != self._answered
        now = self._clock() if is_asked else 0.0
        data = self._unread or self._transport.read(0 if is_asked else limit_s)
        if data:
            self._unread = data[PIECE:]
            self._receive(data[:PIECE])
        elif is_asked:
            self._answer(asked, now)
        if data and self._asked != self._answered:
            now = self._clock()
            if now >= self._asked_at + LOOK_S:
                self._answer(self._asked, now)
        if self._is_simulated and not self._unread and (now := self._clock()) >= self.due:
            self.due = math.inf
            self._looked(now)

    # ------------------------------------------------------------------ in the threads

    def _read(self) -> None:
        limit_s = _SLICE_S if self._is_simulated else None
        try:
            while self._take_over():
                try:
                    self.step(limit_s)
                finally:
                    self._reading.release()
        except BaseException as error:  # also sys.exit(), which would end this thread only
            self._end(link_error(error))
        finally:
            with self._changed:
                self._is_reading = False
                self._changed.notify_all()

    def _take_over(self) -> bool:
        """Become the one who reads as soon as callers do not do it themselves; False at the end."""
        is_due = self._bell.wait(0)
        # A signal handler that closes the link leads until it has returned.
        while not self._is_stopped:
            left_s = self._led_at + _LINGER_S - time.monotonic()
            if (is_due or left_s <= 0) and self._reading.acquire(blocking=False):
                return True
            is_due = self._bell.wait(max(left_s, _LINGER_S))
        return False

    def _answer(self, asked: int, now: float) -> None:
        self._looked(now)
        with self._changed:
            self._answered = asked
            self._asked_at = math.inf if asked == self._asked else now
            self._changed.notify_all()

    def _write_failed(self, error: BaseException) -> None:
        if isinstance(error, LinkClosed):
            self._end(error)
            return
        # The other side may have answered before it went away.
        self.wait_for_look()
        self._end(link_error(error))

    def _end(self, reason: LinkError | LocalError) -> None:
        self._ended(reason)
        with contextlib.suppress(Exception):  # it has failed already
            self._transport.close()


def clock_of(transport: Transport) -> Callable[[], float]:
    """Return the clock of a transport; directly that of the machine, where it is that one."""
    clock = transport.clock  # perhaps that of a transport within
    is_machine = getattr(clock, "__func__", None) is Transport.clock
    return time.monotonic if is_machine else clock


def start_thread(target: Callable[[], None], name: str) -> threading.Thread:
    """Start a thread that does not keep the program alive.

    Raises:
        OpenFailed: the system has no thread to give.
    """
    thread = threading.Thread(target=target, name=name, daemon=True)
    try:
        thread.start()
    except RuntimeError as error:
        raise OpenFailed(f"{name}: {error}; this process or system has too many") from None
    return thread


def start_or_do(work: Callable[[], None], name: str) -> list[threading.Thread]:
    """Do something that may wait in a thread, which is returned; here, where there is none."""
    try:
        return [start_thread(work, name)]
    except LinkError:  # better late than never
        work()
        return []


def join_threads(threads: Iterable[threading.Thread], limit_s: float) -> None:
    """Wait for threads that were told to end, but not for ever."""
    deadline = time.monotonic() + limit_s
    for thread in threads:
        if thread is not threading.current_thread():
            thread.join(max(0.0, deadline - time.monotonic()))
            if thread.is_alive():
                _logger.warning("%s is still busy after close", thread.name)
