"""A transport into simulated firmware, in this process, in simulated time: `sim:fw.elf`.

In: bytes for the firmware. Out: what it answers.
Rules: time is the simulator's and passes only in `read` and `sleep`, as fast as the machine can,
so a test neither waits nor depends on the load; the same calls from one thread give the same bytes
at the same cycles each time. A timeout is in simulated seconds. One thread may read while others
write: a write is noticed within SLICE_S of simulated time.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from typing import Any, Final
from urllib.parse import unquote

from j2a_transports import LinkClosed, LinkLost, OpenFailed, Transport, Url

from j2a.sim._avr import AvrSim
from j2a.sim._errors import FirmwareStopped, SimError
from j2a.sim._options import frequency, rate, speed
from j2a.sim._pace import Pacer

SLICE_S: Final = 0.001
# A host cannot look at its UART more often; without it a loop of read(0) would stop time.
LOOK_S: Final = 0.00001
# A gap on the wire that ends what one read returns, in characters.
GAP_CHARS: Final = 2
MOST_BYTES: Final = 64
PATIENCE_S: Final = 10.0


class SimLink(Transport):
    """The UART of a simulated AVR as a transport.

    Args:
        sim: the simulator; it is booted here (see AvrSim.boot) unless it already listens.
        url: for messages.
        patience_s: after so many simulated seconds without a byte in either direction, time goes
            on no faster than real time, so that a reader that waits for nothing costs little;
            None: never.
        speed: 0: as fast as possible; otherwise simulated seconds per second at most, for hosts
            that measure by the wall clock.

    Attributes:
        sim: the simulator, for cycles, spans, counters and memory.

    Raises:
        SimError: the firmware does not turn its receiver on within a second.
    """

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
        if not sim.receiver_on:
            sim.boot()
        self._patience_s, self._speed = patience_s, speed
        self._pacer = Pacer(speed or 1.0)
        self._pacer.restart(sim.time_s)
        self._pending: deque[bytes] = deque()
        self._changed = threading.Condition()  # a write or close, for a reader that paces itself
        self._reading = threading.RLock()
        self._active_s = sim.time_s
        self._closed = False
        self._stopped: FirmwareStopped | None = None

    @property
    def closed(self) -> bool:
        """See `Transport.closed`."""
        return self._closed

    def close(self) -> None:
        """See `Transport.close`; the simulator stays, to be looked at."""
        with self._changed:
            self._closed = True
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
            self._changed.notify_all()

    def read(self, timeout_s: float | None) -> bytes:
        """See `Transport.read`, with `timeout_s` in simulated seconds.

        Returns what has arrived up to a gap of two characters on the wire, at most some 64 bytes.
        Each call takes at least 10 us of simulated time, so that polling with 0 gets somewhere.
        """
        with self._reading:
            end = float("inf")
            if timeout_s is not None:
                end = self.sim.cycle + self.sim.cycles(max(timeout_s, LOOK_S))
            while True:
                self._check_open()
                if self.sim.readable:
                    return self._collect()
                self._check_running()
                left = end - self.sim.cycle
                if left <= 0:
                    return b""
                self._keep_pace()
                self._pass(self.sim.run_until_output, left)

    def sleep(self, seconds: float) -> None:
        """Let simulated time pass; what arrives meanwhile is kept for the next read.

        Args:
            seconds: how long, in simulated seconds.

        Raises:
            LinkLost: the firmware stopped.
            LinkClosed: this side is closed.
        """
        with self._reading:
            end = self.sim.cycle + self.sim.cycles(seconds)
            while self.sim.cycle < end:
                self._check_open()
                self._check_running()
                self._keep_pace()
                self._pass(self.sim.run, end - self.sim.cycle)

    def _collect(self) -> bytes:
        """Return what is there and what follows it without a gap."""
        data = bytearray(self.sim.uart_read())
        gap = int(GAP_CHARS * self.sim.char_cycles)
        while len(data) < MOST_BYTES:
            self._pass(self.sim.run_until_output, gap)
            more = self.sim.uart_read()
            if not more:
                break
            data += more
        self._active_s = self.sim.time_s
        return bytes(data)

    def _pass(self, run: Callable[[int], object], cycles: float) -> None:
        """Put what was written on the wire and let a slice of time pass, at most `cycles`."""
        while self._pending:
            self.sim.uart_write(self._pending.popleft())
            self._active_s = self.sim.time_s
        try:
            run(int(min(cycles, self.sim.cycles(SLICE_S))))
        except FirmwareStopped as error:
            self._stopped = error

    def _keep_pace(self) -> None:
        """Wait, but for a write or close, while simulated time is too far ahead."""
        now_s = self.sim.time_s
        patient = self._patience_s is None or now_s - self._active_s < self._patience_s
        if self._speed == 0 and patient:
            self._pacer.restart(now_s)
            return
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


def _seconds(text: str) -> float | None:
    """a number of seconds above 0, or none."""
    return None if text.lower() == "none" else rate(text)


def _text(text: str) -> str:
    """any text."""
    return text


_OPTIONS: Final = {
    "mcu": _text,
    "freq": frequency,
    "uart": _text,
    "baud": rate,
    "patience": _seconds,
    "speed": speed,
}


def open_url(url: Url) -> Transport:
    """Open `sim:path/to/firmware.elf?mcu=atmega328p&freq=16000000&uart=0`.

    Args:
        url: further options: `baud` (of the host's end), `patience` and `speed` (see SimLink).

    Returns:
        A SimLink with a simulator of its own.

    Raises:
        BadUrl: an option is unknown or wrong.
        OpenFailed: the simulator cannot run this firmware; the message says what to do.
    """
    path, parts = url.split_query()
    options: dict[str, Any] = url.options(parts, _OPTIONS)
    try:
        sim = AvrSim(
            unquote(path),
            options.get("mcu", "atmega328p"),
            options.get("freq", 16_000_000),
            options.get("uart", "0"),
            options.get("baud"),
        )
        return SimLink(
            sim,
            url.text,
            patience_s=options.get("patience", PATIENCE_S),
            speed=options.get("speed", 0.0),
        )
    except SimError as error:
        raise OpenFailed(f"{url.text}: {error}") from error
