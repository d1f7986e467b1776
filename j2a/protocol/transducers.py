"""The transducers of a device: what its drivers measure, and what hosts set.

What flows in: values of drivers, requests of a2jTransd, and the time of the device's clock. What
flows out: replies, sample SIFs, and calls of the functions that move an actuator or start a
measurement (SPEC.md, section 22).
Rules: no clock of its own, and no waiting: `turn` does what is due and says when to come again. No
request raises. The functions are called after the state has changed, those of one actuator in the
order of their times.
"""

import math
import struct
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final

from j2a_spec import constants as c

from j2a.errors import LocalError
from j2a.protocol import saved_settings
from j2a.types.coding import PythonTypes
from j2a.types.model import Structure, Type
from j2a.types.samples import SampleCodec
from j2a.types.transducers import LOST_BYTES, TIME_BYTES, Descriptors, Transducer

__all__ = ["Action", "SensorState", "TransducerServer"]

Action = Callable[[], object]
"""A call of a function of the user."""

_LOST_MODULO: Final = 0x10000
_MS: Final = 1000
_NEVER: Final = math.inf
_SLOWEST: Final = 0.98
"""A wait is so much shorter, because the clock may run faster than the local time."""
_BYTES: Final[Mapping[int, int]] = {
    c.TRANSD_ENABLED: 1,
    c.TRANSD_PERIOD: 4,
    c.TRANSD_DECIMATION: 1,
    c.TRANSD_WATCHDOG: 2,
    c.TRANSD_TRIGGER: TIME_BYTES,
}
_WRITE_ONLY: Final = (c.TRANSD_SET, c.TRANSD_TRIGGER)
_READ_ONLY: Final = (c.TRANSD_SAMPLE, c.TRANSD_TIME)
_OF_SENSORS: Final = (
    c.TRANSD_ENABLED, c.TRANSD_PERIOD, c.TRANSD_DECIMATION, c.TRANSD_THRESHOLD, c.TRANSD_TRIGGER,
)  # fmt: skip
_OF_ACTUATORS: Final = (c.TRANSD_WATCHDOG, c.TRANSD_SET)


