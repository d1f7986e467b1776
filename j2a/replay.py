"""A recording as a device: its samples come again, in the time in which they came.

What flows in: a file that `j2a.recording` wrote. What flows out: a device with the transducers of
a board, whose sample SIFs are those of the recording, bit for bit.
"""

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from j2a.device import Device
from j2a.errors import LocalError, RegistrationError
from j2a.io.functions import pack_properties
from j2a.protocol.trace import Trace
from j2a.recording import Recorded, RecordedBoard, Recording

__all__ = ["ReplayBoard"]

_NS: Final = 1_000_000_000
_BEGIN_S: Final = 0.5
_OWN: Final = "j2a."


class ReplayBoard(Device):
    """The device of a recording.

    Args:
        path: of the file.
        board: the name of the board; None where the recording has one only.
        trace: as of `Device`.

    Attributes:
        is_whole: the recording had its end; known when it was played.
        problem: what of it was damaged, and left out, or ""; known when it was played.

    Raises:
        LocalError: the file is no recording, or has no such board.
        OSError: it cannot be read.
    """

    def __init__(
        self, path: str | Path, board: str | None = None, *, trace: Trace | None = None
    ) -> None:
        self._path = path
        self._board = _chosen(path, Recording(path).read_boards(), board)
        self._described = threading.Event()
        self._ended = threading.Event()
        self.is_whole = False
        self.problem = ""
        kept = {k: v for k, v in self._board.properties.items() if _is_kept(k, v)}
        super().__init__(kept, transducers=self._board.descriptors, trace=trace)

    def stop(self) -> None:
        """End as `Device.stop`, and play no more."""
        self._ended.set()
        super().stop()

    def _tell_descriptors(self) -> bytes:
        self._described.set()
        return super()._tell_descriptors()

    def play(self, speed: float = 1.0) -> int:
        """Send the samples, from when a host has read the descriptors on; returns how many.

        Args:
            speed: 2 is twice as fast as they came.

        What is damaged of it is left out; see `problem`.

        Raises:
            OSError: it cannot be read.
        """
        self._described.wait()
        self._ended.wait(_BEGIN_S)  # until the host knows them
        recording = Recording(self._path)
        first_ns: int | None = None
        count = 0
        for sample in self._samples(recording):
            if sample.board != self._board.name:
                continue
            if first_ns is None:
                first_ns, start_us = sample.time_ns, self._transducers().now_us()
            due_us = start_us + (sample.time_ns - first_ns) / 1000 / speed
            if self._ended.wait(max(0.0, due_us - self._transducers().now_us()) / 1e6):
                return count
            self.send_sif(sample.sensor.id, sample.payload)
            count += 1
        self.is_whole = recording.is_whole
        return count

    def _samples(self, recording: Recording) -> Iterator[Recorded]:
        try:
            yield from recording
        except LocalError as error:
            self.problem = str(error)


def _is_kept(key: str, value: str) -> bool:
    """Whether a property is one of the application, and one that a device can have."""
    try:
        return bool(pack_properties({key: value})) and not key.startswith(_OWN)
    except (RegistrationError, UnicodeEncodeError):
        return False


def _chosen(path: str | Path, boards: dict[str, RecordedBoard], name: str | None) -> RecordedBoard:
    if not boards:
        raise LocalError(f"{path} has no board of J2A")
    if name is None:
        if len(boards) > 1:
            raise LocalError(f"{path} has several boards; choose one: {', '.join(boards)}")
        return next(iter(boards.values()))
    if name not in boards:
        raise LocalError(f"{path} has no board {name!r}, but {', '.join(boards)}")
    return boards[name]
