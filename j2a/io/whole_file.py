"""A file that grows by whole pieces, also on a full disk.

What flows in: bytes, and where a piece of them is whole. What flows out: the file. Rule: what of a
piece cannot be written to its end is taken back, so that the file ends behind the piece before.
"""

import contextlib
from pathlib import Path

__all__ = ["WholeFile"]


class WholeFile:
    """A new file.

    Args:
        path: of the file.

    Raises:
        OSError: it cannot be made; FileExistsError when it is there.
    """

    def __init__(self, path: Path) -> None:
        self._file = path.open("xb", buffering=0)
        self._waiting: list[bytes] = []
        self._size = 0
        self._before = self._whole = 0  # ends of the last two pieces in the file
        self._is_amid = False  # a piece was begun, and a signal handler may have raised

    def write(self, data: bytes) -> int:
        """Take bytes, which `end_piece` writes."""
        self._waiting.append(data)
        self._size += len(data)
        return len(data)

    def tell(self) -> int:
        """Return the size of the file with what waits."""
        return self._size

    @property
    def whole(self) -> int:
        """The size of the whole pieces in the file."""
        return self._whole

    def forget(self) -> None:
        """Leave out what waits, and what a write that broke off has left of it.

        Raises:
            OSError: the file cannot be cut.
        """
        self._waiting.clear()
        self._size = self._whole
        self._cut(self._whole)

    def flush(self) -> None:
        """Write nothing: who writes through another writer says itself where a piece ends."""

    def end_piece(self) -> None:
        """Write what waits, which is one piece.

        Raises:
            OSError: it cannot be written, and still waits.
        """
        if not self._waiting:
            return
        if self._is_amid:
            self._cut(self._whole)
        self._is_amid = True
        self._write(b"".join(self._waiting), self._whole)
        # One step, in which no signal handler can raise.
        self._before, self._whole, self._waiting = self._whole, self._size, []
        self._is_amid = False

    def end_early(self, end: bytes) -> None:
        """Leave out what waits; write other bytes behind what is whole, if there is room."""
        self._waiting.clear()
        for whole in (self._whole, self._before):  # without the last piece there is some
            if whole:
                with contextlib.suppress(OSError):
                    self._cut(whole)
                    self._write(end, whole)
                    return

    def close(self) -> None:
        """Close the file; what waits is left out."""
        self._file.close()

    def _write(self, data: bytes, begin: int) -> None:
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[self._file.write(rest) :]
        except OSError:
            with contextlib.suppress(OSError):
                self._cut(begin)
            self._is_amid = False
            raise

    def _cut(self, size: int) -> None:
        self._file.truncate(size)
        self._file.seek(size)
