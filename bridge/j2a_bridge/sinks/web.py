"""The sink `web`: the live page, see `j2a view`.

What flows in: topics, samples and the state of all. What flows out: a page on this computer that
shows them and sends orders back.
Rules: samples are thinned to what a picture can show, least and greatest of each span included, so
no spike is lost; topics and lines of the log are gathered between two looks of the server, which
runs in a loop of its own and has a bounded queue for each page.
"""

import asyncio
import dataclasses
import errno
import logging
import re
import threading
import time
from collections import deque
from collections.abc import Mapping, Sequence
from datetime import datetime
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final

from j2a_spec.plural import counted

from j2a import LocalError, Reading
from j2a.cli.plugin import plain
from j2a.types.model import Enumeration, Structure, Type
from j2a.types.scaled_numbers import in_unit, scaling_of, text_in_unit
from j2a_bridge.actuator_values import ActuatorValues
from j2a_bridge.json_values import finite
from j2a_bridge.sink import Control, Option, Sink, SinkError, Status, Update, port_of
from j2a_bridge.sinks.mcap import McapSink
from j2a_bridge.sinks.mqtt import transducer_object
from j2a_bridge.sinks.udp import numbers
from j2a_bridge.topics import Topic
from j2a_bridge.web_server import PageServer, without_plots

if TYPE_CHECKING:
    from j2a_conformance._model import Run

__all__ = ["WebSink"]

_SERIES: Final = 32
_LOG: Final = 200
_LINES: Final = 50
"""So many lines of the log go to pages at once."""
_TEXT: Final = 2000
_START_S: Final = 10.0
_TOKEN: Final = re.compile(r"[A-Za-z0-9_-]{16,}")
"""What nobody guesses, and what is the same in an address."""
_NS_PER_MS: Final = 1_000_000
_value: Final = itemgetter(1)
_logger = logging.getLogger("j2a.bridge")


class _Span:
    """What came of one topic since pages were told last.

    Args:
        newest: of each channel the sample and its reading that is shown; it is brought up to date.
    """

    def __init__(self, newest: dict[int, tuple[Update, Reading]]) -> None:
        self._newest = newest
        self.series: dict[str, list[tuple[int, float]]] = {}

    def add(self, update: Update) -> None:
        """Take a sample in: of each series the least, the greatest and the newest are kept."""
        for one in update.sample.readings:
            self._newest[one.channel] = update, one
        for stamp, name, value in numbers(update):
            point = stamp // _NS_PER_MS, value
            kept = self.series.get(name)
            if kept is None:
                if len(self.series) < _SERIES:
                    self.series[name] = [point]
            elif len(kept) < 3:
                kept.append(point)
            else:
                # Of one millisecond what came last stays last.
                points = sorted([*kept, point], key=itemgetter(0))
                chosen = {min(points, key=_value), max(points, key=_value), points[-1]}
                newest_first = dict.fromkeys(one for one in reversed(points) if one in chosen)
                self.series[name] = [*reversed(newest_first)]

    def object(self) -> dict[str, Any]:
        """Return what pages are told."""
        series = {
            name: [part for point in points for part in point]
            for name, points in self.series.items()
        }
        most = max(self._newest, default=-1) + 1
        values = [_text(self._newest.get(channel)) for channel in range(most)]
        return {"v": values, "s": series}


def _text(newest: tuple[Update, Reading] | None) -> str:
    """Return what is shown of a channel; only now, as most samples are replaced before."""
    if newest is None or newest[1].time_us is None:
        return "none yet"
    update, reading = newest
    if reading.value is None:
        return "N/A"
    sensor = update.topic.transducer
    shown = _shown(reading.raw, sensor.type, *scaling_of(sensor))
    return f"{shown} {update.sample.unit}" if update.sample.unit else shown


def _shown(raw: Any, kind: Type, scale: float = 1.0, offset: float = 0.0) -> str:
    """Return a value as the page shows it, a line for each field of a structure with its unit.

    Args:
        raw: of a reading.
        kind: its type.
        scale: of its transducer.
        offset: of its transducer.
    """
    if hasattr(raw, "_asdict") and isinstance(kind.element, Structure):
        lines = []
        for field, one in zip(kind.element.fields, raw, strict=True):
            lines.append(f"{field.name}  {_shown(one, field.type)} {field.type.unit}".rstrip())
        return "\n".join(lines)
    if isinstance(raw, list | tuple):
        return "  ".join(_shown(one, kind, scale, offset) for one in raw)
    if isinstance(raw, float) or (scale, offset) != (1.0, 0.0):
        return text_in_unit(raw, kind.element, scale, offset)
    return plain(raw)


