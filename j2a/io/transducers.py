"""Sensors and actuators of a device as objects: what both kinds of client have in common.

What flows in: values and settings of the user. What flows out: calls of a2jTransd, and samples.
Rules: values and settings are checked before anything is sent (J2A-TRANS-025); a transducer is
found by its name, so that it stays the same when the device restarts.
"""

import math
import struct
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from numbers import Integral, Real
from typing import Any, Final, TypeVar

from j2a_spec import constants as c
from j2a_spec.nearest import nearest_or_all

from j2a.errors import (
    BatchClosed,
    BatchError,
    BatchLost,
    BatchTimeout,
    CallTimeout,
    FunctionFailed,
    InterfaceChanged,
    LinkClosed,
    LinkError,
    ProtocolError,
    UnknownTransducer,
    WrongArgument,
)
from j2a.events import Reading, Reply, Sample
from j2a.io.samples import SampleSource, WantedSamples
from j2a.io.streams import MAX_SIFS
from j2a.protocol.saved_settings import ITEMS as SETTINGS
from j2a.protocol.saved_settings import KEYS
from j2a.types.arrays import Batch
from j2a.types.coding import PayloadMismatchError
from j2a.types.model import Structure
from j2a.types.samples import SampleCodec
from j2a.types.transducers import TIME_BYTES, Descriptors, Transducer

__all__ = [
    "SETTINGS",
    "RemoteSensor",
    "RemoteTransducer",
    "Transducers",
    "all_checked",
]

