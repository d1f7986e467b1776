"""One daemon at a time, and the socket by which other programs ask it (thesis section 6.2.1).

In: requests of other instances and of `j2a sync`, a line of JSON each. Out: a line of JSON each.
Rules: who holds the lock of the folder is the daemon; the system releases it with the process, so
a daemon that died leaves nothing in the way. A connection carries one request; its length, its time
and the number of connections at a time are bounded, and none waits for another.
"""

import contextlib
import fcntl
import json
import logging
import os
import selectors
import socket
import stat
import struct
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from j2a.io.threads import JOIN_S, join_threads, start_thread

__all__ = ["OTHER_VERSION", "NotRunning", "Server", "Taken", "ask", "ask_any", "folders"]

_logger = logging.getLogger("j2a.syncd")
SOCKET: Final = "syncd.sock"
LOCK: Final = "syncd.lock"
MAX_REQUEST: Final = 4096
MAX_REPLY: Final = 4 * 1024 * 1024
_LEVELS: Final = 8
"""No reply has more lists and objects, one in the other."""
LIMIT_S: Final = 5.0
"""For so long whoever asks waits."""
OTHER_VERSION: Final = "is it of another version of J2A? Start it again"
"""What may be so, and what to do, where something answers as no daemon does."""
_SERVE_S: Final = 2.0
"""For so long a connection may last."""
MAX_CONNECTIONS: Final = 32
"""At a time; the oldest makes room for one that comes."""
_RETRY_S: Final = 0.05
_BACKLOG: Final = 128
_SYSTEM: Final = Path("/run/j2a")
_LOOK_S: Final = 0.5
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
        owner: user and group that root becomes afterwards. They get the folder, for without it
            they could not remove the socket at the end.

    Raises:
        Taken: another daemon has the folder.
        OSError: the folder cannot be made or used.
    """

    def __init__(self, folder: Path, answer: Answer, owner: tuple[int, int] | None = None) -> None:
        self._answer = answer
        self._is_closed = threading.Event()
        self._thread: threading.Thread | None = None
        self.path = folder / SOCKET
        folder.mkdir(mode=0o755, parents=True, exist_ok=True)
        with contextlib.ExitStack() as undo:
            # By its descriptor the socket can be removed, whatever the user may do above it.
            self._folder = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
            undo.callback(os.close, self._folder)
            if owner is None:
                _check_owner(folder, os.fstat(self._folder))
            else:
                before = _take_back(folder, self._folder)
                undo.callback(os.fchown, self._folder, *before)
            self._lock = os.open(
                LOCK,
                os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW,
                0o600,  # who may read it could lock it
                dir_fd=self._folder,
            )
            undo.callback(os.close, self._lock)
            self._take()
            if owner is not None:
                undo.callback(self._socket.close)
                os.fchown(self._folder, *owner)
            undo.pop_all()

    def _take(self) -> None:
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise Taken(f"a daemon runs for {self.path.parent}") from None
        self._unlink()  # of one that died: nobody else has the lock
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            self._socket.bind(os.fspath(self.path))
            # The status is no secret, and whoever may be a client may only ask and name boards.
            os.chmod(SOCKET, 0o666, dir_fd=self._folder)
            self._socket.listen(_BACKLOG)
            self._socket.setblocking(False)
        except BaseException:
            self._socket.close()
            raise

    def _unlink(self) -> None:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(SOCKET, dir_fd=self._folder)

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
            self._unlink()
        os.close(self._lock)
        os.close(self._folder)

    def _serve(self) -> None:
        with selectors.DefaultSelector() as selector:
            selector.register(self._socket, selectors.EVENT_READ)
            while not self._is_closed.is_set():
                for key, _ in selector.select(_LOOK_S):
                    if key.data is None:
                        self._accept(selector)
                    elif not key.data.is_ended and not key.data.go_on(selector, self._answer):
                        key.data.end(selector)
                now = time.monotonic()
                for one in _connections(selector):
                    if one.deadline <= now:
                        one.end(selector)
            for one in _connections(selector):
                one.end(selector)

    def _accept(self, selector: selectors.BaseSelector) -> None:
        there = _connections(selector)
        if len(there) >= MAX_CONNECTIONS:
            min(there, key=lambda one: one.deadline).end(selector)
        try:
            accepted, _ = self._socket.accept()
        except BlockingIOError:  # it has gone
            return
        except OSError:
            # Out of descriptors, or aborted: the next one may do.
            self._is_closed.wait(_RETRY_S)
            return
        accepted.setblocking(False)
        selector.register(accepted, selectors.EVENT_READ, _Connection(accepted))


class _Connection:
    """A request that comes and its reply that goes, without waiting.

    Attributes:
        deadline: when it ends in any case, on the monotonic clock.
        is_ended: another one has its descriptor, perhaps.
    """

    def __init__(self, accepted: socket.socket) -> None:
        self.socket = accepted
        self.deadline = time.monotonic() + _SERVE_S
        self.is_ended = False
        self._request = bytearray()
        self._reply: memoryview | None = None

    def go_on(self, selector: selectors.BaseSelector, answer: Answer) -> bool:
        """Do what the socket allows now; return whether something is left to do."""
        try:
            if self._reply is None:
                if self._read():
                    return True
                self._reply = memoryview(self._answered(answer))
                selector.modify(self.socket, selectors.EVENT_WRITE, self)
            self._reply = self._reply[self.socket.send(self._reply) :]
        except BlockingIOError:
            return True
        except OSError:  # it has hung up
            return False
        return bool(self._reply)

    def _read(self) -> bool:
        """Return whether more has to come."""
        part = self.socket.recv(MAX_REQUEST + 1)
        self._request += part
        return bool(part) and len(self._request) <= MAX_REQUEST and not part.endswith(b"\n")

    def _answered(self, answer: Answer) -> bytes:
        try:
            if len(self._request) > MAX_REQUEST:
                raise ValueError(f"it is longer than {MAX_REQUEST} bytes")
            request = json.loads(self._request.decode())  # of bytes it would guess the encoding
            if not isinstance(request, dict):
                raise ValueError("a request is an object")
        except (ValueError, RecursionError) as error:
            return _packed({"error": f"that is no request: {error}"})
        try:
            return _packed(answer(request, _is_trusted(self.socket)))
        except Exception as error:
            _logger.exception("a request had no answer")
            return _packed({"error": f"the daemon failed: {error!r:.100}"})

    def end(self, selector: selectors.BaseSelector) -> None:
        """Hang up."""
        self.is_ended = True
        selector.unregister(self.socket)
        self.socket.close()


def _connections(selector: selectors.BaseSelector) -> list[_Connection]:
    return [key.data for key in selector.get_map().values() if key.data is not None]


def _packed(reply: dict[str, Any]) -> bytes:
    return json.dumps(reply, allow_nan=False).encode() + b"\n"


def _check_owner(folder: Path, facts: os.stat_result) -> None:
    """Refuse a folder in which others can put something in the place of the socket.

    Raises:
        PermissionError: always then.
    """
    if facts.st_uid != os.geteuid() or facts.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise PermissionError(f"{folder} belongs to another user, or others may write into it")


def _take_back(folder: Path, number: int) -> tuple[int, int]:
    """Let the folder be root's again, so that nobody else changes what root works on.

    Returns: user and group that had it.

    Raises:
        PermissionError: there is something else in it; such a folder is not given away.
    """
    others = set(os.listdir(number)) - {SOCKET, LOCK}
    facts = os.fstat(number)
    if others or facts.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise PermissionError(f"{folder} is not for syncd alone, or others may write into it")
    if facts.st_uid != 0:
        os.fchown(number, 0, 0)
    return (facts.st_uid, facts.st_gid) if facts.st_uid != 0 else (-1, -1)


def _is_trusted(connection: socket.socket) -> bool:
    """Tell whether the other end belongs to the user of this process, or to root."""
    if not hasattr(socket, "SO_PEERCRED"):  # on macOS nobody is known
        return False
    facts = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _PEER.size)
    return _PEER.unpack(facts)[1] in (0, os.geteuid())


def ask(folder: Path, request: dict[str, Any]) -> dict[str, Any]:
    """Ask the daemon; return its reply.

    Raises:
        NotRunning: there is none, or it does not answer within LIMIT_S.
    """
    path = folder / SOCKET
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
            connection.settimeout(LIMIT_S)
            _connect(connection, os.fspath(path))
            connection.sendall(json.dumps(request).encode() + b"\n")
            reply = json.loads(_line(connection))
    except (OSError, ValueError, RecursionError) as error:
        why = error.strerror if isinstance(error, OSError) and error.strerror else error
        raise NotRunning(f"no daemon answers at {path}: {why}; start one: j2a syncd") from None
    if not isinstance(reply, dict) or _is_deeper(reply, _LEVELS):
        raise NotRunning(f"what answers at {path} is no j2a syncd: {OTHER_VERSION}")
    return reply


def _is_deeper(value: object, levels: int) -> bool:
    """Tell whether JSON has more levels, of which a thousand cannot even be printed."""
    if not isinstance(value, dict | list):
        return False
    parts = value.values() if isinstance(value, dict) else value
    return levels == 0 or any(_is_deeper(part, levels - 1) for part in parts)


def ask_any(request: dict[str, Any]) -> dict[str, Any]:
    """Ask the daemon of this user, or else that of the system; return the reply.

    Raises:
        NotRunning: neither answers.
    """
    errors = []
    for folder in folders():
        try:
            return ask(folder, request)
        except NotRunning as error:
            errors.append(str(error))
    raise NotRunning("; ".join(errors))


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


def _line(connection: socket.socket) -> bytes:
    """Read up to a line feed or the end.

    Raises:
        TimeoutError: it takes longer than LIMIT_S.
        ValueError: it is longer than MAX_REPLY bytes.
    """
    parts, length = [], 0
    deadline = time.monotonic() + LIMIT_S
    while length <= MAX_REPLY:
        left_s = deadline - time.monotonic()
        if left_s <= 0:
            raise TimeoutError(f"it took longer than {LIMIT_S:g} s")
        connection.settimeout(left_s)
        part = connection.recv(65536)
        parts.append(part)
        length += len(part)
        if not part or part.endswith(b"\n"):
            return b"".join(parts)
    raise ValueError(f"it is longer than {MAX_REPLY} bytes")