class TransducerServer:
    """The transducers of a device.

    Args:
        descriptors: what the device says of them.

    Attributes:
        content: what a2jGetTransds returns.
        codecs: what packs and unpacks the values of each transducer, by its name.
        on_set: for each actuator what is called with a channel and a value in its unit.
        on_trigger: for each sensor with the key trigger, what lets it measure.
        keep: takes what is to stay while the device is off, and returns whether it does; None for a
            device that keeps nothing, which has no SAVE.
    """

    def __init__(self, descriptors: Descriptors) -> None:
        self.content = str(descriptors).encode()
        types = PythonTypes()
        self.codecs = {one.name: SampleCodec(one, types) for one in descriptors.transducers}
        self.on_set: dict[str, Callable[[int, Any], object]] = {}
        self.on_trigger: dict[str, Callable[[], object]] = {}
        self._sensors = [self._sensor(one) for one in descriptors.transducers if one.is_sensor]
        self._actuators = [
            _Actuator(one, self.codecs[one.name])
            for one in descriptors.transducers
            if not one.is_sensor
        ]
        everything: list[SensorState | _Actuator] = [*self._sensors, *self._actuators]
        self._by_id = {one.transducer.id: one for one in everything}
        self._by_name = {one.transducer.name: one for one in everything}
        self._heard_us = 0
        self.keep: Callable[[bytes], bool] | None = None
        self._saved: saved_settings.SavedSettings = {}

    def _sensor(self, transducer: Transducer) -> "SensorState":
        return SensorState(transducer, self.codecs[transducer.name])

    # ------------------------------------------------------------------ drivers

    def sensor(self, name: str) -> "SensorState":
        """Return a sensor.

        Raises:
            LocalError: there is none of this name.
        """
        sensor = self._by_name.get(name)
        if not isinstance(sensor, SensorState):
            known = ", ".join(one.transducer.name for one in self._sensors) or "none"
            raise LocalError(f"the device has no sensor {name!r}, but {known}")
        return sensor

    # ------------------------------------------------------------------ requests

    def hear(self, local_us: int) -> bool:
        """Notice that the host sent a request, or that its function returned (J2A-TRANS-017).

        Args:
            local_us: the local time, by which intervals are measured (J2A-CLOCK-019).

        Returns: whether an actuator had its safe value, so that a turn is due.
        """
        self._heard_us = local_us
        was_safe = any(actuator.is_safe for actuator in self._actuators)
        for actuator in self._actuators:
            actuator.is_safe = False
        return was_safe

    def request(self, payload: bytes, now_us: int) -> tuple[int, bytes, list[Action]]:
        """Execute a2jTransd (J2A-TRANS-008, J2A-TRANS-009).

        Returns: the code and the payload of the reply, and what is to be called.
        """
        if len(payload) < 2:
            return c.TRANSD_BAD_LENGTH, b"", []
        one = self._by_id.get(payload[0])
        if one is None:
            return c.TRANSD_NO_ID, b"", []
        item, value = payload[1], payload[2:]
        if item == c.TRANSD_SAVE and self.keep is not None:
            code = self._save(one, value) if value else c.RET_OK
            state = c.TRANSD_SAVED if one.transducer.name in self._saved else c.TRANSD_NOT_SAVED
            return code, b"" if code else bytes((state,)), []
        if not _has_item(one.transducer, item, bool(value)):
            return c.TRANSD_NO_ITEM, b"", []
        actions: list[Action] = []
        if value:
            if len(value) not in _lengths(one, item):
                return c.TRANSD_BAD_LENGTH, b"", []
            if not self._write(one, item, value, now_us, actions):
                return c.TRANSD_BAD_VALUE, b"", []
        return c.RET_OK, b"" if item in _WRITE_ONLY else _read(one, item, now_us), actions

    def _write(
        self,
        one: "SensorState | _Actuator",
        item: int,
        value: bytes,
        now_us: int,
        actions: list[Action],
    ) -> bool:
        if item == c.TRANSD_TOPIC:
            return one.write_topic(value)
        if isinstance(one, SensorState):
            if item == c.TRANSD_TRIGGER:
                one.trigger_us = int.from_bytes(value, "little")
                self._start(one, now_us, actions)
                return True
            return one.write(item, value)
        if item == c.TRANSD_WATCHDOG:
            one.watchdog_ms = int.from_bytes(value, "little")
            return True
        if not one.schedule(value):
            return False
        self._move(one, now_us, actions)
        return True

    # ------------------------------------------------------------------ what is kept

    def restore(self, content: bytes) -> None:
        """Bring the settings back that `keep` was given; others are left out (J2A-TRANS-019)."""
        for name, items in saved_settings.load(content, self.content).items():
            one = self._by_name.get(name)
            if one is None:
                continue
            self._saved[name] = items
            for item, value in items.items():
                if _has_item(one.transducer, item, True) and len(value) in _lengths(one, item):
                    self._write(one, item, value, 0, [])

    def _save(self, one: "SensorState | _Actuator", value: bytes) -> int:
        """Execute a write of SAVE (J2A-TRANS-028); return the code."""
        if len(value) != 1:
            return c.TRANSD_BAD_LENGTH
        if value[0] != c.TRANSD_SAVED:
            return c.TRANSD_BAD_VALUE
        settings = {
            item: _read(one, item, 0)
            for item in saved_settings.ITEMS.values()
            if _has_item(one.transducer, item, False)
        }
        saved = {**self._saved, one.transducer.name: settings}
        assert self.keep is not None
        if not self.keep(saved_settings.dump(saved, self.content)):
            return c.RET_FAILED
        self._saved = saved
        return c.RET_OK

    # ------------------------------------------------------------------ what is due

    def move(self, by_us: int) -> None:
        """Move what waits for its time, because the clock was stepped (J2A-CLOCK-020)."""
        for sensor in self._sensors:
            if sensor.trigger_us is not None:
                sensor.trigger_us += by_us
        for actuator in self._actuators:
            for channel, (due_us, data) in actuator.waiting.items():
                actuator.waiting[channel] = due_us + by_us, data

    def catch_up(self, now_us: int) -> list[Action]:
        """Do what SET and TRIGGER asked for by now, before a request is answered (J2A-TRANS-015).

        So a later SET or TRIGGER replaces only what waits (J2A-TRANS-016, J2A-TRANS-018).

        Returns: what is to be called.
        """
        actions: list[Action] = []
        for sensor in self._sensors:
            self._start(sensor, now_us, actions)
        for actuator in self._actuators:
            self._move(actuator, now_us, actions)
        return actions

    def turn(
        self, now_us: int, local_us: int
    ) -> tuple[list[tuple[int, bytes]], list[Action], float]:
        """Do what is due.

        Args:
            now_us: the time of the device's clock.
            local_us: the local time, by which intervals are measured (J2A-CLOCK-019).

        Returns: opcodes and payloads of the sample SIFs to send, what is to be called, and the
            local microseconds until the next turn, infinity while nothing waits.
        """
        sifs: list[tuple[int, bytes]] = []
        actions: list[Action] = []
        next_us = _NEVER
        next_local_us = _NEVER
        for sensor in self._sensors:
            next_us = min(next_us, self._start(sensor, now_us, actions))
            payload, due_us = sensor.report(local_us)
            if payload:
                sifs.append((sensor.transducer.id, payload))
                # A value that comes before the next one is due need not ask for a turn then.
                due_us = sensor.next_us() if sensor.period_us else due_us
            next_local_us = min(next_local_us, due_us)
        for actuator in self._actuators:
            watch_us = self._watch(actuator, now_us, local_us, actions)
            next_local_us = min(next_local_us, watch_us)
            next_us = min(next_us, self._move(actuator, now_us, actions))
        left_us = (next_us - now_us) * _SLOWEST
        return sifs, actions, min(left_us, next_local_us - local_us)

    def _start(self, sensor: "SensorState", now_us: int, actions: list[Action]) -> float:
        due_us = sensor.trigger_us
        if due_us is None:
            return _NEVER
        if due_us > now_us:
            return due_us
        sensor.trigger_us = None
        function = self.on_trigger.get(sensor.transducer.name)
        if function is not None:
            actions.append(function)
        return _NEVER

    def _move(self, actuator: "_Actuator", now_us: int, actions: list[Action]) -> float:
        """Set the channels whose time has come; return the time of the next one."""
        next_us = _NEVER
        for due_us, channel, data in sorted(
            (due_us, channel, data) for channel, (due_us, data) in actuator.waiting.items()
        ):
            if due_us > now_us:
                next_us = min(next_us, due_us)
            else:
                del actuator.waiting[channel]
                self._set(actuator, channel, data, now_us, actions)
        return next_us

    def _watch(
        self, actuator: "_Actuator", now_us: int, local_us: int, actions: list[Action]
    ) -> float:
        """Set an actuator to its safe value when the host was silent for too long."""
        if not actuator.watchdog_ms or actuator.is_safe:
            return _NEVER
        due_us = self._heard_us + actuator.watchdog_ms * _MS
        if due_us > local_us:
            return due_us
        actuator.is_safe = True
        actuator.waiting.clear()
        for channel in range(actuator.transducer.channels):
            self._set(actuator, channel, actuator.safe, now_us, actions)
        return _NEVER

    def _set(
        self,
        actuator: "_Actuator",
        channel: int,
        data: bytes,
        now_us: int,
        actions: list[Action],
    ) -> None:
        actuator.slots[channel] = now_us, data
        function = self.on_set.get(actuator.transducer.name)
        if function is not None:
            value = actuator.codec.unpack_one(data)
            actions.append(lambda: function(channel, value))


