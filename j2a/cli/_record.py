"""`j2a record`: write what the sensors of boards measure into a file.

In: URLs of boards. Out: an MCAP file with messages of ROS 2, which stock viewers read.
Rules: each second all samples are in the file, so that a program that is killed loses one second at
most; Ctrl-C ends the file properly; a board that is lost does not end the others, and is taken in
again when it comes back.
"""

import argparse
import contextlib
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Final

from j2a_spec.plural import counted

import j2a
from j2a.cli._exit import FAILED, LINK, OK, CommandFailed, UsageError
from j2a.cli._heartbeat import Pulse
from j2a.cli._link import add_link_options, connect, finite_number, finite_seconds, whole_number
from j2a.cli._output import note, show
from j2a.cli._progress import Progress, size_text
from j2a.io.threads import start_thread
from j2a.protocol.saved_settings import SavedSettings
from j2a.recording import Recorder, check_package
from j2a.types.naming import free_name
from j2a.types.transducers import Descriptors, Transducer

NOTES: Final = """\
examples:
  j2a record tcp://127.0.0.1:5000 -o drive.mcap
  j2a record tcp://127.0.0.1:5000 tcp://127.0.0.1:5001 -o two.mcap --seconds 60

Topics are those of the sensors; with several boards the name of the board stands before. Values are
raw. A board from which nothing came for 3 s is asked for an echo; if it answers neither of two, it
is taken for lost, as one whose link ended, and taken in again when it answers. It needs the
package mcap: pip install "j2a[record]"."""
_EACH_S: Final = 1.0
_WAIT_S: Final = 10.0
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
    parser.add_argument(
        "--wait",
        type=_seconds,
        default=_WAIT_S,
        metavar="N",
        help="when no board is left, wait N seconds for one to come back (%(default)g); 0 ends",
    )
    add_link_options(parser)


def _seconds(text: str) -> float:
    value = finite_number(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"must be 0 or more, not {text}")
    return value


class _Session:
    """A recording that runs: what was lost, and why it ends."""

    def __init__(self, recorder: Recorder) -> None:
        self.recorder = recorder
        self._lock = threading.Lock()  # each board has a thread of its own
        self.lost = 0  # on the boards; what was lost on the way a `_Board` has
        self.refused = 0
        self.told: set[str] = set()  # what else is to be told at the end
        self.failure: OSError | None = None
        self.ended = threading.Event()

    def keep(
        self, board: str, sensor: j2a.Sensor, announced: Transducer
    ) -> Callable[[j2a.Sample], None]:
        """Return the handler of the samples of a sensor, which was announced so."""

        def write(sample: j2a.Sample) -> None:
            nonlocal announced
            if self.failure is not None:
                return
            lost = sample.lost
            with self._lock:
                self.lost += lost
            descriptor = sensor.descriptor
            if descriptor is not announced:
                if descriptor != announced:
                    self.told.add(
                        f"{sensor.name} of {board} is another one since the board restarted: its "
                        "samples were left out"
                    )
                    return
                announced = descriptor
            try:
                self.recorder.write(board, sample, time.time_ns())
            except j2a.LocalError:
                return  # it has ended meanwhile
            except ValueError:
                with self._lock:
                    self.refused += 1
            except OSError as error:
                self.failure = error
                self.ended.set()

        return write


