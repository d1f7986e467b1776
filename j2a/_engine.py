"""The threads of the blocking client: a session, a transport and three threads.

What flows in: calls from any thread, bytes from the transport. What flows out: replies to the
callers, SIFs to their handlers.
Rules: one thread reads, one writes, one runs the SIF handlers in order, so a handler may itself
call. Each caller watches its own time limit and waits for nothing else: a device that does not read
holds up the writer only (J2A-TIME-006).
"""

import queue
import threading
import time
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

from j2a._handlers import ErrorHook, Handlers, Reporter
from j2a._link import WAIT_S, link_error
from j2a._session import Call, Session
from j2a._shell import MAX_SIFS_WAITING, join_threads, take_stale_input
from j2a.errors import LinkClosed, LinkError, LocalError
from j2a.events import Reply, Sif

if TYPE_CHECKING:
    from j2a_transports import Transport

__all__ = ["Engine", "Handler"]

Handler = Callable[[Sif], object]
"""Called with each SIF that it is registered for, in a thread of the client."""


class Engine:
    """Moves calls and SIFs between a session and a transport.

    Args:
        transport: is closed at the end.
        session: belongs to the engine from now on.
        on_handler_error: see `Client`.

    Attributes:
        handlers: of SIFs.
    """

    def __init__(
        self,
        transport: "Transport",
        session: Session,
        on_handler_error: ErrorHook | None,
    ) -> None:
        self.handlers: Handlers[Handler] = Handlers()
        self._transport = transport
        self._session = session
        self._reporter = Reporter(on_handler_error)
        self._drops_sifs = False
        self._sifs: queue.SimpleQueue[Sif | None] = queue.SimpleQueue()
        self._outgoing: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._state = threading.Lock()
        take_stale_input(transport, session)
        self._threads = [
            self._start(self._read, "reader"),
            self._start(self._write, "writer"),
            self._start(self._dispatch, "handlers"),
        ]

    def _start(self, target: Callable[[], None], role: str) -> threading.Thread:
        thread = threading.Thread(
            target=target, name=f"j2a {role} {self._transport.url}", daemon=True
        )
        thread.start()
        return thread

    def call(self, what: str, opcode: int, payload: bytes, limit_s: float) -> Reply:
        """Make one call, from any thread; see `Client.call`."""
        waiter = threading.Lock()
        waiter.acquire()
        try:
            with self._state:
                call = self._session.start_call(
                    what, opcode, payload, now=time.monotonic(), timeout_s=limit_s, waiter=waiter
                )
                self._settle([])
            self._wait(call, waiter)
        except BaseException:
            with self._state:
                self._settle(self._session.cancel(waiter))
            raise
        if call.reply is None:
            assert call.error is not None
            raise call.error
        return call.reply

    def close(self) -> None:
        """End all calls, drop SIFs that wait for their handlers, wait for the threads."""
        self._drops_sifs = True
        self._end(LinkClosed(f"{self._transport.url} was closed by this program"))
        join_threads(self._threads)

    def _wait(self, call: Call, waiter: threading.Lock) -> None:
        while not call.has_ended:
            wait_s = WAIT_S
            if call.deadline is not None:
                wait_s = min(max(0.0, call.deadline - time.monotonic()), WAIT_S)
            if not waiter.acquire(timeout=wait_s):
                with self._state:
                    self._settle(self._session.handle_timeout(time.monotonic()))

    def _settle(self, events: Iterable[Call | Sif]) -> None:
        """Wake the callers whose call has ended, queue SIFs, and send what is to be sent.

        The state lock is held, so requests keep their order.
        """
        for event in events:
            if isinstance(event, Sif):
                self._queue_sif(event)
            elif event.has_ended and event.waiter.locked():
                event.waiter.release()
        data = self._session.data_to_send()
        if data:
            self._outgoing.put(data)

    def _read(self) -> None:
        try:
            while True:
                data = self._transport.read(None)
                with self._state:
                    self._settle(self._session.receive(data))
        except Exception as error:
            self._end(link_error(error))

    def _write(self) -> None:
        try:
            while (data := self._outgoing.get()) is not None:
                self._transport.write(data)
        except Exception as error:
            self._end(link_error(error))

    def _queue_sif(self, sif: Sif) -> None:
        if self._sifs.qsize() < MAX_SIFS_WAITING:
            self._sifs.put(sif)
        else:
            self._session.count("sifs_dropped")

    def _dispatch(self) -> None:
        while (sif := self._sifs.get()) is not None:
            for handler in self.handlers.of(sif.opcode):
                if self._drops_sifs:
                    return
                try:
                    handler(sif)
                except BaseException as error:
                    # Also sys.exit(): it would end this thread, and all SIFs with it.
                    with self._state:
                        self._session.count("handler_errors")
                    self._reporter.report(error, sif)

    def _end(self, reason: LinkError | LocalError) -> None:
        """End all calls with the reason and let the threads run out."""
        with self._state:
            if not self._session.is_closed:
                self._settle(self._session.close(reason))
                self._sifs.put(None)
                self._outgoing.put(None)
        self._transport.close()
