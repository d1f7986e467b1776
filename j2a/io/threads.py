"""The threads that move bytes between a client and its transport.

What flows in: bytes to send, bytes from the transport, questions whether a reply has arrived. What
flows out: received bytes in small pieces, and the reason for which the link has ended.
Rules: one thread reads, one writes what the link does not take at once; they know no packet. The
reading thread hands over one piece after the other and reads no further meanwhile, so a flood waits
in the transport. A time limit is judged only after a look: the reading thread has taken what had
arrived by then.
"""

import contextlib
import logging
import math
import os
import queue
import threading
import time
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Final

from j2a.errors import LinkClosed, LinkError, LocalError, OpenFailed
from j2a.io.opening import link_error

if TYPE_CHECKING:
    from j2a_transports import Transport

__all__ = ["JOIN_S", "LOOK_S", "PIECE", "LinkThreads", "join_threads", "start_thread"]

PIECE: Final = 4096
"""Bytes handed over at once; the worst ones take about 10 ms to parse."""

LOOK_S: Final = 0.02
"""Where bytes never end, a look is over after so many seconds."""

_UNSURE_S: Final = 0.04
"""How long bytes may take through the thread of a transport that has one of its own."""

_PATIENCE_S: Final = 1.0
"""How long a reading thread that was woken may take to be scheduled."""

JOIN_S: Final = 5.0
"""How long a client that is closed waits for its SIF handlers, and then for its threads."""

_logger = logging.getLogger("j2a")


class LinkThreads:
    """Reads and writes a transport in two threads.

    Args:
        transport: is closed when a thread fails.
        receive: called by the reading thread with 1 to `PIECE` bytes; may wait.
        looked: called by the reading thread with a time (time.monotonic) once everything that had
            arrived by then was given to `receive`.
        ended: called by a thread that ends, with the reason; perhaps by both.
    """

    def __init__(
        self,
        transport: "Transport",
        receive: Callable[[bytes], None],
        looked: Callable[[float], None],
        ended: Callable[[LinkError | LocalError], None],
    ) -> None:
        self._transport = transport
        self._receive = receive
        self._looked = looked
        self._ended = ended
        self._outgoing: queue.SimpleQueue[bytes | LinkClosed | None] = queue.SimpleQueue()
        # A transport may also be an object that has no more than it needs.
        self._try_write = getattr(transport, "try_write", lambda _data: 0)
        # Pieces that were queued, and those of them that were written.
        self._queued = self._written = 0
        self._changed = threading.Condition()
        self._asked = self._answered = 0
        self._asked_at = math.inf
        self._is_reading = True
        self._process = os.getpid()
        self.threads: list[threading.Thread] = []

    def start(self) -> None:
        """Start both threads."""
        self.threads += [
            start_thread(self._read, f"j2a reader {self._transport.url}"),
            start_thread(self._write, f"j2a writer {self._transport.url}"),
        ]

    @property
    def is_inherited(self) -> bool:
        """This process is a child of that which has the threads, and the link is not its own."""
        return os.getpid() != self._process

    def check_process(self) -> None:
        """Refuse to work in a child process, which has the link but not the threads.

        Raises:
            LocalError: this is one.
        """
        if self.is_inherited:
            raise LocalError(
                f"{self._transport.url} was connected before this process was forked and belongs "
                "to its parent; connect again in the child"
            )

    def send(self, data: bytes) -> None:
        """Have bytes written; does not wait. For one thread at a time.

        If nothing waits for the writing thread, what the link takes at once needs no other thread.
        """
        if self._written == self._queued:
            data = data[self._try_write(data) :]
        if data:
            self._queued += 1
            self._outgoing.put(data)

    def stop(self) -> None:
        """Let the writing thread run out; the reading one ends when the transport is closed."""
        self._outgoing.put(None)

    def abandon(self, what: str) -> None:
        """End the link without waiting; `what` happened to it.

        Safe in a destructor, which any thread may run anywhere, and in a signal handler.
        """
        self._outgoing.put(LinkClosed(f"{self._transport.url} {what}"))

    def look(self) -> float:
        """Ask the reading thread to take what has arrived; it calls `looked` then.

        Returns: for how many seconds the answer is worth waiting for. Some transports have a thread
            of their own between the link and `read`, which cannot be asked: without an answer, what
            had arrived has come through by then.
        """
        if not hasattr(self._transport, "wake_reader"):
            return _UNSURE_S
        with self._changed:
            if self._asked == self._answered:
                self._asked_at = time.monotonic()
            self._asked += 1
        if self._transport.wake_reader():
            return _PATIENCE_S
        return _UNSURE_S

    def wait_for_look(self) -> None:
        """Wait until what has arrived was taken, or for as long as `look` says."""
        limit_s = self.look()
        asked = self._asked
        with self._changed:
            self._changed.wait_for(
                lambda: self._answered >= asked or not self._is_reading, timeout=limit_s
            )

    # ------------------------------------------------------------------ in the threads

    def _read(self) -> None:
        try:
            while True:
                asked, now = self._asked, time.monotonic()
                is_asked = asked != self._answered
                data = self._transport.read(0 if is_asked else None)
                if is_asked and not data:
                    self._answer(asked, now)
                for start in range(0, len(data), PIECE):
                    self._receive(data[start : start + PIECE])
                    now = time.monotonic()
                    if now >= self._asked_at + LOOK_S:
                        self._answer(self._asked, now)
        except Exception as error:
            self._end(link_error(error))
        finally:
            with self._changed:
                self._is_reading = False
                self._changed.notify_all()

    def _answer(self, asked: int, now: float) -> None:
        self._looked(now)
        with self._changed:
            self._answered = asked
            self._asked_at = math.inf if asked == self._asked else now
            self._changed.notify_all()

    def _write(self) -> None:
        try:
            while (data := self._outgoing.get()) is not None:
                if isinstance(data, LinkClosed):
                    self._end(data)
                    return
                self._transport.write(data)
                self._written += 1
        except Exception as error:
            # The other side may have answered before it went away.
            self.wait_for_look()
            self._end(link_error(error))

    def _end(self, reason: LinkError | LocalError) -> None:
        self._ended(reason)
        with contextlib.suppress(Exception):  # it has failed already
            self._transport.close()


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


def join_threads(threads: Iterable[threading.Thread], limit_s: float) -> None:
    """Wait for threads that were told to end, but not for ever."""
    deadline = time.monotonic() + limit_s
    for thread in threads:
        if thread is not threading.current_thread():
            thread.join(max(0.0, deadline - time.monotonic()))
            if thread.is_alive():
                _logger.warning("%s is still busy after close", thread.name)
