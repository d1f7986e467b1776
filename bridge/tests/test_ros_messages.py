"""Messages of ROS: their types, their bytes, and which standard ones a sensor is published as."""

import gc
import itertools
import math
import struct
import weakref
from collections.abc import Container
from concurrent.futures import Future
from functools import cache
from typing import Any

import numpy as np
import pytest
from j2a_bridge import ros_messages
from j2a_bridge.actuators import FLOATS, _watched, set_by_command, set_by_own
from j2a_bridge.config import MESSAGES
from j2a_bridge.ros_messages import RosMessages
from j2a_bridge.sink import BoardStatus, SinkStatus, Status, Times, TopicStatus, Update
from j2a_bridge.topics import Topic
from rosbags.typesys import Stores, get_typestore

from j2a import LocalError, Sample
from j2a.protocol.device_info import DeviceInfo
from j2a.types.samples import SampleCodec
from j2a.types.transds_file import read_transds

DISTROS = ("noetic", "humble", "jazzy")
messages_for = cache(RosMessages)
"""One for all topics, as a sink has it; it compiles what reads and writes each type once."""


def topic_of(definition: str, message: str = "auto", name: str = "") -> Topic:
    """Return the topic of the first transducer of a transds.def."""
    descriptors = read_transds(definition)
    first = descriptors.transducers[0]
    return Topic(name or first.name, "board", first, descriptors, message)


def update_of(topic: Topic, payload: bytes, shift_us: int = 0, arrived_ns: int = 0) -> Update:
    """Return a sample with a payload as the library would deliver it."""
    codec = SampleCodec(topic.transducer, DeviceInfo().types)
    if topic.transducer.queue:
        lost, readings, _, _ = codec.times_queued(payload)
    else:
        lost, (readings, _) = 0, codec.times(payload)
    sample = Sample("b", topic.transducer.name, 0, readings, 0.0, topic.transducer.unit, lost)
    object.__setattr__(sample, "payload", payload)
    times = Times(topic.transducer).of(payload)
    return Update(topic, sample, times, shift_us, arrived_ns)


def published(topic: Topic, payload: bytes, distro: str, shift_us: int = 0) -> dict[str, object]:
    """Return the messages of a sample by their topic, as another reader sees them."""
    ros = messages_for(distro)
    update = update_of(topic, payload, shift_us)
    store = ros.store_of(topic.descriptors)
    found = {}
    for message in ros.messages(topic):
        data = message.pack(update)
        if data is not None:
            read = store.deserialize_ros1 if ros.is_ros1 else store.deserialize_cdr
            found[message.topic] = read(data, message.type)
    return found


QUAD = "SENSOR(quad, 0, quad, HEDS-6500, 2, int16_t, none)"
ONE = "SENSOR(quad, 0, quad, HEDS-6500, 1, int16_t, none)"


def test_the_type_of_the_thesis_has_its_text_and_its_sum() -> None:
    topic = topic_of(QUAD)
    text, md5 = messages_for("noetic").definition(topic, "j2a_msgs/msg/quad")
    assert text == "time[] times\nint16[] values\n"
    assert md5 == "46f0c8d8ff1275189412c2debb4f0ce2"


@pytest.mark.parametrize(
    ("distro", "golden"),
    [
        ("noetic", "020000000100000000000000020000000000000002000000" + "0300fcff"),
        ("jazzy", "00010000" + "020000000100000000000000020000000000000002000000" + "0300fcff"),
    ],
)
def test_the_bytes_of_a_sample(distro: str, golden: str) -> None:
    topic = topic_of(QUAD)
    payload = struct.pack("<QhQh", 1_000_000, 3, 2_000_000, -4)
    [message] = messages_for(distro).messages(topic)[:1]
    data = message.pack(update_of(topic, payload))
    assert data is not None
    assert data.hex() == golden


def test_descriptors_without_end_do_not_fill_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """A board may restart with other ones again and again."""
    monkeypatch.setattr(ros_messages, "_MOST_STORES", 4)
    ros = RosMessages("humble")
    topics = [topic_of(f"SENSOR(s{n}, 0, s{n}, M, 1, u8, none)") for n in range(10)]
    stores = weakref.WeakSet(ros.store_of(topic.descriptors) for topic in topics)
    gc.collect()
    assert len(stores) <= 4
    assert ros.type_of(topics[0]) in ros.store_of(topics[0].descriptors).types


