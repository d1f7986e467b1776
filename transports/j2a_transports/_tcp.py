"""TCP: `tcp://host:port`, as a client and as a listener.

In: a URL; options `connect_timeout` (seconds, default 5) and `write_timeout`.  Out: bytes.
Rules: no delay of small packets (Nagle off); a listener binds the address in the URL and no other;
a peer that is gone before it is served is passed over, anything else that fails an accept is told.
"""

from __future__ import annotations

import errno
import os
import socket
import threading
import time

from ._base import LinkClosed, Listener, OpenFailed, Transport, TransportError
from ._poll import CHUNK, PolledTransport, Readiness, Waker
from ._url import Url, host_port, timeout

_CONNECT_TIMEOUT_S = 5.0
# What accept, or an option of the socket that it gave, says of one connection and not of the
# listener: that it has ended already (EINVAL is how macOS says it of an option), or, on Linux, an
# error of the network that had been waiting for that connection.
_GONE = frozenset(
    {errno.ECONNABORTED, errno.ECONNRESET, errno.EINVAL, errno.ENOTCONN, errno.EPROTO}
    | {errno.ENETDOWN, errno.ENETUNREACH, errno.EHOSTDOWN, errno.EHOSTUNREACH, errno.ETIMEDOUT}
)


class TcpTransport(PolledTransport):
    """A connected TCP socket.

    Args:
        url: for messages.
        sock: the connected socket; the transport owns it from now on, and closes it on failure.
        write_timeout_s: see `Transport`.

    Raises:
        OSError: the connection has ended already, or there are too many open files.
    """

    def __init__(self, url: str, sock: socket.socket, write_timeout_s: float | None) -> None:
        self._sock = sock
        try:
            sock.setblocking(False)
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            # A peer that lost its power sends no end of stream; keepalive finds out in the end.
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
            super().__init__(url, sock.fileno(), sock.fileno(), write_timeout_s)
        except OSError:
            sock.close()
            raise

    def _receive(self) -> bytes:
        return self._sock.recv(CHUNK)

    def _send(self, data: memoryview) -> int:
        return self._sock.send(data)

    def _release(self) -> None:
        self._sock.close()


class TcpListener(Listener):
    """A listening TCP socket.

    Args:
        sock: bound and listening; the listener owns it from now on.
        write_timeout_s: given to the transports that are accepted.
    """

    def __init__(self, sock: socket.socket, write_timeout_s: float | None) -> None:
        sock.setblocking(False)
        super().__init__(_url_of(sock.getsockname()))
        self._sock = sock
        self._write_timeout_s = write_timeout_s
        self._waker = Waker()
        self._readable = Readiness(sock.fileno(), self._waker, write=False)
        self._accepting = threading.RLock()
        self._closed = False
        self._released = False

    def accept(self, timeout_s: float | None) -> Transport | None:
        """See `Listener.accept`."""
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        with self._accepting:
            while True:
                if self._closed:
                    raise LinkClosed(f"{self.url} is closed")
                state = self._readable.wait(timeout_s)
                if self._closed:
                    raise LinkClosed(f"{self.url} was closed during accept")
                if not state:
                    return None
                try:
                    sock, address = self._sock.accept()
                    return TcpTransport(_url_of(address), sock, self._write_timeout_s)
                except OSError as error:
                    if not isinstance(error, BlockingIOError) and error.errno not in _GONE:
                        raise TransportError(
                            f"{self.url}: cannot accept: {error.strerror or error}"
                        ) from error
                # The client gave up between its arrival and our call.
                if deadline is not None:
                    timeout_s = max(0.0, deadline - time.monotonic())

    def close(self) -> None:
        """See `Listener.close`."""
        self._closed = True
        self._waker.wake()
        with self._accepting:
            if not self._released:
                self._released = True
                self._sock.close()
                self._waker.close()


def open_url(url: Url) -> Transport:
    """Connect to `tcp://host:port`."""
    address, parts = url.split_query()
    host, port = host_port(url, address)
    options = url.options(parts, {"connect_timeout": timeout})
    wait_s = options.get("connect_timeout", _CONNECT_TIMEOUT_S)
    try:
        sock = socket.create_connection((host, port), wait_s)
        return TcpTransport(url.text, sock, options["write_timeout"])
    except TimeoutError as error:
        raise OpenFailed(
            f"{url.text}: no answer within {wait_s} s: check the address and firewalls"
        ) from error
    except ConnectionRefusedError as error:
        raise OpenFailed(
            f"{url.text}: nothing listens there: start the device first, or check the port"
        ) from error
    except OSError as error:
        raise OpenFailed(f"{url.text}: cannot connect: {error.strerror or error}") from error


def listen_url(url: Url) -> Listener:
    """Listen at `tcp://host:port`; port 0 takes any free one."""
    address, parts = url.split_query()
    host, port = host_port(url, address)
    options = url.options(parts, {})
    try:
        family, kind, protocol, _, place = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        sock = socket.socket(family, kind, protocol)
    except OSError as error:
        raise OpenFailed(f"{url.text}: cannot listen: {error.strerror or error}") from error
    try:
        if os.name == "posix":
            # There it means "reuse after a restart"; on Windows it would share a live port.
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.bind(place)
        sock.listen()
        return TcpListener(sock, options["write_timeout"])
    except OSError as error:
        sock.close()
        advice = ""
        if error.errno == errno.EADDRINUSE:
            advice = ": another program listens there; take another port, or 0 for any free one"
        raise OpenFailed(f"{url.text}: cannot listen: {error.strerror or error}{advice}") from error


def _url_of(address: tuple[str, int]) -> str:
    host, port = address[:2]
    return f"tcp://[{host}]:{port}" if ":" in host else f"tcp://{host}:{port}"
