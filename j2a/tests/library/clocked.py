"""A device with a clock that a host can set, whose crystal is off and which can begin anew.

It keeps the rules of SPEC.md, section 23, in a few lines and floats, for tests of hosts. What it
answers, a test may change.
"""

import struct
import threading
import time
from collections.abc import Callable

from j2a_spec import constants as c

import j2a

SLEW = c.CLOCK_MAX_SLEW_PPM * 1e-6
Answer = tuple[int, bytes]


class ClockedDevice(j2a.Device):
    """Answers a2jClock; `ppm` is how much its counter runs too fast.

    Attributes:
        requests: the payloads that came.
        spoil: called with each payload before it is answered; what it returns is the answer.
    """

    def __init__(
        self,
        ppm: float = 0.0,
        now_s: Callable[[], float] = time.monotonic,
        caps: str = "clock",
        **options: object,
    ) -> None:
        super().__init__({"j2a.caps": caps}, **options)
        self._table.add_call(c.CLOCK, self._answer)
        self.requests: list[bytes] = []
        self.spoil: Callable[[bytes], Answer | None] = lambda _payload: None
        self._rate = 1 + ppm * 1e-6
        self._now_s = now_s
        self._began_s = now_s() - 3.0
        self._lock = threading.Lock()
        self.begin_anew()

    def begin_anew(self) -> None:
        """Be as after a reset, without saying so."""
        with self._lock:
            started = getattr(self, "_target", None) is not None or self.requests
            self._began_s = self._now_s() if started else self._began_s
            self._target: tuple[float, float, float] | None = None
            self._at = (0.0, 0.0)
            self._epoch = 0
            self._uncertainty = c.CLOCK_UNKNOWN

    @property
    def local_us(self) -> float:
        return (self._now_s() - self._began_s) * 1e6 * self._rate

    def time_us(self, local: float | None = None) -> float:
        """Return the time of the clock."""
        local = self.local_us if local is None else local
        if self._target is None:
            return local
        told = self._told(local)
        at, ahead = self._at
        left = max(abs(ahead) - SLEW * (local - at), 0.0)
        return told + (left if ahead > 0 else -left)

    def _told(self, local: float) -> float:
        assert self._target is not None
        at, time_us, rate = self._target
        return time_us + (local - at) * (1 + rate)

    def _answer(self, payload: bytes) -> Answer:
        received = int(self.local_us)
        with self._lock:
            self.requests.append(payload)
            spoilt = self.spoil(payload)
            if spoilt is not None:
                return spoilt
            if payload[0] == c.CLOCK_EXCHANGE:
                turnaround = int(self.local_us) - received
                return 0, payload[1:5] + struct.pack("<QH", received, min(turnaround, 0xFFFF))
            if payload[0] == c.CLOCK_ADJUST and not self._adjust(payload):
                return c.CLOCK_BAD_VALUE, b""
            return 0, self._status()

    def _adjust(self, payload: bytes) -> bool:
        _, mode, local, time_us, rate, uncertainty, _ = struct.unpack("<BBQQiII", payload)
        now = self.local_us
        if local > now or abs(rate) > c.CLOCK_MAX_RATE:
            return False
        before, is_step = self.time_us(now), mode == c.CLOCK_STEP or self._target is None
        self._target = float(local), float(time_us), rate * 1e-9
        self._at = now, 0.0 if is_step else before - self._told(now)
        self._epoch = self._epoch % 255 + 1 if is_step else self._epoch
        self._uncertainty = uncertainty
        return True

    def _status(self) -> bytes:
        local = self.local_us
        time_us = self.time_us(local)
        state, rate = c.CLOCK_FREE, 0.0
        if self._target is not None:
            ahead = time_us - self._told(local)
            state = c.CLOCK_SETTLING if abs(ahead) > 10 else c.CLOCK_LOCKED
            rate = self._target[2] - (0 if ahead == 0 else SLEW if ahead > 0 else -SLEW)
        return struct.pack(
            "<QQBBiI", int(local), int(time_us), state, self._epoch, int(rate * 1e9), 7
        )
