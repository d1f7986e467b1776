"""Messages of ROS 1 and ROS 2 for samples: their types, and their bytes.

What flows in: topics and samples. What flows out: for each topic the messages that it is published
as, with name, type and serialized bytes.
Rules: each sample is a message of its own type with all times and raw values (thesis, listing 8.2).
Where unit and shape say what is measured, it also is one of a standard type in the unit of ROS,
under the topic with a name of that type behind it; a value that is N/A is not sent there, as a
standard message has no way to say so, nor is a channel that was not read since the sample before.
Sensors with a queue and values that are arrays have no standard message.
Types come from rosbags, an extra: each sink that needs it tells which one of its own brings it.
"""

import logging
import math
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from j2a import LocalError
from j2a.types.arrays import Batch
from j2a.types.model import Structure
from j2a.types.ros import PACKAGE, ros1_messages, ros2_messages
from j2a.types.transducers import (
    LOST_BYTES,
    TIME_BYTES,
    Descriptors,
    Transducer,
    number_element,
)
from j2a_bridge.quantities import Quantity, quantity_of
from j2a_bridge.sink import Status, Update
from j2a_bridge.topics import Topic

__all__ = ["DISTROS", "Message", "RosMessages"]

DISTROS: Final = {
    "noetic": Stores.ROS1_NOETIC,
    "humble": Stores.ROS2_HUMBLE,
    "jazzy": Stores.ROS2_JAZZY,
}
_NS: Final = 1_000_000_000
_NS_PER_US: Final = 1000
_TIME: Final = "builtin_interfaces/msg/Time"
_MOST_STORES: Final = 256
"""So many descriptors are remembered with their types: a board may restart with ever other ones."""
_UNKNOWN: Final = -1.0
_logger = logging.getLogger("j2a.bridge")


@dataclass(frozen=True, slots=True)
class Message:
    """One way in which a topic is published.

    Attributes:
        topic: its name, without a slash in front.
        type: of the message, such as "sensor_msgs/msg/Range".
        pack: returns the bytes of a sample, None where it has no value for this message.
    """

    topic: str
    type: str
    pack: Callable[[Update], bytes | None]