class _Transducer:
    """What sensors and actuators have in common: for each channel its time and its value."""

    def __init__(self, transducer: Transducer, codec: SampleCodec) -> None:
        self.transducer = transducer
        self.codec = codec
        self.topic = transducer.get("topic").encode()
        self.slots: list[tuple[int, bytes]] = [
            (0, bytes(transducer.type.size)) for _ in range(transducer.channels)
        ]

    def sample(self) -> bytes:
        """Return a sample of all channels (J2A-TRANS-005)."""
        return b"".join(time.to_bytes(TIME_BYTES, "little") + data for time, data in self.slots)

    def write_topic(self, value: bytes) -> bool:
        """Keep another topic (J2A-TRANS-014)."""
        try:
            text = value.decode()
        except UnicodeDecodeError:
            return False
        if any(ord(char) < 0x20 or ord(char) == 0x7F for char in text):
            return False
        self.topic = value
        return True


class SensorState(_Transducer):
    """A sensor: its settings, and the values that wait."""

    def __init__(self, transducer: Transducer, codec: SampleCodec) -> None:
        super().__init__(transducer, codec)
        self.is_enabled = transducer.is_enabled
        self.period_us = transducer.period_us
        self.decimation = int(transducer.get("decimation", "1"))
        self.threshold = transducer.threshold
        self.trigger_us: int | None = None
        self._skipped = [0] * transducer.channels
        self._last: list[Any] = [None] * transducer.channels
        self._queue: deque[bytes] = deque()
        self._lost = 0
        self._is_fresh = False
        self._reference_us: float | None = None

    def sense(self, first: int, values: Sequence[Any], now_us: int, *, is_raw: bool) -> None:
        """Take values that the sensor has measured: all of them, or none if one is wrong.

        Args:
            first: the channel of the first value; the others are those of the channels behind it.
            values: in the unit of the descriptor; None is the N/A value.
            now_us: the time of the device's clock, from 1 on.
            is_raw: the values are raw ones.

        Raises:
            LocalError: there is no such channel, or a value is not of the type.
        """
        name, channels = self.transducer.name, self.transducer.channels
        if not isinstance(first, int) or not 0 <= first < channels:
            raise LocalError(f"{name} has channels 0 to {channels - 1}, and none {first!r}")
        if first + len(values) > channels:
            raise LocalError(
                f"{name}: {len(values)} values from channel {first} on, where there are {channels} "
                "channels"
            )
        packed = [self._pack(value, is_raw) for value in values]
        for channel, data in enumerate(packed, first):
            self.take(channel, data, now_us)

    def _pack(self, value: Any, is_raw: bool) -> bytes:
        if is_raw:
            return self.codec.pack_raw(value)
        if value is not None:
            return self.codec.pack(value)
        if self.transducer.na is None:
            raise LocalError(f"{self.transducer.name} has no N/A value: give it a number")
        return self.codec.pack_raw(self.transducer.na)

    def take(self, channel: int, data: bytes, now_us: int) -> None:
        """Take a value, unless decimation or threshold leave it out."""
        self._skipped[channel] += 1
        if self._skipped[channel] < self.decimation:
            return
        self._skipped[channel] = 0
        if self.transducer.queue and not self.is_enabled:
            return
        if self.threshold is not None:
            raw = self.codec.unpack_raw(data)
            if self._last[channel] is not None and self._is_near(raw, self._last[channel]):
                return
            self._last[channel] = raw
        if not self.transducer.queue:
            self.slots[channel] = now_us, data
            self._is_fresh = self.is_enabled
        elif len(self._queue) >= self.transducer.queue:
            self._lost += 1
        else:
            self._queue.append(bytes([channel]) + now_us.to_bytes(TIME_BYTES, "little") + data)

    def _is_near(self, raw: Any, last: Any) -> bool:
        """Whether a value differs too little from the one before (J2A-TRANS-013)."""
        is_none = [self.codec.is_na(one) for one in (raw, last)]
        if is_none[0] != is_none[1]:
            return False
        if math.isnan(raw) or math.isnan(last):
            return math.isnan(raw) and math.isnan(last) and bool(self.threshold)
        assert self.threshold is not None
        return self.codec.difference(raw, last) < self.threshold

    def next_us(self) -> float:
        """Return the local time from which the next sample SIF may begin; the first may at once."""
        due_us = -math.inf
        if self._reference_us is not None:
            due_us = self._reference_us + self.period_us
        return due_us

    def due_us(self) -> float:
        """Return the local time at which a sample SIF is due, infinity while there is no value."""
        has_some = bool(self._queue) if self.transducer.queue else self._is_fresh
        return self.next_us() if self.is_enabled and has_some else _NEVER

    def report(self, local_us: int) -> tuple[bytes, float]:
        """Return the payload of a sample SIF that is due, and when to look again."""
        due_us = self.due_us()
        if local_us < due_us:
            return b"", due_us
        # Lateness of less than one PERIOD does not add up (J2A-TRANS-011).
        self._reference_us = due_us if local_us < due_us + self.period_us else local_us
        if not self.transducer.queue:
            self._is_fresh = False
            return self.sample(), _NEVER
        most = (c.MAX_PAYLOAD - LOST_BYTES) // len(self._queue[0])
        count = min(len(self._queue), most)
        lost = (self._lost % _LOST_MODULO).to_bytes(LOST_BYTES, "little")
        payload = lost + b"".join(self._queue.popleft() for _ in range(count))
        return payload, self._reference_us + self.period_us if self._queue else _NEVER

    def write(self, item: int, value: bytes) -> bool:
        """Change a setting; return whether its value is in range."""
        number = int.from_bytes(value, "little")
        if item == c.TRANSD_ENABLED:
            if number > 1:
                return False
            self._enable(bool(number))
        elif item == c.TRANSD_PERIOD:
            self.period_us = number
        elif item == c.TRANSD_DECIMATION:
            if number == 0:
                return False
            self.decimation = number
            self._skipped = [0] * self.transducer.channels
        else:
            raw = self.codec.unpack_raw(value)
            if not raw >= 0:
                return False
            self.threshold = raw
        return True

    def _enable(self, is_enabled: bool) -> None:
        self.is_enabled = is_enabled
        if not is_enabled:
            self._is_fresh = False
            self._lost += len(self._queue)
            self._queue.clear()