def test_the_hash_of_a_type_of_ros2_is_the_known_one() -> None:
    topic = topic_of(QUAD)
    store = messages_for("jazzy").store_of(topic.descriptors)
    known = "RIHS01_893f27f2d0c94f6c987b3f402c93b264222f3d91d18b6415e0e15590a61f9ce8"
    assert store.hash_rihs01("j2a_msgs/msg/Quad") == known


@pytest.mark.parametrize("distro", DISTROS)
@pytest.mark.parametrize(
    ("shift_us", "expected"),
    [
        (-2_000_000, (0, 0)),
        (1 << 60, None),
        (((1 << 31) - 2) * 1_000_000, ((1 << 31) - 1, 500_000_000)),
        (-1_500_000, (0, 0)),
        (-1_499_999, (0, 1000)),
    ],
)
def test_times_before_1970_and_beyond_the_last_one_are_the_nearest(
    distro: str, shift_us: int, expected: tuple[int, int] | None
) -> None:
    topic = topic_of(ONE, "raw")
    [message] = published(topic, struct.pack("<Qh", 1_500_000, 3), distro, shift_us).values()
    last = (1 << 32) - 1 if distro == "noetic" else (1 << 31) - 1
    [time] = message.times
    # rosbags reads seconds of ROS 1 with a sign, which they do not have.
    sec = time.sec & 0xFFFFFFFF
    assert (sec, time.nanosec) == (expected or (last, 999_999_000))


@pytest.mark.parametrize("distro", DISTROS)
@pytest.mark.parametrize("shift_us", [0, 5, 1_700_000_000_000_000])
def test_times_are_those_of_the_source_and_none_stays_none(distro: str, shift_us: int) -> None:
    topic = topic_of(QUAD, "raw")
    payload = struct.pack("<QhQh", 1_500_000, 3, 0, 0)
    [message] = published(topic, payload, distro, shift_us).values()
    seconds, us = divmod(1_500_000 + shift_us, 1_000_000)
    times = [(one.sec, one.nanosec) for one in message.times]
    assert times == [(seconds, us * 1000), (0, 0)]


@pytest.mark.parametrize("distro", DISTROS)
@pytest.mark.parametrize("kind", ["u8", "i8", "u16", "i16", "u32", "i32", "u64", "i64"])
@pytest.mark.parametrize("channels", [1, 3])
def test_integers_of_each_type(distro: str, kind: str, channels: int) -> None:
    topic = topic_of(f"SENSOR(s, 0, s, M, {channels}, {kind}, none)", "raw")
    size = int(kind[1:]) // 8
    low, high = (0, (1 << 8 * size) - 1) if kind[0] == "u" else (-(1 << 8 * size - 1), 5)
    values = [low, high, 1][:channels]
    payload = b"".join(
        struct.pack("<Q", 7) + value.to_bytes(size, "little", signed=kind[0] == "i")
        for value in values
    )
    [message] = published(topic, payload, distro).values()
    assert message.values.tolist() == values


@pytest.mark.sampled(5)  # of each kind with and without a queue, and of each number of channels
@pytest.mark.parametrize("distro", DISTROS)
@pytest.mark.parametrize(
    "kind", ["u8", "i16", "u32", "f64", "bool", "array(u8, 3)", "array(i32, 2)"]
)
@pytest.mark.parametrize("channels", [1, 2, 3, 5])
@pytest.mark.parametrize("queue", [0, 7])
def test_bytes_are_those_of_rosbags(distro: str, kind: str, channels: int, queue: int) -> None:
    more = f", (queue, {queue})" if queue else ""
    topic = topic_of(f"SENSOR(s, 0, s, M, {channels}, {kind}, none{more})", "raw")
    size, ros = topic.transducer.type.size, messages_for(distro)
    store, name = ros.store_of(topic.descriptors), ros.type_of(topic)
    for number in range(1, 8) if queue else (channels,):
        entries = b"".join(
            bytes([at % channels] * bool(queue))
            + struct.pack("<Q", (at % 3) * 1_500_000_000 + at)
            + bytes((at + one) % 2 for one in range(size))
            for at in range(number)
        )
        payload = (b"\5\1" if queue else b"") + entries
        [message] = ros.messages(topic)
        data = message.pack(update_of(topic, payload, 123_456))
        read = store.deserialize_ros1 if ros.is_ros1 else store.deserialize_cdr
        write = store.serialize_ros1 if ros.is_ros1 else store.serialize_cdr
        assert bytes(write(read(data, name), name)) == data