class RosMessages:
    """The messages of one version of ROS.

    Args:
        distro: one of `DISTROS`.
    """

    def __init__(self, distro: str) -> None:
        self.is_ros1 = distro == "noetic"
        self._distro = distro
        self._stores: dict[Descriptors, Any] = {}
        self.store: Any = get_typestore(DISTROS[distro])
        self._time = self.store.types[_TIME]

    # ------------------------------------------------------------------ types

    def store_of(self, descriptors: Descriptors) -> Any:
        """Return the types of a board, and the standard ones.

        Boards may have types of equal names that differ, so each has a store.
        """
        found = self._stores.get(descriptors)
        if found is None:
            found = self._stores[descriptors] = get_typestore(DISTROS[self._distro])
            texts = (ros1_messages if self.is_ros1 else ros2_messages)(descriptors)
            types: dict[str, Any] = {}
            for name, text in texts.items():
                types |= get_types_from_msg(text, f"{PACKAGE}/msg/{name}")
            found.register(types)
            for oldest in list(self._stores)[:-_MOST_STORES]:
                self._stores.pop(oldest, None)
        return found

    def type_of(self, topic: Topic) -> str:
        """Return the type of its own that a transducer has, such as "j2a_msgs/msg/Quad"."""
        names = list((ros1_messages if self.is_ros1 else ros2_messages)(topic.descriptors))
        at = [one.name for one in topic.descriptors.transducers].index(topic.transducer.name)
        return f"{PACKAGE}/msg/{names[at]}"

    def definition(self, topic: Topic, kind: str) -> tuple[str, str]:
        """Return the text of a type with all that it uses, and its MD5 sum as ROS 1 has it."""
        text, md5 = self.store_of(topic.descriptors).generate_msgdef(
            kind, ros_version=1 if self.is_ros1 else 2
        )
        return str(text), str(md5)

    def _serializer(self, store: Any, kind: str) -> Callable[[Any], bytes]:
        serialize = store.serialize_ros1 if self.is_ros1 else store.serialize_cdr
        return lambda message: bytes(serialize(message, kind))

    def time(self, stamp_ns: int) -> Any:
        """Return a time; it is one of 1970 to 2106, or the nearest of these."""
        seconds, ns = divmod(min(max(stamp_ns, 0), (1 << 32) * _NS - 1), _NS)
        if not self.is_ros1 and seconds >= 1 << 31:
            seconds, ns = (1 << 31) - 1, _NS - 1  # its seconds have a sign
        return self._time(seconds, ns)

    def header(self, store: Any, stamp_ns: int, frame: str) -> Any:
        """Return a header."""
        kind = store.types["std_msgs/msg/Header"]
        time = self.time(stamp_ns)
        return kind(0, time, frame) if self.is_ros1 else kind(time, frame)

    # ------------------------------------------------------------------ messages

    def messages(self, topic: Topic) -> list[Message]:
        """Return how a sensor is published.

        Where it does not fit the standard message that is asked for, it has its own alone.
        """
        if not topic.transducer.is_sensor:
            return []
        found = [self._own(topic)] if topic.message in ("auto", "raw") else []
        if topic.message == "raw":
            return found
        standard = list(_standard(topic, self))
        if topic.message != "auto":
            wanted = topic.message.replace("/msg/", "/")
            fits = [one.type.replace("/msg/", "/") for one in standard]
            standard = [one for one, kind in zip(standard, fits, strict=True) if kind == wanted]
            if not standard:
                which = ", ".join(sorted(set(fits))) or "none"
                _logger.warning(
                    "%s does not fit into %s; what fits is: %s", topic.name, topic.message, which
                )
                return [self._own(topic)]
        return found + standard

    def _own(self, topic: Topic) -> Message:
        kind, sensor = self.type_of(topic), topic.transducer
        if not isinstance(sensor.type.element, Structure):
            return Message(topic.name, kind, _Numbers(sensor, is_cdr=not self.is_ros1).pack)
        store = self.store_of(topic.descriptors)
        make, time = store.types[kind], self.time
        serialize = self._serializer(store, kind)
        name = _element_type(store, kind)
        none = self._time(0, 0)

        def pack(update: Update) -> bytes:
            batch = Batch(sensor, [update.sample.payload])
            times = [none if one is None else time(one) for one in update.stamps_ns]
            more: tuple[Any, ...] = ()
            if sensor.queue:
                lost = int.from_bytes(update.sample.payload[:2], "little")
                more = (np.ascontiguousarray(batch.channels), lost)
            values = [_record(store, name, one) for one in batch.raw.ravel()]
            return serialize(make(times, values, *more))

        return Message(topic.name, kind, pack)

    # ------------------------------------------------------------------ actuators, diagnostics

    def read_own(self, topic: Topic, data: bytes) -> tuple[list[Any], int]:
        """Return the raw values of a message for an actuator, and for when they are, 0 for now.

        Raises:
            LocalError: it is no such message, or has other than one time or none.
        """
        store, kind = self.store_of(topic.descriptors), self.type_of(topic)
        message = self._read(store, kind, data)
        stamps = {one.sec * _NS + one.nanosec for one in message.times}
        if len(stamps) > 1:
            raise LocalError(f"{topic.name}: all channels are set at one time, not at several")
        values = [_plain(one) for one in message.values]
        count = topic.transducer.type.count
        if count is not None and not isinstance(topic.transducer.type.element, Structure):
            values = [values[at : at + count] for at in range(0, len(values), count)]
        return values, stamps.pop() if stamps else 0

    def read(self, kind: str, data: bytes) -> Any:
        """Return a standard message; raises as `read_own`."""
        return self._read(self.store, kind, data)

    def _read(self, store: Any, kind: str, data: bytes) -> Any:
        try:
            return (store.deserialize_ros1 if self.is_ros1 else store.deserialize_cdr)(data, kind)
        except Exception as error:  # whatever the package raises for damaged bytes
            raise LocalError(f"a message is no {kind}: {type(error).__name__}: {error}") from None

    def diagnostics(self, status: Status, now_ns: int) -> bytes:
        """Return the state of all as a diagnostic_msgs/DiagnosticArray."""
        types = self.store.types
        one = types["diagnostic_msgs/msg/DiagnosticStatus"]
        pair = types["diagnostic_msgs/msg/KeyValue"]
        found = []
        for level, name, text, board, facts in _diagnoses(status):
            values = [pair(key, value) for key, value in facts.items()]
            found.append(one(level, f"j2a: {name}", text, board, values))
        kind = "diagnostic_msgs/msg/DiagnosticArray"
        message = types[kind](self.header(self.store, now_ns, ""), found)
        return self._serializer(self.store, kind)(message)


