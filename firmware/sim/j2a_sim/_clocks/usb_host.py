"""The daemon `j2a syncd` of the bench: what it tells boards by SyncUSB, and when.

In: boards on one USB, the host's clocks, recorded delays. Out: boards that have the time.
Rules: what is asked, told and concluded is the code of the daemon itself (`j2a.syncd`); here is
only what threads and the system do around it. The daemon has a thread for each board, and here one
after the other has its turn, in simulated time.
"""

from __future__ import annotations

import bisect
import statistics
import time
from collections.abc import Callable
from typing import Final, Protocol

import numpy as np
from j2a_spec import usb
from j2a_spec.constants import CLOCK_FRAME_NUMBERS
from j2a_transports import FrameSeen
from numpy.random import Generator
from numpy.typing import NDArray

from j2a.io.host_time import HostTime
from j2a.protocol.clock import LOOK_S
from j2a.syncd.history import History
from j2a.syncd.sync_board import SyncBoard
from j2a.syncd.usb_bus import Bus
from j2a_sim._clocks.delays import host_delay
from j2a_sim._clocks.report import UNKNOWN
from j2a_sim._clocks.settings import Settings
from j2a_sim._clocks.truth import UNIX_US, Floats, HostClock

__all__ = ["SyncedBoard", "UsbHost"]

START_S: Final = 1.0
TOLD_APART_S: Final = 0.0002
NAME: Final = "usb bus 1"


class SyncedBoard(Protocol):
    """What both engines offer of SyncUSB."""

    def frame_seen(self, at_s: float) -> tuple[int, int, float]:
        """Ask in which frame a request comes; also returns when the answer is there."""

    def packet(self, at_s: float, packet: bytes) -> float:
        """Send a packet; returns when the board has it."""

    def run(self, until_s: float) -> None:
        """Let true time pass."""

    def restart(self, off_s: float, on_s: float) -> None:
        """Lose the power, and get it back."""


class _Port:
    """What `j2a_transports.SyncPort` is to the daemon."""

    frames = NAME
    serial = None

    def __init__(self, host: UsbHost, board: SyncedBoard, number: int) -> None:
        self.name = f"1-{number}"
        self.key = (1, number, self.name)
        self._host, self._board = host, board

    def open(self) -> None:
        """Nothing is to be claimed."""

    def close(self) -> None:
        """Nothing was claimed."""

    def frame(self, nonce: int) -> FrameSeen | None:
        """Ask; the host's time goes on until its program has the answer."""
        del nonce
        return self._host.asks(self._board)

    def send(self, time_us: int, frame: int) -> None:
        """Tell; other threads do not wait until the board has it."""
        self._host.tells(self._board, usb.sync.build({"time_us": time_us, "frame": frame}))


