"""One board with SyncUSB: its thread asks it for frames and gives it times.

In: its port, and the line of its bus. Out: exchanges for the line, packets for the board.
Rules: each transfer has a limit; an error ends the thread, and the daemon begins anew when it sees
the board again.
"""

import logging
import random
import threading
from typing import Any, Final

import j2a_transports
from j2a_spec.plural import counted

from j2a.io.handlers import is_told
from j2a.io.threads import start_thread
from j2a.protocol.clock import LOOK_S
from j2a.syncd.usb_bus import Bus

__all__ = ["SyncBoard"]

_logger = logging.getLogger("j2a.syncd")
_EXCHANGES: Final = 4
"""Of a round; the quickest one counts most."""
_RATED: Final = 2
"""With fewer packets a board knows no rate, and how far it is off grows by nobody knows what."""


class SyncBoard:
    """A board and its thread.

    Args:
        port: see `j2a_transports.SyncPort`; belongs to the thread.
        bus: that it is on.

    Attributes:
        name: bus and ports, such as "usb 1-2.3".
        thread: has ended when the board is gone or refuses; None before `start`.
        problem: why the board gets no time; None where it does.
    """

    def __init__(self, port: Any, bus: Bus) -> None:
        self.name = f"usb {port.name}"
        self.problem: str | None = "no packet yet"
        self._port = port
        self._bus = bus
        self._stop = threading.Event()
        self._packets = 0
        self._lost = 0
        self._number = 0
        self._tells_frames: bool | None = None
        self.thread: threading.Thread | None = None

    def start(self) -> None:
        """Begin.

        Raises:
            OpenFailed: the system has no thread to give.
        """
        self.thread = start_thread(self._run, f"j2a syncd {self._port.name}")

    @property
    def is_running(self) -> bool:
        """The board is there, as far as is known."""
        return self.thread is not None and self.thread.is_alive()

    def stop(self) -> None:
        """Let the thread end."""
        self._stop.set()

    def facts(self) -> dict[str, Any]:
        """Return the row of this board in the status."""
        line = self._bus.facts()
        if self._packets < _RATED:
            line["uncertainty_us"] = None
        state = "syncing" if self.problem is None else "waiting"
        return {
            "board": self._port.serial or self.name,
            "place": self.name,
            "state": state,
            "packets": self._packets,
            "lost": self._lost,
            "tells_frames": self._tells_frames,
            "frames_modulo": self._bus.modulo(self),
            "problem": self.problem,
            **line,
        }

    def _run(self) -> None:
        try:
            self._port.open()
            _logger.info("%s: gets the time", self.name)
            while not self._stop.is_set():
                self.ask()
                if self._wait():
                    self.tell()
        except j2a_transports.TransportError as error:
            self.problem = str(error)
        finally:
            self._bus.forget(self)
            self._port.close()

    def _wait(self) -> bool:
        """Wait for the next round, or for something new; return False at the end."""
        left_s = self._bus.until_next_round_s()
        while left_s > 0:
            if self._stop.wait(min(left_s, LOOK_S)):
                return False
            left_s -= LOOK_S
            if left_s > 0 and self.has_news:
                self.tell()
        return not self._stop.is_set()

    @property
    def has_news(self) -> bool:
        """The board should hear before the next round that the clock was set or slewed."""
        return self._bus.has_news(self._number)

    def ask(self) -> None:
        """Ask the board for its frame.

        Raises:
            LinkLost: the board is gone.
        """
        for _ in range(_EXCHANGES):
            sent_us = self._bus.now_us()
            seen = self._port.frame(random.randrange(1 << 16))
            if seen is not None:
                self._tells_frames = True
                self._bus.add(self, sent_us, self._bus.now_us(), seen.frame, seen.age_us)
            elif self._tells_frames is None:
                self._tells_frames = False

    def tell(self) -> None:
        """Tell the board what all boards of its bus are told in this round.

        Raises:
            LinkLost: the board is gone.
        """
        self._number, packet = self._bus.packet()
        if packet is None:
            self.problem = (
                "no board on this bus says which frame it is, so nothing can be told"
                if self._tells_frames is False
                else "the frames of the bus are being measured"
            )
            return
        if self._bus.is_odd(self):
            self.problem = "it tells other frames than the other boards of this bus"
            return
        try:
            self._port.send(packet.time_us, packet.frame)
        except j2a_transports.WriteTimeout as error:
            self._lost += 1
            self.problem = str(error)
            if is_told(self._lost):
                lost = counted(self._lost, "packet was", "packets were")
                _logger.warning("%s: %s lost so far: %s", self.name, lost, error)
        else:
            self._packets += 1
            self.problem = None
