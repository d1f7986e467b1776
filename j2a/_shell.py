"""What the blocking and the asyncio client have in common; how to wait is not among it.

What flows in: the options of a client. What flows out: a session and a peer, checked arguments.
"""

import contextlib
import logging
import random
import threading
import time
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Final

from j2a_spec.constants import ECHO

from j2a._arguments import check_timeout
from j2a._peer import Peer
from j2a._session import MAX_WINDOW, Session
from j2a._trace import Trace
from j2a.errors import (
    CallTimeout,
    J2AError,
    LocalError,
    OpcodeRefused,
    ProtocolError,
    RemoteError,
)
from j2a.events import Counters, Reply

if TYPE_CHECKING:
    from j2a_transports import Transport

__all__ = [
    "JOIN_S",
    "MAX_DEBUG_READS",
    "MAX_SIFS_WAITING",
    "Shell",
    "boot_limits",
    "check_echo",
    "is_booting",
    "join_threads",
    "no_device",
    "take_stale_input",
]

MAX_SIFS_WAITING: Final = 65536
"""So many SIFs may wait for slow handlers; further ones are dropped and counted."""

MAX_DEBUG_READS: Final = 256
"""A device that writes debug text faster than it is read does not keep its reader for ever."""

_FIRST_LIMIT_S: Final = 0.25
_STALE_READS: Final = 64
JOIN_S: Final = 5.0
_logger = logging.getLogger("j2a")


class Shell:
    """State and options that both clients have; each adds its own way of waiting."""

    def __init__(self, url: str, timeout: float, window: int, trace: Trace | None) -> None:
        if not isinstance(window, int) or not 1 <= window <= MAX_WINDOW:
            raise LocalError(f"window is a number of calls from 1 to {MAX_WINDOW}, not {window!r}")
        self._url = url
        self._timeout = check_timeout(timeout)
        self._window = window
        self._peer = Peer()
        # A random start keeps the replies to an earlier program from answering this one.
        self._session = Session(first_seq=random.randrange(256), window=window, trace=trace)

    @property
    def url(self) -> str:
        """What was connected to."""
        return self._url

    @property
    def counters(self) -> Counters:
        """The health of the link, as it is now."""
        return self._session.counters

    def _limit_s(self, timeout: object) -> float:
        return self._timeout if timeout is None else check_timeout(timeout)


def take_stale_input(transport: "Transport", session: Session) -> None:
    """Give a session what was waiting in the link before it began.

    A reply in it answers nobody: no call has been made. SIFs in it are counted, and lost: nobody
    can have registered a handler yet.
    """
    with contextlib.suppress(Exception):  # the reader meets the same error again
        for _ in range(_STALE_READS):
            data = transport.read(0)
            if not data:
                break
            session.receive(data)


def boot_limits(total_s: float) -> Iterator[float]:
    """Yield the time limits of attempts to reach a board that may still boot, in seconds.

    They grow, so that a slow link gets its time, and end when `total_s` is used up.
    """
    limit_s = _FIRST_LIMIT_S
    while total_s > 0:
        limit_s = min(limit_s, total_s)
        yield limit_s
        total_s -= limit_s
        limit_s *= 2


def is_booting(error: J2AError) -> bool:
    """Whether an attempt that failed like this is worth another one."""
    return isinstance(error, CallTimeout) or (
        isinstance(error, RemoteError) and not isinstance(error, OpcodeRefused)
    )


def no_device(url: str, boot_time: float) -> CallTimeout:
    """Return the error for a link at which nobody answers."""
    return CallTimeout(
        f"no device answered at {url} within {boot_time:g} s; see that the board runs J2A and "
        "that speed and parity are the same at both ends"
    )


def join_threads(threads: Iterable[threading.Thread]) -> None:
    """Wait for threads that were told to end, but not for ever: a handler may be stuck."""
    deadline = time.monotonic() + JOIN_S
    for thread in threads:
        if thread is not threading.current_thread():
            thread.join(max(0.0, deadline - time.monotonic()))
            if thread.is_alive():
                _logger.warning("%s is still busy after close", thread.name)


def check_echo(reply: Reply, payload: bytes) -> bytes:
    """Return what a2jEcho sent back.

    Raises:
        ProtocolError: it is not what was sent.
    """
    if reply != (ECHO, payload):
        raise ProtocolError(
            f"a2jEcho: {len(payload)} bytes came back changed, or with code 0x{reply.code:02X}"
        )
    return reply.payload
