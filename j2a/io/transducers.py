"""Sensors and actuators of a device as objects.

What flows in: values and settings of the user. What flows out: calls of a2jTransd, and samples.
Rules: values and settings are checked before anything is sent (J2A-TRANS-025); a transducer is
found by its name, so that it stays the same when the device restarts.
"""

import asyncio
import struct
import time
import weakref
from collections.abc import Callable, Iterator, Mapping
from difflib import get_close_matches
from typing import Any, Final, TypeVar

from j2a_spec import constants as c

from j2a.errors import (
    FunctionFailed,
    LinkClosed,
    ProtocolError,
    UnknownTransducer,
    WrongArgument,
)
from j2a.events import Reading, Reply, Sample
from j2a.io.samples import SampleSource, WantedSamples
from j2a.io.streams import MAX_SIFS
from j2a.types.arrays import Batch
from j2a.types.coding import PayloadMismatchError
from j2a.types.samples import SampleCodec, pack_time
from j2a.types.transducers import TIME_BYTES, Descriptors, Transducer

__all__ = [
    "Actuator",
    "AsyncActuator",
    "AsyncSensor",
    "RemoteTransducer",
    "Sensor",
    "Transducers",
]

_US: Final = 1_000_000
_MS: Final = 1000
_FAILURES: Final = {
    c.TRANSD_NO_ID: "the device has no transducer of this id",
    c.TRANSD_NO_ITEM: "it cannot be read or written there",
    c.TRANSD_BAD_LENGTH: "it has another length there",
    c.TRANSD_BAD_VALUE: "it is out of range there",
    c.TRANSD_BUSY: "the settings of another transducer are being saved there",
}
_NEEDS: Final = {
    c.TRANSD_DECIMATION: "decimation",
    c.TRANSD_THRESHOLD: "threshold",
    c.TRANSD_TOPIC: "topic",
    c.TRANSD_WATCHDOG: "watchdog",
    c.TRANSD_TRIGGER: "trigger",
}
_SAVE: Final = bytes((c.TRANSD_SAVED,))
_SAVE_S: Final = 20.0
_SAVE_POLL_S: Final = 0.02
_SETTINGS: Final = {
    "enabled": c.TRANSD_ENABLED,
    "period": c.TRANSD_PERIOD,
    "decimation": c.TRANSD_DECIMATION,
    "threshold": c.TRANSD_THRESHOLD,
    "topic": c.TRANSD_TOPIC,
    "watchdog": c.TRANSD_WATCHDOG,
}