@pytest.mark.parametrize("distro", DISTROS)
def test_floats_bools_arrays_and_queues(distro: str) -> None:
    f32 = topic_of("SENSOR(s, 0, s, M, 1, float, none)", "raw")
    [message] = published(f32, struct.pack("<Qf", 7, 1.5), distro).values()
    assert message.values.tolist() == [1.5]
    flag = topic_of("SENSOR(s, 0, s, M, 2, bool, none)", "raw")
    [message] = published(flag, struct.pack("<Q?Q?", 7, True, 8, False), distro).values()
    assert [bool(one) for one in message.values] == [True, False]
    array = topic_of("SENSOR(s, 0, s, M, 2, array(u16, 2), none)", "raw")
    [message] = published(array, struct.pack("<QHHQHH", 7, 1, 2, 7, 3, 4), distro).values()
    assert message.values.tolist() == [1, 2, 3, 4]
    queue = topic_of("SENSOR(s, 0, s, M, 2, u8, none, (queue, 4))", "raw")
    payload = struct.pack("<HBQBBQB", 5, 1, 70, 9, 0, 80, 8)
    [message] = published(queue, payload, distro).values()
    assert (message.values.tolist(), message.channels.tolist(), message.lost) == ([9, 8], [1, 0], 5)


IMU = """
J2A_STRUCT(motion, (array(i16, 3), rate, mdeg/s), (array(i16, 3), acceleration, mg),
           (array(i16, 3), field, uT))
SENSOR(imu, 3, imu, M, 1, motion, none)
"""


@pytest.mark.parametrize("distro", DISTROS)
def test_a_structure_is_itself_and_what_its_fields_measure(distro: str) -> None:
    topic = topic_of(IMU)
    payload = struct.pack("<Q9h", 7_000_000, 1000, 0, -2000, 0, 0, 1000, 40, 0, -1)
    found = published(topic, payload, distro)
    assert set(found) == {"imu", "imu/imu", "imu/magnetic_field"}
    assert found["imu"].values[0].rate.tolist() == [1000, 0, -2000]
    imu = found["imu/imu"]
    assert imu.angular_velocity.z == pytest.approx(-2 * math.pi / 180)
    assert imu.linear_acceleration.z == pytest.approx(9.80665)
    assert imu.orientation_covariance[0] == -1
    assert imu.header.stamp.sec == 7
    assert found["imu/magnetic_field"].magnetic_field.x == pytest.approx(40e-6)


@pytest.mark.parametrize("distro", DISTROS)
def test_ranges_are_in_metres_one_for_each_channel_and_none_where_it_is_na(distro: str) -> None:
    topic = topic_of(
        "SENSOR(dist_us, 2, srf02, SRF02, 2, u16, 0, (unit, cm), (range, 15, 600), (accuracy, 3))"
    )
    found = published(topic, struct.pack("<QHQH", 7, 250, 8, 0), distro)
    assert set(found) == {"dist_us", "dist_us/range_0"}
    one = found["dist_us/range_0"]
    assert one.range == pytest.approx(2.5)
    assert (one.min_range, one.max_range) == (pytest.approx(0.15), pytest.approx(6.0))
    assert one.radiation_type == 0
    if distro == "jazzy":
        assert one.variance == pytest.approx(0.0009)


@pytest.mark.parametrize("distro", DISTROS)
@pytest.mark.parametrize(("value", "told"), [(1e39, math.inf), (-1e300, -math.inf), (1.5, 1.5)])
def test_a_distance_that_32_bits_do_not_hold_is_infinite(
    distro: str, value: float, told: float
) -> None:
    topic = topic_of(
        "SENSOR(s, 0, s, M, 1, f64, none, (unit, m), (range, -1e300, 1e300), (accuracy, 1e30))"
    )
    one = published(topic, struct.pack("<Qd", 7, value), distro)["s/range"]
    assert (one.range, one.min_range, one.max_range) == (told, -math.inf, math.inf)
    if distro == "jazzy":
        assert one.variance == math.inf


@pytest.mark.parametrize("distro", DISTROS)
def test_a_variance_beyond_all_numbers_is_infinite(distro: str) -> None:
    topic = topic_of("SENSOR(s, 0, s, M, 1, f64, none, (unit, Cel), (accuracy, 1e200))")
    found = published(topic, struct.pack("<Qd", 7, 1.5), distro)["s/temperature"]
    assert (found.temperature, found.variance) == (1.5, math.inf)


