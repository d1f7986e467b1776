"""The sinks for plotters and recordings, and the command that runs them."""

import asyncio
import errno
import json
import math
import os
import re
import signal
import socket
import struct
import subprocess
import sys
import time
from dataclasses import replace

import pytest
from j2a_bridge.sink_request import SinkRequest, make_sink
from j2a_bridge.sinks import mcap
from j2a_bridge.sinks.udp import numbers
from j2a_bridge.topics import Topic
from mcap.reader import make_reader

from j2a.recording import Recorder, Recording
from j2a.types.transds_file import read_transds

from .support import PATIENCE_S, TRANSDS, board_of, bridging, config_for, free_port, served, until
from .test_ros_messages import IMU, topic_of, update_of


@pytest.fixture
def receiver():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))
        one.settimeout(PATIENCE_S)
        yield one


def test_numbers_of_structures_and_none_of_what_is_none():
    topic = topic_of(IMU)
    payload = struct.pack("<Q9h", 7, 1, 2, 3, 4, 5, 6, 7, 8, 9)
    found = list(numbers(update_of(topic, payload, shift_us=1)))
    assert found[0] == (8000, "0/rate/0", 1)
    assert found[-1] == (8000, "0/field/2", 9)
    assert len(found) == 9
    floats = topic_of("SENSOR(s, 0, s, M, 4, f32, -1)")
    parts = [(7, 1.5), (7, float("inf")), (0, 2.5), (7, -1.0)]
    payload = b"".join(struct.pack("<Qf", *part) for part in parts)
    assert list(numbers(update_of(floats, payload))) == [(7000, "0", 1.5)]


def test_a_channel_that_was_not_read_is_not_sent_again(receiver):
    sink = make_sink(SinkRequest.parse(f"udp:127.0.0.1:{receiver.getsockname()[1]}"), None)
    topic = topic_of("SENSOR(s, 0, s, M, 2, u8, none)")
    alone = topic_of("SENSOR(s, 0, s, M, 1, u8, none)", name="alone")
    queue = topic_of("SENSOR(s, 0, s, M, 2, u8, none, (queue, 2))", name="queue")

    def sent(topic, *parts, **more):
        update = update_of(topic, struct.pack(*parts))
        sink.publish(replace(update, sample=replace(update.sample, **more)))
        sink.publish(update_of(end, struct.pack("<QB", 1, 1)))
        found = []
        while "end" not in (data := json.loads(receiver.recv(65536))):
            found += [(data["timestamp"], name, value) for name, value in data[topic.name].items()]
        return found

    end = topic_of("SENSOR(s, 0, s, M, 1, u8, none)", name="end")
    sink.open()
    try:
        sink.announce(topic)
        both = [(1.0, "0", 5), (2.0, "1", 6)]
        first = "<QBQB", 1_000_000, 5, 2_000_000, 6
        assert sent(topic, *first) == both
        assert sent(topic, "<QBQB", 1_000_000, 5, 3_000_000, 6) == [(3.0, "1", 6)]
        assert sent(topic, "<QBQB", 1_000_000, 7, 3_000_000, 6) == [(1.0, "0", 7)]
        assert sent(topic, *first, is_reset=True) == both
        assert sent(topic, *first) == []
        assert sent(topic, *first, is_reset=True) == both  # equal, and yet measured anew
        sink.announce(topic)
        assert sent(topic, *first) == both
        for _ in range(2):
            assert sent(alone, "<QB", 1_000_000, 5) == [(1.0, "0", 5)]
            assert sent(queue, "<HBQB", 0, 1, 1_000_000, 5) == [(1.0, "1", 5)]
    finally:
        sink.close()


def test_fields_beside_one_that_is_no_number_are_not_sent_again():
    text = "J2A_STRUCT(pair, (f32, a), (f32, b))\nSENSOR(s, 0, s, M, 2, pair, none)"
    values = struct.pack("<ff", math.nan, 2.5)
    payloads = [
        b"".join(struct.pack("<Q", one) + values for one in times) for times in ((7, 8), (7, 9))
    ]
    update = update_of(topic_of(text), payloads[1])
    assert list(numbers(update, payloads[0])) == [(9000, "1/b", 2.5)]
    assert list(numbers(update)) == [(7000, "0/b", 2.5), (9000, "1/b", 2.5)]


def test_fields_have_the_names_that_the_device_gives_them():
    text = "J2A_STRUCT(way, (u8, from), (u8, to))\nSENSOR(s, 0, s, M, 1, way, none)"
    update = update_of(topic_of(text), struct.pack("<QBB", 7, 1, 2))
    assert [name for _, name, _ in numbers(update)] == ["0/from", "0/to"]


