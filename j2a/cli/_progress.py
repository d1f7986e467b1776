"""A progress bar on standard error.

In: how many bytes or seconds are done. Out: one line that is drawn over itself, and wiped at the
end.
Rules: nothing is drawn when standard error is no terminal, when the user does not want it, or in
the first moments; numbers of bytes are those of payload.
"""

import contextlib
import os
import sys
import time
from typing import Final, Self

from j2a_spec.printable import printable

_FIRST_S: Final = 0.3
_EVERY_S: Final = 0.1
_WIDTH: Final = 30


class Progress:
    """Draws while something runs; a context manager that leaves an empty line.

    Args:
        what: printed before the bar.
        enabled: False draws nothing; neither does a standard error that is not a terminal.
        in_seconds: what is done is a time, in seconds, and no number of bytes.
    """

    def __init__(self, what: str, *, enabled: bool = True, in_seconds: bool = False) -> None:
        self._what = printable(what)
        self._in_seconds = in_seconds
        self._enabled = enabled and sys.stderr.isatty()
        self._start = time.monotonic()
        self._next = self._start + _FIRST_S
        self._drawn = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        if self._drawn:
            sys.stderr.write("\r\x1b[K")
            sys.stderr.flush()

    def __call__(self, done: float, total: float | None = None, more: str = "") -> None:
        """Draw how far it is.

        Args:
            done: so much is.
            total: of so much; None when that is not known.
            more: printed behind that.
        """
        now = time.monotonic()
        if not self._enabled or now < self._next:
            return
        self._next = now + _EVERY_S
        self._drawn = True
        rate = done / (now - self._start)
        head, left = f"{self._what}  ", ""
        if total:
            done = min(done, total)
            left = f"  {(total - done) / rate:.0f} s left" if done else ""
        amount = f"{done:.0f} s" if self._in_seconds else f"{size_text(done)}  {size_text(rate)}/s"
        tail = f"{amount}{more and f'  {more}'}{left}"
        most = _columns() - 1  # what goes on in the next line cannot be drawn over
        if total:
            tail = f"{int(100 * done / total):3d} %  {tail}"
            width = min(_WIDTH, most - len(f"{head}[] {tail}"))
            filled = int(width * done / total)
            head += f"[{'#' * filled}{'.' * (width - filled)}] " * (width > 0)
        line = f"{head}{tail}"[:most]
        sys.stderr.write(f"\r{line}\x1b[K")
        sys.stderr.flush()


def _columns() -> int:
    """Return how many columns the terminal has; it may be made narrower meanwhile."""
    with contextlib.suppress(OSError, ValueError):  # it does not say
        return os.get_terminal_size(sys.stderr.fileno()).columns or sys.maxsize
    return sys.maxsize


def size_text(size: float) -> str:
    """Return a number of bytes for people, such as 12.3 KiB."""
    for unit in ("B", "KiB", "MiB"):
        if size < 1024 or unit == "MiB":
            break
        size /= 1024
    return f"{size:.0f} {unit}" if unit == "B" else f"{size:.1f} {unit}"