_US: Final = 1_000_000
_MS: Final = 1000
_FAILURES: Final = {
    c.TRANSD_NO_ID: "the device has no transducer of this id",
    c.TRANSD_NO_ITEM: "it cannot be read or written there",
    c.TRANSD_BAD_LENGTH: "it has another length there",
    c.TRANSD_BAD_VALUE: "it is out of range there",
    c.RET_FAILED: "the device could not do it",
    c.TRANSD_BUSY: "the settings of another transducer are being saved there",
}
SAVE_S: Final = 20.0
SAVE_POLL_S: Final = 0.02
SAVE: Final = bytes((c.TRANSD_SAVED,))


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

    def __setattr__(self, name: str, value: object) -> None:
        """Refuse an attribute that would change nothing on the device."""
        if not name.startswith("_") and name != "name" and not hasattr(type(self), name):
            raise AttributeError(self._no_attribute(name))
        super().__setattr__(name, value)

    def _no_attribute(self, name: str) -> str:
        return f"{self.name} has no setting {name}; {self._settings_it_has()}"

    @property
    def _client(self) -> Any:
        client = self._client_ref()
        if client is None:
            raise LinkClosed(f"the client of {self._url} is gone")
        return client

    @property
    def _codec(self) -> SampleCodec:
        return self._checked(self._source.codec(self.name))

    def _checked(self, codec: SampleCodec | None) -> SampleCodec:
        if codec is not None:
            return codec
        if not self._source.is_known:
            raise UnknownTransducer(
                f"whether {self._url} has the transducer {self.name!r} is not known: it may have "
                "restarted, and has not yet said what it has"
            )
        raise UnknownTransducer(f"{self._url} has no transducer {self.name!r} any more")

    @property
    def descriptor(self) -> Transducer:
        """What the device says of it: id, channels, type, model, range and more.

        Raises:
            UnknownTransducer: the device has restarted, and has none of that name any more.
        """
        return self._codec.transducer

    @property
    def unit(self) -> str:
        """The unit of the values, a symbol of UCUM such as "mV", or ""; see `units`."""
        return self.descriptor.unit

    @property
    def units(self) -> dict[str, str]:
        """Units by name of the value: "value", or each field of a structure, such as "pose.x"."""
        return self.descriptor.units

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
        key = KEYS.get(item)
        if key is not None and not self.descriptor.has(key):
            raise WrongArgument(f"{self.name} has no {key}: its descriptor does not name the key")
        return bytes([self.descriptor.id, item]) + value

    def _items(self) -> list[int]:
        """Return the settings that it has."""
        common = (c.TRANSD_ENABLED, c.TRANSD_PERIOD) if self.descriptor.is_sensor else ()
        keys = [item for item in SETTINGS.values() if self.descriptor.has(KEYS.get(item, ""))]
        return [*common, *keys]

    def _settings_it_has(self) -> str:
        """Return what to say behind a setting that it does not have."""
        items = self._items()
        names = ", ".join(name for name, item in SETTINGS.items() if item in items)
        return f"{self.name} has: {names}" if names else f"{self.name} has no settings"

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
        item = SETTINGS.get(setting)
        if item is None:
            raise WrongArgument(f"{setting} is no setting; {self._settings_it_has()}")
        is_sensor = self.descriptor.is_sensor
        if (item in (c.TRANSD_ENABLED, c.TRANSD_PERIOD)) and not is_sensor:
            raise WrongArgument(f"{self.name} is an actuator, which has no {setting}")
        return self._request(item, self._packed(setting, value))

    def _packed(self, setting: str, value: Any) -> bytes:
        if setting == "enabled":
            if value.__hash__ is None or value not in (False, True):  # no arrays
                raise WrongArgument(f"enabled is True or False, not {value!r:.40}")
            return bytes([bool(value)])
        if setting == "period":
            return struct.pack("<I", _whole(setting, value, _US, 0xFFFFFFFF))
        if setting == "watchdog":
            return struct.pack("<H", _whole(setting, value, _MS, 0xFFFF))
        if setting == "decimation":
            if not _is_a(Integral, value) or not 1 <= value <= 255:
                raise WrongArgument(f"decimation is a whole number of 1 to 255, not {value!r:.40}")
            return bytes([int(value)])
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
                return self._checked(self._source.codec_of_reply(self.name)).unpack_raw(data)
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

    def _next_save(self, value: bytes, reply: Reply, is_over: bool) -> bytes | None:
        """Return the value of the request of SAVE that follows one, None when settings are kept.

        Args:
            value: of the one that was answered; nothing asks for the state.
            reply: to it.
            is_over: the device has had its time.

        Raises:
            FunctionFailed: the device keeps none, or does not get ready in time.
        """
        if reply.code == c.TRANSD_BUSY and not is_over:
            return value
        self._check_saves(reply)
        state = self._answer(reply)
        if state == SAVE:
            return None
        if state != bytes((c.TRANSD_SAVING,)) or is_over:
            raise FunctionFailed(
                f"{self.name}: its settings are not saved, SAVE is {state!r:.20}",
                code=reply.code,
                payload=state,
            )
        return b""

    def _is_saved(self, reply: Reply) -> bool:
        self._check_saves(reply)
        return self._answer(reply) == SAVE

    def _check_saves(self, reply: Reply) -> None:
        if reply.code == c.TRANSD_NO_ITEM:
            raise FunctionFailed(
                f"{self.name}: the device keeps no settings without power",
                code=reply.code,
                payload=reply.payload,
            )

    def _time(self, data: bytes) -> int:
        if len(data) != TIME_BYTES:
            raise ProtocolError(f"{self.name}: a time came as {data!r:.60}")
        return int.from_bytes(data, "little")

    def _readings(self, data: bytes) -> tuple[Reading, ...]:
        try:
            return self._checked(self._source.codec_of_reply(self.name)).unpack(data)
        except PayloadMismatchError as error:
            raise ProtocolError(f"{self.name}: {error}") from None

    def _set_request(self, values: tuple[Any, ...], channel: int, at_us: int, raw: bool) -> bytes:
        one = self.descriptor
        is_single = one.type.count is None and not isinstance(one.type.element, Structure)
        if is_single and one.channels > 1 and isinstance(next(iter(values), 0), list):
            raise WrongArgument(
                f"{self.name} has {one.channels} channels: give each an argument of its own, as in "
                "set(*values)"
            )
        data = self._codec.pack_set(values, channel, at_us, is_raw=raw)
        return self._request(c.TRANSD_SET, data)

    def _sample_request(self) -> bytes:
        if self.descriptor.queue:
            raise WrongArgument(
                f"{self.name} has a queue, of which the newest value cannot be read: take its "
                "samples as they come"
            )
        return self._request(c.TRANSD_SAMPLE)


