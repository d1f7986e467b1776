"""The threads of the blocking client: a session, a transport and two threads.

What flows in: calls from any thread, bytes from the transport. What flows out: replies to the
callers, SIFs to their handlers.
Rules: one thread reads, another runs the SIF handlers in order, so a handler may itself call. Each
caller writes its own request and watches its own time limit. The reader never writes, so a device
that does not read cannot keep its replies from being read.
"""

import queue
import threading
import time
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

from j2a._handlers import Handlers, Reporter
from j2a._link import TRANSPORT_ERRORS, link_error
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
        on_handler_error: Callable[[Exception, Sif], None] | None,
    ) -> None:
        self.handlers: Handlers[Handler] = Handlers()
        self._transport = transport
        self._session = session
        self._reporter = Reporter(on_handler_error)
        self._drops_sifs = False
        self._sifs: queue.SimpleQueue[Sif | None] = queue.SimpleQueue()
        # Taken in this order. Bytes are fetched and written under the first, so requests keep
        # their order; a write that waits for the device holds up nothing but other writes.
        self._writing = threading.Lock()
        self._state = threading.Lock()
        take_stale_input(transport, session)
        self._reader = self._start(self._read, "reader")
        self._dispatcher = self._start(self._dispatch, "handlers")

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
        with self._state:
            call = self._session.start_call(
                what, opcode, payload, now=time.monotonic(), timeout_s=limit_s, waiter=waiter
            )
        try:
            self._wait(call, waiter)
        except BaseException:
            with self._state:
                self._wake(self._session.cancel(call))
            raise
        if call.reply is None:
            assert call.error is not None
            raise call.error
        return call.reply

    def set_rxbuf(self, rxbuf: int) -> None:
        """Tell the session how many bytes the device holds; see `Session`."""
        with self._state:
            self._session.rxbuf = rxbuf

    def close(self) -> None:
        """End all calls, drop SIFs that wait for their handlers, wait for the threads."""
        self._drops_sifs = True
        self._end(LinkClosed(f"{self._transport.url} was closed by this program"))
        join_threads([self._reader, self._dispatcher])

    def _wait(self, call: Call, waiter: threading.Lock) -> None:
        while True:
            self._flush()
            if call.has_ended:
                return
            wait_s = -1.0
            if call.deadline is not None:
                wait_s = min(max(0.0, call.deadline - time.monotonic()), threading.TIMEOUT_MAX)
            if not waiter.acquire(timeout=wait_s):
                with self._state:
                    self._wake(self._session.handle_timeout(time.monotonic()))

    def _flush(self) -> None:
        """Write what the session has to send; called by callers, never by the reader."""
        try:
            with self._writing:
                with self._state:
                    data = self._session.data_to_send()
                if data:
                    self._transport.write(data)
        except TRANSPORT_ERRORS as error:
            self._end(link_error(error))

    def _wake(self, calls: Iterable[Call | Sif]) -> None:
        """Tell callers that their call was sent or has ended; the state lock is held."""
        for call in calls:
            if isinstance(call, Call) and call.waiter.locked():
                call.waiter.release()

    def _read(self) -> None:
        try:
            while True:
                data = self._transport.read(None)
                with self._state:
                    events = self._session.receive(data)
                    self._wake(events)
                    for event in events:
                        if isinstance(event, Sif):
                            self._queue_sif(event)
        except TRANSPORT_ERRORS as error:
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
                except Exception as error:
                    with self._state:
                        self._session.count("handler_errors")
                    self._reporter.report(error, sif)

    def _end(self, reason: LinkError | LocalError) -> None:
        """End all calls with the reason and let both threads run out."""
        with self._state:
            if not self._session.is_closed:
                self._wake(self._session.close(reason))
                self._sifs.put(None)
        self._transport.close()
