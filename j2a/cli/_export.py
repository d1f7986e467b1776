"""`j2a export`: the samples of a recording as tables.

In: a file that `j2a record` wrote. Out: a folder with a table for each sensor, as CSV or Parquet.
Rules: a row is one value of one channel; channels without a value have none. Tables are written
piece by piece, so that a long recording needs no more memory than a short one. They have their
names when all of them are whole; a full disk, or Ctrl-C, leaves none. A file that is there already
is not overwritten.
"""

import argparse
import contextlib
import errno
import json
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final, Self

from j2a_spec.plural import counted

import j2a
from j2a.cli._exit import FAILED, OK, CommandFailed, UsageError
from j2a.cli._output import note, show
from j2a.cli._progress import Progress
from j2a.recording import Recorded, Recording
from j2a.types.arrays import Batch
from j2a.types.naming import free_name
from j2a.types.transducers import Transducer

NOTES: Final = """\
examples:
  j2a export drive.mcap tables
  j2a export drive.mcap tables --format parquet

The columns: host_time_ns (since 1970), time_us (on the clock of the board), channel, and value in
the unit of the sensor, the number of an enumeration, or the raw fields of a structure. No value
(N/A) is an empty cell. Units of columns stand beside a CSV file in NAME.units.json, and in Parquet
in the metadata of the column, as "unit". It needs NumPy and pandas: pip install "j2a[arrays]"; for
Parquet: pip install "j2a[parquet]"."""
_PIECE: Final = 20_000
_MOST_OF_NAME: Final = 50
_Frame = Any


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("file", metavar="FILE", help="a recording, *.mcap")
    parser.add_argument("folder", metavar="DIR", type=Path, help="where the tables are written")
    parser.add_argument(
        "--format", choices=tuple(_WRITERS), default="csv", help="of the tables (%(default)s)"
    )


def run(args: argparse.Namespace) -> int:
    """Write the tables; returns the exit code."""
    recording = Recording(args.file)
    if args.folder.exists() and not args.folder.is_dir():
        raise UsageError(
            f"{args.folder} is a file: give a folder; it is created if it does not exist"
        )
    try:
        overview = Recording(args.file)
        overview.read_boards()
        args.folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{error.filename}: {error.strerror}") from None
    tables: dict[tuple[str, Transducer], _Table] = {}
    problems: list[j2a.LocalError] = []
    with contextlib.ExitStack() as stack:
        progress = stack.enter_context(Progress(f"reading {args.file}", in_seconds=True))
        try:
            start_ns: int | None = None
            for one in _samples(recording, problems):
                key = one.board, one.sensor
                if key not in tables:
                    name = f"{_plain(one.board)}_{one.sensor.name}"
                    taken = {table.path.stem for table in tables.values()}
                    path = args.folder / f"{free_name(name, taken)}.{args.format}"
                    tables[key] = stack.enter_context(_Table(path, one.sensor, args.format))
                tables[key].add(one)
                start_ns = one.time_ns if start_ns is None else start_ns
                progress(max(0, one.time_ns - start_ns) / 1e9, overview.duration_s)
            for table in tables.values():
                table.finish()
            for table in tables.values():
                table.keep()
        except FileExistsError as error:
            raise UsageError(f"{error.filename} is there already; choose another folder") from None
        except OSError as error:
            raise CommandFailed(f"cannot write the tables: {error.strerror}", FAILED) from None
    for table in tables.values():
        show(f"wrote {table.path}: {counted(table.rows, 'row')}")
    if not tables and not problems:
        end = "" if recording.is_whole else "; it is incomplete"
        note(f"j2a: {args.file} has no samples{end}")
    if problems:
        if tables:
            raise CommandFailed(f"{problems[0]}; the rest is written", FAILED)
        raise problems[0]
    if tables and not recording.is_whole:
        note(f"j2a: {args.file} is incomplete; the samples in it were exported")
    return OK


def _samples(recording: Recording, problems: list[j2a.LocalError]) -> Iterator[Recorded]:
    """Yield what can be read of a recording; that it is damaged is told behind that."""
    try:
        yield from recording
    except j2a.LocalError as error:
        problems.append(error)