def _diagnoses(status: Status) -> Iterator[tuple[int, str, str, str, dict[str, str]]]:
    """Yield level (0 good, 1 warning, 2 error), name, text, hardware and facts of each part."""
    for board in status.boards:
        level = 2 if not board.is_here else int(bool(board.problem))
        facts = {"url": board.url, "clock": board.clock or "not known"}
        if board.uncertainty_us is not None:
            facts["clock uncertainty (us)"] = f"{board.uncertainty_us:.1f}"
        for topic in board.topics:
            latency = "" if topic.latency_ms is None else f", {topic.latency_ms:.2f} ms"
            skipped = f", {topic.skipped} skipped" if topic.skipped else ""
            facts[topic.name] = f"{topic.rate_hz:.1f} Hz{latency}, {topic.lost} lost{skipped}"
        text = board.problem or "samples come"
        yield level, board.name or board.url, text, board.identity, facts
    for sink in status.sinks:
        counts = {"published": str(sink.published), "dropped": str(sink.dropped)}
        yield 0 if sink.is_open else 2, f"sink {sink.name}", sink.problem or "open", "", counts


# ---------------------------------------------------------------------- values


class _Numbers:
    """Packs samples of numbers, which most are: what rosbags would do, in a tenth of the time.

    Args:
        sensor: whose values are no structures.
        is_cdr: pack for ROS 2; else for ROS 1, which has no header and aligns nothing.
    """

    def __init__(self, sensor: Transducer, *, is_cdr: bool) -> None:
        self._head = b"\0\1\0\0" if is_cdr else b""
        self._is_cdr = is_cdr
        self._most = (1 << 31) - 1 if is_cdr else (1 << 32) - 1
        self._size = sensor.type.size
        self._count = sensor.type.count or 1
        self._has_queue = sensor.queue > 0
        self._start = LOST_BYTES + 1 if self._has_queue else 0
        self._entry = self._has_queue + TIME_BYTES + self._size
        self._structs: dict[int, struct.Struct] = {}

    def pack(self, update: Update) -> bytes:
        """Return the message of a sample."""
        payload, shift, size = update.sample.payload, update.shift_us, self._size
        times = update.times_us
        count = len(times)
        # Times are 8 bytes, so values begin at a multiple of 8, where those of any size may begin.
        parts: list[int] = [count]
        for time in times:
            if time:
                seconds, us = divmod(time + shift, 1_000_000)
                if not 0 <= seconds <= self._most:
                    seconds, us = (self._most, 999_999) if seconds > 0 else (0, 0)
                parts += seconds, us * _NS_PER_US
            else:
                parts += 0, 0
        packed = self._structs.get(count)
        if packed is None:
            packed = self._structs[count] = struct.Struct(f"<{2 * count + 2}I")
        at = self._start + TIME_BYTES
        if count == 1:
            values = payload[at : at + size]
        else:
            entry = self._entry
            values = b"".join(payload[one : one + size] for one in range(at, len(payload), entry))
        data = self._head + packed.pack(*parts, count * self._count) + values
        return data + self._queued(payload, count, len(values)) if self._has_queue else data

    def _queued(self, payload: bytes, count: int, size: int) -> bytes:
        """Return the channels of values, and how many values were lost."""
        channels = payload[LOST_BYTES :: self._entry]
        if not self._is_cdr:
            return struct.pack("<I", count) + channels + payload[:LOST_BYTES]
        before, behind = bytes(-size % 4), bytes(count % 2)
        return before + struct.pack("<I", count) + channels + behind + payload[:LOST_BYTES]


