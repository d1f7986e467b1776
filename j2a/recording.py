"""Recordings of samples: files of the format MCAP, with messages of ROS 2.

What flows in: samples of boards, or a file. What flows out: a file that stock viewers read, or the
samples in it, bit for bit.
Rules: what was flushed, and each chunk of 64 KiB of messages once it is complete, stays readable
whatever happens then; a file that ends early is read up to there, and says so; what is damaged in
between is left out. Needs the package mcap (`pip install "j2a[record]"`).
"""

import json
import math
import re
import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from types import TracebackType
from typing import Any, Final, NamedTuple, Self

from j2a_spec.constants import TRANSD_TOPIC
from j2a_spec.plural import counted

from j2a.errors import LocalError
from j2a.events import Sample, immutable
from j2a.io.mcap_file import END, LATEST_NS, About, ChannelRecord, McapFile
from j2a.io.whole_file import WholeFile
from j2a.protocol.saved_settings import SavedSettings, dump
from j2a.types.cdr import SampleMessage
from j2a.types.descriptors import parse_descriptors
from j2a.types.naming import free_name
from j2a.types.ros import ros2_definition
from j2a.types.transducers import Descriptors, Transducer

__all__ = ["Recorded", "RecordedBoard", "Recorder", "Recording", "check_package", "topic_of"]

_BOARD: Final = "j2a.board"
_CHUNK_BYTES: Final = 1 << 16
_MOST_DESCRIBED: Final = 1 << 24
"""So many characters say what the boards of a file are, which stay in memory."""
_NOT_IN_TOPICS: Final = re.compile(r"[^A-Za-z0-9_/]")


@immutable
@dataclass(frozen=True, slots=True)
class RecordedBoard:
    """A board of a recording.

    Attributes:
        name: in the recording.
        url: where it was.
        descriptors: what it said of its transducers.
        properties: its properties.
        settings: those of its sensors when the recording began, as `Device(settings=...)` keeps
            them; "" where they are not known.
    """

    name: str
    url: str
    descriptors: Descriptors
    properties: Mapping[str, str]
    settings: str = ""


@immutable
@dataclass(frozen=True, slots=True)
class Recorded:
    """A sample of a recording.

    Attributes:
        board: the name of the board.
        sensor: of which it is.
        time_ns: when it came to the host, in nanoseconds since 1970.
        sequence: its number; see `Sample.sequence`.
        payload: of the sample SIF.
    """

    board: str
    sensor: Transducer
    time_ns: int
    sequence: int
    payload: bytes


def topic_of(board: str, topic: str) -> str:
    """Return the topic of a sensor in a recording, of names of letters, digits and "_"."""
    names = [name for name in _NOT_IN_TOPICS.sub("_", f"{board}/{topic}").split("/") if name]
    return "".join(f"/_{name}" if name[0].isdigit() else f"/{name}" for name in names) or "/_"


class _Message(NamedTuple):
    """A sample as the package mcap takes it."""

    board: str
    sensor: str
    time_ns: int
    data: bytes
    sequence: int


