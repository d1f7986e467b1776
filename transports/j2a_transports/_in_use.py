"""Descriptors that are freed once nobody uses them.

Rules: whoever ends the use from another thread waits for the one that goes on; a signal handler
that does so amid the use of its own thread leaves it to that, as waiting would never end. A forked
process frees nothing: its parent uses it, and the thread that does so is not there to wait for.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from typing import TypeVar

_ResultT = TypeVar("_ResultT")


class InUse:
    """What is used by one thread at a time, and may be used by its signal handlers meanwhile.

    Args:
        release: frees it; called once.
    """

    def __init__(self, release: Callable[[], object]) -> None:
        self._release = release
        self._process = os.getpid()
        self._lock = threading.RLock()
        self._users = 0  # more than one are a thread and its signal handlers
        self._is_ending = False
        self._is_released = False

    def run(self, work: Callable[[], _ResultT]) -> _ResultT:
        """Return the result of what uses it, and which looks first whether that was ended."""
        with self._lock:
            self._users += 1
            try:
                return work()
            finally:
                self._users -= 1
                self._end()

    def end(self) -> None:
        """Free it when it is in use no more; may be called twice."""
        if os.getpid() != self._process:
            return
        with self._lock:
            self._is_ending = True
            self._end()

    def _end(self) -> None:
        if self._is_ending and not self._users and not self._is_released:
            self._is_released = True
            self._release()