async def sent(device, url, sink, receiver):
    async with bridging(config_for(url, sinks=(sink, "kept"))) as bridge:
        await until(lambda: "quad" in bridge._flows)
        device.sense("quad", 1, 45.5)
        return await asyncio.to_thread(receiver.recv, 65536)


def test_a_recording_goes_on_when_a_board_comes_back_with_other_firmware(tmp_path):
    sink = make_sink(SinkRequest.parse(f"mcap:{tmp_path / 'a.mcap'}"), None)
    sink.open()
    for kind, names, value in [("u8", "ab", b"\1"), ("u16", "cb", b"\2\0"), ("u8", "ab", b"\3")]:
        text = "".join(f"SENSOR({n}, {i}, {n}, M, 1, {kind}, none)" for i, n in enumerate(names))
        descriptors = read_transds(text)
        topics = [Topic(one.name, "arm", one, descriptors, "") for one in descriptors.transducers]
        for topic in topics:
            sink.announce(topic)
        for topic in topics:
            sink.publish(update_of(topic, struct.pack("<Q", 7) + value, arrived_ns=1_000_009))
        for topic in topics:
            sink.retract(topic)
    sink.close()
    assert {one.time_ns for one in Recording(tmp_path / "a.mcap")} == {1_000_009}
    found = [
        (one.board, one.sensor.name, one.payload[8:]) for one in Recording(tmp_path / "a.mcap")
    ]
    assert sorted(found) == [
        ("arm", "a", b"\1"),
        ("arm", "a", b"\3"),
        ("arm", "b", b"\1"),
        ("arm", "b", b"\3"),
        ("arm_2", "b", b"\2\0"),
        ("arm_2", "c", b"\2\0"),
    ]


def test_json_for_plotjuggler(receiver):
    device = board_of()
    with served(device) as url:
        sink = f"udp:127.0.0.1:{receiver.getsockname()[1]}"
        found = json.loads(asyncio.run(sent(device, url, sink, receiver)))
    assert found["quad"] == {"1": 45.5}
    assert found["timestamp"] == pytest.approx(time.time(), abs=PATIENCE_S)


def test_lines_for_teleplot(receiver):
    device = board_of()
    with served(device) as url:
        sink = f"udp:127.0.0.1:{receiver.getsockname()[1]},format=teleplot"
        line = asyncio.run(sent(device, url, sink, receiver)).decode()
    name, ms, value = line.split(":")
    assert (name, value) == ("quad/1", "45.5§deg")
    assert float(ms) == pytest.approx(time.time() * 1000, abs=PATIENCE_S * 1000)


def datagrams(receiver, format_, topic, payload):
    """Return what is sent for one sample."""
    port = receiver.getsockname()[1]
    sink = make_sink(SinkRequest.parse(f"udp:127.0.0.1:{port},format={format_}"), None)
    sink.open()
    try:
        sink.publish(update_of(topic, payload))
        end = topic_of("SENSOR(end, 0, s, M, 1, u8, none)")
        sink.publish(update_of(end, struct.pack("<QB", 1, 1)))
        found = []
        while b"end" not in (data := receiver.recv(65536)):
            found.append(data)
        return found
    finally:
        sink.close()


@pytest.mark.parametrize("count", [1, 40, 60, 80, 200])
@pytest.mark.parametrize("length", [1, 20, 64])
def test_datagrams_for_teleplot_are_not_too_long_and_have_all_values_once(receiver, count, length):
    name = "n" * length
    topic = topic_of(f"SENSOR(s, 0, s, M, 1, array(u8, {count}), none)", name=name)
    found = datagrams(receiver, "teleplot", topic, struct.pack("<Q", 7) + bytes(range(count)))
    assert all(len(one) <= 1400 for one in found)
    lines = b"\n".join(found).decode().split("\n")
    assert lines == [f"{name}/0/{at}:0.007:{at}" for at in range(count)]


@pytest.mark.parametrize("times", [(7, 8), (999, 1000), (1_000_000, 1_000_001), (5, 5)])
def test_values_for_plotjuggler_have_their_time_to_the_microsecond(receiver, times):
    topic = topic_of("SENSOR(s, 0, s, M, 2, u64, none)")
    values = 2**63 + 1, 2**53 + 1
    payload = b"".join(struct.pack("<QQ", *one) for one in zip(times, values, strict=True))
    found = {}
    for data in datagrams(receiver, "json", topic, payload):
        about = json.loads(data)
        found |= {name: (about["timestamp"], value) for name, value in about["s"].items()}
    assert found == {str(channel): (times[channel] / 1e6, values[channel]) for channel in range(2)}