@pytest.mark.parametrize(
    ("unit", "name", "suffix", "field", "raw", "value"),
    [
        ("Cel", "t", "temperature", "temperature", 21.5, 21.5),
        ("K", "t", "temperature", "temperature", 300.0, 26.85),
        ("hPa", "p", "pressure", "fluid_pressure", 1013.0, 101300.0),
        ("lx", "l", "illuminance", "illuminance", 12.0, 12.0),
        ("%", "humidity", "humidity", "relative_humidity", 40.0, 0.4),
        ("m", "d", "range", "range", 1.5, 1.5),
    ],
)
def test_units_choose_the_message(
    unit: str, name: str, suffix: str, field: str, raw: float, value: float
) -> None:
    topic = topic_of(f"SENSOR({name}, 0, s, M, 1, double, nan, (unit, {unit}))")
    size = topic.transducer.type.size
    found = published(topic, struct.pack("<Q" + {4: "f", 8: "d"}[size], 7, raw), "noetic")
    assert getattr(found[f"{name}/{suffix}"], field) == pytest.approx(value, rel=1e-6)


@pytest.mark.parametrize("unit", ["", "V", "%", "furlong"])
def test_what_is_not_known_is_only_its_own_message(unit: str) -> None:
    topic = topic_of(f"SENSOR(s, 0, s, M, 1, u8, none, (unit, {unit}))" if unit else ONE)
    assert [one.topic for one in messages_for("jazzy").messages(topic)] == [topic.name]


def test_angles_are_positions_of_joints_in_radians() -> None:
    topic = topic_of(
        "SENSOR(quad, 0, quad, M, 2, i16, -1, (unit, deg), (scale, 0.5))", name="left/quad"
    )
    found = published(topic, struct.pack("<QhQh", 8_000_000, 180, 9_000_000, -1), "jazzy")
    joints = found["left/quad/joints"]
    assert joints.name == ["left_quad_0"]
    assert joints.position.tolist() == [pytest.approx(math.pi / 2)]
    assert joints.header.stamp.sec == 8  # that of the joint, not of the one that is N/A


def test_a_joint_that_was_not_read_is_in_no_message() -> None:
    ros = messages_for("noetic")
    topic = topic_of("SENSOR(quad, 0, quad, M, 3, i16, none, (unit, rad))")
    [_, message] = ros.messages(topic)

    def joints_of(*parts: int) -> Any:
        data = message.pack(update_of(topic, struct.pack("<QhQhQh", *parts)))
        if data is None:
            return None
        found = ros.read(message.type, data)
        return found.header.stamp.sec, dict(zip(found.name, found.position, strict=True))

    second = 1_000_000
    assert joints_of(second, 5, 0, 0, 2 * second, 6) == (2, {"quad_0": 5, "quad_2": 6})
    assert joints_of(3 * second, 5, 0, 0, 2 * second, 6) == (3, {"quad_0": 5})
    assert joints_of(3 * second, 5, 0, 0, 2 * second, 6) is None
    # The stamp is that of the joints which are in it, and not of one that was newer before.
    assert joints_of(3 * second, 5, 2 * second, 7, 2 * second, 6) == (2, {"quad_1": 7})


@pytest.mark.sampled(5)  # of each channel the newest, and the one that was not read
@pytest.mark.parametrize("distro", DISTROS)
@pytest.mark.parametrize("seconds", list(itertools.product([0, 2, 3, 4], repeat=3)))
def test_joints_are_of_the_time_of_the_newest_one(distro: str, seconds: tuple[int, ...]) -> None:
    """Whichever of the channels it is; those without a time were not read."""
    topic = topic_of("SENSOR(quad, 0, quad, M, 3, i16, none, (unit, rad))")
    payload = b"".join(struct.pack("<Qh", one * 1_000_000, 7) for one in seconds)
    joints: Any = published(topic, payload, distro).get("quad/joints")
    read = [f"quad_{channel}" for channel, one in enumerate(seconds) if one]
    if read:
        assert joints.name == read
        assert joints.header.stamp.sec == max(seconds)
    else:
        assert joints is None