class _Board:
    """A board of the recording, which is opened again when its link was lost.

    Args:
        session: that is recorded.
        client: of the board.
        name: in the recording.
        connect: opens the link again.

    Attributes:
        is_gone: the link is lost.
        gaps: how often it was.
        dropped: SIFs that came, and for which this program was too slow, of links that are closed.
    """

    def __init__(
        self, session: _Session, client: j2a.Client, name: str, connect: Callable[[], j2a.Client]
    ) -> None:
        self._session = session
        self._client = client
        self._name = name
        self._connect = connect
        self._identity = _identity(client)
        self._descriptors = client.transducers.descriptors or Descriptors()
        self.is_gone = False
        self.gaps = self.dropped = 0
        self._closed: j2a.Client | None = None
        self._missed, self._watched, self._missed_before = 0, client, 0
        self._gap_s = 0.0  # of those that are over
        self._gone_s = 0.0

    def begin(self, *, is_alone: bool) -> None:
        """Announce the board, and take its samples."""
        client = self._client
        self._session.recorder.add_board(
            self._name,
            self._descriptors,
            url=client.url,
            properties=client.properties,
            prefix="" if is_alone else self._name,
            settings=_settings(client),
        )
        self._subscribe()
        start_thread(self._keep, f"j2a record {client.url}")

    def _subscribe(self) -> None:
        client = self._client
        self._missed, self._watched = self.missed, client
        self._missed_before = client.counters.sifs_missed
        known = {one.name: one for one in self._descriptors.transducers if one.is_sensor}
        for name, sensor in self._client.transducers.items():
            if isinstance(sensor, j2a.Sensor) and name in known:
                sensor.on_sample(self._session.keep(self._name, sensor, known[name]))
        self._client.on_restart(lambda _: self._compare())
        self._compare()

    def _compare(self) -> None:
        """Note which sensors the board has now that it did not have, and the other way round."""
        descriptors = self._client.transducers.descriptors
        if descriptors is None:
            return
        names, before = (
            {one.name for one in known.transducers if one.is_sensor}
            for known in (descriptors, self._descriptors)
        )
        for name in names - before:
            self._session.told.add(f"{name} of {self._name} is new: its samples were left out")
        for name in before - names:
            self._session.told.add(f"{name} of {self._name} is gone since the board restarted")

    @property
    def missed(self) -> int:
        """SIFs of any kind that were lost on the way; a sample tells of the last of them only."""
        return self._missed + self._watched.counters.sifs_missed - self._missed_before

    @property
    def gap_s(self) -> float:
        """For how long nothing came from it, in all."""
        return self._gap_s + (time.monotonic() - self._gone_s if self.is_gone else 0.0)

    def _keep(self) -> None:
        """Watch the link, and open it again when it is lost, until the recording ends."""
        while (why := self._wait_for_loss()) is not None:
            note(f"j2a: {why}")
            self.close()
            self._come_back()

    def _wait_for_loss(self) -> str | None:
        """Wait until the link is lost or the board hangs; return which, None at the end."""
        client = self._client
        pulse = Pulse(client)
        while not self._session.ended.wait(_EACH_S):
            with contextlib.suppress(j2a.J2AError):
                pulse.check()
                continue
            if self._session.ended.is_set():
                break
            self._gone_s = time.monotonic() - (client.now() - pulse.heard_s)
            self.gaps += 1
            self.is_gone = True
            return f"{client.url} does not answer" if client.is_open else f"lost {client.url}"
        return None

    def _come_back(self) -> None:
        told = ""
        while not self._session.ended.wait(_EACH_S):
            try:
                client = self._client = self._connect()
                problem = self._problem(client)
                if not problem:
                    self._subscribe()
            except j2a.J2AError:  # it may be lost again meanwhile
                self.close()
                continue
            if problem:
                self.close()
                if told != problem:
                    told = problem
                    note(f"j2a: {client.url} {problem}")
                continue
            if self._session.ended.is_set():
                client.close()
                return
            gap_s = time.monotonic() - self._gone_s
            self._gap_s, self.is_gone = self._gap_s + gap_s, False
            note(f"j2a: {client.url} is here again, after {gap_s:.1f} s without samples")
            return

    def _problem(self, client: j2a.Client) -> str:
        """Return why a link cannot take the place of the one that was lost, or ""."""
        identity = _identity(client)
        if identity != self._identity:
            return f"is another board now: {identity}"
        transducers = client.transducers
        return "" if transducers else f"has no sensors now: {transducers.why}"

    def close(self) -> None:
        """Write the samples that have come, and close the link."""
        client = self._client
        client.close()
        if client is not self._closed:
            self._closed = client
            self.dropped += client.counters.sifs_dropped


def _identity(client: j2a.Client) -> str:
    own = (client.properties.get(key, "") for key in ("name", "serial"))
    return " ".join(filter(None, own)) or "without a name"


