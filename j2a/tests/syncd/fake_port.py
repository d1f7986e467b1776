"""Boards with SyncUSB of the tests: a bus with frames, and ports that may fail."""

import threading
import time

import j2a_transports


class FakeBus:
    """Frames of 1 ms of a counter that runs `ppm` faster than the host's."""

    def __init__(self, ppm=0.0):
        self._ppm = ppm
        self._start = time.monotonic_ns()

    def now(self):
        """Return the number of the frame, without a bound, and the microseconds since its begin."""
        passed_us = (time.monotonic_ns() - self._start) / 1000 * (1 + self._ppm / 1e6)
        return int(passed_us // 1000), int(passed_us % 1000)


class FakePort:
    """A board.

    Attributes:
        packets: that it got, as (time_us, frame, frame of its arrival).
        fails: raised by the next transfer.
        tells: whether it knows the request for frames.
        modulo: so many numbers its frames have.
        blocks: transfers wait for this event.
    """

    def __init__(self, bus, name="1-1", number=1, address=2, serial="left"):
        self.frames = f"usb bus {number}"
        self.name = name
        self.key = (number, address, name)
        self.serial = serial
        self.packets = []
        self.fails = None
        self.tells = True
        self.modulo = 2048
        self.blocks = None
        self.opened = self.closed = 0
        self.got = threading.Condition()
        self._frames = bus

    def open(self):
        self._meet()
        self.opened += 1

    def close(self):
        self.closed += 1

    def _meet(self):
        if self.blocks is not None:
            self.blocks.wait(60)
        if self.fails is not None:
            raise self.fails

    def frame(self, nonce):
        self._meet()
        if not self.tells:
            return None
        frame, age_us = self._frames.now()
        return j2a_transports.FrameSeen(frame % self.modulo, age_us)

    def send(self, time_us, frame):
        self._meet()
        with self.got:
            self.packets.append((time_us, frame, self._frames.now()[0]))
            self.got.notify_all()

    def wait_for(self, count):
        with self.got:
            assert self.got.wait_for(lambda: len(self.packets) >= count, 60), len(self.packets)