@pytest.mark.parametrize("kind", ["sensor_msgs/Imu", "sensor_msgs/Nonsense"])
def test_a_message_that_does_not_fit_is_told_and_the_own_one_stays(kind: str, caplog: Any) -> None:
    topic = topic_of("SENSOR(d, 0, s, M, 1, u16, 0, (unit, cm))", kind)
    assert [one.topic for one in messages_for("jazzy").messages(topic)] == ["d"]
    assert f"d does not fit into {kind}; what fits is: sensor_msgs/Range" in caplog.text


def test_a_chosen_message_is_the_only_one() -> None:
    definition = "SENSOR(d, 0, s, M, 1, u16, 0, (unit, cm))"
    ros = messages_for("jazzy")
    assert [one.type for one in ros.messages(topic_of(definition, "sensor_msgs/Range"))] == [
        "sensor_msgs/msg/Range"
    ]


UNITS = ("Pa", "lx", "deg", "m", "%", "Cel")


def test_the_configuration_knows_the_standard_messages() -> None:
    definitions = [f"SENSOR(humid, 0, s, M, 1, u8, none, (unit, {unit}))" for unit in UNITS]
    ros = messages_for("noetic")
    found = {
        one.type.replace("/msg/", "/")
        for definition in (*definitions, IMU, FIX)
        for one in ros.messages(topic_of(definition))[1:]
    }
    assert found == set(MESSAGES[2:])


@pytest.mark.parametrize("distro", DISTROS)
def test_messages_for_actuators_are_read_as_raw_values_and_a_time(distro: str) -> None:
    topic = topic_of("ACTUATOR(servo, 1, servo, M, 2, int8_t, 0)")
    ros = messages_for(distro)
    store, kind = ros.store_of(topic.descriptors), ros.type_of(topic)
    make = store.types[kind]
    write = store.serialize_ros1 if ros.is_ros1 else store.serialize_cdr
    values = np.array([3, -4], "i1")
    now = write(make([], values), kind)
    assert ros.read_own(topic, now) == ([3, -4], 0)
    later = write(make([ros.time(1_500_000_000)] * 2, values), kind)
    assert ros.read_own(topic, later) == ([3, -4], 1_500_000_000)
    mixed = write(make([ros.time(1), ros.time(2)], values), kind)
    with pytest.raises(LocalError, match="at one time"):
        ros.read_own(topic, mixed)
    for end in range(4, len(now) - 1):
        with pytest.raises(LocalError, match="is no j2a_msgs"):
            ros.read_own(topic, bytes(now)[:end])


@pytest.mark.parametrize("distro", DISTROS)
def test_diagnostics_tell_what_is_wrong(distro: str) -> None:
    ros = messages_for(distro)
    topics = (TopicStatus("quad", 10, 99.9, 0.5, 3, 0), TopicStatus("thin", 10, 5.0, None, 0, 7))
    status = Status(
        "host",
        (
            BoardStatus("left", "A1", "tcp://x", True, "", "locked", 1.0, 2.5, topics),
            BoardStatus("", "", "tcp://y", False, "nothing listens there"),
        ),
        (SinkStatus("udp", False, "no route", 5, 6),),
    )
    kind = "diagnostic_msgs/msg/DiagnosticArray"
    message = ros.read(kind, ros.diagnostics(status, 3_000_000_005))
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (3, 5)
    found = {one.name: one for one in message.status}
    assert [int(one.level) for one in message.status] == [0, 2, 2]
    assert found["j2a: tcp://y"].message == "nothing listens there"
    facts = {one.key: one.value for one in found["j2a: left"].values}
    assert facts["quad"] == "99.9 Hz, 0.50 ms, 3 lost"
    assert facts["thin"] == "5.0 Hz, 0 lost, 7 skipped"
    assert facts["clock"] == "locked"


@pytest.mark.parametrize("distro", DISTROS)
@pytest.mark.parametrize("is_here", [False, True])
@pytest.mark.parametrize("problem", ["", "odd"])
@pytest.mark.parametrize("count", [0, 5])
def test_the_level_of_diagnostics_is_that_of_the_state_now(
    distro: str, is_here: bool, problem: str, count: int
) -> None:
    """Not of what was before: a board or a sink that has gone may have done well."""
    ros = messages_for(distro)
    topics = (TopicStatus("quad", count, 0.0, None, 0, 0),) * bool(count)
    board = BoardStatus("left", "A1", "tcp://x", is_here, problem, topics=topics)
    status = Status("host", (board,), (SinkStatus("udp", is_here, problem, count, 0),))
    message = ros.read("diagnostic_msgs/msg/DiagnosticArray", ros.diagnostics(status, 5))
    levels = [int(one.level) for one in message.status]
    assert levels == ([int(bool(problem)), 0] if is_here else [2, 2])


