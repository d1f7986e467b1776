"""Boards without SyncUSB, whose links belong to the daemon.

In: URLs. Out: clocks that are disciplined over these links, and their rows of the status.
Rules: a fleet opens the links and opens them again; each board has a thread of its own. Nothing is
opened before `look` is called, in the process and with the rights that the daemon then has.
"""

from __future__ import annotations

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
from j2a.syncd.history import History, Round

__all__ = ["LinkBoards"]

_logger = logging.getLogger("j2a.syncd")
MAX_BOARDS: Final = 256


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
        self._urls: list[str] = []
        self._keepers: dict[str, tuple[j2a.Client, ClockKeeper]] = {}
        self._problems: dict[str, str] = {}
        self._readings: dict[str, ClockReading] = {}
        self._fleet: j2a.Fleet | None = None
        for url in urls:
            self.add(url)

    def add(self, url: str) -> None:
        """Take in a board; nothing happens where it is known.

        Raises:
            LocalError: the URL is of no known scheme, or there are too many.
        """
        with self._lock:
            if url in self._urls:
                return
            if len(self._urls) >= MAX_BOARDS:
                raise j2a.LocalError(f"the daemon has {MAX_BOARDS} boards, and takes no more")
            try:
                j2a_transports.innermost(url)
            except j2a_transports.TransportError as error:
                raise link_error(error) from None
            if self._fleet is not None:
                self._fleet.add(url)
            self._urls.append(url)

    def look(self) -> None:
        """Begin with the boards that have come, and note how all of them do."""
        with self._lock:
            if self._fleet is None:
                self._fleet = j2a.Fleet(*self._urls, identify=by_url)
            fleet = self._fleet
        for url in list(self._urls):
            client = fleet.get(url)
            kept, keeper = self._keepers.get(url, (None, None))
            if client is None or (kept is client and keeper is not None and keeper.is_running):
                self._note(url, client)
                continue
            try:
                self._keepers[url] = client, client.clock.discipline(self._interval_s)
                self._problems.pop(url, None)
                _logger.info("%s: its clock is disciplined", url)
            except j2a.J2AError as error:
                if self._problems.get(url) != str(error):
                    _logger.warning("%s", error)
                self._problems[url] = str(error)

    def _note(self, url: str, client: j2a.Client | None) -> None:
        if client is None:
            self._readings.pop(url, None)
            return
        _, keeper = self._keepers[url]
        try:
            reading = client.clock.read()
        except j2a.J2AError as error:
            self._problems[url] = str(error)
            return
        self._problems.pop(url, None)
        self._readings[url] = reading
        if keeper.error is not None and keeper.rounds == 0:
            self._problems[url] = str(keeper.error)
        self._history.add(
            url, Round(time.time(), reading.offset_us, reading.rate_ppb, reading.uncertainty_us)
        )

    def facts(self) -> list[dict[str, Any]]:
        """Return the rows of these boards in the status."""
        fleet = self._fleet
        failed = {} if fleet is None else fleet.problems
        problems = {url: str(error) for url, error in failed.items()}
        rows = []
        for url in list(self._urls):
            reading = self._readings.get(url)
            _, keeper = self._keepers.get(url, (None, None))
            rows.append(
                {
                    "board": url,
                    "place": url,
                    "state": "waiting" if reading is None else reading.state,
                    "packets": 0 if keeper is None else keeper.rounds,
                    "lost": 0 if keeper is None else keeper.failures,
                    "tells_frames": None,
                    "problem": problems.get(url) or self._problems.get(url),
                    "offset_us": None if reading is None else round(reading.offset_us, 1),
                    "rate_ppb": None if reading is None else round(reading.rate_ppb),
                    "uncertainty_us": None if reading is None else round(reading.uncertainty_us, 1),
                }
            )
        return rows

    def close(self) -> None:
        """Close all links."""
        with self._lock:
            if self._fleet is not None:
                self._fleet.close()
