"""The demo device in Python: the same functions as the demo firmware.

What flows in: calls. What flows out: replies, SIFs and debug text.
Rules: it describes itself by the same text as the firmware; a test compares the two.
"""

import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from functools import partial
from typing import Annotated, Any, Final, NamedTuple

from j2a_spec.constants import RET_FAILED

from j2a.device import Device
from j2a.errors import Fail
from j2a.io.bell import Flag
from j2a.io.functions import ManyReply, ManyRequest, Result, read_chunk
from j2a.io.threads import start_thread
from j2a.types.annotations import Length, f32, i8, i16, i32, i64, u8, u16, u32, u64

__all__ = ["SIF_PERIODIC", "STORE_BYTES", "DemoDevice"]

SIF_PERIODIC: Final = 0x20
"""Opcode of the SIFs that `sifPeriod` starts."""

STORE_BYTES: Final = 2 * 2**20
"""How much `store` keeps."""


class mode(IntEnum):  # noqa: N801 - hosts see this name, which is that of the firmware's demo
    """A choice, for `echoShapes`."""

    off = 0
    slow = 1
    fast = -2


@dataclass(frozen=True)
class point:  # noqa: N801 - as above
    """A place, for `echoShapes`."""

    x: Annotated[f32, "m"]
    y: i16


class Numbers(NamedTuple):
    """The results of `echoNumbers`."""

    on: bool
    big: i64
    sum: i64
    wide: u32
    small: i16
    flag: u8


class Shapes(NamedTuple):
    """The results of `echoShapes`."""

    raw: Annotated[list[i32], Length(3)]
    place: point
    mode: i8
    note: str


class First(NamedTuple):
    """The result of `echoFirst`."""

    first: u32


class Words(NamedTuple):
    """The result of `echoWords`."""

    words: list[u16]


class DemoDevice(Device):
    """A device with the demo functions.

    Args:
        properties: in addition to, or instead of, the demo's own.
        options: others of `Device`, such as `clock` and `room`.
    """

    def __init__(
        self,
        properties: Mapping[str, str] | None = None,
        **options: Any,
    ) -> None:
        own = {"name": "J2A demo", "serial": "0001", "port": "python"}
        properties = {**own, **(properties or {})}
        super().__init__(properties, **options)
        self._start_us = time.monotonic_ns() // 1000
        self._content = bytearray()
        self._ticker = _Ticker(self)
        self.describe_sif(
            "counter", SIF_PERIODIC, "(count u32)", "Counts from 0 while sifPeriod is not 0."
        )
        self.function("getTime", signature="() u64 us", idempotent=True)(self._get_time)
        self.function("add", idempotent=True)(self._add)
        self.many("store")(self._store)
        self.function("ret")(self._ret)
        self.function("delay", signature="(time u16 ms)", slow_ms=65535, idempotent=True)(
            self._delay
        )
        self.function("sif")(self._sif)
        self.function("sifPeriod", signature="(period u16 ms)", idempotent=True)(self._sif_period)
        self.function("overruns", idempotent=True)(self._overruns)
        self.function("divide", idempotent=True)(self._divide)
        self.function("echoNumbers", idempotent=True)(self._echo_numbers)
        self.function("echoShapes", idempotent=True)(self._echo_shapes)
        self.function("echoWords", idempotent=True)(self._echo_words)
        self.function("echoFirst", idempotent=True)(self._echo_first)

    def stop(self) -> None:
        """See `Device.stop`; ends the periodic SIFs too."""
        self._ticker.start(0)
        super().stop()

    def _get_time(self) -> int:
        """Returns the time since the start."""
        return time.monotonic_ns() // 1000 - self._start_us

    def _add(self, a: i32, b: i32) -> i32:
        """Adds two numbers."""
        return (a + b + 2**31) % 2**32 - 2**31

    def _overruns(self) -> u16:
        """Returns how often received bytes were lost since the start."""
        return 0

    def _divide(self, a: i32, b: i32) -> i32:
        """Divides; fails with code 1 where b is 0."""
        if b == 0:
            raise Fail(1)
        quotient = abs(a) // abs(b) * (1 if (a < 0) == (b < 0) else -1)
        return (quotient + 2**31) % 2**32 - 2**31

    def _echo_numbers(  # noqa: PLR0917 - hosts give them in this order
        self, flag: bool, small: i8, wide: u16, sum: i32, big: u64, on: bool
    ) -> Numbers:
        """Returns the numbers as other types."""
        return Numbers(on, (big + 2**63) % 2**64 - 2**63, sum, wide, small, flag)

    def _echo_shapes(
        self,
        mode: Annotated[mode, i8],
        place: point,
        raw: Annotated[list[i16], Length(3)],
        note: str,
    ) -> Shapes:
        """Returns what it takes, in another order."""
        return Shapes(raw, place, mode, note)

    def _echo_words(self, words: list[u16]) -> Words:
        """Returns the words."""
        return Words(words)

    def _echo_first(self, first: u32, rest: bytes) -> First:
        """Returns the first."""
        return First(first)

    def _store(self, request: ManyRequest) -> ManyReply:
        if not request.is_write:
            return read_chunk(self._content, request)
        if request.offset == 0:
            self._content.clear()
        if request.offset != len(self._content) or request.offset + len(request.data) > STORE_BYTES:
            return ManyReply(RET_FAILED)
        self._content += request.data
        return ManyReply(is_last=request.is_last)

    def _ret(self, payload: bytes) -> Result:
        if not payload:
            return RET_FAILED
        code = payload[0]
        self.debug(f"ret 0x{code:02X}\n")
        return code  # also one that a function may not return: the device sends 0xFF instead

    def _delay(self, time_ms: int) -> None:
        """Returns after the time."""
        time.sleep(time_ms / 1000)

    def _sif(self, payload: bytes) -> Result:
        if not payload or self._is_reserved(payload[0]):
            return RET_FAILED
        if not self.send_sif(payload[0], payload[1:]):
            return RET_FAILED
        return None

    def _sif_period(self, period: int) -> None:
        """Sends the SIF counter periodically; 0 stops it."""
        self._ticker.start(period / 1000)


class _Ticker:
    """Sends a counter from 0 on as a SIF, once in each period, from a thread of its own."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._stop = Flag()
        # Held while a SIF is handed over, so that none follows the reply to what stopped them. A
        # signal handler may stop the device while its own thread holds it.
        self._sending = threading.RLock()

    def start(self, period_s: float) -> None:
        """Begin anew with this period; 0 only stops."""
        self._stop.set()
        with self._sending:
            self._stop = Flag()
        if period_s > 0:
            start_thread(partial(self._run, period_s, self._stop), "j2a demo SIFs")

    def _run(self, period_s: float, stop: Flag) -> None:
        counter = 0
        due = time.monotonic() + period_s
        while not stop.wait(max(0.0, due - time.monotonic())):
            due += period_s
            with self._sending:
                if not stop.is_set() and self._device.send("counter", counter):
                    counter = (counter + 1) & 0xFFFFFFFF
