"""One daemon at a time, and the socket by which other programs ask it (thesis section 6.2.1).

In: requests of other instances and of `j2a sync`, a line of JSON each. Out: a line of JSON each.
Rules: who holds the lock of the folder is the daemon; the system releases it with the process, so
a daemon that died leaves nothing to clean up. A connection carries one request; its length, its
time and the number of connections at a time are bounded.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import socket
import stat
import struct
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from j2a.io.threads import JOIN_S, join_threads, start_thread

__all__ = ["NotRunning", "Server", "Taken", "ask", "folders"]

MAX_REQUEST: Final = 4096
MAX_REPLY: Final = 64 * 1024 * 1024
LIMIT_S: Final = 5.0
"""For so long whoever asks waits."""
_SERVE_S: Final = 1.0
"""For so long a connection may take the daemon's time, in each direction."""
_RETRY_S: Final = 0.05
_BACKLOG: Final = 16
_SYSTEM: Final = Path("/run/j2a")
_ACCEPT_S: Final = 0.5
_PEER: Final = struct.Struct("=iII")  # process, user, group

Answer = Callable[[dict[str, Any], bool], dict[str, Any]]
"""Takes a request, and whether it comes from the daemon's user or root; returns the reply."""


class Taken(Exception):  # noqa: N818 - the name says what is so
    """Another daemon runs for this folder."""


class NotRunning(Exception):  # noqa: N818 - likewise
    """No daemon answers; the text says where it was looked for."""


def folders() -> list[Path]:
    """Return the folders that may have the socket, the one of this process first.

    That is the folder that the environment variable J2A_RUNTIME_DIR names, or systemd for a unit;
    else that of this user, and then that of the system.
    """
    for name in ("J2A_RUNTIME_DIR", "RUNTIME_DIRECTORY"):
        if path := os.environ.get(name):
            return [Path(path.split(":")[0])]
    if os.geteuid() == 0:
        return [_SYSTEM]
    own = Path(os.environ.get("XDG_RUNTIME_DIR") or f"/run/user/{os.geteuid()}")
    return [own / "j2a", _SYSTEM]


class Server:
    """The socket of the daemon; being it is being the only one.

    Args:
        folder: see `folders`; it is made where it is not there.
        answer: returns the reply to a request; runs in a thread of this object, one at a time.

    Raises:
        Taken: another daemon has the folder.
        OSError: the folder cannot be made or used.
    """

    def __init__(self, folder: Path, answer: Answer) -> None:
        self._answer = answer
        self._is_closed = threading.Event()
        folder.mkdir(mode=0o755, parents=True, exist_ok=True)
        owner = folder.stat()
        if owner.st_uid != os.geteuid() or owner.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
            raise PermissionError(f"{folder} belongs to another user, or others may write into it")
        self.path = folder / "syncd.sock"
        self._lock = os.open(folder / "syncd.lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        try:
            self._take(folder)
        except BaseException:
            os.close(self._lock)
            raise
        self._thread: threading.Thread | None = None

    def _take(self, folder: Path) -> None:
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise Taken(f"a daemon runs for {folder}") from None
        self.path.unlink(missing_ok=True)  # of one that died: nobody else has the lock
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            self._socket.bind(os.fspath(self.path))
            # The status is no secret, and whoever may be a client may only ask and name boards.
            self.path.chmod(0o666)
            self._socket.listen(_BACKLOG)
            self._socket.settimeout(_ACCEPT_S)
        except BaseException:
            self._socket.close()
            raise

    def start(self) -> None:
        """Answer from now on, in a thread; after a fork or a change of the user, if any."""
        self._thread = start_thread(self._serve, "j2a syncd socket")

    def close(self) -> None:
        """Answer no more, and let another one be the daemon."""
        self._is_closed.set()
        if self._thread is not None:
            join_threads([self._thread], JOIN_S)
        self._socket.close()
        with contextlib.suppress(OSError):
            self.path.unlink()
        os.close(self._lock)

    def _serve(self) -> None:
        while not self._is_closed.is_set():
            try:
                connection, _ = self._socket.accept()
            except TimeoutError:
                continue
            except OSError:
                # Out of descriptors, or aborted: the next one may do.
                self._is_closed.wait(_ACCEPT_S)
                continue
            with connection, contextlib.suppress(OSError):
                self._reply(connection)

    def _reply(self, connection: socket.socket) -> None:
        try:
            request = json.loads(_line(connection, MAX_REQUEST, _SERVE_S))
            if not isinstance(request, dict):
                raise ValueError("a request is an object")
            reply = self._answer(request, _is_trusted(connection))
        except (ValueError, RecursionError) as error:
            reply = {"error": f"that is no request: {error}"}
        connection.settimeout(_SERVE_S)  # sendall takes it for the limit of the whole
        connection.sendall(json.dumps(reply, allow_nan=False).encode() + b"\n")


def _is_trusted(connection: socket.socket) -> bool:
    """Tell whether the other end belongs to the user of this process, or to root."""
    facts = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _PEER.size)
    return _PEER.unpack(facts)[1] in (0, os.geteuid())


def ask(folder: Path, request: dict[str, Any]) -> dict[str, Any]:
    """Ask the daemon; return its reply.

    Raises:
        NotRunning: there is none, or it does not answer within LIMIT_S.
    """
    path = folder / "syncd.sock"
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
            connection.settimeout(LIMIT_S)
            _connect(connection, os.fspath(path))
            connection.sendall(json.dumps(request).encode() + b"\n")
            reply = json.loads(_line(connection, MAX_REPLY, LIMIT_S))
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) and error.strerror else error
        raise NotRunning(f"no daemon answers at {path}: {why}; start one: j2a syncd") from None
    if not isinstance(reply, dict):
        raise NotRunning(f"what answers at {path} is no j2a syncd")
    return reply


def _connect(connection: socket.socket, path: str) -> None:
    """Connect to a daemon that may have more to do: its queue being full is an error at once."""
    deadline = time.monotonic() + LIMIT_S
    while True:
        try:
            return connection.connect(path)
        except BlockingIOError:
            if time.monotonic() >= deadline:
                raise
            time.sleep(_RETRY_S)


def _line(connection: socket.socket, limit: int, limit_s: float) -> bytes:
    """Read up to a line feed or the end.

    Raises:
        TimeoutError: it takes longer than `limit_s`.
        ValueError: it is longer than `limit` bytes.
    """
    parts, length = [], 0
    deadline = time.monotonic() + limit_s
    while length <= limit:
        left_s = deadline - time.monotonic()
        if left_s <= 0:
            raise TimeoutError(f"it took longer than {limit_s:g} s")
        connection.settimeout(left_s)
        part = connection.recv(65536)
        parts.append(part)
        length += len(part)
        if not part or part.endswith(b"\n"):
            return b"".join(parts)
    raise ValueError(f"it is longer than {limit} bytes")
