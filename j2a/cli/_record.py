"""`j2a record`: write what the sensors of boards measure into a file.

In: URLs of boards. Out: an MCAP file with messages of ROS 2, which stock viewers read.
Rules: each second all samples are in the file, so that a program that is killed loses one second at
most; Ctrl-C ends the file properly; a board that is lost does not end the others.
"""

from __future__ import annotations

import argparse
import contextlib
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

import j2a
from j2a.cli._exit import FAILED, LINK, OK, CommandFailed, UsageError, end_on_sigterm
from j2a.cli._link import add_link_options, connect_to, finite_seconds, whole_number
from j2a.cli._output import note, show
from j2a.cli._progress import Progress, size_text
from j2a.protocol.saved_settings import SavedSettings
from j2a.recording import Recorder, check_package

NOTES: Final = """\
examples:
  j2a record tcp://127.0.0.1:5000 -o drive.mcap
  j2a record tcp://127.0.0.1:5000 tcp://127.0.0.1:5001 -o two.mcap --seconds 60

Topics are those of the sensors; with several boards the name of the board stands before. Values are
raw. It needs the package mcap: pip install "j2a[record]"."""
_EACH_S: Final = 1.0
_MIB: Final = 1 << 20


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument(
        "urls", metavar="URL", nargs="+", help="a board, such as tcp://127.0.0.1:5000"
    )
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="FILE", help="what to write: *.mcap"
    )
    parser.add_argument(
        "--seconds", type=finite_seconds, metavar="N", help="end after N seconds; else by Ctrl-C"
    )
    parser.add_argument(
        "--segment",
        type=whole_number(1),
        metavar="MIB",
        help="begin another file, FILE-1.mcap and so on, when one has so many MiB",
    )
    add_link_options(parser)


class _Session:
    """A recording that runs: what was lost, and why it ends."""

    def __init__(self, recorder: Recorder) -> None:
        self.recorder = recorder
        self.lost = 0
        self.refused = 0
        self.changed: set[str] = set()
        self.failure: OSError | None = None
        self.ended = threading.Event()

    def keep(self, board: str, sensor: j2a.Sensor) -> Callable[[j2a.Sample], None]:
        """Return the handler of the samples of a sensor."""
        announced = sensor.descriptor

        def write(sample: j2a.Sample) -> None:
            nonlocal announced
            if self.failure is not None or self.ended.is_set():
                return
            self.lost += sample.lost + sample.missed
            descriptor = sensor.descriptor
            if descriptor is not announced:
                if descriptor != announced:
                    self.changed.add(f"{sensor.name} of {board}")
                    return
                announced = descriptor
            try:
                self.recorder.write(board, sample, time.time_ns())
            except j2a.LocalError:
                return  # it has ended meanwhile
            except ValueError:
                self.refused += 1
            except OSError as error:
                self.failure = error
                self.ended.set()

        return write


def run(args: argparse.Namespace) -> int:
    """Record until the end; returns the exit code."""
    if args.output.suffix != ".mcap":
        raise UsageError(f"{args.output}: the name ends in .mcap")
    twice = [url for url in args.urls if args.urls.count(url) > 1]
    if twice:
        raise UsageError(f"{twice[0]} stands there twice")
    check_package()  # now, as samples come as soon as the boards are there
    end_on_sigterm()
    with contextlib.ExitStack() as stack:
        boards = [stack.enter_context(connect_to(args, url)) for url in args.urls]
        for board in boards:
            if not any(isinstance(one, j2a.Sensor) for one in board.transducers.values()):
                raise UsageError(f"{board.url} has no sensors: {board.transducers.why}")
        try:
            segment = args.segment and args.segment * _MIB
            recorder = Recorder(args.output, segment_bytes=segment)
        except FileExistsError:
            raise UsageError(f"{args.output} is there already; choose another name") from None
        except OSError as error:
            raise UsageError(f"cannot write {args.output}: {error.strerror}") from None
        session = _Session(recorder)
        try:
            for board, name in zip(boards, _names(boards), strict=True):
                _begin(session, board, name, is_alone=len(boards) == 1)
            code = _record(session, boards, args.seconds)
        except (KeyboardInterrupt, SystemExit):
            _finish(session)
            raise
        _finish(session)
    return code


def _names(boards: list[j2a.Client]) -> list[str]:
    """Return a name for each board: its own, with its serial number or a number where need be."""
    own = [board.properties.get("name") or "board" for board in boards]
    names: list[str] = []
    for board, first in zip(boards, own, strict=True):
        serial = board.properties.get("serial")
        name = f"{first}_{serial}" if serial and own.count(first) > 1 else first
        made, number = name, 1
        while made in names:
            number += 1
            made = f"{name}_{number}"
        names.append(made)
    return names


def _begin(session: _Session, board: j2a.Client, name: str, *, is_alone: bool) -> None:
    descriptors = board.transducers.descriptors
    assert descriptors is not None
    session.recorder.add_board(
        name,
        descriptors,
        url=board.url,
        properties=board.properties,
        prefix="" if is_alone else name,
        settings=_settings(board),
    )
    for sensor in board.transducers.values():
        if isinstance(sensor, j2a.Sensor):
            sensor.on_sample(session.keep(name, sensor))


def _settings(board: j2a.Client) -> SavedSettings:
    """Return the settings that sensors have now, without those that the board does not tell."""
    found: SavedSettings = {}
    try:
        for sensor in board.transducers.values():
            if isinstance(sensor, j2a.Sensor):
                found[sensor.name] = sensor._settings()
    except j2a.J2AError as error:  # an older board, or one that is being lost
        note(f"j2a: {board.url}: {error}")
    return found


def _record(session: _Session, boards: list[j2a.Client], seconds: float | None) -> int:
    """Wait for the end; returns the exit code."""
    with Progress("record", in_seconds=True) as progress:
        return _wait(session, boards, seconds, progress)


def _wait(
    session: _Session, boards: list[j2a.Client], seconds: float | None, progress: Progress
) -> int:
    start = time.monotonic()
    gone: set[str] = set()
    while True:
        left = _EACH_S if seconds is None else min(_EACH_S, start + seconds - time.monotonic())
        if left <= 0:
            return LINK if gone else OK
        session.ended.wait(left)
        if session.failure is None:
            try:
                session.recorder.flush()
            except OSError as error:
                session.failure = error
        if session.failure is not None:
            return FAILED
        for board in boards:
            if not board.is_open and board.url not in gone:
                gone.add(board.url)
                note(f"j2a: lost {board.url}")
        if len(gone) == len(boards):
            return LINK
        recorder = session.recorder
        more = f"{recorder.samples} samples  {size_text(recorder.size)}  {session.lost} lost"
        progress(time.monotonic() - start, seconds, more)


def _finish(session: _Session) -> None:
    recorder = session.recorder
    failure = session.failure
    session.ended.set()
    try:
        recorder.close()
    except OSError as error:
        failure = failure or error
    paths = ", ".join(map(str, recorder.paths))
    if failure is not None:
        why = failure.strerror or failure
        raise CommandFailed(f"{why}: what was written before is in {paths}", FAILED)
    show(f"wrote {paths}: {recorder.samples} samples, {session.lost} lost on the way")
    if session.refused:
        note(f"j2a: {session.refused} samples were left out: their times fit into no message")
    for what in sorted(session.changed):
        note(f"j2a: {what} is another one since the board restarted: its samples were left out")