def run(args: argparse.Namespace) -> int:
    """Record until the end; returns the exit code."""
    if args.output.suffix != ".mcap":
        raise UsageError(
            f"{args.output}: give it a name that ends in .mcap; j2a export makes tables of it"
        )
    twice = [url for url in args.urls if args.urls.count(url) > 1]
    if twice:
        raise UsageError(f"{twice[0]} stands there twice")
    check_package()  # now, as samples come as soon as the boards are there
    with contextlib.ExitStack() as stack:
        clients = [stack.enter_context(connect(args, url)) for url in args.urls]
        for client in clients:
            if not any(isinstance(one, j2a.Sensor) for one in client.transducers.values()):
                raise UsageError(f"{client.url} has no sensors: {client.transducers.why}")
        try:
            segment = args.segment and args.segment * _MIB
            recorder = Recorder(args.output, segment_bytes=segment)
        except FileExistsError:
            raise UsageError(f"{args.output} is there already; choose another name") from None
        except OSError as error:
            raise UsageError(f"cannot write {args.output}: {error.strerror}") from None
        session = _Session(recorder)
        boards = [
            _Board(session, client, name, partial(connect, args, url))
            for client, name, url in zip(clients, _names(clients), args.urls, strict=True)
        ]
        for board in boards:
            stack.callback(board.close)
        stack.callback(session.ended.set)
        try:
            for board in boards:
                board.begin(is_alone=len(boards) == 1)
            with Progress("record", in_seconds=True) as progress:
                code = _wait(session, boards, args, progress)
        except (KeyboardInterrupt, SystemExit):
            _finish(session, boards)
            raise
        _finish(session, boards)
    return code


def _kept(paths: list[Path]) -> bool:
    """Tell whether anything was written; else remove the file, or its name would be taken."""
    if any(path.exists() and path.stat().st_size for path in paths):
        return True
    for path in paths:
        path.unlink(missing_ok=True)
    return False


def _names(boards: list[j2a.Client]) -> list[str]:
    """Return a name for each board: its own, with its serial number or a number where need be."""
    own = [board.properties.get("name") or "board" for board in boards]
    names: list[str] = []
    for board, first in zip(boards, own, strict=True):
        serial = board.properties.get("serial")
        name = f"{first}_{serial}" if serial and own.count(first) > 1 else first
        names.append(free_name(name, names, "_"))
    return names


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


def _wait(
    session: _Session, boards: list[_Board], args: argparse.Namespace, progress: Progress
) -> int:
    """Wait for the end; returns the exit code."""
    seconds: float | None = args.seconds
    start = here = time.monotonic()
    while True:
        left = _EACH_S if seconds is None else min(_EACH_S, start + seconds - time.monotonic())
        if left <= 0:
            return LINK if any(board.is_gone for board in boards) else OK
        session.ended.wait(left)
        if session.failure is None:
            try:
                session.recorder.flush()
            except OSError as error:
                session.failure = error
        if session.failure is not None:
            return FAILED
        if not all(board.is_gone for board in boards):
            here = time.monotonic()
        elif time.monotonic() - here >= args.wait:
            return LINK
        recorder = session.recorder
        lost = _lost(session, boards)
        more = f"{counted(recorder.samples, 'sample')}  {size_text(recorder.size)}  {lost} lost"
        progress(time.monotonic() - start, seconds, more)


def _lost(session: _Session, boards: list[_Board]) -> int:
    return session.lost + sum(board.missed for board in boards)


def _finish(session: _Session, boards: list[_Board]) -> None:
    recorder = session.recorder
    failure = None
    session.ended.set()
    try:
        for board in boards:
            board.close()
    finally:  # a second Ctrl-C ends the file, too
        try:
            recorder.close()
        except OSError as error:
            failure = error
    failure = session.failure or failure
    paths = ", ".join(map(str, recorder.paths))
    if failure is not None:
        why = failure.strerror or failure
        if not _kept(recorder.paths):
            raise CommandFailed(f"cannot write {paths}: {why}", FAILED)
        raise CommandFailed(f"{why}: what was written before is in {paths}", FAILED)
    gaps, gap_s = (sum(getattr(board, key) for board in boards) for key in ("gaps", "gap_s"))
    more = f", and a board was away {counted(gaps, 'time')}, {gap_s:.1f} s" if gaps else ""
    lost = _lost(session, boards)
    samples = counted(recorder.samples, "sample")
    show(f"wrote {paths}: {samples}, {lost} lost on the way{more}")
    if session.refused:
        fit = "sample was left out: its time fits", "samples were left out: their times fit"
        note(f"j2a: {counted(session.refused, *fit)} into no message")
    if dropped := sum(board.dropped for board in boards):
        sifs = counted(dropped, "SIF was", "SIFs were")
        note(f"j2a: {sifs} left out: this computer is too slow for all of them")
    for what in sorted(session.told):
        note(f"j2a: {what}")
