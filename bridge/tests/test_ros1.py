"""The sink `ros1` with a real roscore, and a node that knows nothing of J2A."""

import asyncio
import contextlib
import http.client
import json
import os
import queue
import shutil
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import j2a_bridge.sinks.ros1_node
import pytest
from j2a_bridge.ros_messages import RosMessages
from j2a_bridge.sink import SinkError
from j2a_bridge.sink_request import SinkRequest, make_sink
from j2a_bridge.sinks.ros1 import Ros1Sink
from rosbags.typesys import Stores, get_typestore

from .support import PATIENCE_S, board_of, bridging, config_for, free_port, served, until

PYTHON = "/usr/bin/python3"
NODE = str(Path(j2a_bridge.sinks.ros1_node.__file__).parent)
pytestmark = pytest.mark.ros
if not shutil.which("rosmaster") and not os.environ.get("J2A_REQUIRE_AVR"):
    pytestmark = pytest.mark.skip("needs Debian's python3-rospy and python3-rosmaster")


class Process:
    """A process whose lines are read."""

    def __init__(self, command, **more):
        self.process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            **more,
        )
        self.lines = queue.Queue()
        self.seen = []
        self._thread = threading.Thread(target=self._read)
        self._thread.start()

    def _read(self):
        for line in self.process.stdout:
            self.lines.put(line)
        self.lines.put(None)

    def tell(self, *words):
        self.process.stdin.write(json.dumps(words) + "\n")
        self.process.stdin.flush()

    def next(self, *begin):
        """Return the rest of the next line of JSON that begins so."""
        while True:
            line = self.lines.get(timeout=PATIENCE_S)
            assert line is not None, self.seen
            self.seen.append(line)
            with contextlib.suppress(ValueError):
                found = json.loads(line)
                if found[: len(begin)] == list(begin):
                    return found[len(begin) :]

    def end(self):
        self.process.kill()
        self.process.wait()
        self._thread.join(PATIENCE_S)
        self.process.stdin.close()
        self.process.stdout.close()


@pytest.fixture
def ros_home(tmp_path, monkeypatch):
    monkeypatch.setenv("ROS_HOME", str(tmp_path))
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path))
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setenv("ROS_MASTER_URI", f"http://127.0.0.1:{free_port()}")
    monkeypatch.setenv("ROS_IP", "127.0.0.1")


def start_master():
    port = os.environ["ROS_MASTER_URI"].rsplit(":", 1)[1]
    master = Process([PYTHON, "/usr/bin/rosmaster", "--core", "-p", port])
    if not master_is_up():
        master.end()
        raise AssertionError(master.seen)
    return master


def master_is_up():
    code = (
        "import xmlrpc.client, os, time, uuid\n"
        "m = xmlrpc.client.ServerProxy(os.environ['ROS_MASTER_URI'])\n"
        "for _ in range(2000):\n"
        "    try:\n"
        "        m.setParam('/t', '/run_id', str(uuid.uuid4())); break\n"
        "    except OSError: time.sleep(0.03)\n"
        "else: raise SystemExit(1)\n"
    )
    return subprocess.run([PYTHON, "-c", code], check=False).returncode == 0


@pytest.fixture
def master(ros_home):
    process = start_master()
    yield process
    process.end()


@pytest.fixture
def peer(master):
    process = Process([PYTHON, str(Path(__file__).with_name("ros1_peer.py")), NODE])
    process.next("ready")
    yield process
    process.end()


STORE = get_typestore(Stores.ROS1_NOETIC)
QUAD = "time[] times\nint16[] values\n"


def text_of(name):
    return STORE.generate_msgdef(name.replace("/", "/msg/"), ros_version=1)[0]


async def listening(peer, topic, name, text):
    """Have the peer subscribe, and wait until the bridge is connected to it."""
    peer.tell("subscribe", topic, name, text)


async def heard(peer, device, sense, topic):
    """Have a board measure until the peer hears of it; return the first message."""
    got = asyncio.get_running_loop().run_in_executor(None, peer.next, "got", topic)
    while not got.done():
        sense()
        await asyncio.wait([got], timeout=0.05)
    [message] = got.result()
    return message


