"""The sensors of a recorded device, whose samples come again under settings that hosts change.

What flows in: payloads of recorded samples, requests of a2jTransd, and the time. What flows out:
the payloads to send now.
Rules: the recorded values are what the drivers give. Under the settings of the recording each
payload goes out as it was, bit for bit; others leave out more of them (SPEC.md, section 22). What
would need values that were not recorded is BAD_VALUE: a shorter PERIOD, a lower THRESHOLD, and a
DECIMATION that is no multiple.
"""

from collections.abc import Iterator
from typing import Any

from j2a_spec import constants as c

from j2a.protocol.transducers import SensorState, TransducerServer
from j2a.types.samples import SampleCodec
from j2a.types.transducers import LOST_BYTES, TIME_BYTES, Descriptors, Transducer

__all__ = ["ReplayServer"]

_LOST_MODULO = 0x10000


class _ReplayedSensor(SensorState):
    def __init__(self, transducer: Transducer, codec: SampleCodec) -> None:
        super().__init__(transducer, codec)
        self._is_playing = False
        self._least_us, self._step, self._least = 0, 1, self.threshold
        self._newest: list[tuple[int, bytes]] = list(self.slots)
        self._told = 0

    def begin(self) -> None:
        """Take the settings of now for those of the recording; what was recorded was enabled."""
        self.is_enabled = True
        self._least_us = self.period_us
        self._step = self.decimation
        self._least = self.threshold
        self._is_playing = True

    def replay(self, payload: bytes, local_us: int) -> bytes:
        """Take a recorded sample in; return the payload that is due, or nothing."""
        if self.transducer.queue:
            told = int.from_bytes(payload[:LOST_BYTES], "little")
            if self.is_enabled:
                self._lost += (told - self._told) % _LOST_MODULO
            self._told = told
        entries = list(self.entries(payload))
        for channel, time_us, data in entries:
            # A value stays in the samples of a sensor without queue until there is a newer one.
            if self.transducer.queue or (time_us and self._newest[channel] != (time_us, data)):
                self.take(channel, data, time_us)
        if not self.transducer.queue:
            self._newest = [(time_us, data) for _, time_us, data in entries]
            if self._takes_all():
                self.slots = list(self._newest)
                self._is_fresh = self.is_enabled
        return self.report(local_us)[0]

    def take(self, channel: int, data: bytes, now_us: int) -> None:
        """Take a value; the recorded device had left out those before it."""
        self._skipped[channel] += self._step - 1
        super().take(channel, data, now_us)

    def report(self, local_us: int) -> tuple[bytes, float]:
        """Return the payload of a sample SIF that is due; the recorded ones came in their time."""
        if self.period_us == self._least_us:
            self._reference_us = None
        return super().report(local_us)

    def write(self, item: int, value: bytes) -> bool:
        """Change a setting; return whether it is one under which all values are recorded."""
        if self._is_playing:
            number = int.from_bytes(value, "little")
            if item == c.TRANSD_PERIOD and number < self._least_us:
                return False
            if item == c.TRANSD_DECIMATION and number % self._step:
                return False
            if item == c.TRANSD_THRESHOLD and not self.codec.unpack_raw(value) >= self._least:
                return False
        return super().write(item, value)

    def _is_near(self, raw: Any, last: Any) -> bool:
        return self.threshold != self._least and super()._is_near(raw, last)

    def _takes_all(self) -> bool:
        return self.decimation == self._step and self.threshold == self._least

    def entries(self, payload: bytes) -> Iterator[tuple[int, int, bytes]]:
        """Yield the channel, the time and the bytes of each value."""
        has_queue = self.transducer.queue > 0
        start = LOST_BYTES if has_queue else 0
        size = has_queue + TIME_BYTES + self.transducer.type.size
        for number, at in enumerate(range(start, len(payload), size)):
            entry = payload[at + has_queue : at + size]
            channel = payload[at] if has_queue else number
            yield channel, int.from_bytes(entry[:TIME_BYTES], "little"), entry[TIME_BYTES:]


class ReplayServer(TransducerServer):
    """The transducers of a recorded device.

    Args:
        descriptors: what it said of them.
        settings: those that it had, as `TransducerServer.keep` takes them, or nothing.
    """

    def __init__(self, descriptors: Descriptors, settings: bytes = b"") -> None:
        super().__init__(descriptors)
        self.restore(settings)
        for sensor in self._sensors:
            self._replayed(sensor.transducer.name).begin()

    def _sensor(self, transducer: Transducer) -> SensorState:
        return _ReplayedSensor(transducer, self.codecs[transducer.name])

    def newest_us(self, name: str, payload: bytes) -> int:
        """Return the time of the newest value in a recorded sample, 0 where it has none."""
        return max((time_us for _, time_us, _ in self._replayed(name).entries(payload)), default=0)

    def replay(self, name: str, payload: bytes, local_us: int) -> list[tuple[int, bytes]]:
        """Take a recorded sample in.

        Args:
            name: of its sensor.
            payload: of the sample SIF.
            local_us: the local time, by which intervals are measured.

        Returns: opcodes and payloads of the sample SIFs to send now.
        """
        sensor = self._replayed(name)
        due = sensor.replay(payload, local_us)
        return [(sensor.transducer.id, due)] if due else []

    def _replayed(self, name: str) -> _ReplayedSensor:
        sensor = self._by_name[name]
        assert isinstance(sensor, _ReplayedSensor)
        return sensor