class UsbHost:
    """Gives the boards of a run the time.

    Args:
        settings: of the run.
        rng: the source of all that is random.
        clock: the host's.
        boards: them.

    Attributes:
        lost: requests without an answer that could be used.
        refused: always 0, for nobody answers a packet.
    """

    def __init__(
        self, settings: Settings, rng: Generator, clock: HostClock, boards: list[SyncedBoard]
    ) -> None:
        self._settings, self._rng = settings, rng
        self._wake = host_delay(settings.load, "wake")
        self._write = host_delay(settings.load, "write")
        self._now_s = START_S
        host = HostTime(
            lambda: float(clock.monotonic_us(self._now_s)),
            lambda: UNIX_US + round(float(clock.unix_us(self._now_s))),
        )
        self._bus = Bus(NAME, settings.period_s, History(), host)
        self._boards = boards
        self._synced = [self._plugged(number) for number in range(len(boards))]
        self._replugged = False
        # What the daemon said of the error of each board, and since when.
        self._announced: list[list[tuple[float, int]]] = [[] for _ in boards]
        self._cpu_ns = 0
        self._trips_us: list[float] = []
        self.lost = self.refused = 0

    def _plugged(self, number: int) -> SyncBoard:
        return SyncBoard(_Port(self, self._boards[number], number + 1), self._bus)

    @property
    def slack_us(self) -> float:
        """What the lower tenth of the round trips left unexplained, on average."""
        trips = sorted(self._trips_us)
        return statistics.mean(trips[: max(1, len(trips) // 10)]) if trips else 0.0

    @property
    def cpu_us(self) -> float:
        """Processor time of the daemon for each answer; this alone depends on the machine."""
        return self._cpu_ns / 1000 / max(1, len(self._trips_us))

    def announced_us(self, number: int, times_s: Floats) -> NDArray[np.uint32]:
        """What the status said of the error of a board at true times, UNKNOWN before it did.

        Boards cannot tell it, because packets of SyncUSB do not (SYNC-006).
        """
        since = [at_s for at_s, _ in self._announced[number]]
        said = [UNKNOWN, *(told_us for _, told_us in self._announced[number])]
        return np.array([said[bisect.bisect_right(since, t)] for t in times_s], dtype=np.uint32)

    def run(self, progress: Callable[[float], object] = lambda _done_s: None) -> None:
        """Do the whole run; call `progress` with the simulated seconds that are over."""
        settings = self._settings
        end_s = settings.seconds if settings.holdover_at is None else settings.holdover_at
        self._ask_all()
        while self._wait(end_s):
            progress(self._now_s)
            self._tell(self._present())
            self._ask_all()
        for board in self._boards:
            board.run(settings.seconds)

    def _wait(self, end_s: float) -> bool:
        """Wait for the next round as each thread does; return False at the end of the run."""
        left_s = self._bus.until_next_round_s()
        while left_s > 0:
            self._now_s += min(left_s, LOOK_S) + self._wake.one_s(self._rng)
            if self._now_s >= end_s:
                return False
            left_s -= LOOK_S
            if left_s > 0:
                self._tell([one for one in self._present() if one.has_news])
        return True

    def _present(self) -> list[SyncBoard]:
        """Return the boards that are there now; one that was plugged in again is a new one."""
        s, now_s = self._settings, self._now_s
        if s.suspend_at is not None and s.suspend_at <= now_s < s.suspend_at + s.suspend_for:
            return []
        if s.unplug_at is None or now_s < s.unplug_at:
            return self._synced
        back_s = s.unplug_at + s.unplug_for
        if now_s < back_s:
            return self._synced[1:]
        if not self._replugged:
            self._replugged = True
            self._boards[0].restart(s.unplug_at, back_s)
            self._bus.forget(self._synced[0])
            self._synced[0] = self._plugged(0)
        return self._synced

    def _ask_all(self) -> None:
        for board in self._present():
            began_ns = time.process_time_ns()
            board.ask()
            self._cpu_ns += time.process_time_ns() - began_ns

    def _tell(self, boards: list[SyncBoard]) -> None:
        for board in boards:
            board.tell()
            self._now_s += TOLD_APART_S
        for board, announced in zip(self._synced, self._announced, strict=True):
            if board in boards:
                told_us = board.facts()["uncertainty_us"]
                announced.append((self._now_s, UNKNOWN if told_us is None else told_us))

    # ------------------------------------------------------------------ for ports

    def asks(self, board: SyncedBoard) -> FrameSeen | None:
        """Let a board say in which frame it is asked, while a thread waits."""
        began_ns, sent_us = time.process_time_ns(), self._bus.now_us()
        at_s = self._now_s + self._write.one_s(self._rng)
        frame, age_us, came_s = board.frame_seen(at_s)
        self._now_s = came_s + self._wake.one_s(self._rng)
        self._trips_us.append(self._bus.now_us() - sent_us)
        self._cpu_ns -= time.process_time_ns() - began_ns
        if frame >= CLOCK_FRAME_NUMBERS:
            self.lost += 1
            return None
        return FrameSeen(frame, age_us)

    def tells(self, board: SyncedBoard, packet: bytes) -> None:
        """Let a board have a packet."""
        board.packet(self._now_s + self._write.one_s(self._rng), packet)
