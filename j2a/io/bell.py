"""A bell that any thread may ring, and a signal handler too, whatever its thread is doing.

Rules: a `threading.Event` holds a lock for a moment in each of its methods. A signal handler that
sets one amid such a moment of its own thread would wait for that lock for ever.
"""

import contextlib
import threading

__all__ = ["Bell"]


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