def test_a_recording_has_all_samples_under_their_topics(tmp_path):
    path = tmp_path / "a.mcap"

    async def work(device, url):
        async with bridging(config_for(url, sinks=(f"mcap:{path}", "kept"))) as bridge:
            await until(lambda: "quad" in bridge._flows)
            for value in range(50):
                device.sense("quad", 0, value, raw=True)
                await until(lambda count=value + 1: bridge.runners[0].published >= count)

    device = board_of()
    with served(device) as url:
        asyncio.run(work(device, url))
    recording = Recording(path)
    found = list(recording)
    assert recording.is_whole
    assert [int.from_bytes(one.payload[8:10], "little") for one in found] == list(range(50))
    assert {one.board for one in found} == {"robot"}


def test_two_boards_and_one_that_changes_are_apart_in_a_recording(tmp_path):
    path = tmp_path / "a.mcap"
    names = []

    async def work():
        port = free_port()
        config = config_for(f"tcp://127.0.0.1:{port}", sinks=(f"mcap:{path}", "kept"))
        async with bridging(config) as bridge:
            for kind in ("u8", "u16"):
                device = board_of(f"SENSOR(s, 0, s, M, 1, {kind}, none)", serial="1")
                with served(device, port):
                    await until(lambda kind=kind: _is_kind(bridge, kind))
                    count = bridge.runners[0].published
                    device.sense("s", 0, 5)
                    await until(lambda count=count: bridge.runners[0].published > count)
                await until(lambda: not bridge._flows)

    asyncio.run(work())
    for one in Recording(path):
        names.append((one.board, str(one.sensor.type), one.payload[8:]))
    assert names == [("robot", "u8", b"\5"), ("robot_2", "u16", b"\5\0")]


def test_a_time_that_a_message_cannot_have_ends_no_recording(tmp_path):
    path = tmp_path / "a.mcap"

    async def work(device, url):
        async with bridging(config_for(url, sinks=(f"mcap:{path}", "kept"))) as bridge:
            await until(lambda: "quad" in bridge._flows)
            device.sense("quad", 0, 1, raw=True)
            await until(lambda: bridge.runners[0].published)
            [board] = bridge._boards.values()
            times = struct.pack("<Qh", (1 << 64) - 1, 2) + struct.pack("<Qh", 0, 0)
            level = bridge._flows["quad"]
            sample = update_of(level.topic, times).sample
            bridge._take_of(board, sample, time.time_ns())
            await until(lambda: bridge.runners[0].dropped)
            device.sense("quad", 0, 3, raw=True)
            await until(lambda: bridge.runners[0].published == 2)
            assert bridge.runners[0].problem == ""

    device = board_of()
    with served(device) as url:
        asyncio.run(work(device, url))
    values = [one.payload[8] for one in Recording(path)]
    assert values == [1, 3]


def _is_kind(bridge, kind):
    flow = bridge._flows.get("s")
    return flow is not None and str(flow.topic.transducer.type) == kind


@pytest.mark.parametrize(("segment", "size"), [(0, None), (1, 1 << 20), (3, 3 << 20)])
def test_a_segment_has_so_many_mib(tmp_path, monkeypatch, segment, size):
    sizes = []
    monkeypatch.setattr(mcap, "Recorder", lambda path, segment_bytes: sizes.append(segment_bytes))
    make_sink(SinkRequest.parse(f"mcap:{tmp_path / 'a.mcap'},segment={segment}"), None).open()
    assert sizes == [size]


def test_a_full_disk_ends_the_recording_and_nothing_else(kept, tmp_path, monkeypatch):
    device = board_of("SENSOR(s, 0, s, M, 1, array(u8, 200), none)")
    path = tmp_path / "a.mcap"

    def fail(self):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    async def work(url):
        async with bridging(config_for(url, sinks=(f"mcap:{path}", "kept"))) as bridge:
            await until(lambda: "s" in bridge._flows)
            recorder = bridge.runners[0]
            for value in range(20):
                if value == 10:
                    monkeypatch.setattr(Recorder, "flush", fail)
                device.sense("s", 0, [value] * 200)
                await until(lambda count=value + 1: len(kept[0].updates) >= count)
            await until(lambda: recorder.problem)
            assert "No space left" in recorder.problem
            assert not recorder.status.is_open
            assert bridge.runners[1].status.is_open

    with served(device) as url:
        asyncio.run(work(url))
    assert len(list(Recording(path))) >= 10


