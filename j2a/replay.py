"""A recording as a device: its samples come again, in the time in which they came.

What flows in: a file that `j2a.recording` wrote. What flows out: a device with the transducers of
a board, whose sample SIFs are those of the recording, bit for bit, until a host changes settings.
Its clock goes on as that of the recorded board.
"""

import time
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Final

from j2a.device import Device
from j2a.errors import LocalError, RegistrationError
from j2a.io.bell import Flag
from j2a.io.functions import pack_properties
from j2a.protocol.replayed import ReplayServer
from j2a.protocol.trace import Trace
from j2a.protocol.transducers import TransducerServer
from j2a.recording import Recorded, RecordedBoard, Recording
from j2a.types.transducers import Descriptors

__all__ = ["ReplayBoard", "check_speed"]

MAX_SPEED: Final = 1e6
"""The time of a board has 64 bits; at this speed they last for seven months."""
_LONGEST_WAIT_S: Final = 3600.0
_BEGIN_S: Final = 0.5
_OWN: Final = "j2a."


class ReplayBoard(Device):
    """The device of a recording.

    Args:
        path: of the file.
        board: the name of the board; None where the recording has one only.
        trace: as of `Device`.

    Attributes:
        duration_s: of the recording, in seconds; None where it does not say.
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
        recording = Recording(path)
        self._board = _chosen(path, recording.read_boards(), board)
        self.duration_s = recording.duration_s
        self._server = ReplayServer(self._board.descriptors, self._board.settings.encode())
        self._pace = time.monotonic_ns(), 0, 1.0
        self._shift_us = 0
        self._newest_us: dict[str, int] = {}
        self._described = Flag()
        self._ended = Flag()
        self.is_whole = False
        self.problem = ""
        kept = {k: v for k, v in self._board.properties.items() if _is_kept(k, v)}
        super().__init__(kept, transducers=self._board.descriptors, trace=trace)

    def stop(self) -> None:
        """End as `Device.stop`, and play no more."""
        self._ended.set()
        self._described.set()
        super().stop()

    @property
    def clock_us(self) -> int:
        """The time of the recorded board; before its first sample that since the start."""
        return self._local_us() + self._shift_us

    def _local_us(self) -> int:
        base_ns, base_us, speed = self._pace
        return base_us + int((time.monotonic_ns() - base_ns) * speed / 1000)

    def _transducer_server(self, known: Descriptors) -> TransducerServer:
        return self._server

    def _tell_descriptors(self) -> bytes:
        self._described.set()
        return super()._tell_descriptors()

    def play(
        self,
        speed: float = 1.0,
        progress: Callable[[float], object] = lambda _done_s: None,
        others: Iterable["ReplayBoard"] = (),
    ) -> int:
        """Play the samples, from when a host has read the descriptors on; returns how many.

        A sample is sent as it was, unless a host has changed settings of its sensor. What is
        damaged of the recording is left out; see `problem`.

        Args:
            speed: 2 is twice as fast as they came; the time of the board is, too.
            progress: called with how much was played, in seconds of the recording.
            others: boards of the same recording, which are played with this one in their common
                time, whether hosts know them already or not.

        Raises:
            LocalError: the speed is out of range.
            OSError: it cannot be read.
        """
        check_speed(speed)
        boards = {one._board.name: one for one in (self, *others)}
        self._described.wait()
        self._ended.wait(_BEGIN_S)  # until the host knows them
        for one in boards.values():
            one._pace = time.monotonic_ns(), one._local_us(), speed
            one._transducers().set_pace(speed)
        recording = Recording(self._path)
        start_us, passed_ns = self._local_us(), 0
        last_ns = None
        count = 0
        for sample in self._samples(recording):
            board = boards.get(sample.board)
            if board is None:
                continue
            if last_ns is not None:
                # Where the clock of the computer was set back meanwhile, it goes on at once.
                passed_ns += max(0, sample.time_ns - last_ns)
            last_ns = sample.time_ns
            if not self._wait_until(start_us + passed_ns // 1000):
                return count
            board._transducers().give(partial(board._replay, sample))
            count += 1
            progress(passed_ns / 1e9)
        self.is_whole = recording.is_whole
        return count

    def _wait_until(self, due_us: int) -> bool:
        """Wait until a local time; return False when the device was stopped."""
        while not self._ended.is_set():
            left_s = (due_us - self._local_us()) / self._pace[2] / 1e6
            if left_s <= 0:
                return True
            self._ended.wait(min(left_s, _LONGEST_WAIT_S))
        return False

    def _replay(self, sample: Recorded, local_us: int) -> list[tuple[int, bytes]]:
        name = sample.sensor.name
        newest_us = self._server.newest_us(name, sample.payload)
        if newest_us:
            self._set_clock(name, newest_us, local_us)
        return self._server.replay(name, sample.payload, local_us)

    def _set_clock(self, name: str, newest_us: int, local_us: int) -> None:
        """Set the clock so that no value is ahead of it; back only where that of the board went."""
        shift_us = newest_us - local_us
        is_back = newest_us < self._newest_us.get(name, 0)
        if not self._newest_us or is_back or shift_us > self._shift_us:
            moved_us, self._shift_us = shift_us - self._shift_us, shift_us
            self._transducers().move(moved_us)
        self._newest_us[name] = newest_us

    def _samples(self, recording: Recording) -> Iterator[Recorded]:
        try:
            yield from recording
        except LocalError as error:
            self.problem = str(error)


def check_speed(speed: float) -> None:
    """Refuse a speed that no recording can be played at.

    Raises:
        LocalError: it is not above 0, or too high.
    """
    if not 0 < speed <= MAX_SPEED:
        raise LocalError(f"a speed is a number above 0 and at most {MAX_SPEED:g}, not {speed:g}")


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
            names = ", ".join(boards)
            raise LocalError(
                f"{path} has several boards; choose one: {names} (j2a replay --board NAME)"
            )
        return next(iter(boards.values()))
    if name not in boards:
        raise LocalError(f"{path} has no board {name!r}, but {', '.join(boards)}")
    return boards[name]
