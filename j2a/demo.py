"""The demo device in Python: the same functions as the demo firmware.

What flows in: calls of `getTime`, `add`, `store`, `ret`, `delay`, `sif`, `sifPeriod`, `overruns`;
numbers are little-endian. What flows out: replies, SIFs and debug text.
Rules: a payload of the wrong length returns 0xFF and nothing else.
"""

import struct
import threading
import time
from collections.abc import Mapping
from typing import Final

from j2a_spec.constants import MAX_PAYLOAD, RET_FAILED

from j2a.device import Device
from j2a.io.functions import ManyReply, ManyRequest, Result, read_chunk
from j2a.protocol.trace import Trace

__all__ = ["SIF_PERIODIC", "STORE_BYTES", "DemoDevice"]

SIF_PERIODIC: Final = 0x20
"""Opcode of the SIFs that `sifPeriod` starts."""

STORE_BYTES: Final = 2 * 2**20
"""How much `store` keeps."""


class DemoDevice(Device):
    """A device with the demo functions.

    Args:
        properties: in addition to, or instead of, the demo's own.
        room, trace: see `Device`.
    """

    def __init__(
        self,
        properties: Mapping[str, str] | None = None,
        *,
        room: int = MAX_PAYLOAD,
        trace: Trace | None = None,
    ) -> None:
        own = {"name": "J2A demo", "serial": "0001", "port": "python"}
        super().__init__({**own, **(properties or {})}, room=room, trace=trace)
        self._start_us = time.monotonic_ns() // 1000
        self._content = bytearray()
        self._ticker = _Ticker(self)
        self.function("getTime")(self._get_time)
        self.function("add")(self._add)
        self.many("store")(self._store)
        self.function("ret")(self._ret)
        self.function("delay")(self._delay)
        self.function("sif")(self._sif)
        self.function("sifPeriod")(self._sif_period)
        self.function("overruns")(lambda _payload: bytes(2))

    def stop(self) -> None:
        """See `Device.stop`; ends the periodic SIFs too."""
        self._ticker.start(0)
        super().stop()

    def _get_time(self, _payload: bytes) -> bytes:
        return struct.pack("<Q", time.monotonic_ns() // 1000 - self._start_us)

    def _add(self, payload: bytes) -> Result:
        if len(payload) != 8:
            return RET_FAILED
        first, second = struct.unpack("<II", payload)
        return struct.pack("<I", (first + second) & 0xFFFFFFFF)

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

    def _delay(self, payload: bytes) -> Result:
        if len(payload) != 2:
            return RET_FAILED
        (delay_ms,) = struct.unpack("<H", payload)
        time.sleep(delay_ms / 1000)
        return None

    def _sif(self, payload: bytes) -> Result:
        if not payload or not self.send_sif(payload[0], payload[1:]):
            return RET_FAILED
        return None

    def _sif_period(self, payload: bytes) -> Result:
        if len(payload) != 2:
            return RET_FAILED
        (period_ms,) = struct.unpack("<H", payload)
        self._ticker.start(period_ms / 1000)
        return None


class _Ticker:
    """Sends a counter from 0 on as a SIF, once in each period, from a thread of its own."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._stop = threading.Event()

    def start(self, period_s: float) -> None:
        """Begin anew with this period; 0 only stops."""
        self._stop.set()
        self._stop = threading.Event()
        if period_s > 0:
            threading.Thread(
                target=self._run, args=(period_s, self._stop), name="j2a demo SIFs", daemon=True
            ).start()

    def _run(self, period_s: float, stop: threading.Event) -> None:
        counter = 0
        due = time.monotonic() + period_s
        while not stop.wait(max(0.0, due - time.monotonic())):
            due += period_s
            if self._device.send_sif(SIF_PERIODIC, struct.pack("<I", counter)):
                counter = (counter + 1) & 0xFFFFFFFF
