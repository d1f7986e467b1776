"""What any thread may wait for, and a signal handler may end, whatever its thread is doing.

Rules: a `threading.Event` holds a lock for a moment in each of its methods. A signal handler that
sets one amid such a moment of its own thread would wait for that lock for ever.
"""

import contextlib
import math
import threading
import time

__all__ = ["Bell", "Flag"]


class Bell:
    """Wakes one thread that waits, or else the next one that will; rung twice it wakes once."""

    def __init__(self) -> None:
        self._silence = threading.Lock()  # free when the bell was rung
        self._silence.acquire()

    def ring(self) -> None:
        """Wake who waits; safe anywhere."""
        if self._silence.locked():
            with contextlib.suppress(RuntimeError):  # another one has just rung it
                self._silence.release()

    def wait(self, timeout: float) -> bool:
        """Wait until it is rung; return whether it was.

        Args:
            timeout: the time limit in seconds; 0 only looks.
        """
        return self._silence.acquire(timeout=timeout)


class Flag:
    """A bell that, once rung, is rung for all who wait and for all who will."""

    def __init__(self) -> None:
        self._is_set = False
        self._bell = Bell()

    def is_set(self) -> bool:
        """Return whether it was set."""
        return self._is_set

    def set(self) -> None:
        """Wake all who wait; safe anywhere, and may be called twice."""
        self._is_set = True
        self._bell.ring()

    def wait(self, timeout: float = math.inf) -> bool:
        """Wait until it is set; return whether it was.

        Args:
            timeout: the time limit in seconds.
        """
        end = time.monotonic() + timeout
        while not self._is_set and (left_s := end - time.monotonic()) > 0:
            self._bell.wait(min(left_s, threading.TIMEOUT_MAX))
        if self._is_set:
            self._bell.ring()  # for the next one who waits
        return self._is_set