def _element_type(store: Any, kind: str, field: str = "values") -> str:
    """Return the type of the elements of a field that holds structures."""
    _, fields = store.fielddefs[kind]
    return str(dict(fields)[field][1][0][1])


def _record(store: Any, name: str, record: Any) -> Any:
    """Return a structure of NumPy as a message of ROS, field by field."""
    fields = dict(store.fielddefs[name][1])
    values = []
    for (field, kind), value in zip(fields.items(), record, strict=True):
        values.append(_field_value(store, kind, value, field))
    return store.types[name](*values)


def _field_value(store: Any, kind: Any, value: Any, field: str) -> Any:
    node, detail = kind[0].name, kind[1]
    if node == "NAME":
        return _record(store, detail, value)
    if node == "ARRAY":
        inner = detail[0]
        if inner[0].name == "NAME":
            return [_record(store, inner[1], one) for one in value]
        return np.ascontiguousarray(value)
    return value.item() if hasattr(value, "item") else value


def _plain(value: Any) -> Any:
    """Return a value of a message as the library takes it: a number, or a list."""
    if hasattr(value, "__dataclass_fields__"):
        names = [one for one in value.__dataclass_fields__ if one != "__msgtype__"]
        return [_plain(getattr(value, one)) for one in names if not one.isupper()]
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, list):
        return [_plain(one) for one in value]
    return value.item() if hasattr(value, "item") else value


# ---------------------------------------------------------------------- standard messages


class _Newest:
    """Finds what is new of one channel: a sample has all channels, whichever was read.

    Args:
        sensor: without a queue.
        channel: of it.
    """

    def __init__(self, sensor: Transducer, channel: int) -> None:
        self._is_alone = sensor.channels == 1
        self._channel = channel
        self._before = b""

    def of(self, update: Update) -> tuple[Any, int] | None:
        """Return the value and its stamp; None where there is none, or it was there before."""
        reading, stamp = update.sample.readings[self._channel], update.stamps_ns[self._channel]
        is_always_new = self._is_alone or update.sample.is_reset
        is_old = not is_always_new and update.is_old(self._channel, self._before)
        self._before = update.sample.payload
        return None if is_old or reading.value is None or stamp is None else (reading.value, stamp)


def _standard(topic: Topic, ros: RosMessages) -> Iterator[Message]:
    """Yield the standard messages that fit a sensor."""
    sensor = topic.transducer
    if sensor.queue:
        return
    store = ros.store
    kind = sensor.type.element
    if isinstance(kind, Structure):
        if sensor.type.count is None:
            yield from _of_structure(topic, ros, kind)
        return
    quantity = quantity_of(sensor.unit)
    if quantity is None or number_element(sensor.type) is None:
        return
    if quantity.kind == "angle":
        yield _joint_state(topic, ros, quantity)
        return
    found = _NUMBERS.get(quantity.kind)
    if quantity.kind == "share" and "humid" in f"{sensor.name} {sensor.model} {sensor.doc}".lower():
        found = _NUMBERS["humidity"]
    if found is None:
        return
    suffix, name, fill = found
    for channel in range(sensor.channels):
        make = store.types[f"sensor_msgs/msg/{name}"]
        serialize = ros._serializer(store, f"sensor_msgs/msg/{name}")
        newest = _Newest(sensor, channel)
        behind = suffix if sensor.channels == 1 else f"{suffix}_{channel}"

        def pack(
            update: Update, newest: _Newest = newest, make: Any = make, serialize: Any = serialize
        ) -> bytes | None:
            found = newest.of(update)
            if found is None:
                return None
            number, stamp = found
            value = number * quantity.factor + quantity.offset
            header = ros.header(store, stamp, topic.name)
            return bytes(serialize(make(header, **fill(sensor, quantity, value, make))))

        yield Message(f"{topic.name}/{behind}", f"sensor_msgs/msg/{name}", pack)


