"""The sink `ros2`, seen by Fast DDS, which knows nothing of J2A."""

import asyncio
import contextlib
import os
import queue
import random
import shutil
import subprocess
import sys
import threading
from concurrent.futures import Future
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from cyclonedds.builtin import (
    BuiltinDataReader,
    BuiltinTopicDcpsPublication,
    BuiltinTopicDcpsSubscription,
)
from cyclonedds.domain import DomainParticipant
from j2a_bridge.actuators import FLOATS
from j2a_bridge.ros_messages import RosMessages
from j2a_bridge.sink import SinkError
from j2a_bridge.sink_request import SinkRequest, make_sink
from j2a_bridge.topics import Topic

from j2a import LocalError
from j2a.types.transds_file import read_transds

from .support import PATIENCE_S, TRANSDS, board_of, bridging, config_for, served, until
from .test_zenoh import HASH, _descriptors

HEADER = Path("/usr/include/fastdds/dds/topic/TopicDataType.hpp")
pytestmark = [pytest.mark.dds]
needs_fastdds = pytest.mark.skipif(
    not (HEADER.exists() and shutil.which("g++")) and not os.environ.get("J2A_REQUIRE_AVR"),
    reason="needs Debian's libfastrtps-dev and g++",
)


@pytest.fixture(scope="session")
def program(tmp_path_factory):
    """Return the program of Fast DDS."""
    made = tmp_path_factory.mktemp("fastdds") / "peer"
    source = Path(__file__).with_name("fastdds_peer.cpp")
    command = ["g++", "-O1", "-o", str(made), str(source), "-lfastrtps", "-lfastcdr"]
    subprocess.run(command, check=True, capture_output=True, timeout=600)
    return made


@pytest.fixture
def domain():
    """Return a domain that no other test uses now."""
    return random.randrange(1, 200)


