"""Boards without SyncUSB, whose links belong to the daemon.

In: URLs. Out: clocks that are disciplined over these links, and their rows of the status.
Rules: a fleet opens the links and opens them again; each board has a thread of its own here as
well, so that one that is silent delays no other. Nothing is opened before `look` is called, in the
process and with the rights that the daemon then has.
"""

import logging
import threading
import time
from collections.abc import Sequence
from typing import Any, Final

import j2a_transports

import j2a
from j2a.clock import ClockKeeper, ClockReading
from j2a.fleet import by_url
from j2a.io.clock import MAX_PERIOD_S
from j2a.io.opening import link_error
from j2a.io.threads import JOIN_S, join_threads, start_thread
from j2a.syncd.history import History, Round

__all__ = ["LinkBoards"]

_logger = logging.getLogger("j2a.syncd")
MAX_BOARDS: Final = 256
_LOOK_S: Final = 1.0
"""So often at least it looks for a board that is not there."""


class LinkBoards:
    """The boards of some URLs.

    Args:
        urls: of the boards; `add` takes more.
        interval_s: between two adjustments, and between two records in the history; at most 5.
        history: gets a record of each round.
    """

    def __init__(self, urls: Sequence[str], interval_s: float, history: History) -> None:
        self._interval_s = min(interval_s, MAX_PERIOD_S)
        self._history = history
        self._lock = threading.Lock()
        self._boards: dict[str, _LinkBoard] = {}
        self._fleet: j2a.Fleet | None = None
        self._is_closed = False
        for url in urls:
            self.add(url)

    def add(self, url: str) -> None:
        """Take in a board; nothing happens where it is known.

        Raises:
            LocalError: the URL is of no known scheme, or there are too many.
        """
        with self._lock:
            if url in self._boards:
                return
            if len(self._boards) >= MAX_BOARDS:
                raise j2a.LocalError(f"the daemon has {MAX_BOARDS} boards, and takes no more")
            try:
                j2a_transports.innermost(url)
            except j2a_transports.TransportError as error:
                raise link_error(error) from None
            self._boards[url] = _LinkBoard(url, self._interval_s, self._history)

    def look(self) -> None:
        """Begin with the boards that have come.

        Raises:
            OpenFailed: the system has no thread to give; the next look tries again.
        """
        with self._lock:
            if self._is_closed:
                return
            if self._fleet is None:
                self._fleet = j2a.Fleet(identify=by_url)
            for one in self._boards.values():
                one.start(self._fleet)

    def facts(self) -> list[dict[str, Any]]:
        """Return the rows of these boards in the status."""
        fleet = self._fleet
        failed = {} if fleet is None else fleet.problems
        with self._lock:
            boards = list(self._boards.items())
        return [one.facts(failed.get(url)) for url, one in boards]

    def close(self) -> None:
        """Close all links."""
        with self._lock:
            self._is_closed = True
            boards = list(self._boards.values())
        for one in boards:
            one.stop()
        if self._fleet is not None:
            self._fleet.close()
        join_threads([one.thread for one in boards if one.thread is not None], JOIN_S)


class _LinkBoard:
    """A board and its thread.

    Attributes:
        thread: None before it was started.
    """

    def __init__(self, url: str, interval_s: float, history: History) -> None:
        self.thread: threading.Thread | None = None
        self._url = url
        self._interval_s = interval_s
        self._history = history
        self._stop = threading.Event()
        self._kept: j2a.Client | None = None
        self._keeper: ClockKeeper | None = None
        self._reading: ClockReading | None = None
        self._problem: str | None = None

    def start(self, fleet: j2a.Fleet) -> None:
        """Begin, where it has not yet."""
        if self.thread is None:
            self.thread = start_thread(lambda: self._run(fleet), f"j2a syncd {self._url}")

    def stop(self) -> None:
        """Let the thread end."""
        self._stop.set()

    def facts(self, failed: j2a.J2AError | None) -> dict[str, Any]:
        """Return the row of this board in the status.

        Args:
            failed: why its link is not open.
        """
        reading, keeper = self._reading, self._keeper
        return {
            "board": self._url,
            "place": self._url,
            "state": "waiting" if reading is None else reading.state,
            "packets": 0 if keeper is None else keeper.rounds,
            "lost": 0 if keeper is None else keeper.failures,
            "tells_frames": None,
            "frames_modulo": None,
            "problem": self._problem if failed is None else str(failed),
            "offset_us": None if reading is None else round(reading.offset_us, 1),
            "rate_ppb": None if reading is None else round(reading.rate_ppb),
            "uncertainty_us": None if reading is None else round(reading.uncertainty_us, 1),
        }

    def _run(self, fleet: j2a.Fleet) -> None:
        is_added = False
        while not self._stop.is_set():
            try:
                if not is_added:
                    fleet.add(self._url)
                    is_added = True
                self._go_on(fleet.get(self._url))
                self._problem = None
            except j2a.J2AError as error:
                if self._problem != str(error):
                    _logger.warning("%s", error)
                self._problem = str(error)
                self._reading = None  # nobody knows how the clock does meanwhile
            self._stop.wait(self._interval_s if self._reading else min(self._interval_s, _LOOK_S))

    def _go_on(self, client: j2a.Client | None) -> None:
        """Discipline a board that is there, and note how it does.

        Raises:
            J2AError: it has no clock, or does not answer.
        """
        if client is None:
            self._reading = self._kept = None
            return
        keeper = self._keeper
        if self._kept is not client or keeper is None or not keeper.is_running:
            self._reading = None
            self._keeper = client.clock.discipline(self._interval_s)
            self._kept = client
            _logger.info("%s: its clock is disciplined", self._url)
            return
        self._reading = reading = client.clock.read()
        if keeper.error is not None and keeper.rounds == 0:
            raise keeper.error
        self._history.add(
            self._url,
            Round(time.time(), reading.offset_us, reading.rate_ppb, reading.uncertainty_us),
        )
