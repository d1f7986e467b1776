"""One host of a device: the state of its link, and the transport to it.

What flows in: bytes of the host, SIFs from any thread. What flows out: requests to execute, replies
and SIFs on the wire.
Rules: replies are written by the thread that serves the host. A SIF is written by the thread that
sends it as far as the link takes it at once. The rest, and SIFs in quick succession, are written by
one that is started for it; so a host that does not read delays nobody but itself. What waits for it
is bounded: further SIFs are lost for this host, which sees the gap in their numbers.
"""

import contextlib
import logging
import math
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Final

from j2a.errors import LinkClosed, LinkError
from j2a.io.bell import Bell
from j2a.io.opening import TRANSPORT_ERRORS, WAIT_S, link_error
from j2a.io.threads import clock_of, start_thread
from j2a.protocol.server import Request, Server

if TYPE_CHECKING:
    from j2a_transports import Transport

__all__ = ["MAX_WAITING", "Connection"]

MAX_WAITING: Final = 2**18
"""So many bytes may wait for a host that reads slowly."""
LAST_WRITE_S: Final = 0.2
SUCCESSION_S: Final = 0.001
"""A SIF so soon after another is left to the thread, which writes several of them at once."""
_logger = logging.getLogger("j2a")


class Connection:
    """A host that is being served.

    Args:
        server: the state of the link.
        transport: the open byte stream to the host.

    Attributes:
        transport: that byte stream.
        has_asked: the host has sent a good request.
        last_heard: when bytes of the host came last, by the transport's clock in seconds.
    """

    def __init__(self, server: Server, transport: "Transport") -> None:
        self.transport = transport
        self.has_asked = False
        self._now = clock_of(transport)
        self.last_heard = self._now()
        self._server = server
        # Taken in this order. Bytes are fetched and written under the first, so they keep their
        # order; a write that waits for the host holds up nothing but other writes to it.
        self._writing = threading.Lock()
        self._state = threading.RLock()  # a signal handler may close amid all of this
        self._unwritten = b""
        self._last_sif = -math.inf
        self._sif_writer: threading.Thread | None = None
        self._sif_waits = Bell()
        self._ended = False

    def run(self, execute: Callable[[int, bytes], tuple[int, bytes]]) -> None:
        """Serve until the link ends, whichever side ends it."""
        try:
            self._flush()  # what a host is told before it asks
            while True:
                self._read()
                while (request := self._next_request()) is not None:
                    self.has_asked = True
                    code, payload = execute(request.opcode, request.payload)
                    with self._state:
                        self._server.reply(request, code, payload)
                    self._flush()
                self._flush()
        except TRANSPORT_ERRORS as error:
            _log_end(error)
        finally:
            self._ended = True
            self._sif_waits.ring()

    def send_sif(self, opcode: int, payload: bytes) -> bool:
        """Send a SIF, without waiting; False when the link has ended or the host is too slow."""
        with self._state:
            if self._ended:
                return False
            if self._server.waiting >= MAX_WAITING:
                self._server.skip_sif()
                return False
            self._server.send_sif(opcode, payload)
            before, self._last_sif = self._last_sif, self._now()
            is_alone = self._last_sif - before >= SUCCESSION_S
        if not (is_alone and self._try_write()):
            self._write_soon()
        return True

    @property
    def silent_s(self) -> float:
        """For how long nothing has come from the host, in seconds."""
        return self._now() - self.last_heard

    def close(self) -> None:
        """Write what waits, as far as the host takes it at once, and end the link."""
        self.transport.write_timeout_s = LAST_WRITE_S
        if self._writing.acquire(timeout=LAST_WRITE_S):
            try:
                with contextlib.suppress(*TRANSPORT_ERRORS):
                    self._write()
            finally:
                self._writing.release()
        self.transport.close()

    def _try_write(self) -> bool:
        """Write what the link takes at once; return whether nothing is left for another thread."""
        if not self._writing.acquire(blocking=False):
            return False
        try:
            if not self._unwritten:
                data = self._fetch()
                self._unwritten = data[self.transport.try_write(data) :]
            return not self._unwritten
        finally:
            self._writing.release()

    def _write_soon(self) -> None:
        with self._state:
            if self._sif_writer is None:
                # Without a thread to give for it, the SIF goes out with the next reply.
                with contextlib.suppress(LinkError):
                    self._sif_writer = start_thread(
                        self._write_sifs, f"j2a SIFs {self.transport.url}"
                    )
        self._sif_waits.ring()

    def _write_sifs(self) -> None:
        try:
            while True:
                self._sif_waits.wait(threading.TIMEOUT_MAX)
                if self._ended:
                    return
                self._flush()
        except TRANSPORT_ERRORS as error:
            _log_end(error)
            self.transport.close()

    def _read(self) -> None:
        with self._state:
            deadline = self._server.next_timeout()
        wait_s = WAIT_S
        if deadline is not None:
            wait_s = min(max(0.0, deadline - self._now()), WAIT_S)
        data = self.transport.read(wait_s)
        if not data:
            # This thread may have been late itself: what has come by now came in time.
            data = self.transport.read(0)
        now = self._now()
        with self._state:
            if data:
                self.last_heard = now
                self._server.receive(data, now)
            else:
                self._server.handle_timeout(now)

    def _next_request(self) -> Request | None:
        with self._state:
            return self._server.next_request()

    def _flush(self) -> None:
        with self._writing:
            self._write()

    def _write(self) -> None:
        data = self._fetch()
        self._unwritten = b""
        if data:
            self.transport.write(data)

    def _fetch(self) -> bytes:
        with self._state:
            return self._unwritten + self._server.data_to_send()


def _log_end(error: Exception) -> None:
    reason = link_error(error)
    level = logging.DEBUG if isinstance(reason, LinkClosed) else logging.INFO
    _logger.log(level, "the link to a host has ended: %s", reason)