@pytest.mark.parametrize("distro", DISTROS)
def test_transducers_of_equal_shape_have_each_its_own_type(distro: str) -> None:
    names = ["left", "right", "wheel", "servo"]
    text = "".join(
        f"{'ACTUATOR' if name == 'servo' else 'SENSOR'}({name}, {at}, {name}, M, 1, u8, 0)\n"
        for at, name in enumerate(names)
    )
    ros, descriptors = messages_for(distro), read_transds(text)
    found = [ros.type_of(Topic(one.name, "b", one, descriptors)) for one in descriptors.transducers]
    expected = names if ros.is_ros1 else [name.capitalize() for name in names]
    assert found == [f"j2a_msgs/msg/{name}" for name in expected]


def test_types_of_boards_that_differ_do_not_meet() -> None:
    ros = messages_for("jazzy")
    one, other = topic_of(QUAD), topic_of("SENSOR(quad, 0, quad, M, 2, u8, none)")
    assert ros.definition(one, ros.type_of(one)) != ros.definition(other, ros.type_of(other))
    assert get_typestore(Stores.ROS2_JAZZY).types.keys() == ros.store.types.keys()


def test_an_actuator_is_not_published() -> None:
    for distro in DISTROS:
        topic = topic_of("ACTUATOR(servo, 1, servo, M, 2, int8_t, 0, (unit, deg))")
        assert messages_for(distro).messages(topic) == []


@pytest.mark.parametrize("distro", DISTROS)
def test_a_time_beyond_what_a_message_can_hold_is_the_nearest(distro: str) -> None:
    last = (1 << 32 if distro == "noetic" else 1 << 31) - 1
    ros = messages_for(distro)
    for seconds in (0, 1, (1 << 31) - 1, 1 << 31, (1 << 32) - 1, 1 << 32, 1 << 40):
        time = ros.time(seconds * 1_000_000_000 + 5)
        is_inside = seconds <= last
        assert (time.sec, time.nanosec) == ((seconds, 5) if is_inside else (last, 999_999_999))
    assert (ros.time(-1).sec, ros.time(-1).nanosec) == (0, 0)


def stamps_of(definition: str, *samples: Any, resets: Container[int] = ()) -> list[Any]:
    """Return of each sample the standard messages, with the seconds of their stamps."""
    ros, topic = messages_for("noetic"), topic_of(definition)
    messages = ros.messages(topic)[1:]
    found = []
    for number, payload in enumerate(samples):
        update = update_of(topic, payload)
        object.__setattr__(update.sample, "is_reset", number in resets)
        packed = [(one, one.pack(update)) for one in messages]
        found.append(
            {
                one.topic: ros.read(one.type, data).header.stamp.sec
                for one, data in packed
                if data is not None
            }
        )
    return found


RANGE = "SENSOR(d, 0, s, M, {}, u16, 0, (unit, cm))"


def test_a_channel_that_was_not_read_is_not_published_again() -> None:
    first = struct.pack("<QHQH", 1_000_000, 50, 2_000_000, 60)
    later = struct.pack("<QHQH", 1_000_000, 50, 3_000_000, 60)
    other = struct.pack("<QHQH", 1_000_000, 51, 3_000_000, 60)
    both = {"d/range_0": 1, "d/range_1": 2}
    found = stamps_of(RANGE.format(2), first, later, other, other, first, first, resets={5})
    assert found == [both, {"d/range_1": 3}, {"d/range_0": 1}, {}, both, both]


def test_a_structure_that_was_not_read_is_not_published_again() -> None:
    values = struct.pack("<9h", *range(9))
    samples = [
        b"".join(struct.pack("<Q", time * 1_000_000) + values for time in times)
        for times in ((1, 2), (1, 3))
    ]
    found = stamps_of(IMU.replace("M, 1, motion", "M, 2, motion"), *samples)
    assert found[1] == {"imu/imu_1": 3, "imu/magnetic_field_1": 3}
    assert len(found[0]) == 4


NAN = struct.pack("<f", math.nan)
PAIR = "J2A_STRUCT(place, (array(f32, 3), field, uT))\nSENSOR(d, 0, s, M, 2, place, none)"