class RemoteTransducer:
    """What sensors and actuators have in common, without the waiting.

    Attributes:
        name: what the device calls it.
    """

    def __init__(
        self, name: str, source: SampleSource, client: "weakref.ref[Any]", url: str
    ) -> None:
        self.name = name
        self._source = source
        self._client_ref = client
        self._url = url

    def __repr__(self) -> str:
        codec = self._source.codec(self.name)
        what = "gone" if codec is None else str(codec.transducer).split("\n", 1)[0]
        return f"<j2a {what} of {self._url}>"

    @property
    def _client(self) -> Any:
        client = self._client_ref()
        if client is None:
            raise LinkClosed(f"the client of {self._url} is gone")
        return client

    @property
    def _codec(self) -> SampleCodec:
        codec = self._source.codec(self.name)
        if codec is None:
            raise UnknownTransducer(f"{self._url} has no transducer {self.name!r} any more")
        return codec

    @property
    def descriptor(self) -> Transducer:
        """What the device says of it: id, channels, type, model, range and more.

        Raises:
            UnknownTransducer: the device has restarted, and has none of that name any more.
        """
        return self._codec.transducer

    @property
    def unit(self) -> str:
        """The unit of the values, a symbol of UCUM such as "mV", or ""."""
        return self.descriptor.unit

    @property
    def channels(self) -> int:
        """How many equal values it has."""
        return self.descriptor.channels

    @property
    def doc(self) -> str:
        """One line for people, or ""."""
        return self.descriptor.doc

    # ------------------------------------------------------------------ requests and replies

    def _request(self, item: int, value: bytes = b"") -> bytes:
        """Return the payload of a2jTransd that reads or writes an item.

        Raises:
            WrongArgument: the transducer does not have it.
        """
        key = _NEEDS.get(item)
        if key is not None and not self.descriptor.has(key):
            raise WrongArgument(f"{self.name} has no {key}: its descriptor does not name the key")
        return bytes([self.descriptor.id, item]) + value

    def _answer(self, reply: Reply) -> bytes:
        """Return the item that a reply holds.

        Raises:
            FunctionFailed: the device refused.
        """
        if reply.code != 0:
            why = _FAILURES.get(reply.code, f"it returned the code 0x{reply.code:02X}")
            raise FunctionFailed(f"{self.name}: {why}", code=reply.code, payload=reply.payload)
        return reply.payload

    def _pack(self, setting: str, value: Any) -> bytes:
        """Return the request that changes a setting.

        Raises:
            WrongArgument: there is no such setting, or it cannot have this value.
        """
        item = _SETTINGS.get(setting)
        if item is None:
            raise WrongArgument(f"{setting} is no setting; there are: {', '.join(_SETTINGS)}")
        is_sensor = self.descriptor.is_sensor
        if (item in (c.TRANSD_ENABLED, c.TRANSD_PERIOD)) and not is_sensor:
            raise WrongArgument(f"{self.name} is an actuator, which has no {setting}")
        return self._request(item, self._packed(setting, value))

    def _packed(self, setting: str, value: Any) -> bytes:
        if setting == "enabled":
            if value not in (False, True):
                raise WrongArgument(f"enabled is True or False, not {value!r:.40}")
            return bytes([bool(value)])
        if setting == "period":
            return struct.pack("<I", _whole(setting, value, _US, 0xFFFFFFFF))
        if setting == "watchdog":
            return struct.pack("<H", _whole(setting, value, _MS, 0xFFFF))
        if setting == "decimation":
            if not isinstance(value, int) or not 1 <= value <= 255:
                raise WrongArgument(f"decimation is a whole number of 1 to 255, not {value!r:.40}")
            return bytes([value])
        if setting == "threshold":
            return self._codec.pack_threshold(value)
        if not isinstance(value, str) or not value.isprintable():
            raise WrongArgument(f"a topic is a printable text, not {value!r:.40}")
        data = value.encode()
        if not 1 <= len(data) <= c.TRANSD_MAX_TOPIC:
            raise WrongArgument(f"a topic is 1 to {c.TRANSD_MAX_TOPIC} bytes long, not {len(data)}")
        return data

    def _unpack(self, setting: str, data: bytes) -> Any:
        """Return the value of a setting.

        Raises:
            ProtocolError: the device returned something else.
        """
        try:
            if setting == "threshold":
                return self._codec.unpack_raw(data)
            if setting == "topic":
                return data.decode()
            if setting in ("enabled", "decimation"):
                [number] = struct.unpack("<B", data)
                return bool(number) if setting == "enabled" else number
            if setting == "period":
                return struct.unpack("<I", data)[0] / _US
            return struct.unpack("<H", data)[0] / _MS
        except (struct.error, PayloadMismatchError, UnicodeDecodeError) as error:
            raise ProtocolError(f"{self.name}: {setting} came as {data!r:.60}: {error}") from None

    def _next_save(self, request: bytes, reply: Reply, end: float) -> bytes | None:
        """Return the request that follows one of SAVE, None when the settings are kept.

        Raises:
            FunctionFailed: the device keeps none, or does not get ready in time.
        """
        if reply.code == c.TRANSD_BUSY and time.monotonic() < end:
            return request
        state = self._answer(reply)
        if state == _SAVE:
            return None
        if state != bytes((c.TRANSD_SAVING,)) or time.monotonic() >= end:
            raise FunctionFailed(
                f"{self.name}: its settings are not saved, SAVE is {state!r:.20}",
                code=reply.code,
                payload=state,
            )
        return self._request(c.TRANSD_SAVE)

    def _time(self, data: bytes) -> int:
        if len(data) != TIME_BYTES:
            raise ProtocolError(f"{self.name}: a time came as {data!r:.60}")
        return int.from_bytes(data, "little")

    def _readings(self, data: bytes) -> tuple[Reading, ...]:
        try:
            return self._codec.unpack(data)
        except PayloadMismatchError as error:
            raise ProtocolError(f"{self.name}: {error}") from None

    def _set_request(self, values: tuple[Any, ...], channel: int, at_us: int, raw: bool) -> bytes:
        data = self._codec.pack_set(values, channel, at_us, is_raw=raw)
        return self._request(c.TRANSD_SET, data)

    def _sample_request(self) -> bytes:
        if self.descriptor.queue:
            raise WrongArgument(
                f"{self.name} has a queue, of which the newest value cannot be read: take its "
                "samples as they come"
            )
        return self._request(c.TRANSD_SAMPLE)

    def _wanted(self) -> WantedSamples:
        return WantedSamples(self._source, self.name)


