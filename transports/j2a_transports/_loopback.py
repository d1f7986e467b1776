"""Memory transports: `pair()`, and `loopback:name` between threads of one process.

In: bytes written at one end.  Out: the same bytes at the other end.
Rules: each direction holds at most `LIMIT` bytes, so that a peer that does not read is noticed as
on a real link; what was written before `close()` is still delivered.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any, Final

from ._base import (
    DEFAULT_WRITE_TIMEOUT_S,
    BadUrl,
    LinkClosed,
    LinkLost,
    Listener,
    OpenFailed,
    Transport,
    WriteTimeout,
)
from ._scheme import Scheme, Usage
from ._url import Url

LIMIT: Final = 65536
_LOOK_S: Final = 0.1
"""So often a wait looks at its condition without being told, in seconds."""

_OPEN: Final = Usage(
    "loopback:NAME", "the listener of that name in this process", ("loopback:board",)
)
_LISTEN: Final = Usage("loopback:NAME", "a name in this process", ("loopback:board",))
SCHEME: Final = Scheme(name="loopback", open=_OPEN, listen=_LISTEN)


def _wait_for(
    changed: threading.Condition, holds: Callable[[], bool], timeout_s: float | None
) -> None:
    """Wait until a condition holds or the time is over; the lock is held.

    It is looked at again and again, because a signal handler that changes something amid the first
    steps of a wait of its own thread tells nobody.
    """
    end = None if timeout_s is None else time.monotonic() + timeout_s
    while not holds():
        left_s = _LOOK_S if end is None else min(_LOOK_S, end - time.monotonic())
        if left_s <= 0:
            return
        changed.wait(left_s)


class Channel:
    """One direction: a bounded buffer of bytes with one writing and one reading side."""

    def __init__(self, limit: int = LIMIT) -> None:
        self._limit = limit
        self._data = bytearray()
        self._changed = threading.Condition()
        self.writer_closed = False
        self.reader_closed = False
        self._reader_woken = False

    def wake_reader(self) -> None:
        """Make the `get` that waits, or the next one, return at once."""
        with self._changed:
            self._reader_woken = True
            self._changed.notify_all()

    def close_writer(self) -> None:
        """No more bytes will come."""
        with self._changed:
            self.writer_closed = True
            self._changed.notify_all()

    def close_reader(self) -> None:
        """Nobody will take bytes any more; those that wait are thrown away."""
        with self._changed:
            self.reader_closed = True
            self._data.clear()
            self._changed.notify_all()

    def get(self, timeout_s: float | None) -> bytes:
        """Take all bytes, waiting for the first; b"" at the timeout, the end, or when woken."""
        with self._changed:
            _wait_for(
                self._changed,
                lambda: bool(
                    self._data or self.writer_closed or self.reader_closed or self._reader_woken
                ),
                timeout_s,
            )
            self._reader_woken = False
            data = bytes(self._data)
            self._data.clear()
            if data:
                self._changed.notify_all()
            return data

    def put(self, data: memoryview, timeout_s: float | None) -> int:
        """Add as many bytes as fit, waiting for room for the first; 0 at the timeout or a close."""
        with self._changed:
            _wait_for(
                self._changed,
                lambda: len(self._data) < self._limit or self.writer_closed or self.reader_closed,
                timeout_s,
            )
            if self.writer_closed or self.reader_closed:
                return 0
            taken = data[: self._limit - len(self._data)]
            self._data += taken
            if taken:
                self._changed.notify_all()
            return len(taken)


class LoopbackTransport(Transport):
    """One end of a pair of channels.

    Args:
        url: for messages.
        incoming: the channel to read from.
        outgoing: the channel to write to.
        write_timeout_s: see `Transport`.
    """

    def __init__(
        self,
        url: str,
        incoming: Channel,
        outgoing: Channel,
        write_timeout_s: float | None = DEFAULT_WRITE_TIMEOUT_S,
    ) -> None:
        super().__init__(url, write_timeout_s)
        self._incoming = incoming
        self._outgoing = outgoing
        self._writing = threading.Lock()

    def read(self, timeout_s: float | None) -> bytes:
        """See `Transport.read`."""
        data = self._incoming.get(timeout_s)
        if self._incoming.reader_closed:
            raise LinkClosed(f"{self.url} is closed")
        # The peer may write and close between the two lines above: look once more before the end.
        if not data and self._incoming.writer_closed:
            data = self._incoming.get(0)
            if not data:
                raise self._lost()
        return data

    def wake_reader(self) -> bool:
        """See `Transport.wake_reader`."""
        self._incoming.wake_reader()
        return True

    def write(self, data: bytes | bytearray | memoryview) -> None:
        """See `Transport.write`."""
        rest = memoryview(data).cast("B")
        with self._writing:
            while True:
                sent = self._outgoing.put(rest, self.write_timeout_s) if rest else 0
                rest = rest[sent:]
                if self._outgoing.writer_closed:
                    raise LinkClosed(f"{self.url} is closed")
                if self._outgoing.reader_closed:
                    raise self._lost()
                if not rest:
                    return
                if not sent:
                    raise WriteTimeout(
                        f"{self.url} took no byte for {self.write_timeout_s} s "
                        f"({len(rest)} of {len(data)} bytes not sent): the peer does not read"
                    )

    @property
    def closed(self) -> bool:
        """See `Transport.closed`."""
        return self._incoming.reader_closed

    def close(self) -> None:
        """See `Transport.close`."""
        self._outgoing.close_writer()
        self._incoming.close_reader()

    def _lost(self) -> LinkLost:
        """Say how the link was lost."""
        return LinkLost(f"{self.url} is lost: the peer closed it")


def pair(
    url: str = "loopback:", write_timeout_s: float | None = DEFAULT_WRITE_TIMEOUT_S
) -> tuple[LoopbackTransport, LoopbackTransport]:
    """Return two joined ends."""
    there, back = Channel(), Channel()
    return (
        LoopbackTransport(url, back, there, write_timeout_s),
        LoopbackTransport(url, there, back, write_timeout_s),
    )


_listeners: dict[str, LoopbackListener] = {}
_listeners_lock = threading.RLock()  # a signal handler may close a listener amid all of this


class LoopbackListener(Listener):
    """A name in this process that `open("loopback:name")` finds."""

    def __init__(self, url: str, name: str, write_timeout_s: float | None) -> None:
        super().__init__(url)
        self._name = name
        self._write_timeout_s = write_timeout_s
        self._waiting: deque[LoopbackTransport] = deque()
        self._changed = threading.Condition()
        self._closed = False

    def connect(self, write_timeout_s: float | None) -> LoopbackTransport:
        """Return the near end of a new pair; the far end waits for `accept`."""
        near, far = pair(self.url, write_timeout_s)
        far.write_timeout_s = self._write_timeout_s
        with self._changed:
            if self._closed:
                raise OpenFailed(f"{self.url}: the listener has just been closed")
            self._waiting.append(far)
            self._changed.notify()
        return near

    def accept(self, timeout_s: float | None) -> Transport | None:
        """See `Listener.accept`."""
        with self._changed:
            _wait_for(self._changed, lambda: bool(self._waiting) or self._closed, timeout_s)
            if self._closed:
                raise LinkClosed(f"{self.url} is closed")
            return self._waiting.popleft() if self._waiting else None

    def close(self) -> None:
        """See `Listener.close`; peers that were not accepted lose their link."""
        with _listeners_lock:
            if _listeners.get(self._name) is self:
                del _listeners[self._name]
        with self._changed:
            self._closed = True
            for transport in self._waiting:
                transport.close()
            self._waiting.clear()
            self._changed.notify_all()


def check_url(url: Url) -> tuple[str, dict[str, Any]]:
    """Return name and options of `loopback:name`; raises BadUrl."""
    return _name(url), url.options([], _OPEN)


def open_url(url: Url) -> Transport:
    """Connect to the listener of that name in this process."""
    name, options = check_url(url)
    with _listeners_lock:
        listener = _listeners.get(name)
    if listener is None:
        raise OpenFailed(
            f"{url.text}: no such listener in this process; make it first with listen({url.text!r})"
        )
    return listener.connect(options["write_timeout"])


def listen_url(url: Url) -> Listener:
    """Give this process a listener of that name."""
    options = url.options([], _LISTEN)
    name = _name(url)
    with _listeners_lock:
        if name in _listeners:
            raise OpenFailed(f"{url.text}: this name is taken; close that listener or use another")
        listener = LoopbackListener(url.text, name, options["write_timeout"])
        _listeners[name] = listener
    return listener


def _name(url: Url) -> str:
    if not url.rest or "?" in url.rest:
        raise BadUrl(f"{url.text}: expected loopback:name; options go into keywords of open()")
    return url.rest