def _plain(name: str) -> str:
    """Return a name as a part of that of a file; it stays in the folder, and is not too long."""
    made = "".join(char if char.isalnum() or char in "-." else "_" for char in name)
    return made[:_MOST_OF_NAME] or "board"


class _Table:
    """The table of one sensor; a context manager that removes it if it was not kept.

    Raises:
        FileExistsError: one of its files is there already.
    """

    def __init__(self, path: Path, sensor: Transducer, form: str) -> None:
        self.path = path
        self.rows = 0
        self._sensor = sensor
        self._waiting: list[Recorded] = []
        self._about = path.with_suffix(".units.json") if form == "csv" else None
        for one in filter(None, (path, self._about)):
            if one.exists() or one.is_symlink():
                raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(one))
        self._units: dict[str, str] = {}
        self._parts = {path: _part_of(path)}
        self._parts[path].unlink(missing_ok=True)  # of a run that was killed
        self._write, self._close = _WRITERS[form](self._parts[path])

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        with contextlib.suppress(OSError):  # as was told
            self._close()
        for part in self._parts.values():
            with contextlib.suppress(OSError):
                part.unlink(missing_ok=True)

    def add(self, one: Recorded) -> None:
        """Take a sample; now and then it writes what waits."""
        self._waiting.append(one)
        if len(self._waiting) >= _PIECE:
            self._flush()

    def finish(self) -> None:
        """Write all that there is, and close the files."""
        self._flush()
        self._close()
        if self._about and self._units:
            part = self._parts[self._about] = _part_of(self._about)
            part.write_text(json.dumps(self._units, indent=1) + "\n", encoding="utf-8")

    def keep(self) -> None:
        """Give the files, which are finished, their names."""
        for path, part in self._parts.items():
            part.replace(path)

    def _flush(self) -> None:
        if self._waiting:
            frame = _frame(self._sensor, self._waiting)
            self._waiting = []
            self.rows += len(frame)
            self._units = frame.attrs["units"]
            self._write(frame)


def _part_of(path: Path) -> Path:
    return path.with_name(f"{path.name}.part")


def _frame(sensor: Transducer, samples: list[Recorded]) -> _Frame:
    """Return a table of samples, without the channels that have no value yet."""
    from numpy import array, repeat  # noqa: PLC0415 - an extra

    batch = Batch(sensor, [one.payload for one in samples])
    frame = batch.to_pandas()
    times = array([one.time_ns for one in samples], dtype="i8")
    frame.insert(0, "host_time_ns", repeat(times, batch.counts))
    return frame[frame["time_us"] != 0]


_Writer = tuple[Callable[[_Frame], None], Callable[[], None]]


def _csv(path: Path) -> _Writer:
    file = path.open("x", encoding="utf-8", newline="")
    heads: Iterator[bool] = iter((True,))

    def write(frame: _Frame) -> None:
        frame.to_csv(file, index=False, header=next(heads, False), lineterminator="\n")

    return write, file.close


def _parquet(path: Path) -> _Writer:
    try:
        import pyarrow as arrow  # noqa: PLC0415 - an extra
        from pyarrow import parquet  # noqa: PLC0415
    except ImportError:
        raise j2a.LocalError('this needs pyarrow: pip install "j2a[parquet]"') from None
    file = path.open("xb")
    writers: list[Any] = []

    def write(frame: _Frame) -> None:
        table = arrow.Table.from_pandas(frame, preserve_index=False)
        schema = table.schema
        for name, unit in frame.attrs["units"].items():
            at = schema.get_field_index(name)
            schema = schema.set(at, schema.field(at).with_metadata({"unit": unit}))
        if not writers:
            writers.append(parquet.ParquetWriter(file, schema))
        writers[0].write_table(table.cast(writers[0].schema))

    def close() -> None:
        for writer in writers:
            writer.close()
        file.close()

    return write, close


_WRITERS: Final[dict[str, Callable[[Path], _Writer]]] = {"csv": _csv, "parquet": _parquet}
