"""What the transports into simulated firmware share, whatever wire they use.

In: bytes to send. Out: bytes that came, from a simulator that runs while somebody reads or sleeps.
Rules: time is the simulator's and passes only in `read` and `sleep`, as fast as the machine can,
so a test neither waits nor depends on the load; the same calls from one thread give the same bytes
at the same cycles each time. A timeout is in simulated seconds. One thread may read while others
write: a write is noticed within SLICE_S of simulated time.
"""

from __future__ import annotations

import threading
from abc import abstractmethod
from collections import deque
from collections.abc import Callable
from typing import Final

from j2a_transports import LinkClosed, LinkLost, Transport

from j2a_sim._avr import AvrSim
from j2a_sim._errors import SimError
from j2a_sim._pace import Pacer

SLICE_S: Final = 0.001
# At once where nothing is paced and so nothing is to be done meanwhile: a write or close wakes it.
# Not longer, for Ctrl-C waits until it is over.
LONG_SLICE_S: Final = 0.05
# A host cannot look at its wire more often; without it a loop of read(0) would stop time.
LOOK_S: Final = 0.00001
PATIENCE_S: Final = 10.0


class TimedLink(Transport):
    """A wire into a simulated AVR, as a transport; a kind of wire overrides what is abstract here.

    Args:
        sim: the simulator.
        url: for messages.
        patience_s: after so many simulated seconds without a byte in either direction, time goes
            on no faster than real time, so that a reader that waits for nothing costs little;
            None: never.
        speed: 0: as fast as possible; otherwise simulated seconds per second at most, for hosts
            that measure by the wall clock.

    Attributes:
        sim: the simulator, for cycles, spans, counters and memory.

    Raises:
        SimError: the speed is negative.
    """

    is_simulated = True

    def __init__(
        self,
        sim: AvrSim,
        url: str = "sim:",
        *,
        patience_s: float | None = PATIENCE_S,
        speed: float = 0.0,
    ) -> None:
        super().__init__(url, None)
        if speed < 0:
            raise SimError(f"speed {speed} is negative")
        self.sim = sim
        self._patience_s, self._speed = patience_s, speed
        self._pacer = Pacer(speed or 1.0)
        self._is_paced = speed > 0
        self._pending: deque[bytes] = deque()
        self._changed = threading.Condition()  # a write or close, for a reader that paces itself
        self._reading = threading.RLock()
        self._closed = False
        self._stopped: SimError | None = None
        self._set_up()
        self._pacer.restart(sim.time_s)
        self._active_s = sim.time_s

    @abstractmethod
    def _set_up(self) -> None:
        """Let the firmware get ready."""

    @abstractmethod
    def _send(self, data: bytes) -> None:
        """Put a write on the wire."""

    @property
    @abstractmethod
    def _readable(self) -> bool:
        """Whether something has come that was not read yet."""

    @abstractmethod
    def _run_until_readable(self, cycles: int) -> None:
        """Run until something comes, for at most so many cycles."""

    @abstractmethod
    def _run(self, cycles: int) -> None:
        """Run for so many cycles; what comes is kept."""

    @abstractmethod
    def _collect(self) -> bytes:
        """Return what has come and what follows it closely; something has."""

    @property
    def closed(self) -> bool:
        """See `Transport.closed`."""
        return self._closed

    def close(self) -> None:
        """See `Transport.close`; the simulator stays, to be looked at."""
        with self._changed:
            self._closed = True
            self.sim.wake()
            self._changed.notify_all()

    def clock(self) -> float:
        """Simulated seconds, the counterpart of time.monotonic."""
        return self.sim.time_s

    def write(self, data: bytes | bytearray | memoryview) -> None:
        """Queue bytes for the wire; they are on it back to back while a read or sleep runs."""
        with self._changed:
            self._check_open()
            self._check_running()
            self._pending.append(bytes(data))
            self.sim.wake()
            self._changed.notify_all()

    def read(self, timeout_s: float | None) -> bytes:
        """See `Transport.read`, with `timeout_s` in simulated seconds.

        Each call takes at least 10 us of simulated time, so that polling with 0 gets somewhere.
        """
        with self._reading:
            end = float("inf")
            if timeout_s is not None:
                end = self.sim.cycle + self.sim.cycles(max(timeout_s, LOOK_S))
            while True:
                self._check_open()
                if self._readable:
                    data = self._collect()
                    self._active_s = self.sim.time_s
                    return data
                self._check_running()
                left = end - self.sim.cycle
                if left <= 0:
                    return b""
                self._keep_pace()
                self._pass(self._run_until_readable, left)

    def sleep(self, seconds: float) -> None:
        """Let simulated time pass; what arrives meanwhile is kept for the next read.

        Args:
            seconds: how long, in simulated seconds.

        Raises:
            LinkLost: the firmware stopped, or the link broke.
            LinkClosed: this side is closed.
        """
        with self._reading:
            end = self.sim.cycle + self.sim.cycles(seconds)
            while self.sim.cycle < end:
                self._check_open()
                self._check_running()
                self._keep_pace()
                self._pass(self._run, end - self.sim.cycle)

    def _pass(self, run: Callable[[int], None], cycles: float) -> None:
        """Put what was written on the wire and let a slice of time pass, at most `cycles`."""
        self.sim.heed()  # before one looks: what comes behind that wakes it again
        slice_s = SLICE_S if self._is_paced else LONG_SLICE_S
        try:
            while self._pending:
                self._send(self._pending.popleft())
                self._active_s = self.sim.time_s
            run(int(min(cycles, self.sim.cycles(slice_s))))
        except SimError as error:
            self._stopped = error

    def _keep_pace(self) -> None:
        """Wait, but for a write or close, while simulated time is too far ahead."""
        now_s = self.sim.time_s
        patient = self._patience_s is None or now_s - self._active_s < self._patience_s
        if self._speed == 0:
            if patient:
                self._is_paced = False
                return
            if not self._is_paced:
                self._pacer.restart(now_s)
                self._is_paced = True
        wait_s = self._pacer.wait_s(now_s)
        if wait_s:
            with self._changed:
                if not self._pending and not self._closed:
                    self._changed.wait(wait_s)

    def _check_open(self) -> None:
        if self._closed:
            raise LinkClosed(f"{self.url} is closed")

    def _check_running(self) -> None:
        if self._stopped is not None:
            raise LinkLost(f"{self.url}: {self._stopped}")