def _whole(setting: str, value: Any, unit: int, most: int) -> int:
    if not isinstance(value, int | float) or not 0 <= value <= most / unit:
        raise WrongArgument(f"{setting} is 0 to {most / unit:g} s, not {value!r:.40}")
    return round(value * unit)


class _Blocking(RemoteTransducer):
    def _ask(self, request: bytes) -> bytes:
        return self._answer(self._client.call(c.TRANSD, request))

    def _get(self, setting: str) -> Any:
        return self._unpack(setting, self._ask(self._request(_SETTINGS[setting])))

    def configure(self, **settings: Any) -> None:
        """Change settings: enabled, period, decimation, threshold, topic, watchdog.

        All are checked before the first one is sent (J2A-TRANS-025).

        Raises:
            WrongArgument: a setting is not there, or cannot have this value.
            FunctionFailed: the device refused one.
        """
        for request in [self._pack(name, value) for name, value in settings.items()]:
            self._ask(request)

    def read(self) -> tuple[Reading, ...]:
        """Ask the device for the newest reading of each channel (J2A-TRANS-009).

        Raises: as `Client.call`; WrongArgument for a sensor with a queue.
        """
        return self._readings(self._ask(self._sample_request()))

    def time_us(self) -> int:
        """Ask the device for the time of its clock, in microseconds.

        Raises: as `Client.call`.
        """
        return self._time(self._ask(self._request(c.TRANSD_TIME)))

    def save(self, timeout: float = _SAVE_S) -> None:
        """Have the device keep the settings of now without power; return when it does.

        Args:
            timeout: seconds; a device needs up to 10 (J2A-TRANS-028), and as long before for what
                it is saving already.

        Raises: as `Client.call`; FunctionFailed when the device keeps none, or is still busy.
        """
        end = time.monotonic() + timeout
        request: bytes | None = self._request(c.TRANSD_SAVE, _SAVE)
        while request is not None:
            request = self._next_save(request, self._client.call(c.TRANSD, request), end)
            if request is not None:
                time.sleep(_SAVE_POLL_S)

    def is_saved(self) -> bool:
        """Ask whether a reset brings settings back that were saved (J2A-TRANS-019).

        Raises: as `Client.call`; FunctionFailed when the device keeps none.
        """
        return self._ask(self._request(c.TRANSD_SAVE)) == _SAVE

    @property
    def topic(self) -> str:
        """The name under which hosts publish it, 1 to 32 bytes."""
        if not self.descriptor.has("topic"):
            return self.name
        return str(self._get("topic"))

    @topic.setter
    def topic(self, topic: str) -> None:
        self.configure(topic=topic)