class Recorder:
    """Writes samples into a file; a context manager that ends the file.

    Any thread may call it, and so may a signal handler: what that asks for amid a call of its own
    thread is done at the end of that call, which raises what may be wrong with it.

    Args:
        path: of the file, which must not be there.
        segment_bytes: when the file is so long, another one is begun: NAME-1.mcap and so on.

    Attributes:
        paths: of the files.

    Raises:
        LocalError: the package mcap is missing.
        OSError: the file cannot be made; FileExistsError when it is there.
    """

    def __init__(self, path: str | Path, *, segment_bytes: int | None = None) -> None:
        self._first = Path(path)
        self._segment_bytes = segment_bytes
        # Re-entrant, so that a signal handler does not wait for its own thread.
        self._lock = threading.RLock()
        self._later: list[Callable[[], None]] = []  # what signal handlers asked for meanwhile
        self._boards: dict[str, tuple[RecordedBoard, Mapping[str, str]]] = {}
        self._announced: dict[str, None] = {}  # boards in the file that is being written
        self._open_chunk: list[_Message] = []  # what `_mend` writes again
        self._chunk_end = 0  # of the last whole chunk, which is perhaps not in the file yet
        self._is_torn = False  # a signal handler has raised amid the package mcap
        self._has_index = True
        self._end_at = math.inf
        self._number = 0
        self._topics: set[str] = set()
        self._channels: dict[tuple[str, str], tuple[int, SampleMessage]] = {}
        self.paths: list[Path] = []
        self._samples = 0  # of the chunks in the files
        self._file: WholeFile | None = None
        self._size = 0  # of the file, when it was flushed last
        self._writer: Any = None
        self._begin()

    @property
    def samples(self) -> int:
        """How many samples were written."""
        return self._samples + len(self._open_chunk)

    @property
    def size(self) -> int:
        """Bytes of the file that is being written."""
        file = self._file  # which another thread or a signal handler may end
        return 0 if file is None else file.tell()

    def add_board(
        self,
        name: str,
        descriptors: Descriptors,
        *,
        url: str = "",
        properties: Mapping[str, str] | None = None,
        prefix: str = "",
        topics: Mapping[str, str] | None = None,
        settings: SavedSettings | None = None,
    ) -> None:
        """Announce a board before its samples.

        Args:
            name: tells it from the other boards of the file.
            descriptors: what it says of its transducers.
            url, properties: kept for who reads the file.
            prefix: of its topics; needed where there are several boards.
            topics: names of topics by sensor, in place of those that the descriptors give.
            settings: by sensor the bytes of items of a2jTransd, which `j2a replay` needs; a TOPIC
                names the topic.

        Raises:
            LocalError: there is a board of that name, or the recorder is closed.
        """
        named = {one.name: one.topic for one in descriptors.transducers if one.is_sensor}
        named |= {
            sensor: items[TRANSD_TOPIC].decode(errors="replace")
            for sensor, items in (settings or {}).items()
            if TRANSD_TOPIC in items
        }
        kept = dump(settings, str(descriptors).encode()).decode() if settings else ""

        def add() -> None:
            names: dict[str, str] = {}
            for sensor, topic in named.items():
                taken = {*names.values(), *self._topics}
                names[sensor] = free_name(topic_of(prefix, topic), taken)
            names.update({sensor: topic_of("", topic) for sensor, topic in (topics or {}).items()})
            if name in self._boards:
                raise LocalError(f"the recording has a board {name!r} already")
            board = RecordedBoard(name, url, descriptors, properties or {}, kept)
            self._check_open()
            self._boards[name] = board, names
            self._topics |= set(names.values())
            self._is_torn = True
            self._announce(board, names)
            self._is_torn = False

        self._do(add)

    def write(self, board: str, sample: Sample, time_ns: int) -> None:
        """Write a sample.

        Args:
            board: the name of its board.
            sample: as a sensor gives it.
            time_ns: when it came, in nanoseconds since 1970, 0 to 2**63 - 1.

        Raises:
            LocalError: no such sensor was announced, the time is none, or the recorder is closed.
            ValueError: the sample cannot be a message.
            OSError: it cannot be written, such as on a full disk.
        """
        # Here, because the package mcap would stop amid a record, or write what readers refuse.
        if not isinstance(time_ns, int) or not 0 <= time_ns < LATEST_NS:
            raise LocalError(f"time_ns is a number of nanoseconds since 1970, not {time_ns!r:.40}")
        self._do(partial(self._write, board, sample, time_ns))

    def flush(self) -> None:
        """Write all samples into the file, so that they stay even if this program is killed.

        Raises:
            OSError: they cannot be written.
        """
        self._do(self._flush)

    def close(self) -> None:
        """End the file; may be called twice.

        Raises:
            OSError: not all can be written; the file then ends behind the last chunk that was, and
                has no index.
        """
        self._do(self._end)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def _do(self, action: Callable[[], None]) -> None:
        """Do something alone: the package mcap does no second thing amid a first one."""
        if self._lock._is_owned():  # type: ignore[attr-defined]
            self._later.append(action)  # this is a signal handler amid that
            return
        try:
            with self._lock:
                self._do_all(action)
        finally:
            if self._later:  # since the last look
                self._do(self._do_later)

    def _do_all(self, action: Callable[[], None]) -> None:
        try:
            action()
        finally:
            self._do_later()

    def _do_later(self) -> None:
        try:
            while self._later:
                self._later.pop(0)()
        finally:
            if self._later:  # behind an error
                self._do_later()

    def _write(self, board: str, sample: Sample, time_ns: int) -> None:
        file = self._check_open()
        self._flush_chunk(file)  # one for which there was no room
        _, message = self._channel(board, sample.name)
        data = message.pack(sample.payload)
        one = _Message(board, sample.name, time_ns, data, sample.sequence & 0xFFFFFFFF)
        self._is_torn = True
        before = file.tell()
        self._add(one)
        self._open_chunk.append(one)
        if file.tell() != before:
            self._chunk_end = file.tell()
        self._is_torn = False
        self._flush_chunk(file)
        if self._segment_bytes and self._size >= self._segment_bytes:
            self._end()
            self._begin()

    def _add(self, one: "_Message") -> None:
        channel, _ = self._channels[one.board, one.sensor]
        self._writer.add_message(channel, one.time_ns, one.data, one.time_ns, one.sequence)

    def _flush(self) -> None:
        file = self._check_open()
        self._is_torn = True
        self._writer.flush()
        self._chunk_end = file.tell()
        self._is_torn = False
        self._flush_chunk(file)

    def _check_open(self) -> WholeFile:
        """Return the file, all of which is whole.

        Raises:
            LocalError: the recorder is closed.
        """
        if self._file is None or self._file.whole >= self._end_at:
            raise LocalError("the recorder is closed")
        if self._is_torn:
            self._mend(self._file)
        return self._file

    def _flush_chunk(self, file: WholeFile) -> None:
        if file.tell() != self._size:  # a chunk is complete
            file.end_piece()
            self._size = file.tell()
        self._forget_chunk(file)

    def _forget_chunk(self, file: WholeFile) -> None:
        if self._chunk_end and file.whole >= self._chunk_end:
            # One step, in which no signal handler can raise behind the property.
            self._samples, self._open_chunk, self._chunk_end = self.samples, [], 0

    def _mend(self, file: WholeFile) -> None:
        """Write anew what is not in the file, as half of a record may be among it.

        The package knows nothing of what its writer of before has written, so that the file gets
        no index. Where this is interrupted as well, it is done again.
        """
        file.forget()
        self._forget_chunk(file)
        self._chunk_end = 0
        self._size = file.tell()
        self._start(file)
        self._channels.clear()
        for board in self._announced:
            self._announce(*self._boards[board])
        for one in self._open_chunk:
            self._add(one)
        self._is_torn = False

    def _channel(self, board: str, sensor: str) -> tuple[int, SampleMessage]:
        if board in self._boards and board not in self._announced:
            self._is_torn = True
            self._announce(*self._boards[board])
            self._is_torn = False
        found = self._channels.get((board, sensor))
        if found is None:
            raise LocalError(f"the recording has no sensor {sensor!r} of a board {board!r}")
        return found

    def _begin(self) -> None:
        check_package()
        self._announced.clear()  # a segment has the boards of its own samples
        self._channels.clear()
        self._samples, self._open_chunk = self.samples, []
        self._size = self._chunk_end = 0
        self._end_at = math.inf
        self._is_torn = True
        path, file = self._open()
        self.paths.append(path)
        self._file = file
        self._start(file)
        self._is_torn = False

    def _start(self, file: WholeFile) -> None:
        """Have the package write, from the end of the file on."""
        writer = check_package().Writer
        # Boards and channels are outside the chunks, each of which has a checksum of its own.
        self._writer = writer(file, chunk_size=_CHUNK_BYTES, enable_data_crcs=True)
        self._has_index = not file.tell()
        if self._has_index:
            self._writer.start(profile="ros2", library="j2a")

    def _open(self) -> tuple[Path, WholeFile]:
        """Make the next file; a recording that runs passes over names that are there already."""
        number = self._number
        while True:
            name = f"{self._first.stem}-{number}" if number else self._first.stem
            path = self._first.with_stem(name)
            try:
                file = WholeFile(path)
            except FileExistsError:
                if not number:
                    raise
                number += 1
                continue
            self._number = number + 1
            return path, file

    def _announce(self, board: RecordedBoard, topics: Mapping[str, str]) -> None:
        about = {
            "name": board.name,
            "url": board.url,
            "descriptors": str(board.descriptors),
            "properties": json.dumps(dict(board.properties)),
        }
        if board.settings:
            about["settings"] = board.settings
        self._writer.add_metadata(_BOARD, about)
        self._announced[board.name] = None
        for one in board.descriptors.transducers:
            if not one.is_sensor:
                continue
            kind, definition = ros2_definition(board.descriptors, one.name)
            schema = self._writer.register_schema(kind, "ros2msg", definition.encode())
            about = {"board": board.name, "sensor": one.name, "unit": one.unit}
            about |= {key: one.get(key) for key in ("scale", "offset", "na") if one.has(key)}
            channel = self._writer.register_channel(topics[one.name], "cdr", schema, about)
            self._channels[board.name, one.name] = channel, SampleMessage(one)

    def _end(self) -> None:
        file = self._file
        if file is None:
            return
        try:
            try:
                self._finish(file)
            except BaseException as error:
                if isinstance(error, OSError) and not self._is_torn:
                    raise
                self._is_torn = True  # of a signal handler
                self._finish(file)
                raise
        except OSError:
            if file.whole < self._end_at:
                file.end_early(END)
            raise
        finally:
            file.close()
            self._file = None

    def _finish(self, file: WholeFile) -> None:
        if file.whole >= self._end_at:  # and a signal handler has raised behind that
            return
        if self._is_torn:
            self._mend(file)
        self._is_torn = True
        if self._has_index:
            self._writer.finish()
        else:
            self._writer.flush()
            file.write(END)
        self._end_at = file.tell()
        self._is_torn = False
        file.end_piece()


