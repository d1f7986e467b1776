"""TCP: `tcp://host:port`, as a client and as a listener.

In: a URL; options `connect_timeout` (seconds, default 5) and `write_timeout`.  Out: bytes.
Rules: no delay of small packets (Nagle off); a listener binds the address in the URL and no other.
"""

from __future__ import annotations

import errno
import os
import socket
import time
from typing import Any, Final

from ._base import LinkLost, Listener, OpenFailed, Transport
from ._poll import CHUNK, PolledTransport
from ._scheme import Option, Scheme, Usage
from ._socket_listener import SocketListener
from ._url import Url, host_port
from .options import timeout

_OPEN: Final = Usage(
    "tcp://HOST:PORT",
    "a TCP connection",
    ("tcp://127.0.0.1:5000",),
    (
        Option(
            "connect_timeout",
            timeout,
            "time until the connection must be there; for opening only",
            "5",
        ),
    ),
)
_LISTEN: Final = Usage(
    "tcp://HOST:PORT",
    "a TCP port; 0 takes a free one",
    ("tcp://127.0.0.1:5000", "tcp://[::1]:0"),
)
SCHEME: Final = Scheme(
    name="tcp",
    open=_OPEN,
    listen=_LISTEN,
    accepts_again=True,
    meant_by={r"(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9_.-]+):[0-9]{1,5}": r"tcp://\g<0>"},
)


class TcpTransport(PolledTransport):
    """A connected TCP socket.

    Args:
        url: for messages.
        sock: the connected socket; the transport owns it from now on, and closes it on failure.
        write_timeout_s: see `Transport`.
        may_be_refused: the peer is a server, which closes the connection if it is busy.

    Raises:
        OSError: the connection has ended already, or there are too many open files.
    """

    says_empty = True

    def __init__(
        self,
        url: str,
        sock: socket.socket,
        write_timeout_s: float | None,
        *,
        may_be_refused: bool = False,
    ) -> None:
        self._sock = sock
        self._may_be_refused = may_be_refused
        self._has_received = False
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
        data = self._sock.recv(CHUNK)
        if not self._has_received:
            self._has_received = bool(data)
        return data

    def _lost(self, error: OSError | None) -> LinkLost:
        by_server = error is None or isinstance(error, ConnectionError)
        if by_server and self._may_be_refused and not self._has_received:
            return LinkLost(
                f"{self.url} is lost: the server closed the connection before it sent anything; "
                "it may be busy with another host"
            )
        return super()._lost(error)

    def _send(self, data: bytes | memoryview) -> int:
        return self._sock.send(data)

    def _release(self) -> None:
        self._sock.close()


class TcpListener(SocketListener):
    """A listening TCP socket.

    Args:
        sock: bound and listening; the listener owns it from now on.
        write_timeout_s: given to the transports that are accepted.
    """

    def __init__(self, sock: socket.socket, write_timeout_s: float | None) -> None:
        super().__init__(_url_of(sock.getsockname()), sock)
        self._write_timeout_s = write_timeout_s

    def _take(self) -> Transport:
        sock, address = self._sock.accept()
        return TcpTransport(_url_of(address), sock, self._write_timeout_s)


def check_url(url: Url) -> tuple[str, int, dict[str, Any]]:
    """Return host, port and options of `tcp://host:port`; raises BadUrl."""
    address, parts = url.split_query()
    return *host_port(url, address), url.options(parts, _OPEN)


def open_url(url: Url) -> Transport:
    """Connect to `tcp://host:port`."""
    host, port, options = check_url(url)
    wait_s = options["connect_timeout"]
    try:
        sock = _connect(host, port, wait_s)
        return TcpTransport(url.text, sock, options["write_timeout"], may_be_refused=True)
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


def _connect(host: str, port: int, wait_s: float | None) -> socket.socket:
    """Connect to the first address of a host that answers; they share the time."""
    deadline = None if wait_s is None else time.monotonic() + wait_s
    places = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    while True:
        family, kind, protocol, _, place = places.pop(0)
        try:
            sock = socket.socket(family, kind, protocol)
            try:
                if deadline is not None:
                    left_s = (deadline - time.monotonic()) / (1 + len(places))
                    sock.settimeout(max(0.001, left_s))
                sock.connect(place)
                if _is_itself(sock):
                    raise ConnectionRefusedError(errno.ECONNREFUSED, "Connection refused")
                return sock
            except BaseException:
                sock.close()
                raise
        except OSError:
            if not places:
                raise


def _is_itself(sock: socket.socket) -> bool:
    """Whether a connection has reached itself, from one of the ports that the system hands out."""
    try:
        return bool(sock.getsockname() == sock.getpeername())
    except OSError:
        return False  # the server has closed it already, as the first read will tell


def listen_url(url: Url) -> Listener:
    """Listen at `tcp://host:port`; port 0 takes any free one."""
    address, parts = url.split_query()
    host, port = host_port(url, address)
    options = url.options(parts, _LISTEN)
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