class _Actuator(_Transducer):
    def __init__(self, transducer: Transducer, codec: SampleCodec) -> None:
        super().__init__(transducer, codec)
        self.watchdog_ms = int(transducer.get("watchdog", "0"))
        self.is_safe = False
        self.waiting: dict[int, tuple[int, bytes]] = {}
        safe = transducer.safe
        self._bools = tuple(_bools(transducer.type))
        self.safe = bytes(transducer.type.size) if safe is None else codec.pack_raw(safe)

    def schedule(self, value: bytes) -> bool:
        """Take what SET writes; return whether all of it is in range (J2A-TRANS-016)."""
        first, due_us = value[0], int.from_bytes(value[1 : 1 + TIME_BYTES], "little")
        size = self.transducer.type.size
        data = value[1 + TIME_BYTES :]
        values = [data[at : at + size] for at in range(0, len(data), size)]
        if first + len(values) > self.transducer.channels:
            return False
        if self.transducer.range is not None:
            low, high = self.transducer.range
            if not all(low <= self.codec.unpack_raw(one) <= high for one in values):
                return False
        for channel, one in enumerate(values, first):
            self.waiting[channel] = due_us, self._tidy(one)
        return True

    def _tidy(self, data: bytes) -> bytes:
        """Return a value whose bools are 0 or 1; hosts may send any byte (J2A-TYPE-002)."""
        tidy = bytearray(data)
        for at in self._bools:
            tidy[at] = bool(tidy[at])
        return bytes(tidy)