def _scalar(field: str) -> Callable[[Transducer, Quantity, float, Any], dict[str, Any]]:
    def fill(sensor: Transducer, quantity: Quantity, value: float, make: Any) -> dict[str, Any]:
        del make
        return {field: value, "variance": _variance(sensor, quantity)}

    return fill


def _range(sensor: Transducer, quantity: Quantity, value: float, make: Any) -> dict[str, Any]:
    low, high = 0.0, math.inf
    if sensor.range is not None:
        ends = (one * sensor.scale + sensor.offset for one in sensor.range)
        low, high = sorted(one * quantity.factor for one in ends)
    about = f"{sensor.name} {sensor.model} {sensor.doc}".lower()
    is_infrared = "infrared" in about or "_ir" in about or "gp2" in about or "tof" in about
    fields = {
        "radiation_type": int(is_infrared),
        "field_of_view": 0.0,
        "min_range": _as_f32(low),
        "max_range": _as_f32(high),
        "range": _as_f32(value),
    }
    if "variance" in make.__dataclass_fields__:
        fields["variance"] = _as_f32(_variance(sensor, quantity))
    return fields


def _as_f32(value: float) -> float:
    """Return a number as a field of 32 bits takes it: infinite where it is beyond these."""
    try:
        struct.pack("<f", value)
    except OverflowError:
        return math.copysign(math.inf, value)
    return value


def _variance(sensor: Transducer, quantity: Quantity) -> float:
    """Return the square of the accuracy, 0 where it is not known, as messages want it."""
    error = (sensor.accuracy or 0.0) * quantity.factor
    return error * error  # where a power would raise, this is infinite


_NUMBERS: Final[Mapping[str, tuple[str, str, Callable[..., dict[str, Any]]]]] = {
    "length": ("range", "Range", _range),
    "temperature": ("temperature", "Temperature", _scalar("temperature")),
    "pressure": ("pressure", "FluidPressure", _scalar("fluid_pressure")),
    "illuminance": ("illuminance", "Illuminance", _scalar("illuminance")),
    "humidity": ("humidity", "RelativeHumidity", _scalar("relative_humidity")),
}


def _joint_state(topic: Topic, ros: RosMessages, quantity: Quantity) -> Message:
    """Return the angles of the channels that were read as positions of joints."""
    kind = "sensor_msgs/msg/JointState"
    store, make = ros.store, ros.store.types[kind]
    serialize = ros._serializer(store, kind)
    channels = topic.transducer.channels
    base = topic.name.replace("/", "_")
    names = [base] if channels == 1 else [f"{base}_{channel}" for channel in range(channels)]
    newest = [_Newest(topic.transducer, channel) for channel in range(channels)]
    nothing = np.zeros(0)

    def pack(update: Update) -> bytes | None:
        # The message has one stamp: the position of a joint that was not read is not of that time.
        found = zip(names, [one.of(update) for one in newest], strict=True)
        there = [(name, *one) for name, one in found if one is not None]
        if not there:
            return None
        positions = np.array([value * quantity.factor for _, value, _ in there])
        header = ros.header(store, max(stamp for _, _, stamp in there), topic.name)
        joints = [name for name, _, _ in there]
        return serialize(make(header, joints, positions, nothing, nothing))

    return Message(f"{topic.name}/joints", kind, pack)