def test_samples_are_messages_of_the_thesis_and_standard_ones(peer):
    async def work():
        device = board_of()
        with served(device) as url:
            async with bridging(config_for(url, sinks=("ros1",))) as bridge:
                assert not bridge.runners[0].problem
                peer.tell("subscribe", "/quad", "the_missing_link/quad", QUAD)
                before = time.time_ns()
                message = await heard(peer, device, lambda: device.sense("quad", 0, 90), "/quad")
                joints = "sensor_msgs/JointState"
                peer.tell("subscribe", "/quad/joints", joints, text_of(joints))
                joint = await heard(
                    peer, device, lambda: device.sense("quad", 0, 90), "/quad/joints"
                )
                diagnostics = "diagnostic_msgs/DiagnosticArray"
                peer.tell("subscribe", "/diagnostics", diagnostics, text_of(diagnostics))
                found = await heard(peer, device, lambda: None, "/diagnostics")
        assert message["values"] == [180, 0]
        assert message["times"][1] == 0
        assert before - 2 * 10**9 < message["times"][0] < time.time_ns() + 2 * 10**9
        assert joint["position"] == [pytest.approx(1.5708, abs=1e-4)]
        assert "j2a: robot" in [one["name"] for one in found["status"]]

    asyncio.run(work())


def test_actuators_are_set_by_both_messages_and_refuse_with_a_reason(peer, caplog):
    async def work():
        device = board_of()
        with served(device) as url:
            async with bridging(config_for(url, sinks=("ros1",))):
                kind = "j2a_msgs/servo"
                text = "time[] times\nint8[] values\n"
                peer.tell("publish", "/servo", kind, text, {"values": [10, -20]})
                await until(lambda: ("servo", 1, -20) in device.was_set)
                floats = "std_msgs/Float64MultiArray"
                cmd = "/servo/cmd", floats, text_of(floats)
                peer.tell("publish", *cmd, {"data": [33.0]})
                await until(lambda: ("servo", 0, 33) in device.was_set)
                count = len(device.was_set)
                peer.tell("publish", *cmd, {"data": [101.0]})
                await until(lambda: any("was not set" in one.message for one in caplog.records))
                assert len(device.was_set) == count

    asyncio.run(work())
    assert "servo is -100 % to 100 %, not 101 %" in caplog.text


def test_a_message_that_fails_leaves_those_behind_it(peer, caplog, monkeypatch):
    def fail(*_):
        raise RuntimeError("of the test")

    monkeypatch.setattr(j2a_bridge.sinks.ros1, "set_by_command", fail)

    async def work():
        device = board_of()
        with served(device) as url:
            async with bridging(config_for(url, sinks=("ros1",))):
                floats = "std_msgs/Float64MultiArray"
                cmd = "/servo/cmd", floats, text_of(floats)
                peer.tell("publish", *cmd, {"data": [33.0]})
                await until(lambda: "of the test" in caplog.text)
                own = "/servo", "j2a_msgs/servo", "time[] times\nint8[] values\n"
                peer.tell("publish", *own, {"values": [10, -20]})
                await until(lambda: ("servo", 1, -20) in device.was_set)

    asyncio.run(work())


def test_settings_are_a_service(peer):
    async def work():
        device = board_of()
        with served(device) as url:
            async with bridging(config_for(url, sinks=("ros1",))):
                answers = []
                for names, values in (
                    ([], []),
                    (["period", "enabled"], ["0.25", "false"]),
                    (["period"], ["-1"]),
                    (["colour"], ["red"]),
                    (["period"], ["[" * 100_000]),
                    ([], []),
                ):
                    peer.tell("call", "/quad/configure", names, values)
                    answers.append(await asyncio.to_thread(peer.next, "answer"))
        assert answers[0] == [True, json.dumps({"enabled": True, "period": 0.0})]
        assert answers[1] == [True, json.dumps({"enabled": False, "period": 0.25})]
        assert answers[2][0] is False
        assert "period is 0 to" in answers[2][1]
        assert "colour is no setting" in answers[3][1]
        assert answers[4][0] is False
        assert answers[5] == answers[1]

    asyncio.run(work())


