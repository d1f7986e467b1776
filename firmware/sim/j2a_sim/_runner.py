"""Puts the UART of a simulated AVR on a transport listener.

In: bytes of one client at a time. Out: what the firmware sends, to that client.
Rules: what has arrived is taken before each slice of simulated time and goes onto the simulated
wire without gaps; what a client that is gone has left behind is dropped; a second client is refused
at once by closing its connection, unless the first is gone, or so far behind that it cannot be
seen whether it is; simulated time never runs ahead of the wall
clock times the speed; speed 0 is as fast as possible while bytes are on the way, and real time
while nothing happens, so that a pause of the client lasts as long for the firmware as for the
client and an idle simulator costs next to nothing.
"""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Final, TextIO

from j2a_transports import LinkClosed, LinkLost, Listener, Transport, TransportError, listen

from j2a_sim._avr import AvrSim
from j2a_sim._errors import FirmwareStopped, SimError
from j2a_sim._pace import Pacer

SLICE_S: Final = 0.001
# At speed 0, simulated time after the last byte that still passes at full speed: enough for a
# reply, and well below the 9 ms between two bytes that end a frame.
ACTIVE_S: Final = 0.005

# Above that many bytes waiting for the wire the client has to wait, as at a serial port. No host of
# J2A has as many requests on the way; that it is gone would be seen behind them only.
MAX_BACKLOG: Final = 2**18
# Simulated time after which the firmware has abandoned a frame whose rest was dropped.
QUIET_S: Final = 0.025
LOOK_S: Final = 0.2


class Runner:
    """Runs a simulator and serves its UART to one client after the other.

    Args:
        sim: the simulator; its firmware should be listening (see AvrSim.boot).
        listener: where clients arrive.
        speed: simulated seconds per second, or 0 (see the module's rules).
        once: end when the first client has gone.
        reset: reset the chip when a client arrives.
        say: called with a line of text when a client is dropped for a fault.

    Raises:
        SimError: the speed is negative.
    """

    def __init__(
        self,
        sim: AvrSim,
        listener: Listener,
        *,
        speed: float = 1.0,
        once: bool = False,
        reset: bool = False,
        say: Callable[[str], None] = lambda _: None,
    ) -> None:
        if not 0 <= speed < float("inf"):
            raise SimError(f"speed {speed} is out of range: 0, or simulated seconds per second")
        self.sim, self._listener, self._speed = sim, listener, speed
        self._once, self._reset, self._say = once, reset, say
        self._pacer = Pacer(speed or 1.0)
        self._slice = sim.cycles(SLICE_S)
        self._active_until = 0
        self._free_at = 0
        self._client: Transport | None = None
        self._next: Transport | None = None  # the one to serve after it
        self._backlog = bytearray()

    def serve(self, stop: threading.Event) -> None:
        """Run until `stop` is set, or with `once` until the first client has gone.

        Args:
            stop: may be set from a signal handler or another thread; seen within milliseconds.

        Raises:
            FirmwareStopped: the firmware can go no further.
            TransportError: the listener failed.
        """
        self._pacer.restart(self.sim.time_s)
        had_client = False
        ended = threading.Event()
        threading.Thread(target=self._end_waits, args=(stop, ended), daemon=True).start()
        try:
            while not stop.is_set():
                if self._client is None:
                    if self._once and had_client:
                        return
                    self._accept()
                    had_client = had_client or self._client is not None
                else:
                    self._receive(self._client)
                    self._meet_another()
                if self._wait_s() > 0:
                    continue  # simulated time is still ahead
                self._feed()
                self.sim.run(self._slice)
                self._send()
                self.sim.drop_untaken()
        finally:
            ended.set()
            for client in (self._client, self._next):
                if client is not None:
                    client.close()
            self._client = self._next = None

    def _wait_s(self) -> float:
        """How long to wait for input before the next slice, or before the next look at `stop`."""
        sim = self.sim
        if self._speed == 0:
            if sim.counters.queued or self._backlog:
                self._stay_active()
            if sim.cycle < self._active_until:
                self._pacer.restart(sim.time_s)
                return 0.0
        return min(self._pacer.wait_s(sim.time_s), LOOK_S)

    def _stay_active(self) -> None:
        self._active_until = self.sim.cycle + self.sim.cycles(ACTIVE_S)

    def _end_waits(self, stop: threading.Event, ended: threading.Event) -> None:
        """End a write to a client that does not read, when the run shall stop."""
        while not ended.is_set():
            if stop.wait(LOOK_S):
                client = self._client
                if client is not None:
                    client.close()
                return

    def _accept(self) -> None:
        wait_s = self._wait_s()
        if self.sim.cycle < self._free_at:
            time.sleep(wait_s)
            return
        self._client, self._next = self._next or self._listener.accept(wait_s), None
        if self._client is None:
            return
        if self._reset:
            self.sim.reset()
            self.sim.boot()
        self.sim.uart_read()  # sent before this client was there

    def _meet_another(self) -> None:
        """Refuse a second client, or take it if the first is gone or far behind."""
        if self._client is None or (other := self._listener.accept(0)) is None:
            return
        url = self._client.url
        while len(self._backlog) < MAX_BACKLOG and self._read(self._client, 0):
            pass  # what comes before the end of the first, if that has come
        if self._client is not None and len(self._backlog) < MAX_BACKLOG:
            self._say(f"refused {other.url}: {url} is being served")
            other.close()
            return
        if self._client is not None:
            self._say(f"dropped {url}: another came, and it was {len(self._backlog)} bytes behind")
            self._leave(self._client)
        self._next = other

    def _receive(self, client: Transport) -> None:
        """Read what has arrived, until the next slice begins."""
        while True:
            wait_s = self._wait_s()
            if len(self._backlog) >= MAX_BACKLOG:
                time.sleep(wait_s)
                return
            if not self._read(client, wait_s) or wait_s == 0:
                return
            self._feed()

    def _read(self, client: Transport, wait_s: float) -> bool:
        """Read once; returns whether anything came."""
        try:
            data = client.read(wait_s)
        except TransportError as error:
            self._drop(client, error)
            return False
        self._backlog += data
        if data:
            self._stay_active()
        return bool(data)

    def _feed(self) -> None:
        """Keep the wire busy for the next two slices; what is behind them can still be dropped."""
        sim = self.sim
        room = int(2 * self._slice / sim.char_cycles) + 2 - sim.counters.queued
        if room > 0 and self._backlog:
            sim.uart_write(bytes(self._backlog[:room]))
            del self._backlog[:room]

    def _send(self) -> None:
        data = self.sim.uart_read()
        if not data:
            return
        self._stay_active()
        if self._client is not None:
            try:
                self._client.write(data)
            except TransportError as error:
                self._drop(self._client, error)

    def _drop(self, client: Transport, error: TransportError) -> None:
        # A client that leaves is nothing to talk about, and neither is the end of the run.
        if not isinstance(error, LinkLost | LinkClosed):
            self._say(f"dropped {client.url}: {error}")
        self._leave(client)

    def _leave(self, client: Transport) -> None:
        client.close()
        self._client = None
        self._backlog.clear()
        self._free_at = self.sim.cycle + self.sim.cycles(QUIET_S)
        self._active_until = max(self._active_until, self._free_at)


