"""One configuration of a gadget by its host, as a transport.

In: bytes that the gadget's reading thread hands over, and those to write.  Out: the same bytes.
Rules: a reset, an unplugging and a new configuration by the host drop what was not yet read or
sent (USB-011), and end all calls at once; a burst ends with a short packet, so with an empty one
where the last was full (USB-014).
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from typing import Final

from j2a_transports._base import LinkClosed, LinkLost, Transport, WriteTimeout
from j2a_transports._loopback import Channel

# A multiple of every packet size. The kernel copies it to a buffer in one piece.
CHUNK: Final = 16384

# How long closing waits for a host to fetch the empty packet that ends a burst; for bytes it waits
# as long as a write does.
EMPTY_PACKET_END_S: Final = 0.1


class _Outgoing(Channel):
    """A channel that can be asked whether there is something in it."""

    @property
    def empty(self) -> bool:
        with self._changed:
            return not self._data


class GadgetTransport(Transport):
    """The byte stream to the host that has configured a gadget.

    Args:
        url: for messages.
        write_timeout_s: see `Transport`.
        on_close: called once, when what was written has been sent or is dropped.

    Attributes:
        used: whether a byte of the host has come, or one was given to `write`.
        lost: whether the host or the bus has ended the link.
    """

    def __init__(
        self,
        url: str,
        write_timeout_s: float | None,
        on_close: Callable[[GadgetTransport], None],
    ) -> None:
        super().__init__(url, write_timeout_s)
        self.used = False
        self._incoming = Channel()
        self._outgoing = _Outgoing()
        self._on_close = on_close
        self._closed = False
        self._reason: str | None = None
        self._sent = threading.Event()
        self._only_empty_packet = False
        self._writing = threading.Lock()
        # Re-entrant, so that a signal handler may close what its own thread is closing.
        self._ending = threading.RLock()
        self._process = os.getpid()
        self._ended = False

    # ------------------------------------------------------------------ for the program

    def read(self, timeout_s: float | None) -> bytes:
        """See `Transport.read`; what the host sent before it left is dropped, not returned."""
        data = self._incoming.get(timeout_s)
        self._check()
        return data

    def write(self, data: bytes | bytearray | memoryview) -> None:
        """See `Transport.write`."""
        rest = memoryview(data).cast("B")
        with self._writing:
            self._check()
            while rest:
                self.used = True
                sent = self._outgoing.put(rest, self.write_timeout_s)
                self._check()
                rest = rest[sent:]
                if not sent:
                    raise WriteTimeout(
                        f"{self.url} took no byte for {self.write_timeout_s} s "
                        f"({len(rest)} of {len(data)} bytes not sent): the host does not read"
                    )

    @property
    def closed(self) -> bool:
        """See `Transport.closed`."""
        return self._closed

    def close(self) -> None:
        """See `Transport.close`; the gadget leaves the bus until the next `accept`.

        A child process only lets go: the link is its parent's.
        """
        self._closed = True
        if os.getpid() != self._process:
            return
        with self._ending:
            if self._ended:  # or it is being closed, and this is a signal handler amid that
                return
            self._ended = True
            self._outgoing.close_writer()
            self._incoming.close_reader()
            limit_s = self.write_timeout_s
            deadline = None if limit_s is None else time.monotonic() + limit_s
            while not self._sent.wait(EMPTY_PACKET_END_S):
                if self._only_empty_packet and self._outgoing.empty:
                    break
                if deadline is not None and time.monotonic() >= deadline:
                    break
            self._outgoing.close_reader()
            self._on_close(self)

    def _check(self) -> None:
        if self._closed:
            raise LinkClosed(f"{self.url} is closed")
        if self._reason is not None:
            raise LinkLost(f"{self.url} is lost: {self._reason}")

    # ------------------------------------------------------------------ for the gadget

    @property
    def lost(self) -> bool:
        """Whether `lose` was called."""
        return self._reason is not None

    def lose(self, reason: str) -> None:
        """End the link; only the first reason counts."""
        if self._reason is None:
            self._reason = reason
        self._incoming.close_reader()
        self._outgoing.close_reader()

    def take(self, data: bytes) -> None:
        """Hand over bytes of the host; waits while the program does not read them."""
        self.used = True
        rest = memoryview(data)
        while sent := self._incoming.put(rest, None):
            rest = rest[sent:]

    def send_all(self, send: Callable[[bytes], bool], packet: Callable[[], int]) -> None:
        """Send what is written until the link ends.

        Args:
            send: sends one piece, waiting for the host; returns whether the link is still there.
            packet: the packet size of the endpoint.
        """
        try:
            data = self._outgoing.get(None)
            while data:
                for at in range(0, len(data), CHUNK):
                    if not send(data[at : at + CHUNK]):
                        return
                more = self._outgoing.get(0)
                if not more:
                    if len(data) % packet() == 0:
                        self._only_empty_packet = True
                        if not send(b""):
                            return
                        self._only_empty_packet = False
                    more = self._outgoing.get(None)
                data = more
        finally:
            self._outgoing.close_reader()
            self._sent.set()