def test_answers_keep_neither_the_loop_nor_the_reader_waiting(peer, monkeypatch):
    threads = []
    send = Ros1Sink._send

    def note(sink, what, *frame):
        if what == j2a_bridge.sinks.ros1_node.ANSWER:
            threads.append(threading.current_thread())
        send(sink, what, *frame)

    monkeypatch.setattr(Ros1Sink, "_send", note)

    async def work():
        device = board_of()
        with served(device) as url:
            async with bridging(config_for(url, sinks=("ros1",))) as bridge:
                for names, values in (([], []), (["colour"], ["red"])):
                    peer.tell("call", "/quad/configure", names, values)
                    await asyncio.to_thread(peer.next, "answer")
                return bridge.runners[0].sink._reader

    reader = asyncio.run(work())
    assert len(threads) == 2
    assert not {threading.current_thread(), reader} & set(threads)


def test_a_node_that_takes_a_part_of_a_frame_gets_no_other(monkeypatch):
    monkeypatch.setattr(j2a_bridge.sinks.ros1, "_WRITE_S", 0.01)
    sink = make_sink(SinkRequest.parse("ros1"), None)
    command = [sys.executable, "-c", "import time; time.sleep(600)"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, bufsize=0) as process:
        os.set_blocking(process.stdin.fileno(), False)
        sink._process = process
        with pytest.raises(SinkError, match="takes nothing"):
            sink._send(j2a_bridge.sinks.ros1_node.ANSWER, 0, bytes(1 << 20))
        assert process.wait(PATIENCE_S)
        with pytest.raises(SinkError, match="has ended: it took nothing"):
            sink._send(j2a_bridge.sinks.ros1_node.PUBLISH, 0)


def test_a_roscore_that_is_killed_and_started_anew_is_found_again(ros_home, monkeypatch):
    monkeypatch.setattr(Ros1Sink, "RETRY_S", 0.2)

    async def work():
        device = board_of()
        with served(device) as url:
            async with bridging(config_for(url, sinks=("ros1", "kept"))) as bridge:
                runner = bridge.runners[0]
                assert "no roscore answers" in runner.problem
                for value in range(2):
                    master = await asyncio.to_thread(start_master)
                    try:
                        await until(lambda: runner.status.is_open)
                        command = [PYTHON, str(Path(__file__).with_name("ros1_peer.py")), NODE]
                        peer = Process(command)
                        try:
                            await asyncio.to_thread(peer.next, "ready")
                            peer.tell("subscribe", "/quad", "a/quad", QUAD)
                            sense = lambda value=value: device.sense("quad", 0, value, raw=True)  # noqa: E731
                            message = await heard(peer, device, sense, "/quad")
                            assert message["values"][0] == value
                        finally:
                            peer.end()
                    finally:
                        master.end()

    asyncio.run(work())


def test_stamps_are_in_the_time_of_ros_where_it_is_simulated(master, monkeypatch):
    code = (
        "import xmlrpc.client, os\n"
        "xmlrpc.client.ServerProxy(os.environ['ROS_MASTER_URI'])"
        ".setParam('/t', '/use_sim_time', True)\n"
    )
    subprocess.run([PYTHON, "-c", code], check=True, timeout=PATIENCE_S)
    clock = Process(
        [
            PYTHON,
            "-c",
            "import rospy, genpy.dynamic, time\n"
            "k = genpy.dynamic.generate_dynamic('rosgraph_msgs/Clock', 'time clock\\n')"
            "['rosgraph_msgs/Clock']\n"
            "rospy.init_node('clock', disable_signals=True)\n"
            "p = rospy.Publisher('/clock', k, queue_size=1)\n"
            "while True:\n"
            "    p.publish(k(rospy.Time(100, 500)))\n"
            "    time.sleep(0.01)\n",
        ]
    )
    peer = Process([PYTHON, str(Path(__file__).with_name("ros1_peer.py")), NODE])
    peer.next("ready")

    async def work():
        device = board_of()
        with served(device) as url:
            async with bridging(config_for(url, sinks=("ros1",))) as bridge:
                sink = bridge.runners[0].sink
                await until(lambda: sink._shift_ns)
                peer.tell("subscribe", "/quad", "a/quad", QUAD)
                return await heard(peer, device, lambda: device.sense("quad", 0, 1), "/quad")

    try:
        message = asyncio.run(work())
    finally:
        peer.end()
        clock.end()
    assert 0 < message["times"][0] < 200 * 10**9