def _of_structure(topic: Topic, ros: RosMessages, structure: Structure) -> Iterator[Message]:
    """Yield the standard messages that the fields of a structure fill."""
    vectors: dict[str, tuple[int, Quantity]] = {}
    for at, field in enumerate(structure.fields):
        quantity = quantity_of(field.type.unit)
        is_vector = field.type.count == 3 and isinstance(field.type.element, str)
        if quantity is not None and is_vector:
            vectors.setdefault(quantity.kind, (at, quantity))
    makers: list[tuple[str, str, Callable[[Sequence[Any]], dict[str, Any] | None]]] = []
    if "angular velocity" in vectors and "acceleration" in vectors:
        makers.append(("imu", "Imu", _imu(ros.store, vectors)))
    if "magnetic field" in vectors:
        makers.append(("magnetic_field", "MagneticField", _magnetic(ros.store, vectors)))
    position = _position(ros.store, structure)
    if position is not None:
        makers.append(("fix", "NavSatFix", position))
    for suffix, name, fields_of in makers:
        yield from _structured(topic, ros, suffix, f"sensor_msgs/msg/{name}", fields_of)


def _structured(
    topic: Topic,
    ros: RosMessages,
    suffix: str,
    kind: str,
    fields_of: Callable[[Sequence[Any]], dict[str, Any] | None],
) -> Iterator[Message]:
    store, make = ros.store, ros.store.types[kind]
    serialize = ros._serializer(store, kind)
    channels = topic.transducer.channels
    for channel in range(channels):
        behind = suffix if channels == 1 else f"{suffix}_{channel}"
        newest = _Newest(topic.transducer, channel)

        def pack(update: Update, newest: _Newest = newest) -> bytes | None:
            found = newest.of(update)
            if found is None:
                return None
            value, stamp = found
            fields = fields_of(value)
            if fields is None:
                return None
            return serialize(make(header=ros.header(store, stamp, topic.name), **fields))

        yield Message(f"{topic.name}/{behind}", kind, pack)


def _vector(store: Any, values: Sequence[Any], place: tuple[int, Quantity]) -> Any:
    at, quantity = place
    return store.types["geometry_msgs/msg/Vector3"](*(one * quantity.factor for one in values[at]))


def _imu(store: Any, places: Mapping[str, Any]) -> Callable[[Sequence[Any]], dict[str, Any]]:
    unknown = np.array([_UNKNOWN, *[0.0] * 8])
    open_ = np.zeros(9)

    def fields(values: Sequence[Any]) -> dict[str, Any]:
        return {
            "orientation": store.types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
            "orientation_covariance": unknown,  # there is none, as its first number says
            "angular_velocity": _vector(store, values, places["angular velocity"]),
            "angular_velocity_covariance": open_,
            "linear_acceleration": _vector(store, values, places["acceleration"]),
            "linear_acceleration_covariance": open_,
        }

    return fields


def _magnetic(store: Any, places: Mapping[str, Any]) -> Callable[[Sequence[Any]], dict[str, Any]]:
    return lambda values: {
        "magnetic_field": _vector(store, values, places["magnetic field"]),
        "magnetic_field_covariance": np.zeros(9),
    }


def _position(
    store: Any, structure: Structure
) -> Callable[[Sequence[Any]], dict[str, Any] | None] | None:
    """Return what makes a position of latitude and longitude in degrees, None without them."""
    places: dict[str, tuple[int, float]] = {}
    for at, field in enumerate(structure.fields):
        name, quantity = field.name.lower(), quantity_of(field.type.unit)
        if field.type.count is not None or quantity is None:
            continue
        for key, kind in (("latitude", "angle"), ("longitude", "angle"), ("altitude", "length")):
            if name.startswith(key[:3]) and quantity.kind == kind:
                degrees = 180 / math.pi if kind == "angle" else 1.0
                places.setdefault(key, (at, quantity.factor * degrees))
    if not {"latitude", "longitude"} <= places.keys():
        return None

    def fields(values: Sequence[Any]) -> dict[str, Any] | None:
        found = {key: values[at] * factor for key, (at, factor) in places.items()}
        return {
            "status": store.types["sensor_msgs/msg/NavSatStatus"](0, 1),
            "altitude": math.nan,
            **found,
            "position_covariance": np.zeros(9),
            "position_covariance_type": 0,
        }

    return fields