@pytest.mark.parametrize(
    ("definition", "value", "first", "second"),
    [
        (
            "SENSOR(d, 0, s, M, 2, f32, none, (unit, Cel))",
            NAN,
            {"d/temperature_0": 1, "d/temperature_1": 2},
            {"d/temperature_1": 3},
        ),
        (
            PAIR,
            bytes(4) + NAN + bytes(4),
            {"d/magnetic_field_0": 1, "d/magnetic_field_1": 2},
            {"d/magnetic_field_1": 3},
        ),
    ],
)
def test_what_is_no_number_is_not_published_again_either(
    definition: str, value: bytes, first: dict[str, int], second: dict[str, int]
) -> None:
    samples = [
        b"".join(struct.pack("<Q", time * 1_000_000) + value for time in times)
        for times in ((1, 2), (1, 3), (1, 3))
    ]
    assert stamps_of(definition, *samples) == [first, second, {}]


def test_of_a_channel_that_is_alone_each_sample_is_published() -> None:
    sample = struct.pack("<QH", 1_000_000, 50)
    assert stamps_of(RANGE.format(1), sample, sample) == [{"d/range": 1}] * 2


@pytest.mark.parametrize("distro", DISTROS)
@pytest.mark.parametrize(("scale", "ends"), [(1, (0.15, 6.0)), (-1, (-6.0, -0.15))])
def test_the_lower_end_of_a_range_is_the_lower_one(
    distro: str, scale: int, ends: tuple[float, float]
) -> None:
    definition = f"SENSOR(d, 0, s, M, 1, i16, 0, (unit, cm), (scale, {scale}), (range, 15, 600))"
    one = published(topic_of(definition), struct.pack("<Qh", 7, 100), distro)["d/range"]
    assert (one.min_range, one.max_range) == pytest.approx(ends)


@pytest.mark.parametrize("distro", DISTROS)
def test_each_channel_of_a_structure_has_its_own_time(distro: str) -> None:
    topic = topic_of(IMU.replace("M, 1, motion", "M, 2, motion"))
    values = struct.pack("<9h", *range(9))
    payload = b"".join(struct.pack("<Q", time) + values for time in (5_000_000, 9_000_000))
    found = published(topic, payload, distro)
    stamps = {name: one.header.stamp.sec for name, one in found.items() if "/" in name}
    assert stamps == {
        "imu/imu_0": 5, "imu/imu_1": 9, "imu/magnetic_field_0": 5, "imu/magnetic_field_1": 9,
    }  # fmt: skip
    found = published(topic, bytes(8) + values + payload[-26:], distro)
    assert set(found) == {"imu", "imu/imu_1", "imu/magnetic_field_1"}


FIX = """
J2A_STRUCT(gps, (f32, accuracy, m), (i32, lap, deg), (f64, latitude, deg), (f64, longitude, rad),
           (i32, alt, cm))
SENSOR(gps, 3, gps, M, 1, gps, none)
"""


@pytest.mark.parametrize("distro", DISTROS)
def test_a_position_has_degrees_and_metres_of_the_fields_that_are_called_so(distro: str) -> None:
    payload = struct.pack("<Qfiddi", 7, 3.5, 99, 52.25, math.pi / 18, 3400)
    fix = published(topic_of(FIX), payload, distro)["gps/fix"]
    assert fix.latitude == pytest.approx(52.25)
    assert fix.longitude == pytest.approx(10)
    assert fix.altitude == pytest.approx(34)


@pytest.mark.parametrize("order", list(itertools.permutations(range(3))))
def test_of_fields_that_measure_the_same_the_first_one_counts(order: tuple[int, ...]) -> None:
    fields = [
        ("(array(i16, 3), one, rad/s)", "(f64, lat, deg)"),
        ("(array(i16, 3), two, m/s2)", "(f64, lon, deg)"),
        ("(array(i16, 3), three, m/s2)", "(f64, lat_error, deg)"),
    ]
    payload = struct.pack("<Q", 7)
    chosen = [fields[at] for at in order]
    made = "SENSOR(s, 3, s, M, 1, made, none)"
    motion = topic_of(f"J2A_STRUCT(made, {', '.join(one for one, _ in chosen)})\n{made}")
    numbers = struct.pack("<9h", *(10 * at for at in order for _ in range(3)))
    imu: Any = published(motion, payload + numbers, "noetic")["s/imu"]
    assert imu.linear_acceleration.x == next(10 * at for at in order if at in (1, 2))
    place = topic_of(f"J2A_STRUCT(made, {', '.join(one for _, one in chosen)})\n{made}")
    fix: Any = published(place, payload + struct.pack("<3d", *order), "noetic")["s/fix"]
    assert fix.latitude == pytest.approx(next(at for at in order if at in (0, 2)))