class Sensor(_Blocking):
    """A sensor of a device; from `Client.transducers`.

    Example::

        for sample in board.transducers["quad"]:
            print(sample.time_us, sample.values)

    Settings are attributes; to read or set one asks the device.
    """

    def latest(self) -> Sample | None:
        """Return the newest sample that has come, None before the first one. Asks nothing."""
        return self._source.latest(self.name)

    def samples(self, *, max_waiting: int = MAX_SIFS) -> Any:
        """Return the samples that come from now on, to iterate over; as `Client.sifs`.

        Args:
            max_waiting: so many may wait; then the oldest are dropped, and counted in `lost`.
        """
        return self._client._engine.stream(self._wanted(), max_waiting)

    def __iter__(self) -> Iterator[Sample]:
        stream: Iterator[Sample] = self.samples()
        return stream

    def wait(self, timeout: float | None = None) -> Sample:
        """Return the next sample that comes.

        Args:
            timeout: the time limit in seconds; None takes the client's.

        Raises: as `Client.wait_sif`.
        """
        client = self._client
        with self.samples() as stream:
            sample: Sample = stream.wait(client._limit_s(timeout))
            return sample

    def read_batch(self, count: int, timeout: float | None = None) -> Batch:
        """Return the next samples that come as arrays.

        Args:
            count: so many samples.
            timeout: the time limit for all of them in seconds; None takes the client's.

        Raises: as `wait`; LocalError where NumPy is missing.
        """
        if not isinstance(count, int) or count < 1:
            raise WrongArgument(f"a batch has 1 sample or more, not {count!r:.40}")
        client = self._client
        end = client.now() + client._limit_s(timeout)
        with self.samples(max_waiting=max(count, MAX_SIFS)) as stream:
            found = [stream.wait(max(0.0, end - client.now())) for _ in range(count)]
        return Batch.of(self.descriptor, found)

    def on_sample(self, handler: Callable[[Sample], object]) -> Any:
        """Have a function called with each sample; returns an object whose `cancel()` ends it.

        Handlers run in the thread of the SIF handlers; they may use the client.
        """
        return self._client._handlers.add(self._wanted(), handler)

    def trigger(self, at_us: int = 0) -> None:
        """Have the sensor measure once (J2A-TRANS-018).

        Args:
            at_us: when, on the clock of the device; at once if that is over.

        Raises:
            WrongArgument: the sensor has no key trigger.
        """
        self._ask(self._request(c.TRANSD_TRIGGER, pack_time(at_us)))

    @property
    def enabled(self) -> bool:
        """It sends samples on its own."""
        return bool(self._get("enabled"))

    @enabled.setter
    def enabled(self, enabled: bool) -> None:
        self.configure(enabled=enabled)

    @property
    def period(self) -> float:
        """The least time between two samples, in seconds."""
        return float(self._get("period"))

    @period.setter
    def period(self, period: float) -> None:
        self.configure(period=period)

    @property
    def decimation(self) -> int:
        """Every so manieth value is taken."""
        return int(self._get("decimation"))

    @decimation.setter
    def decimation(self, decimation: int) -> None:
        self.configure(decimation=decimation)

    @property
    def threshold(self) -> Any:
        """By how much a raw value must differ from the one taken before."""
        return self._get("threshold")

    @threshold.setter
    def threshold(self, threshold: Any) -> None:
        self.configure(threshold=threshold)


class Actuator(_Blocking):
    """An actuator of a device; from `Client.transducers`."""

    def set(self, *values: Any, channel: int = 0, at_us: int = 0, raw: bool = False) -> None:
        """Set channels to values (J2A-TRANS-016).

        Args:
            values: one for each channel from `channel` on, in the unit of the descriptor.
            channel: the first of them.
            at_us: when, on the clock of the device (`time_us()`); at once if that is
                over.
            raw: the values are raw ones, before scale and offset.

        Raises:
            WrongArgument: a value is not of the type or out of range, or there is no such channel;
                nothing was sent.
            FunctionFailed: the device refused.
        """
        self._ask(self._set_request(values, channel, at_us, raw))

    @property
    def watchdog(self) -> float:
        """After so many seconds of silence the device sets it to its safe value; 0 is never."""
        return float(self._get("watchdog"))

    @watchdog.setter
    def watchdog(self, watchdog: float) -> None:
        self.configure(watchdog=watchdog)


