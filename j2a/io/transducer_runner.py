"""Runs the transducers of a Python device: in time, and one function at a time.

What flows in: values of drivers and requests, from any thread. What flows out: sample SIFs, and
calls of the functions that the user has registered.
Rules: such a function runs while no other one of the device does, as on a microcontroller; what
waits for its time does so in a thread that `stop` ends.
"""

import logging
import math
import os
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, Final

from j2a.errors import LocalError
from j2a.io.functions import let_end
from j2a.io.threads import start_thread
from j2a.protocol.transducers import Action, TransducerServer

__all__ = ["TransducerRunner"]

_logger = logging.getLogger("j2a")
_US: Final = 1_000_000
_NOW: Final = -math.inf
_LONGEST_WAIT_S: Final = 3600.0


class TransducerRunner:
    """The transducers of a device.

    Args:
        server: what the device says of them, and what they do.
        send: sends a SIF to each host.
        calling: is held while a function of the device runs.
        settings: the file that keeps settings; None keeps none.
        local_us: returns the local time of the device, in microseconds.
        clock_us: returns the time of its clock.
        pace: how many local microseconds pass in one.
    """

    def __init__(
        self,
        server: TransducerServer,
        send: Callable[[int, bytes], object],
        calling: threading.Lock,
        settings: Path | None = None,
        *,
        local_us: Callable[[], int],
        clock_us: Callable[[], int],
        pace: float,
    ) -> None:
        self._server = server
        if settings is not None:
            if settings.exists():
                self._server.restore(settings.read_bytes())
            self._server.keep = partial(_keep, settings)
        self._send = send
        self._calling = calling
        self._changed = threading.Condition()
        self._next_us = math.inf
        self._local_us = local_us
        self._clock_us = clock_us
        self._seconds = 0.0
        self.set_pace(pace)
        self._thread: threading.Thread | None = None
        self._is_stopped = False

    @property
    def content(self) -> bytes:
        """What a2jGetTransds returns."""
        return self._server.content

    def now_us(self) -> int:
        """Return the time of the device's clock, in microseconds from 1 on."""
        return max(1, self._clock_us())

    # ------------------------------------------------------------------ the user's side

    def on_set(self, name: str, function: Callable[[int, Any], object]) -> None:
        """Register what moves an actuator.

        Raises:
            LocalError: the device has no such actuator.
        """
        codec = self._server.codecs.get(name)
        if codec is None or codec.transducer.is_sensor:
            raise LocalError(f"the device has no actuator {name!r}")
        self._server.on_set[name] = function

    def on_trigger(self, name: str, function: Callable[[], object]) -> None:
        """Register what lets a sensor measure.

        Raises:
            LocalError: the device has no such sensor, or one without the key trigger.
        """
        codec = self._server.codecs.get(name)
        if codec is None or not codec.transducer.has("trigger"):
            raise LocalError(f"the device has no sensor {name!r} with the key trigger")
        self._server.on_trigger[name] = function

    def sense(self, name: str, first: int, values: Sequence[Any], *, is_raw: bool) -> None:
        """Take values that a sensor has measured now, of the channels from the first one on.

        With a value for each channel the sample is whole, and this thread sends it if it is due.
        Otherwise the device's own thread does, because the other channels may follow at once.

        Raises:
            LocalError: as `TransducerServer.sensor` and `SensorState.sense`; no value was taken.
        """
        sensor = self._server.sensor(name)
        is_whole = len(values) == sensor.transducer.channels and self._thread is not None
        # While a function of the device runs, the sample SIF waits for its end.
        may_send = is_whole and self._calling.acquire(blocking=False)
        try:
            with self._changed:
                sensor.sense(first, values, self.now_us(), is_raw=is_raw)
                payload, due_us = b"", sensor.due_us()
                if may_send:
                    payload, due_us = sensor.report(self._local_us())
                self._turn_by(due_us)
            if payload:
                self._send(sensor.transducer.id, payload)
        finally:
            if may_send:
                self._calling.release()

    def give(self, values: Callable[[int], list[tuple[int, bytes]]]) -> None:
        """Have something given to the server at this local time, and send the SIFs that it returns.

        It is done between two functions of the device, so that no setting changes meanwhile.
        """
        with self._calling:
            with self._changed:
                sifs = values(self._local_us())
                self._wake()
            for opcode, payload in sifs:
                self._send(opcode, payload)

    # ------------------------------------------------------------------ requests

    def hear(self) -> None:
        """Notice a request of a host, or that its function has returned."""
        with self._changed:
            if self._server.hear(self._local_us()):
                self._wake()

    def request(self, payload: bytes) -> tuple[int, bytes]:
        """Execute a2jTransd; the lock `calling` is held."""
        with self._changed:
            now_us = self.now_us()
            due = self._server.catch_up(now_us)  # the thread may be late
            code, reply, actions = self._server.request(payload, now_us)
            self._wake()
        _run([*due, *actions])
        return code, reply

    def set_pace(self, pace: float) -> None:
        """Notice that so many local microseconds pass in one from now on."""
        with self._changed:
            self._seconds = 1 / (_US * pace)
            self._wake()

    def move(self, by_us: int) -> None:
        """Notice that the clock was adjusted, and stepped by so much."""
        with self._changed:
            self._server.move(by_us)
            self._wake()

    # ------------------------------------------------------------------ the thread

    def start(self) -> None:
        """Begin to send and to move; may be called twice, and again where it failed.

        Raises:
            OpenFailed: the system has no thread to give.
        """
        with self._changed:
            if self._thread is None and not self._is_stopped:
                self._thread = start_thread(self._work, "j2a transducers")

    def stop(self) -> None:
        """End the thread; may be called twice."""
        with self._changed:
            self._is_stopped = True
            self._wake()

    def _wake(self) -> None:
        self._turn_by(_NOW)

    def _turn_by(self, due_us: float) -> None:
        """Have the thread take its next turn at this local time, unless it does so before."""
        if due_us < self._next_us:
            self._next_us = due_us
            self._changed.notify_all()

    def _work(self) -> None:
        while self._wait():
            with self._calling:
                with self._changed:
                    local_us = self._local_us()
                    sifs, actions, left_us = self._server.turn(self.now_us(), local_us)
                    self._next_us = local_us + left_us
                for opcode, payload in sifs:
                    self._send(opcode, payload)
                _run(actions)

    def _wait(self) -> bool:
        """Wait until the next turn; return False at the end."""
        with self._changed:
            while not self._is_stopped and (left_us := self._next_us - self._local_us()) > 0:
                self._changed.wait(min(left_us * self._seconds, _LONGEST_WAIT_S))
            return not self._is_stopped


def _keep(path: Path, content: bytes) -> bool:
    """Replace a file at once, so that it is whole at any time; return whether that went well."""
    from tempfile import NamedTemporaryFile  # noqa: PLC0415 - slow to load; few devices keep any

    new: Path | None = None
    try:
        with NamedTemporaryFile(dir=path.parent, prefix=f".{path.name}.", delete=False) as file:
            new = Path(file.name)
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        new.replace(path)
    except OSError:
        _logger.exception("the settings cannot be kept in %s", path)
        if new is not None:
            with suppress(OSError):
                new.unlink()
        return False
    return True


def _run(actions: list[Action]) -> None:
    for action in actions:
        try:
            action()
        except BaseException as error:
            # Also sys.exit(): it would end the thread that sends the samples of all sensors and
            # sets actuators to their safe values.
            let_end(error)
            _logger.exception("a function of a transducer failed")
