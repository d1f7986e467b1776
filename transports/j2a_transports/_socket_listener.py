"""A listener on a socket whose system can tell when a peer has arrived: TCP, Bluetooth.

In: a bound and listening socket.  Out: the transports that a subclass makes of its peers.
Rules: a peer that is gone before it is served is passed over; while the system has no file for
another peer, those that arrive are turned away by closing their connection, and listening goes on;
anything else that fails an accept is told.
"""

from __future__ import annotations

import contextlib
import errno
import os
import socket
import time
from abc import abstractmethod
from typing import Final

from ._base import LinkClosed, Listener, Transport, TransportError
from ._in_use import InUse
from ._poll import Readiness, Waker

# What accept, or an option of the socket that it gave, says of one connection and not of the
# listener: that it has ended already (EINVAL is how macOS says it of an option), or, on Linux, an
# error of the network that had been waiting for that connection.
_GONE = frozenset(
    {errno.ECONNABORTED, errno.ECONNRESET, errno.EINVAL, errno.ENOTCONN, errno.EPROTO}
    | {errno.ENETDOWN, errno.ENETUNREACH, errno.EHOSTDOWN, errno.EHOSTUNREACH, errno.ETIMEDOUT}
)
# No file or memory for another connection at the moment: of this process, or of the system.
_SCARCE: Final = frozenset({errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM})
BACK_OFF_S: Final = 0.1


class SocketListener(Listener):
    """A listening socket; a subclass says how to take the next peer.

    Args:
        url: what a client opens.
        sock: bound and listening; the listener owns it from now on.
    """

    def __init__(self, url: str, sock: socket.socket) -> None:
        sock.setblocking(False)
        super().__init__(url)
        self._sock = sock
        self._waker = Waker()
        self._readable = Readiness(sock.fileno(), self._waker, write=False)
        self._in_use = InUse(self._free)
        self._spare = _spare_file()
        self._closed = False

    def accept(self, timeout_s: float | None) -> Transport | None:
        """See `Listener.accept`."""
        return self._in_use.run(lambda: self._accept(timeout_s))

    def _accept(self, timeout_s: float | None) -> Transport | None:
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        while True:
            if self._closed:
                raise LinkClosed(f"{self.url} is closed")
            state = self._readable.wait(timeout_s)
            if self._closed:
                raise LinkClosed(f"{self.url} was closed during accept")
            if not state:
                return None
            try:
                return self._take()
            except OSError as error:
                if error.errno in _SCARCE:
                    self._turn_away()
                    time.sleep(BACK_OFF_S)
                elif not isinstance(error, BlockingIOError) and error.errno not in _GONE:
                    raise TransportError(
                        f"{self.url}: cannot accept: {error.strerror or error}"
                    ) from error
            # The client gave up between its arrival and our call, or was turned away; however many
            # others there are, they wait for the next call.
            if deadline is not None:
                timeout_s = deadline - time.monotonic()
                if timeout_s <= 0:
                    return None

    @abstractmethod
    def _take(self) -> Transport:
        """Accept the next peer; OSError when it cannot be."""

    def _turn_away(self) -> None:
        """Accept the next peer with the one file that was kept for this, and hang up."""
        if self._spare is not None:
            os.close(self._spare)
        with contextlib.suppress(OSError, TransportError):
            self._take().close()
        self._spare = _spare_file()

    def close(self) -> None:
        """See `Listener.close`."""
        self._closed = True
        self._waker.wake()
        self._in_use.end()

    def _free(self) -> None:
        self._release()
        if self._spare is not None:
            os.close(self._spare)
        self._waker.close()

    def _release(self) -> None:
        """Free the socket; called once, when it is no longer in use."""
        self._sock.close()


def _spare_file() -> int | None:
    try:
        return os.open(os.devnull, os.O_RDONLY)
    except OSError:
        return None