@contextmanager
def stopped_by_signals(stop: threading.Event) -> Iterator[list[int]]:
    """Let Ctrl-C, SIGTERM and SIGHUP set `stop`; yield a list that their numbers are added to."""
    received: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield received  # only the main thread may handle signals
        return

    def on_signal(number: int, _frame: FrameType | None) -> None:
        received.append(number)
        if len(received) == 1:  # another one amid `set` would wait for ever for its lock
            stop.set()

    numbers = [signal.SIGINT, signal.SIGTERM]
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # as nohup has it
        numbers.append(signal.SIGHUP)
    before = {number: signal.signal(number, on_signal) for number in numbers}
    try:
        yield received
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def summary(sim: AvrSim, wall_s: float) -> str:
    """One line with the exact figures of a run, as `name=value` words."""
    c = sim.counters
    return (
        f"figures of the run: cycles={sim.cycle} simulated_s={sim.time_s:.6f} wall_s={wall_s:.3f} "
        f"bytes_in={c.bytes_in} bytes_out={c.bytes_out} overruns={c.overruns} "
        f"unheard={c.unheard} rx_framing_errors={c.rx_framing_errors} "
        f"tx_framing_errors={c.tx_framing_errors} stack_bytes={sim.stack_bytes}"
    )


def run(
    elf: Path | str,
    listen_url: str,
    speed: float = 1.0,
    *,
    mcu: str = "atmega328p",
    frequency_hz: int = 16_000_000,
    uart: str | None = None,
    host_baud: float | None = None,
    once: bool = False,
    reset: bool = False,
    stop: threading.Event | None = None,
    out: TextIO | None = None,
    err: TextIO | None = None,
) -> int | None:
    """Serve firmware in a simulated AVR until a signal, `stop`, or `once` ends it.

    Prints `listening on URL` to `out` when the firmware listens and a client may come, and the
    figures of the run (see `summary`) to `err` at the end.

    Args:
        elf: the firmware.
        listen_url: such as `tcp://127.0.0.1:0`; see `j2a_transports.listen`.
        speed: simulated seconds per second; 0: as fast as possible (see the module's rules).
        mcu: as simavr names it.
        frequency_hz: the clock.
        uart: "0" to "3"; None: the first that the MCU has.
        host_baud: bit rate of the host; None: the firmware's.
        once: end when the first client has gone.
        reset: reset the chip when a client arrives.
        stop: ends the run when set.
        out: standard output when None.
        err: standard error when None.

    Returns:
        The number of the signal that ended it, such as signal.SIGINT; None when there was none.

    Raises:
        SimError: see AvrSim; FirmwareStopped when the firmware crashed.
        TransportError: the listener cannot be opened, or failed.
    """
    stop = stop or threading.Event()
    began_s = time.monotonic()
    with (
        AvrSim(elf, mcu, frequency_hz, uart, host_baud) as sim,
        stopped_by_signals(stop) as signals,
    ):
        try:
            sim.boot()
            with listen(listen_url) as listener:

                def say(text: str) -> None:
                    print(text, file=err or sys.stderr, flush=True)

                runner = Runner(sim, listener, speed=speed, once=once, reset=reset, say=say)
                print(f"listening on {listener.url}", file=out or sys.stdout, flush=True)
                runner.serve(stop)
        except FirmwareStopped:
            print(summary(sim, time.monotonic() - began_s), file=err or sys.stderr, flush=True)
            raise
        print(summary(sim, time.monotonic() - began_s), file=err or sys.stderr, flush=True)
        return signals[0] if signals else None