class _Async(RemoteTransducer):
    async def _ask(self, request: bytes) -> bytes:
        return self._answer(await self._client.call(c.TRANSD, request))

    async def configure(self, **settings: Any) -> None:
        """Change settings; `Sensor.configure` for asyncio."""
        for request in [self._pack(name, value) for name, value in settings.items()]:
            await self._ask(request)

    async def setting(self, name: str) -> Any:
        """Return a setting as the device has it now, such as "period" in seconds."""
        if name not in _SETTINGS:
            raise WrongArgument(f"{name} is no setting; there are: {', '.join(_SETTINGS)}")
        return self._unpack(name, await self._ask(self._request(_SETTINGS[name])))

    async def read(self) -> tuple[Reading, ...]:
        """Ask the device for the newest reading of each channel."""
        return self._readings(await self._ask(self._sample_request()))

    async def time_us(self) -> int:
        """Ask the device for the time of its clock, in microseconds."""
        return self._time(await self._ask(self._request(c.TRANSD_TIME)))

    async def save(self, timeout: float = _SAVE_S) -> None:
        """Have the device keep the settings of now without power; `Sensor.save` for asyncio."""
        end = time.monotonic() + timeout
        request: bytes | None = self._request(c.TRANSD_SAVE, _SAVE)
        while request is not None:
            request = self._next_save(request, await self._client.call(c.TRANSD, request), end)
            if request is not None:
                await asyncio.sleep(_SAVE_POLL_S)

    async def is_saved(self) -> bool:
        """Ask whether a reset brings settings back that were saved."""
        return await self._ask(self._request(c.TRANSD_SAVE)) == _SAVE


class AsyncSensor(_Async):
    """A sensor of a device; `async for sample in board.transducers["quad"]`."""

    def latest(self) -> Sample | None:
        """Return the newest sample that has come, None before the first one. Asks nothing."""
        return self._source.latest(self.name)

    def samples(self, *, max_waiting: int = MAX_SIFS) -> Any:
        """Return the samples that come from now on; as `AsyncClient.sifs`."""
        return self._client._engine.stream(self._wanted(), max_waiting)

    def __aiter__(self) -> Any:
        return self.samples()

    async def wait(self, timeout: float | None = None) -> Sample:
        """Return the next sample that comes; `Sensor.wait` for asyncio."""
        client = self._client
        async with self.samples() as stream:
            sample: Sample = await stream.wait(client._limit_s(timeout))
            return sample

    def on_sample(self, handler: Callable[[Sample], object]) -> Any:
        """Have a function or coroutine function called with each sample."""
        return self._client._handlers.add(self._wanted(), handler)

    async def trigger(self, at_us: int = 0) -> None:
        """Have the sensor measure once; `Sensor.trigger` for asyncio."""
        await self._ask(self._request(c.TRANSD_TRIGGER, pack_time(at_us)))


class AsyncActuator(_Async):
    """An actuator of a device."""

    async def set(self, *values: Any, channel: int = 0, at_us: int = 0, raw: bool = False) -> None:
        """Set channels to values; `Actuator.set` for asyncio."""
        await self._ask(self._set_request(values, channel, at_us, raw))


_TransducerT = TypeVar("_TransducerT", bound=RemoteTransducer)


class Transducers(Mapping[str, _TransducerT]):
    """The transducers of a device by name, in the order in which it lists them.

    Attributes:
        descriptors: what the device says of them; None where it describes none.
        why: what messages say then.
    """

    def __init__(
        self,
        made: Callable[[str], _TransducerT],
        names: list[str],
        why: str,
        descriptors: Descriptors | None,
    ) -> None:
        self.descriptors = descriptors
        self._made: dict[str, _TransducerT] = {name: made(name) for name in names}
        self.why = why

    def __getitem__(self, name: str) -> _TransducerT:
        found = self._made.get(name)
        if found is not None:
            return found
        if not self._made:
            raise UnknownTransducer(f"there is no transducer {name!r}: {self.why}")
        near = get_close_matches(str(name), self._made, n=3, cutoff=0.5)
        hint = f"near it are: {', '.join(near)}" if near else f"it has: {', '.join(self._made)}"
        raise UnknownTransducer(f"the device has no transducer {name!r}; {hint}")

    def __iter__(self) -> Iterator[str]:
        return iter(self._made)

    def __len__(self) -> int:
        return len(self._made)

    def __repr__(self) -> str:
        return f"<j2a transducers: {', '.join(self._made) or 'none'}>"
