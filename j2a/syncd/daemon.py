"""The daemon: every board with SyncUSB gets the time, and so do boards whose URL is given.

In: what the USB tells about boards, and requests of other programs. Out: packets with times, and
the status. Rules: a board has a thread of its own, so that none waits for another; the boards of
one bus share one line from frame numbers to times, so that the error of the host is the same for
all of them (thesis section 6.1).
"""

import logging
import os
import threading
import time
from collections.abc import Callable, Sequence
from types import NoneType
from typing import Any, Final

import j2a_transports

import j2a
from j2a.io.bell import Bell
from j2a.io.host_time import HostTime, host_time
from j2a.io.threads import JOIN_S, join_threads
from j2a.syncd.history import History
from j2a.syncd.sync_board import SyncBoard
from j2a.syncd.url_boards import LinkBoards
from j2a.syncd.usb_bus import Bus

__all__ = ["Daemon"]

_logger = logging.getLogger("j2a.syncd")
_LOOK_S: Final = 1.0
"""How often it looks for boards that nobody has told of."""
MAX_BOARDS: Final = 127
"""With SyncUSB; a bus has no more addresses."""


class Daemon:
    """Gives boards the time until it is told to stop.

    Args:
        interval_s: seconds between two packets to a board.
        urls: of boards without SyncUSB, whose links belong to the daemon.
        ports: returns the boards with SyncUSB; None where there is no USB to look at.
        only: bus and address of the one board that is meant; None for what may be any. The
            request "look" may name more.
        host: the time of this computer, for counting how often it was set.
    """

    def __init__(
        self,
        *,
        interval_s: float,
        urls: Sequence[str] = (),
        ports: Callable[[], list[Any]] | None,
        only: tuple[int | None, int | None] = (None, None),
        host: HostTime | None = None,
    ) -> None:
        self._interval_s = interval_s
        self._ports = ports
        self._only = {only}
        self._history = History()
        self._boards: dict[tuple[int, int, str], SyncBoard] = {}
        self._buses: dict[str, Bus] = {}
        self._host = host_time() if host is None else host
        self._lock = threading.Lock()
        self._wake = Bell()
        self._is_stopped = False
        self._began_s = time.monotonic()
        self._problem: str | None = None
        self._links = LinkBoards(urls, interval_s, self._history)

    def run(self) -> None:
        """Look for boards until `stop` is called; then give all of them back."""
        try:
            while not self._is_stopped:
                self.observe()
                problems = [self._problem_of(look) for look in (self._look, self._links.look)]
                problem = "; ".join(filter(None, problems)) or None
                if problem is not None and problem != self._problem:
                    _logger.warning("%s", problem)
                self._problem = problem
                self._wake.wait(_LOOK_S)
        finally:
            self._links.close()
            with self._lock:
                boards = list(self._boards.values())
                self._boards.clear()
            for one in boards:
                one.stop()
            join_threads([one.thread for one in boards if one.thread is not None], JOIN_S)

    @staticmethod
    def _problem_of(look: Callable[[], None]) -> str | None:
        """Look for boards; return why that failed, as while devices come and go."""
        try:
            look()
        except (j2a.J2AError, j2a_transports.TransportError) as error:
            return str(error)
        return None

    def observe(self) -> None:
        """Note whether the clock of this computer was set, which boards are told at once."""
        steps = self._host.reference.steps
        self._host.observe()
        if self._host.reference.steps != steps:
            by_s = self._host.reference.last_step_us / 1e6
            _logger.warning("the clock of this computer was set by %+.6f s", by_s)

    def stop(self) -> None:
        """End `run`; may be called from a signal handler."""
        self._is_stopped = True
        self._wake.ring()

    def answer(self, request: dict[str, Any], is_trusted: bool) -> dict[str, Any]:
        """Return the reply to a request; see `singleton.Server`."""
        command = request.get("command")
        if command == "status":
            return self.status()
        if command == "history":
            board = request.get("board")
            if board is None:
                return {"boards": self._history.boards}
            return {"rounds": self._history.facts(str(board))}
        if command == "look":
            self._wake.ring()
            return self._add(request.get("urls", []), request.get("only"), is_trusted)
        return {"error": f"there is no command {command!r:.40}"}

    def status(self) -> dict[str, Any]:
        """Return what `j2a sync status --json` prints."""
        with self._lock:
            boards = [one.facts() for one in self._boards.values()]
        links = self._links.facts()
        return {
            "pid": os.getpid(),
            "uptime_s": round(time.monotonic() - self._began_s),
            "steps": self._host.reference.steps,
            "problem": self._problem,
            "boards": boards + links,
        }

    def _add(self, urls: object, only: object, is_trusted: bool) -> dict[str, Any]:
        if not isinstance(urls, list) or not all(isinstance(url, str) for url in urls):
            return {"error": "urls is a list of texts"}
        if (urls or only is not None) and not is_trusted:
            return {"error": "only the user of the daemon, and root, may give it URLs, or boards"}
        if only is not None:
            numbers = only if isinstance(only, list) else []
            if len(numbers) != 2 or not all(type(one) in {int, NoneType} for one in numbers):
                return {"error": "only is a list of bus and address"}
            self._only.add((numbers[0], numbers[1]))
            self._wake.ring()
        try:
            for url in urls:
                self._links.add(url)
        except j2a.J2AError as error:
            return {"error": str(error)}
        return {"pid": os.getpid(), "added": len(urls)}

    def _look(self) -> None:
        """Compare the boards that are there with those that were."""
        if self._ports is None:
            return
        found = self._ports()
        there = {one.key: one for one in found if self._is_meant(one.key)}
        with self._lock:
            ended = [key for key, one in self._boards.items() if not one.is_running]
            for key in ended:  # the next look begins anew with a board that is still there
                one = self._boards.pop(key)
                _logger.info("%s: %s", one.name, one.problem or "gone")
            for key in self._boards.keys() - there.keys():
                self._boards[key].stop()
            for key in there.keys() - self._boards.keys() - set(ended):
                if len(self._boards) < MAX_BOARDS:
                    self._boards[key] = self._start(there[key])

    def _is_meant(self, key: tuple[int, int, str]) -> bool:
        return any(
            bus in {None, key[0]} and address in {None, key[1]}
            for bus, address in self._only.copy()
        )

    def _start(self, port: Any) -> SyncBoard:
        bus = self._buses.setdefault(port.frames, Bus(port.frames, self._interval_s, self._history))
        board = SyncBoard(port, bus)
        board.start()
        return board