def _control(topic: Topic) -> dict[str, Any]:
    """Return what a control of the page needs.

    A slider moves by one step of the raw value, or by "any" as of HTML, from its lowest value on: a
    limit with digits that only rounding made would put all values off, and the highest one out of
    reach. Of an enumeration the names within the range can be chosen.
    """
    one = topic.transducer
    element, ends = one.type.element, one.range
    about: dict[str, Any] = {"step": "any" if element in ("f32", "f64") else abs(one.scale)}
    if ends is not None and one.is_scaled:
        about["range"] = finite([in_unit(end, element, one.scale, one.offset) for end in ends])
    if isinstance(element, Enumeration) and one.type.count is None and not one.is_sensor:
        names = element.values
        about["choices"] = [
            name for name, number in names if ends is None or ends[0] <= number <= ends[1]
        ]
    return about


def _line(board: str, kind: str, text: str) -> dict[str, Any]:
    return {"t": time.time_ns() // _NS_PER_MS, "board": board, "kind": kind, "text": text}


class WebSink(Sink):
    """Serves the live page.

    Attributes:
        actuators: the values that they have.
        reports: what j2a-conform found of boards, as of `j2a_bridge.reports.read_reports`.
        server: of the page.
    """

    SUMMARY = "a live page in the browser of this computer"
    ARGUMENT = "[PORT]"
    OPTIONS: ClassVar[Mapping[str, Option]] = {
        "folder": Option(str, ".", "where recordings are written"),
        "token": Option(str, "", "the end of the address: 16 or more of A-Za-z0-9_- (random)"),
    }
    WAITING = 1 << 15

    def __init__(self, argument: str, options: Mapping[str, Any], control: Control) -> None:
        super().__init__(argument, options, control)
        port = port_of(argument or "0")
        if port is None:
            raise LocalError(f"web takes a port, not {argument!r:.40}")
        if options["token"] and not _TOKEN.fullmatch(options["token"]):
            raise LocalError("the token of web is 16 or more of A-Z, a-z, 0-9, _ and -")
        self._lock = threading.Lock()
        self._topics: dict[str, Topic] = {}
        self._spans: dict[str, _Span] = {}
        self._newest: dict[str, dict[int, tuple[Update, Reading]]] = {}
        self._status: Status | None = None
        self._log: deque[dict[str, Any]] = deque(maxlen=_LOG)
        self._lines: list[dict[str, Any]] = []
        self._left_out = 0
        self._noted = 0
        self._has_changed = False
        self._recorder: McapSink | None = None
        self._is_wanted = False
        self._problem = ""
        self.actuators = ActuatorValues()
        self.reports: Sequence[Run] = ()
        self.server = PageServer(self, port, options["token"])
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread: threading.Thread | None = None

    # ------------------------------------------------------------------ life

    def open(self) -> None:
        """Serve the page."""
        with self._lock:
            self._topics.clear()
            self._spans.clear()
            self._newest.clear()
        self.actuators.forget()
        started: list[str] = []
        ready = threading.Event()

        async def serve() -> None:
            self._loop = asyncio.get_running_loop()
            try:
                await self.server.start()
            except OSError as error:
                why = str(error.strerror or error)
                if error.errno == errno.EADDRINUSE:  # asyncio tells it at length
                    why = f"port {self.argument} is taken"
                started.append(f"the page cannot be served: {why}")
                return
            finally:
                ready.set()
            await self.server.run()

        def work() -> None:
            try:
                asyncio.run(serve())
            except Exception:  # `status` notices it
                _logger.exception("the server of the page has ended")

        self._thread = threading.Thread(target=work, name="j2a page", daemon=True)
        self._thread.start()
        if not ready.wait(_START_S) or started:
            raise SinkError(started[0] if started else "the page cannot be served")

    def told(self) -> str:
        """Return the address of the page."""
        return "; ".join(filter(None, (f"the page is at {self.server.url}", without_plots())))

    def close(self) -> None:
        """Serve no more, and end a recording."""
        self._end_recording()
        loop, self._loop = self._loop, None
        if loop is not None and not loop.is_closed():
            loop.call_soon_threadsafe(self.server.stop)
        if self._thread is not None:
            self._thread.join(_START_S)
            self._thread = None

    # ------------------------------------------------------------------ from the bridge

    def announce(self, topic: Topic) -> None:
        """Show a transducer."""
        with self._lock:
            self._topics[topic.name] = topic
            self._has_changed = True
        if self._recorder is not None:
            self._recorder.announce(topic)

    def retract(self, topic: Topic) -> None:
        """Show it no more."""
        with self._lock:
            self._topics.pop(topic.name, None)
            self._spans.pop(topic.name, None)
            self._newest.pop(topic.name, None)
            self._has_changed = True
        self.actuators.forget(topic.name)

    def publish(self, update: Update) -> None:
        """Take a sample in."""
        with self._lock:
            span = self._spans.get(update.topic.name)
            if span is None:
                newest = self._newest.setdefault(update.topic.name, {})
                span = self._spans[update.topic.name] = _Span(newest)
            span.add(update)
        if self._recorder is not None:
            self._record(lambda recorder: recorder.publish(update))

    def flush(self) -> None:
        """Have a recording flushed."""
        if self._recorder is not None:
            self._record(McapSink.flush)

    def status(self, status: Status) -> None:
        """Show the state of all; begin or end a recording that was asked for."""
        if self._thread is not None and not self._thread.is_alive():
            raise SinkError("the page is served no more; it is served anew")
        self._status = status
        is_wanted = self._is_wanted
        if is_wanted and self._recorder is None:
            self._begin_recording()
        elif not is_wanted and self._recorder is not None:
            self._end_recording()
        self.flush()
        loop = self._loop
        if loop is not None and not loop.is_closed():
            loop.call_soon_threadsafe(self.server.tell, self.state())

    # ------------------------------------------------------------------ for the server

    def topics(self) -> dict[str, Any]:
        """Return all transducers."""
        with self._lock:
            topics = list(self._topics.values())
        return {
            "op": "topics",
            "topics": {
                one.name: {"board": one.board, **transducer_object(one), **_control(one)}
                for one in topics
            },
        }

    def actuators_of(self, board: str) -> list[Topic]:
        """Return the actuators of a board."""
        with self._lock:
            topics = list(self._topics.values())
        return [one for one in topics if one.board == board and not one.transducer.is_sensor]

    def state(self) -> dict[str, Any]:
        """Return the state of all."""
        about = {} if self._status is None else finite(dataclasses.asdict(self._status))
        recording = None if self._recorder is None else self._recorder.argument
        return {"op": "status", **about, "recording": recording, "problem": self._problem}

    def news(self) -> list[dict[str, Any]]:
        """Return what came since the last time."""
        with self._lock:
            spans, self._spans = self._spans, {}
            lines, self._lines = self._lines, []
            left_out, self._left_out = self._left_out, 0
            has_changed, self._has_changed = self._has_changed, False
        news = [self.topics()] if has_changed else []
        if spans:
            news.append({"op": "data", "d": {name: span.object() for name, span in spans.items()}})
        if (values := self.actuators.news()) is not None:
            news.append(values)
        if left_out:
            text = counted(left_out, "more line is not shown", "more lines are not shown")
            lines.append(_line("", "log", text))
        if lines:
            news.append({"op": "log", "lines": lines})
        return news

    def note(self, board: str, kind: str, text: str) -> None:
        """Put a line into the log of pages; from any thread."""
        line = _line(board, kind, text[:_TEXT])
        with self._lock:
            self._noted += 1
            line["number"] = self._noted  # a page that is new may be told it twice
            self._log.append(line)
            if len(self._lines) < _LINES:
                self._lines.append(line)
            else:
                self._left_out += 1

    def log(self) -> dict[str, Any]:
        """Return the lines of the log."""
        with self._lock:
            return {"op": "log", "lines": list(self._log), "is_all": True}

    def want_recording(self, is_wanted: bool) -> None:
        """Begin or end a recording, with the next state at the latest."""
        self._is_wanted = is_wanted

    # ------------------------------------------------------------------ recordings

    def _begin_recording(self) -> None:
        # Of a name that is new: after the server has failed, the file of before is there.
        name = datetime.now().strftime("j2a-%Y%m%d-%H%M%S-%f.mcap")
        path = str(Path(self.options["folder"]) / name)
        defaults = {name: option.default for name, option in McapSink.OPTIONS.items()}
        try:
            recorder = McapSink(path, defaults, self.control)
            recorder.open()
        except (LocalError, OSError, SinkError) as error:
            self._is_wanted, self._problem = False, f"no recording: {error}"
            return
        with self._lock:
            topics = list(self._topics.values())
        for topic in topics:
            recorder.announce(topic)
        self._problem = ""
        self._recorder = recorder

    def _record(self, work: Any) -> None:
        """Do something with the recorder; a recording that fails ends alone."""
        assert self._recorder is not None
        try:
            work(self._recorder)
        except (OSError, SinkError) as error:
            self._problem = f"the recording ended: {error}"
            self._is_wanted = False
            self._end_recording()

    def _end_recording(self) -> None:
        recorder, self._recorder = self._recorder, None
        if recorder is not None:
            try:
                recorder.close()
            except OSError as error:
                self._problem = f"the recording ended: {error}"