def test_nothing_is_published_before_the_simulated_time_is_known(master):
    code = (
        "import xmlrpc.client, os\n"
        "xmlrpc.client.ServerProxy(os.environ['ROS_MASTER_URI'])"
        ".setParam('/t', '/use_sim_time', True)\n"
    )
    subprocess.run([PYTHON, "-c", code], check=True, timeout=PATIENCE_S)

    async def work():
        device = board_of()
        with served(device) as url:
            async with bridging(config_for(url, sinks=("ros1", "kept"))) as bridge:
                runner = bridge.runners[0]
                await until(lambda: "quad" in bridge._flows)
                device.sense("quad", 0, 1)
                await until(lambda: runner.published + runner.dropped)
                return runner.published, runner.problem, runner.sink._shift_ns

    assert asyncio.run(work()) == (0, "", None)


def test_a_server_that_is_no_roscore_does_not_end_the_watch(monkeypatch):
    node, runs = j2a_bridge.sinks.ros1_node, iter([OSError, "garbage", "other"])

    class Master:
        def __init__(self, uri):
            pass

        def getParam(self, name, key):  # noqa: N802 - of the API of ROS
            run = next(runs)
            if run is OSError:
                raise run
            if run == "garbage":
                raise http.client.BadStatusLine(run)
            return 1, "", run

        def lookupNode(self, name, other):  # noqa: N802
            return [1]

    class Ended(BaseException):
        pass

    def end(why):
        raise Ended(why)

    monkeypatch.setattr(node.xmlrpc.client, "ServerProxy", Master)
    monkeypatch.setattr(node.time, "sleep", lambda _s: None)
    monkeypatch.setattr(node, "end", end)
    with pytest.raises(Ended, match="another roscore"):
        node.watch_master("http://127.0.0.1:1", "/j2a", "ours")


def test_sums_of_all_types_agree_with_genpy(master):
    """A type whose sum rosbags and genpy see differently would be no type of ROS."""
    text = """
    J2A_STRUCT(motion, (array(i16, 3), rate, mdeg/s), (array(i16, 3), acceleration, mg))
    J2A_ENUM(state, u8, (off, 0), (on, 1))
    SENSOR(imu, 0, imu, M, 2, motion, none)
    SENSOR(mode, 1, mode, M, 1, state, none, (queue, 3))
    SENSOR(dist, 2, dist, M, 2, f32, nan, (unit, mm))
    SENSOR(temperature, 3, t, M, 1, double, nan, (unit, Cel))
    SENSOR(flags, 4, flags, M, 1, array(bool, 3), none)
    """

    async def work():
        with served(board_of(text)) as url:
            async with bridging(config_for(url, sinks=("ros1", "kept"))) as bridge:
                await until(lambda: len(bridge._flows) == 5)
                await until(lambda: len(bridge.runners[0].sink._numbers) == 5)
                await asyncio.sleep(0.5)
                return bridge.runners[0].problem

    assert asyncio.run(work()) == ""
    assert RosMessages("noetic").is_ros1


def test_a_node_whose_bridge_is_killed_ends_while_the_master_hangs(ros_home):
    port = int(os.environ["ROS_MASTER_URI"].rsplit(":", 1)[1])
    with socket.create_server(("127.0.0.1", port)) as hanging:
        hanging.settimeout(PATIENCE_S)
        process = subprocess.Popen(
            [PYTHON, j2a_bridge.sinks.ros1_node.__file__, "n"],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
        )
        try:
            asked, _ = hanging.accept()
            with asked:
                process.stdin.close()  # as the kernel does when the bridge is killed
                assert process.wait(PATIENCE_S) == 0
        finally:
            process.kill()
            process.wait()