@pytest.mark.parametrize("distro", DISTROS)
def test_values_of_an_actuator_with_arrays_are_grouped(distro: str) -> None:
    topic = topic_of("ACTUATOR(leds, 1, leds, M, 2, array(u8, 3), none)")
    ros = messages_for(distro)
    store, kind = ros.store_of(topic.descriptors), ros.type_of(topic)
    write = store.serialize_ros1 if ros.is_ros1 else store.serialize_cdr
    data = write(store.types[kind]([], np.arange(6, dtype="u1")), kind)
    assert ros.read_own(topic, data) == ([[0, 1, 2], [3, 4, 5]], 0)


@pytest.mark.parametrize("distro", DISTROS)
@pytest.mark.parametrize("length", range(8))
def test_a_command_for_arrays_has_all_its_numbers_also_of_one_that_is_not_whole(
    distro: str, length: int
) -> None:
    """The board refuses that one; left out in silence, it would look as if it were done."""
    topic = topic_of("ACTUATOR(leds, 1, leds, M, 3, array(u8, 3), none)")
    ros, orders = messages_for(distro), Orders()
    layout = ros.store.types["std_msgs/msg/MultiArrayLayout"]([], 0)
    message = ros.store.types[FLOATS](layout, np.arange(length, dtype=np.float64))
    write = ros.store.serialize_ros1 if ros.is_ros1 else ros.store.serialize_cdr
    set_by_command(orders, ros, topic, bytes(write(message, FLOATS)))  # type: ignore[arg-type]
    [(_, values, _)] = orders.given
    assert [one for group in values for one in group] == list(range(length))
    assert [len(one) for one in values[:-1]] == [3] * (len(values) - 1)


class Orders:
    """Takes what is ordered."""

    def __init__(self) -> None:
        self.given: list[Any] = []

    def set(self, *order: Any, **more: Any) -> "Future[None]":
        self.given.append((*order, more))
        future: Future[None] = Future()
        future.set_result(None)
        return future


@pytest.mark.parametrize("distro", DISTROS)
def test_orders_have_the_values_and_the_time_of_this_computer(distro: str) -> None:
    servo = topic_of("ACTUATOR(servo, 1, servo, M, 2, int8_t, 0)")
    ros, orders = messages_for(distro), Orders()
    store, kind = ros.store_of(servo.descriptors), ros.type_of(servo)
    write = store.serialize_ros1 if ros.is_ros1 else store.serialize_cdr
    values = np.array([3, -4], "i1")
    for times, shift_ns in (([], 7), ([ros.time(50)] * 2, 20), ([ros.time(50)] * 2, -20)):
        data = write(store.types[kind](times, values), kind)
        set_by_own(orders, ros, servo, data, shift_ns)  # type: ignore[arg-type]
    at = [0, 30, 70]
    assert orders.given == [("servo", [3, -4], {"at_ns": one, "raw": True}) for one in at]
    orders.given.clear()
    empty = store.types["std_msgs/msg/MultiArrayLayout"]([], 0)
    floats = store.types[FLOATS](empty, np.array([3.0, -4.0, 1.5]))
    command = write(floats, FLOATS)
    leds = topic_of("ACTUATOR(leds, 1, leds, M, 2, array(u8, 3), none)")
    motor = topic_of("ACTUATOR(motor, 1, m, M, 3, f32, none)")
    for topic in (servo, leds, motor):
        set_by_command(orders, ros, topic, command)  # type: ignore[arg-type]
    assert [order[1] for order in orders.given] == [[3, -4, 1.5], [[3, -4, 1.5]], [3, -4, 1.5]]
    assert [type(one) for one in orders.given[0][1]] == [int, int, float]
    assert [type(one) for one in orders.given[2][1]] == [float, float, float]


@pytest.mark.parametrize("is_cancelled", [True, False])
def test_an_order_that_the_end_of_the_bridge_cancels_is_no_error(caplog, is_cancelled) -> None:
    future: Future[None] = Future()
    _watched(topic_of(ONE), future)
    if is_cancelled:
        future.cancel()
    else:
        future.set_exception(LocalError("out of range"))
    assert [one.message for one in caplog.records] == (
        [] if is_cancelled else ["quad was not set: out of range"]
    )