def _bools(type_: Type, at: int = 0) -> Iterator[int]:
    """Yield where the bools of a value are."""
    for _ in range(type_.count or 1):
        if isinstance(type_.element, Structure):
            for field in type_.element.fields:
                yield from _bools(field.type, at)
                at += field.type.size
        else:
            if type_.element == "bool":
                yield at
            at += Type(type_.element).size


def _has_item(one: Transducer, item: int, is_write: bool) -> bool:
    """Whether a transducer has an item to write, or to read."""
    if item > c.TRANSD_TIME or item == c.TRANSD_SAVE:
        return False
    if item in (_READ_ONLY if is_write else _WRITE_ONLY):
        return False
    if item == c.TRANSD_SAMPLE:
        return not one.queue
    if item in (_OF_ACTUATORS if one.is_sensor else _OF_SENSORS):
        return False
    key = saved_settings.KEYS.get(item)
    return key is None or one.has(key)


def _lengths(one: SensorState | _Actuator, item: int) -> Sequence[int]:
    """Return how long an item may be that is written."""
    size = one.transducer.type.size
    if item == c.TRANSD_SET:
        return range(1 + TIME_BYTES + size, c.MAX_PAYLOAD, size)
    if item == c.TRANSD_TOPIC:
        return range(1, c.TRANSD_MAX_TOPIC + 1)
    return (_BYTES.get(item, size),)


def _read(one: SensorState | _Actuator, item: int, now_us: int) -> bytes:
    if item == c.TRANSD_SAMPLE:
        return one.sample()
    if item == c.TRANSD_TOPIC:
        return one.topic
    if item == c.TRANSD_TIME:
        return now_us.to_bytes(TIME_BYTES, "little")
    if isinstance(one, _Actuator):
        return struct.pack("<H", one.watchdog_ms)
    if item == c.TRANSD_THRESHOLD:
        return one.codec.pack_raw(one.threshold)
    number = {
        c.TRANSD_ENABLED: int(one.is_enabled),
        c.TRANSD_PERIOD: one.period_us,
        c.TRANSD_DECIMATION: one.decimation,
    }[item]
    return number.to_bytes(_BYTES[item], "little")