class Recording:
    """The samples of a file, in the order in which they were written.

    Args:
        path: of the file.

    Attributes:
        boards: by name; known once the iteration has come to a sample of theirs.
        is_whole: the file has its end; known when the iteration is over.
        duration_s: how long it is in seconds, as it says itself; None before `read_boards`, and
            where it does not say.
    """

    def __init__(self, path: str | Path) -> None:
        self._path = Path(path)
        self.duration_s: float | None = None
        self.boards: dict[str, RecordedBoard] = {}
        self.is_whole = False

    def __iter__(self) -> Iterator[Recorded]:
        """Yield the samples; what is damaged is left out, and told at the end.

        Raises:
            LocalError: the file is no recording, or parts of it are damaged. All samples that could
                be read have been given then.
            OSError: it cannot be read.
        """
        file = McapFile(self._path)
        described = 0
        sensors: dict[int, tuple[str, Transducer, SampleMessage]] = {}
        for record in file.records():
            try:
                if isinstance(record, About):
                    described += self._add_board(record, described)
                elif isinstance(record, ChannelRecord):
                    found = self._sensor(record.about)
                    if found is not None:
                        sensors[record.id] = *found, SampleMessage(found[1])
                elif record.channel in sensors:
                    board, sensor, message = sensors[record.channel]
                    payload = message.unpack(record.data)
                    yield Recorded(board, sensor, record.time_ns, record.sequence, payload)
            except ValueError as error:
                file.damaged(error)
        self.is_whole = file.is_whole
        self._check(file)

    def read_boards(self) -> dict[str, RecordedBoard]:
        """Return all boards, without reading the samples.

        Raises:
            LocalError: the file is no recording, or it is so damaged that it has no boards.
            OSError: it cannot be read.
        """
        file = McapFile(self._path)
        described = 0
        for record in file.records(chunks=False):
            if isinstance(record, About):
                try:
                    described += self._add_board(record, described)
                except ValueError as error:
                    file.damaged(error)
        if not self.boards:
            self._check(file)
        if file.times_ns is not None:
            self.duration_s = (file.times_ns[1] - file.times_ns[0]) / 1e9
        return self.boards

    def _check(self, file: McapFile) -> None:
        if file.problems:
            more = file.problems - 1
            others = f", and {counted(more, 'other part')}" if more else ""
            raise LocalError(f"{self._path} is damaged: {file.problem}{others}; it was left out")

    def _add_board(self, record: About, described: int) -> int:
        """Take a board in; return the length of what is said of it.

        Raises:
            ValueError: it is not described right, or with those before too long.
        """
        if record.name != _BOARD:
            return 0
        about = record.about
        length = sum(map(len, about.values()))
        if described + length > _MOST_DESCRIBED:
            raise ValueError(f"the boards are described by more than {_MOST_DESCRIBED} characters")
        try:
            name = about["name"]
            descriptors = parse_descriptors(about["descriptors"])
            properties = json.loads(about.get("properties", "{}"))
        except (KeyError, ValueError, LocalError, RecursionError) as error:
            raise ValueError(f"a board is not described right: {error}") from None
        if not isinstance(properties, dict):
            properties = {}
        texts = {str(key): str(value) for key, value in properties.items()}
        url, settings = about.get("url", ""), about.get("settings", "")
        self.boards[name] = RecordedBoard(name, url, descriptors, texts, settings)
        return length

    def _sensor(self, about: Mapping[str, str]) -> tuple[str, Transducer] | None:
        board = self.boards.get(about.get("board", ""))
        if board is None:
            return None
        try:
            return board.name, board.descriptors[about.get("sensor", "")]
        except KeyError:
            return None


def check_package() -> Any:
    """Load the package mcap, which takes a moment; return its module that writes.

    Raises:
        LocalError: it is not installed.
    """
    try:
        return import_module("mcap.writer")
    except ImportError:
        raise LocalError('recordings need the package mcap: pip install "j2a[record]"') from None