class FastDds:
    """The program, whose lines are read."""

    def __init__(self, program, domain):
        self._process = subprocess.Popen(
            [str(program), str(domain)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        self._lines = queue.Queue()
        self._thread = threading.Thread(target=self._read)
        self._thread.start()
        self.next("ready")

    def _read(self):
        for line in self._process.stdout:
            self._lines.put(line.strip())
        self._lines.put("end")

    def tell(self, *words):
        self._process.stdin.write(" ".join(words) + "\n")
        self._process.stdin.flush()

    def next(self, *begin):
        while True:
            words = self._lines.get(timeout=PATIENCE_S).split(" ")
            assert words != ["end"]
            if words[: len(begin)] == list(begin):
                return words[len(begin) :]

    def end(self):
        self._process.kill()
        self._process.wait()
        self._thread.join(PATIENCE_S)
        self._process.stdin.close()
        self._process.stdout.close()


@contextlib.asynccontextmanager
async def bridged(domain, *more, text=TRANSDS, option=""):
    device = board_of(text)
    with served(device) as url:
        config = config_for(url, sinks=(f"ros2:domain={domain},node=arm{option}", "kept", *more))
        async with bridging(config) as bridge:
            assert bridge.runners[0].problem == ""
            await until(lambda: len(bridge._flows) == text.count("\n") - 1)
            yield device, bridge


async def first(device, sense, got):
    """Have a board measure until something has come; return it."""
    task = asyncio.create_task(asyncio.to_thread(got))
    while not task.done():
        sense()
        await asyncio.wait([task], timeout=0.05)
    return task.result()


@needs_fastdds
@pytest.mark.parametrize("option", ["", ",process=yes"])
def test_samples_reach_fast_dds_and_its_messages_actuators(program, domain, caplog, option):
    ros = RosMessages("jazzy")
    store = ros.store_of(_descriptors())

    async def work():
        peer = await asyncio.to_thread(FastDds, program, domain)
        try:
            async with bridged(domain, option=option) as (device, _):
                peer.tell("sub", "rt/quad", "j2a_msgs::msg::dds_::Quad_", "best")
                [data] = await first(
                    device,
                    lambda: device.sense("quad", 1, 90),
                    lambda: peer.next("got", "rt/quad"),
                )
                joint = "sensor_msgs::msg::dds_::JointState_"
                peer.tell("sub", "rt/quad/joints", joint, "best")
                [joints] = await first(
                    device,
                    lambda: device.sense("quad", 1, 90),
                    lambda: peer.next("got", "rt/quad/joints"),
                )
                diagnostics = "diagnostic_msgs::msg::dds_::DiagnosticArray_"
                peer.tell("sub", "rt/diagnostics", diagnostics, "reliable")
                [told] = await asyncio.to_thread(peer.next, "got", "rt/diagnostics")

                def hex_of(kind, message):
                    return bytes(store.serialize_cdr(message, kind)).hex()

                async def publish(topic, kind, message, is_done):
                    """Publish until it has come: at first a reader may not know the writer yet."""
                    package, _, name = kind.split("/")
                    data = hex_of(kind, message)
                    while not is_done():
                        peer.tell("pub", topic, f"{package}::msg::dds_::{name}_", data)
                        await asyncio.sleep(0.1)

                servo, floats = "j2a_msgs/msg/Servo", "std_msgs/msg/Float64MultiArray"
                layout = store.types["std_msgs/msg/MultiArrayLayout"]([], 0)
                own = store.types[servo]([], np.array([10, -20], "i1"))
                await publish("rt/servo", servo, own, lambda: ("servo", 1, -20) in device.was_set)
                good, bad, last = (
                    store.types[floats](layout, np.array([one])) for one in (33.0, 101.0, 44.0)
                )
                await publish(
                    "rt/servo/cmd", floats, good, lambda: ("servo", 0, 33) in device.was_set
                )
                await publish("rt/servo/cmd", floats, bad, lambda: "not 101 %" in caplog.text)
                # What is no such message is dropped by DDS, and what comes behind it still comes.
                peer.tell("pub", "rt/servo/cmd", "x", "00010000ffffffff")
                await publish(
                    "rt/servo/cmd", floats, last, lambda: ("servo", 0, 44) in device.was_set
                )
                assert ("servo", 0, 101) not in device.was_set
                return data, joints, told
        finally:
            peer.end()

    data, joints, told = asyncio.run(work())
    message = store.deserialize_cdr(bytes.fromhex(data), "j2a_msgs/msg/Quad")
    assert message.values.tolist() == [0, 180]
    joint = store.deserialize_cdr(bytes.fromhex(joints), "sensor_msgs/msg/JointState")
    assert joint.position.tolist() == [pytest.approx(1.5708, abs=1e-4)]
    kind = "diagnostic_msgs/msg/DiagnosticArray"
    assert ros.read(kind, bytes.fromhex(told)).status[0].name.startswith("j2a: ")
    assert "servo is -100 % to 100 %, not 101 %" in caplog.text


@needs_fastdds
def test_the_graph_names_the_node_with_all_that_it_has(program, domain):
    async def work():
        peer = await asyncio.to_thread(FastDds, program, domain)
        try:
            async with bridged(domain) as (_, bridge):
                kind = "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_"
                peer.tell("sub", "ros_discovery_info", kind, "latched")
                sink = bridge.runners[0].sink
                while True:
                    [data] = await asyncio.to_thread(peer.next, "got", "ros_discovery_info")
                    name = "rmw_dds_common/msg/ParticipantEntitiesInfo"
                    graph = RosMessages("jazzy").read(name, bytes.fromhex(data))
                    [node] = graph.node_entities_info_seq
                    # quad twice, level, diagnostics; servo and its commands
                    if len(node.writer_gid_seq) == 4 and len(node.reader_gid_seq) == 2:
                        break
                gids = [bytes(one.data) for one in node.writer_gid_seq]
                known = [
                    one.writer.guid.bytes for found in sink._writers.values() for _, one in found
                ]
                assert set(known) <= set(gids)
                assert bytes(graph.gid.data) == sink._participant.guid.bytes
                return node
        finally:
            peer.end()

    node = asyncio.run(work())
    assert (node.node_namespace, node.node_name) == ("/", "arm")


def test_endpoints_tell_the_hash_of_their_type_and_the_quality_of_sensor_data(domain):
    async def work():
        async with bridged(domain):
            participant = DomainParticipant(domain)
            reader = BuiltinDataReader(participant, BuiltinTopicDcpsPublication)
            found = {}

            def look():
                for one in reader.take(N=100):
                    found[one.topic_name] = one
                return "rt/quad" in found and "rt/diagnostics" in found

            await until(look)
            return found["rt/quad"], found["rt/diagnostics"]

    quad, diagnostics = asyncio.run(work())
    assert quad.type_name == "j2a_msgs::msg::dds_::Quad_"
    about = str(quad.qos)
    assert "BestEffort" in about
    assert "KeepLast(depth=5)" in about
    assert f"typehash={HASH};" in about
    assert "Reliable" in str(diagnostics.qos)


BOARDS = {
    "arm": "SENSOR(quad, 0, q, M, 2, i16, none, (unit, deg))\nACTUATOR(servo, 1, s, M, 2, i8, 0)",
    "leg": "SENSOR(far, 0, f, M, 3, u16, none, (unit, cm))\nACTUATOR(lamp, 1, l, M, 1, bool, 0)",
}


def topics_of_boards():
    """Return the topics of two boards, and all types that they are published or taken as."""
    topics, kinds = [], {}
    for board, text in BOARDS.items():
        descriptors = read_transds(text)
        for one in descriptors.transducers:
            topic = Topic(f"{board}/{one.name}", board, one, descriptors)
            ros = RosMessages("jazzy")
            store = ros.store_of(descriptors)
            topics.append(topic)
            kinds |= {
                f"rt/{message.topic}": store.hash_rihs01(message.type)
                for message in ros.messages(topic)
            }
            if not one.is_sensor:
                kinds[f"rt/{topic.name}"] = store.hash_rihs01(ros.type_of(topic))
                if one.name != "lamp":  # which no number sets
                    kinds[f"rt/{topic.name}/cmd"] = store.hash_rihs01(FLOATS)
    return topics, kinds


def test_the_graph_has_all_writers_and_readers_of_the_boards_that_are_here(domain):
    sink = make_sink(SinkRequest.parse(f"ros2:domain={domain}"), None)
    sink.open()
    told = []
    sink._graph.put = told.append

    def graph():
        """What was told last, and what there is."""
        kind = "rmw_dds_common/msg/ParticipantEntitiesInfo"
        [node] = RosMessages("jazzy").read(kind, told[-1]).node_entities_info_seq
        readers = [one for found in sink._readers.values() for one in found]
        writers = [sink._diagnostics.writer]
        writers += [one.writer for found in sink._writers.values() for _, one in found]
        told_gids = [
            sorted(bytes(one.data) for one in gids)
            for gids in (node.writer_gid_seq, node.reader_gid_seq)
        ]
        assert told_gids == [
            sorted(one.guid.bytes for one in found) for found in (writers, readers)
        ]
        return len(writers), len(readers)

    topics, _ = topics_of_boards()
    try:
        counts = []
        for topic in topics:
            sink.announce(topic)
            counts.append(graph())
        assert counts == [(3, 0), (3, 2), (7, 2), (7, 3)]
        for topic in reversed(topics):
            sink.retract(topic)
            counts.append(graph())
        assert counts[4:] == [(7, 2), (3, 2), (3, 0), (1, 0)]
    finally:
        sink.close()


def test_each_endpoint_has_the_hash_of_its_type_and_the_quality_that_its_peers_expect(domain):
    sink = make_sink(SinkRequest.parse(f"ros2:domain={domain}"), None)
    sink.open()
    topics, kinds = topics_of_boards()
    actuators = {f"rt/{one.name}" for one in topics if not one.transducer.is_sensor}
    actuators |= {f"{one}/cmd" for one in actuators}
    try:
        for topic in topics:
            sink.announce(topic)
        participant = DomainParticipant(domain)
        readers = [
            BuiltinDataReader(participant, one)
            for one in (BuiltinTopicDcpsPublication, BuiltinTopicDcpsSubscription)
        ]
        found = {}

        def look():
            for at, reader in enumerate(readers):
                found.update({(at, one.topic_name): str(one.qos) for one in reader.take(N=100)})
            return {name for _, name in found} >= {"ros_discovery_info", *kinds}

        async def wait():
            await until(look)

        asyncio.run(wait())
    finally:
        sink.close()
    for name, type_hash in kinds.items():
        qos = found[int(name in actuators), name]
        assert f"typehash={type_hash};" in qos, name
        kind, depth = ("Reliable", 10) if name in actuators else ("BestEffort", 5)
        assert f"Reliability.{kind}" in qos and f"KeepLast(depth={depth})" in qos, name
        assert "Durability.Volatile" in qos, name
    graph = found[0, "ros_discovery_info"]
    for word in ("Reliability.Reliable", "KeepLast(depth=1)", "Durability.TransientLocal"):
        assert word in graph


@pytest.mark.parametrize("waiting", [1, 2, 10])
def test_all_commands_that_wait_are_done_in_their_order(domain, monkeypatch, waiting):
    """A reader is told once of what came at once; one that is refused stops no other."""
    values, listeners = [], []

    def take(topic, wanted, **more):
        del topic, more
        if wanted == [1]:
            raise LocalError("not this one")
        values.append(wanted)
        return Future()

    sink = make_sink(SinkRequest.parse(f"ros2:domain={domain}"), SimpleNamespace(set=take))
    topic = next(one for one in topics_of_boards()[0] if one.name == "arm/servo")
    sink.open()
    try:
        real = sink._dds.DataReader

        def make(*about, **more):
            listeners.append(more["listener"])
            return real(*about, **more)

        monkeypatch.setattr(sink._dds, "DataReader", make)
        sink.announce(topic)
        store = sink._ros.store_of(topic.descriptors)
        layout = store.types["std_msgs/msg/MultiArrayLayout"]([], 0)
        kind = sink._dds.kind(store, FLOATS)
        samples = []
        for number in range(waiting):
            sample = object.__new__(kind)
            message = store.types[FLOATS](layout, np.array([float(number)]))
            sample.j2a_data = bytes(store.serialize_cdr(message, FLOATS))
            samples.append(sample)
        reader = SimpleNamespace(take=lambda N: samples[:N])  # noqa: N803 - of cyclonedds
        listeners[1].on_data_available(reader)
    finally:
        sink.close()
    assert values == [[number] for number in range(waiting) if number != 1]


def test_discovery_stays_on_this_computer(domain):
    """No socket of the bridge takes datagrams from others, and none is in a multicast group."""
    code = (
        "import asyncio, sys\n"
        "from j2a_bridge.sinks.ros2 import Ros2Sink\n"
        "options = {name: one.default for name, one in Ros2Sink.OPTIONS.items()}\n"
        f"sink = Ros2Sink('', options | {{'domain': {domain}}}, None)\n"
        "sink.open()\n"
        "print('open', flush=True)\n"
        "sys.stdin.read()\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout.readline() == "open\n"
        inodes = {
            str(one.readlink()).removeprefix("socket:[").removesuffix("]")
            for one in Path(f"/proc/{process.pid}/fd").iterdir()
            if "socket" in str(one.readlink())
        }
        addresses = set()
        for line in Path("/proc/net/udp").read_text().splitlines()[1:]:
            words = line.split()
            if words[9] in inodes:
                addresses.add(words[1].split(":")[0])
        groups = Path("/proc/net/igmp").read_text()
    finally:
        process.communicate()
    assert addresses
    assert addresses <= {"0100007F", "00000000"}
    assert "0100FFEF" not in groups  # 239.255.0.1


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("ros2:domain=233", "a domain is 0 to 232"),
        ("ros2:distro=noetic", "humble or jazzy"),
        ("ros2:domain=x", "whole number"),
        ("ros2:node=a b", "the name of a node is letters"),
        ("ros2:node=", "the name of a node is letters"),
        ("zenoh:node=a/b", "the name of a node is letters"),
    ],
)
def test_what_is_wrong_is_told(words, told):
    with pytest.raises(LocalError, match=told):
        make_sink(SinkRequest.parse(words), None)


def test_a_network_that_is_not_there_is_told(domain, capfd):
    sink = make_sink(SinkRequest.parse(f"ros2:domain={domain},network=nosuch0"), None)
    with pytest.raises(SinkError, match=r"no network interface 'nosuch0'; there are: .*lo"):
        sink.open()
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("kind", ["ros2", "zenoh"])
@pytest.mark.parametrize(
    ("environment", "option", "domain"),
    [("", "", 0), ("17", "", 17), ("17", "domain=5", 5), ("17", "domain=0", 0)],
)
def test_the_domain_of_the_environment_counts_where_no_option_says_another_one(
    monkeypatch, kind, environment, option, domain
):
    monkeypatch.setenv("ROS_DOMAIN_ID", environment)
    assert make_sink(SinkRequest.parse(f"{kind}:,{option}".strip(":,")), None)._domain == domain


@pytest.mark.parametrize("kind", ["ros2", "zenoh"])
@pytest.mark.parametrize("text", ["x", "-2", "1.5", "233"])
def test_a_domain_of_the_environment_that_is_none_is_told(monkeypatch, kind, text):
    monkeypatch.setenv("ROS_DOMAIN_ID", text)
    with pytest.raises(LocalError, match=r"ROS_DOMAIN_ID is a number|a domain is 0 to 232"):
        make_sink(SinkRequest.parse(kind), None)


@pytest.mark.parametrize("distro", ["humble", "jazzy"])
def test_types_of_all_shapes_are_made_for_dds(domain, distro):
    text = """
J2A_STRUCT(motion, (array(i16, 3), rate, mdeg/s), (array(i16, 3), acceleration, mg))
J2A_ENUM(state, u8, (off, 0), (on, 1))
SENSOR(imu, 0, imu, M, 2, motion, none)
SENSOR(mode, 1, mode, M, 1, state, none, (queue, 3))
SENSOR(flags, 4, flags, M, 1, array(bool, 3), none)
J2A_STRUCT(odd, (u8, serialize), (u8, deserialize), (u8, j2a_data), (u16, other))
SENSOR(odd, 6, odd, M, 1, odd, none)
ACTUATOR(pose, 5, pose, M, 1, motion, none)
"""

    async def work():
        device = board_of(text)
        with served(device) as url:
            config = config_for(url, sinks=(f"ros2:domain={domain},distro={distro}", "kept"))
            async with bridging(config) as bridge:
                await until(lambda: len(bridge.runners[0].sink._writers) == 5)
                device.sense("flags", 0, [True, False, True])
                device.sense("odd", 0, [1, 2, 3, 4])
                await until(lambda: bridge.runners[0].published == 2)
                assert bridge.runners[0].sink._writers["odd"]
                return bridge.runners[0].problem

    assert asyncio.run(work()) == ""