class RemoteSensor(RemoteTransducer):
    """What the sensors of both clients have in common."""

    def latest(self) -> Sample | None:
        """Return the newest sample that has come, None before the first one. Asks nothing."""
        return self._source.latest(self.name)

    def samples(self, *, max_waiting: int = MAX_SIFS) -> Any:
        """Return the samples that come from now on, to iterate over; as `Client.sifs`.

        Args:
            max_waiting: so many may wait; then the oldest are dropped, and counted in `lost`.
        """
        return self._client._engine.stream(self._wanted(), max_waiting)

    def on_sample(self, handler: Callable[[Sample], object]) -> Any:
        """Have a function called with each sample; returns an object whose `cancel()` ends it.

        It is called as SIF handlers are, see `Client.on_sif`: it may use the client, and with
        asyncio it may be a coroutine function.
        """
        return self._client._handlers.add(self._wanted(), handler)

    def _wanted(self) -> WantedSamples:
        return WantedSamples(self._source, self.name)

    def _stream_of_batch(self, count: int) -> tuple[Transducer, Any]:
        """Return what the sensor is now, and a stream with room for a batch of its samples.

        Raises:
            WrongArgument: the count is none of samples.
        """
        if not isinstance(count, Integral) or count < 1:
            raise WrongArgument(f"a batch has 1 sample or more, not {count!r:.40}")
        engine = self._client._engine
        # With room for all of them, what is dropped comes after the last one of the batch.
        return self.descriptor, engine.stream(self._wanted(), int(count), drops_newest=True)

    def _left_of_batch(self, end: float) -> float:
        """Return for how long to wait for the next sample of a batch, in seconds.

        Once the time is over, what has come is still taken; a limit of 0 is none, so it is the
        least one that there is.
        """
        left_s: float = end - self._client.now()
        return max(math.ulp(0.0), left_s)

    def _late(self, timeout: float, error: CallTimeout) -> CallTimeout:
        """Return the error of a sample that did not come, which names what may be the cause."""
        why = "it may be disabled, or have no new value"
        if self.descriptor.has("trigger"):
            why += ", or wait for its trigger"
        return CallTimeout(
            f"no sample of {self.name} came within {timeout:g} s: {why}", outcome=error.outcome
        )

    def _batch_error(
        self, before: Transducer, found: list[Sample], count: int, error: CallTimeout | LinkError
    ) -> BatchError:
        """Return the error of a batch that did not get full, which hands over what came.

        Raises: as `_batch`.
        """
        came = f"{len(found)} of {count} samples of {self.name} came"
        has = "which the error has as its batch"
        made: BatchError
        if isinstance(error, CallTimeout):
            text = f"{came} in time, {has}; ask for fewer, or wait longer"
            made = BatchTimeout(text, outcome=error.outcome)
        else:
            kind = BatchClosed if isinstance(error, LinkClosed) else BatchLost
            made = kind(f"{error}; {came} before, {has}", outcome=error.outcome)
        made.batch = self._batch(before, found)
        return made

    def _batch(self, before: Transducer, samples: list[Sample]) -> Batch:
        """Return samples of a sensor as arrays.

        Raises:
            InterfaceChanged: since the device has restarted, the sensor is another one.
        """
        if self._checked(self._source.codec_of_reply(self.name)).transducer != before:
            raise InterfaceChanged(
                f"the device has restarted, and {self.name} is another sensor now: its samples "
                "do not fit into one batch"
            )
        return Batch.of(before, samples)


def _is_a(kind: type, value: object) -> bool:
    """Whether a value is a number of a kind; those of NumPy are, too."""
    return isinstance(value, kind)


def _whole(setting: str, value: Any, unit: int, most: int) -> int:
    if not _is_a(Real, value) or not 0 <= value <= most / unit:
        raise WrongArgument(f"{setting} is 0 to {most / unit:.12g} s, not {value!r:.40}")
    # No time above 0 becomes 0, which is never for a watchdog.
    return max(round(float(value) * unit), int(value > 0))


_TransducerT = TypeVar("_TransducerT", bound=RemoteTransducer)


class Transducers(Mapping[str, _TransducerT]):
    """The transducers of a device by name, in the order in which it lists them.

    Attributes:
        descriptors: what the device says of them; None where it describes none.
        why: what messages say then.
    """

    def __init__(
        self,
        known: Mapping[str, _TransducerT],
        why: str,
        descriptors: Descriptors | None,
    ) -> None:
        self.descriptors = descriptors
        self._known = known
        self.why = why

    def __getitem__(self, name: str) -> _TransducerT:
        found = self._known.get(name)
        if found is not None:
            return found
        if not self._known:
            raise UnknownTransducer(f"there is no transducer {name!r}: {self.why}")
        hint = nearest_or_all(str(name), self._known, most=3, cutoff=0.5)
        raise UnknownTransducer(f"the device has no transducer {name!r}; {hint}")

    def __iter__(self) -> Iterator[str]:
        return iter(self._known)

    def __len__(self) -> int:
        return len(self._known)

    def __repr__(self) -> str:
        return f"<j2a transducers: {', '.join(self._known) or 'none'}>"


def all_checked(requests: Sequence[Callable[[], bytes]]) -> bytes:
    """Return the first request, but only where all can be made (J2A-TRANS-025)."""
    first, *_ = [request() for request in requests]
    return first