def run_command(*words, **more):
    return subprocess.Popen(
        [sys.executable, "-m", "j2a", "bridge", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **more,
    )


@pytest.fixture
def heeds_sighup():
    """Nothing has SIGHUP ignored, as nohup does."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@pytest.mark.usefixtures("heeds_sighup")
def test_the_command_ends_properly_by_a_signal(tmp_path, number):
    path = tmp_path / "a.mcap"
    device = board_of()
    with served(device) as url:
        process = run_command(url, "--sink", f"mcap:{path}")
        assert f"recording into {path}" in process.stderr.readline()
        while not path.exists() or not _recorded(path):
            device.sense("quad", 0, 1)
            time.sleep(0.02)
            assert process.poll() is None
        process.send_signal(number)
        _, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 128 + number
    assert "Traceback" not in err
    assert re.match(r"j2a: \S+ is here: (\w+, )*quad\b", err)
    recording = Recording(path)
    assert len(list(recording)) > 0
    assert recording.is_whole


@pytest.mark.parametrize(
    ("sink", "told"),
    [
        ("udp", "sending datagrams in the format json to 127.0.0.1:9870"),
        ("udp:[::1]:99,format=teleplot", "sending datagrams in the format teleplot to [::1]:99"),
    ],
)
def test_the_command_tells_where_datagrams_go(sink, told):
    process = run_command("loopback:none", "--sink", sink, "--seconds", "0.1")
    _, err = process.communicate(timeout=PATIENCE_S)
    assert told in err


def test_the_command_tells_once_why_a_sink_has_failed(tmp_path):
    path = tmp_path / "none" / "a.mcap"
    process = run_command("loopback:none", "--sink", f"mcap:{path}")
    _, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 1
    assert err.count("No such file or directory") == 1
    assert err.splitlines()[-1] == f"j2a: the sink mcap:{path} has failed"


def _recorded(path):
    try:
        return list(Recording(path))
    except Exception:  # its first bytes are on the way
        return []


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ((), "name a board"),
        (("tcp://127.0.0.1:1",), "name a sink"),
        (("tcp://127.0.0.1:1", "tcp://127.0.0.1:1", "--sink", "udp"), "stands there twice"),
        (("tcp://127.0.0.1:1", "--sink", "ros9"), "there is no sink"),
        (("nonsense://x", "--sink", "udp"), "nonsense"),
        (("--config", "missing.toml"), "missing.toml"),
    ],
)
def test_what_is_wrong_is_told_in_a_line(words, told):
    process = run_command(*words)
    out, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 2, err
    assert told in err
    assert "Traceback" not in err + out


def test_the_list_of_sinks_names_their_options():
    process = run_command("--list")
    out, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0
    for word in ("mcap:FILE.mcap", "segment=", "udp[:HOST:PORT]", "ros1"):
        assert word in out, err


@pytest.mark.parametrize("package", ["numpy", "rosbags"])
def test_a_sink_whose_packages_are_missing_names_its_own_extra(package):
    script = f"import sys; sys.modules[{package!r}] = None; from j2a.cli import main; main()"

    def run(*words):
        command = [sys.executable, "-c", script, *words]
        return subprocess.run(
            command, capture_output=True, text=True, timeout=PATIENCE_S, check=False
        )

    listed = run("bridge", "--list").stdout
    for sink, extra in {
        "foxglove": "foxglove",
        "ros1": "ros",
        "ros2": "ros2",
        "zenoh": "zenoh",
    }.items():
        told = rf'does not load: this needs {package}\S*: pip install "j2a\[{extra}]"'
        assert re.search(rf"^  {sink} +\({told}\)$", listed, re.MULTILINE)
    assert 'pip install "j2a[zenoh]"' in run("fleet").stderr


def test_a_file_says_all(tmp_path):
    path = tmp_path / "a.mcap"
    file = tmp_path / "robot.toml"
    device = board_of(TRANSDS)
    with served(device) as url:
        file.write_text(
            f'[[boards]]\nurl = "{url}"\ntransducers.quad = {{ topic = "wheel" }}\n'
            f'[[sinks]]\nuse = "mcap"\nto = "{path}"\n'
        )
        process = run_command("--config", str(file), env={**os.environ, "PYTHONUNBUFFERED": "1"})
        while not path.exists() or not _recorded(path):
            device.sense("quad", 0, 1)
            time.sleep(0.02)
            assert process.poll() is None, process.communicate()
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=PATIENCE_S)
    with path.open("rb") as stream:
        topics = {channel.topic for _, channel, _ in make_reader(stream).iter_messages()}
    assert topics == {"/wheel"}
