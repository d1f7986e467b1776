"""The sink `mcap`: a recording, as `j2a record` writes it.

What flows in: samples. What flows out: a file of messages of ROS 2, each at the time when it came;
its readings have times of the board's clock, which `j2a replay` needs.
Rules: each second all samples are in the file; a full disk ends the sink, and what was written
before stays readable.
"""

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Final

from j2a import LocalError
from j2a.recording import Recorder, check_package
from j2a.types.transducers import Descriptors
from j2a_bridge.sink import (
    PROCESS,
    Control,
    NotTaken,
    Option,
    Sink,
    SinkError,
    Update,
)
from j2a_bridge.topics import Topic

__all__ = ["McapSink"]

_MIB: Final = 1 << 20
_EACH_S: Final = 1.0


class McapSink(Sink):
    """Writes samples into a file."""

    SUMMARY = "a recording that stock viewers and `j2a replay` read"
    ARGUMENT = "FILE.mcap"
    OPTIONS: ClassVar[Mapping[str, Option]] = {
        "segment": Option(int, 0, "begin another file when one has so many MiB"),
        **PROCESS,
    }
    RETRY_S = None
    WAITING = 1 << 16

    def __init__(self, argument: str, options: Mapping[str, Any], control: Control) -> None:
        super().__init__(argument, options, control)
        self._path = Path(argument)
        if self._path.suffix != ".mcap":
            raise LocalError(f"{argument}: the name of a recording ends in .mcap")
        if self._path.exists():
            raise LocalError(f"{argument} is there already; choose another name")
        if options["segment"] < 0:
            raise LocalError(f"a segment has 1 MiB or more, not {options['segment']}")
        check_package()
        self._recorder: Recorder | None = None
        self._topics: dict[str, dict[str, Topic]] = {}
        self._added: dict[str, tuple[str, dict[str, Topic]]] = {}
        self._names: dict[tuple[str, Descriptors, frozenset[tuple[str, str]]], str] = {}
        self._flushed = 0.0
        self._kept = 0  # samples that are not in the file yet
        self._size = 0  # of the file

    def open(self) -> None:
        """Make the file."""
        try:
            segment = self.options["segment"] * _MIB or None
            self._recorder = Recorder(self._path, segment_bytes=segment)
        except FileExistsError:
            raise SinkError(f"{self._path} is there already; choose another name") from None

    def announce(self, topic: Topic) -> None:
        """Note a sensor; its board is announced with the first sample, when all are known."""
        if topic.transducer.is_sensor:
            self._topics.setdefault(topic.board, {})[topic.transducer.name] = topic

    def retract(self, topic: Topic) -> None:
        """Nothing to do: the board may come again."""

    def publish(self, update: Update) -> None:
        """Write a sample."""
        assert self._recorder is not None
        recorder, board = self._recorder, update.topic.board
        name, topics = self._added.get(board, ("", {}))
        if topics.get(update.topic.transducer.name) != update.topic:
            name = self._add(update.topic)
            self._size = recorder.size  # what it says of the board completes no chunk
        try:
            recorder.write(name, update.sample, update.arrived_ns)
        except ValueError as error:
            raise NotTaken(str(error)) from None
        self._kept += 1
        if recorder.size != self._size:  # a chunk is complete, and in the file
            self._size, self._kept = recorder.size, 0

    def _add(self, topic: Topic) -> str:
        """Announce a board as it is now, unless it was so before; return its name in the file."""
        assert self._recorder is not None
        board, descriptors = topic.board, topic.descriptors
        topics = {
            sensor: one
            for sensor, one in self._topics[board].items()
            if one.descriptors == descriptors  # the others are of what it was before
        }
        self._topics[board] = topics
        names = {sensor: topic.name for sensor, topic in topics.items()}
        known = board, descriptors, frozenset(names.items())
        name = self._names.get(known)
        if name is None:
            name, number = board, 1
            while name in self._names.values():
                number += 1
                name = f"{board}_{number}"
            self._recorder.add_board(name, descriptors, topics=names)
            self._names[known] = name
        self._added[board] = name, dict(topics)
        return name

    def flush(self) -> None:
        """Write all into the file, once a second."""
        now = time.monotonic()
        if self._recorder is not None and now - self._flushed >= _EACH_S:
            self._flushed = now
            self._recorder.flush()
            self._size, self._kept = self._recorder.size, 0

    def status(self, status: Any) -> None:
        """Flush also when nothing comes."""
        self.flush()

    def told(self) -> str:
        """Return what is written."""
        return f"recording into {self._path}"

    def close(self) -> None:
        """End the file."""
        recorder, self._recorder = self._recorder, None
        if recorder is not None:
            try:
                recorder.close()
            except OSError:
                self.lost += self._kept
                raise
