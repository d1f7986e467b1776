"""Programs that the suite starts: hosts under test, servers of testees, their builds.

What flows in: a command. What flows out: how it ended, and what it printed. Rules: a program runs
in a session of its own, so that Ctrl-C is for the suite alone and so that it can be ended with all
that it started itself, also where it left that behind; what it prints is always read, so that it
never waits for a reader.
"""

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from ._model import HarnessError

__all__ = ["Process"]

_GRACE_S: Final = 1.0
_SLICE_S: Final = 0.02
_KEPT: Final = 1 << 19  # bytes, at the beginning and at the end


class Process:
    """A program that runs until `end` is called.

    Args:
        words: program and arguments.
        cwd: where it runs; None: here.
        env: its environment; None: that of the suite.

    Raises:
        HarnessError: it cannot be started.
    """

    def __init__(
        self, words: Sequence[str], cwd: Path | None = None, env: Mapping[str, str] | None = None
    ) -> None:
        try:
            self._popen = subprocess.Popen(
                list(words),
                cwd=cwd,
                env=env,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                start_new_session=os.name == "posix",
            )
        except (OSError, ValueError) as error:
            raise HarnessError(f"cannot start {words[0]}: {error}") from error
        self._said = bytearray()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self._popen.stdout is not None
        with self._popen.stdout as pipe:
            while data := os.read(pipe.fileno(), 1 << 16):
                self._said += data
                # The beginning may say where a server answers, the end why it failed.
                del self._said[_KEPT : max(_KEPT, len(self._said) - _KEPT)]

    def code(self, wait_s: float = 0.0) -> int | None:
        """Return the exit code, or None where the program still runs after `wait_s`."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            return self._popen.wait(wait_s)
        return None

    def said(self) -> str:
        """Return what the program printed, of more than 1 MiB the beginning and the end."""
        if self._popen.poll() is not None:
            self._reader.join(_GRACE_S)  # what it left behind may hold the pipe open
        return self._said.decode("utf-8", "replace")

    def end(self, wait_s: float = 0.0) -> None:
        """End the program and all that it started.

        Args:
            wait_s: is left to the program to end by itself.
        """
        self.code(wait_s)
        for name in ("SIGTERM", "SIGKILL"):
            self._signal(name)
            deadline_s = time.monotonic() + _GRACE_S
            while self._is_left() and time.monotonic() < deadline_s:
                time.sleep(_SLICE_S)
        self._popen.wait()
        self._reader.join(_GRACE_S)

    def _is_left(self) -> bool:
        """Tell whether the program, or on POSIX something that it started, still runs."""
        return self._popen.poll() is None or self._signal("")

    def _signal(self, name: str) -> bool:
        """Send a signal, none for ""; tell whether anything was there to get it."""
        if sys.platform == "win32":
            if name:
                self._popen.terminate()
            return self._popen.poll() is None
        number = getattr(signal, name) if name else 0
        try:
            os.killpg(self._popen.pid, number)
        except (ProcessLookupError, PermissionError):  # the latter on macOS, of what has ended
            return False
        return True
