"""A listener at a place with room for one peer: standard input and output, a serial port.

In: a way to open the transport.  Out: that transport, one at a time.
Rules: the first opening happens at once, so that a wrong name is told when listening starts; the
next one comes when the transport before has been closed, or never.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Final

from ._base import LinkClosed, Listener, Transport

LOOK_S: Final = 0.02


def wait_to_look(deadline: float | None) -> bool:
    """Wait a moment for what has to be looked at again and again.

    Args:
        deadline: on the monotonic clock, None for none.

    Returns:
        Whether it is time to look; False when the deadline is over.
    """
    wait_s = LOOK_S if deadline is None else min(LOOK_S, deadline - time.monotonic())
    if wait_s > 0:
        time.sleep(wait_s)  # an Event would hold a lock, amid which a signal handler may close
    return wait_s > 0


class SoloListener(Listener):
    """A listener that hands out one transport at a time.

    Args:
        url: of the place.
        opener: opens the transport; may raise `OpenFailed`, which `accept` passes on.
        again: whether to open it again after it has been closed.
    """

    def __init__(self, url: str, opener: Callable[[], Transport], *, again: bool) -> None:
        super().__init__(url)
        self._opener = opener
        self._again = again
        self._closed = False
        self._lock = threading.RLock()
        self._ready: Transport | None = opener()
        self._current = self._ready

    def accept(self, timeout_s: float | None) -> Transport | None:
        """See `Listener.accept`; after the only transport was closed it raises `LinkClosed`."""
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        while True:
            with self._lock:
                if self._closed:
                    raise LinkClosed(f"{self.url} is closed")
                if self._current is None or self._current.closed:
                    if not self._again:
                        raise LinkClosed(f"{self.url} has served its only peer")
                    self._current = self._ready = self._opener()
                if self._ready is not None:
                    transport, self._ready = self._ready, None
                    return transport
            if not wait_to_look(deadline):
                return None

    def close(self) -> None:
        """See `Listener.close`; a transport that was not accepted is closed."""
        self._closed = True
        with self._lock:
            if self._ready is not None:
                self._ready.close()
                self._ready = None
