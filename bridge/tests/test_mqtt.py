"""The sink `mqtt` with a real broker."""

import asyncio
import json
import os
import queue
import shutil
import signal
import socket
import struct
import subprocess
import time
from concurrent.futures import CancelledError, Future
from dataclasses import replace

import paho.mqtt.client as paho
import pytest
from j2a_bridge.runner import SinkRunner
from j2a_bridge.sink import Control, SinkError
from j2a_bridge.sinks import mqtt
from j2a_bridge.sinks.mqtt import MqttSink
from j2a_bridge.topics import plain_name

from j2a import LocalError

from .support import PATIENCE_S, board_of, bridging, config_for, free_port, served, until
from .test_ros_messages import topic_of, update_of

pytestmark = [pytest.mark.broker]
if not shutil.which("mosquitto", path="/usr/sbin:/usr/bin") and not os.environ.get(
    "J2A_REQUIRE_AVR"
):
    pytestmark.append(pytest.mark.skip("needs the broker mosquitto"))
HOST = plain_name(socket.gethostname())


class Broker:
    """Mosquitto on the loopback."""

    def __init__(self, port, folder):
        self.port = port
        file = folder / "mosquitto.conf"
        file.write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\npersistence false\n")
        self._process = subprocess.Popen(
            ["/usr/sbin/mosquitto", "-c", str(file)],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        end = time.monotonic() + PATIENCE_S
        while time.monotonic() < end:
            with socket.socket() as one:
                if one.connect_ex(("127.0.0.1", port)) == 0:
                    return
            time.sleep(0.02)
        raise AssertionError("the broker does not start")

    def end(self):
        self._process.kill()
        self._process.wait()


@pytest.fixture
def broker(tmp_path):
    one = Broker(free_port(), tmp_path)
    yield one
    one.end()


class Listener:
    """Hears all topics."""

    def __init__(self, port):
        self.messages = queue.Queue()
        ready = queue.Queue()
        self.client = paho.Client(paho.CallbackAPIVersion.VERSION2)
        self.client.on_message = lambda client, data, message: self.messages.put(
            (message.topic, message.payload, message.retain)
        )
        self.client.on_subscribe = lambda *args: ready.put(1)
        self.client.connect("127.0.0.1", port)
        self.client.loop_start()
        self.client.subscribe("#", qos=1)
        ready.get(timeout=PATIENCE_S)

    def next(self, topic, is_right=lambda about: True):
        while True:
            name, payload, _ = self.messages.get(timeout=PATIENCE_S)
            if name == topic:
                about = json.loads(payload)
                if is_right(about):
                    return about

    def end(self):
        self.client.disconnect()
        self.client.loop_stop()


@pytest.fixture
def listener(broker):
    one = Listener(broker.port)
    yield one
    one.end()


def test_births_samples_orders_and_deaths(broker, listener):
    async def work():
        device = board_of()
        heard = lambda *words: asyncio.to_thread(listener.next, *words)  # noqa: E731
        sink = f"mqtt:127.0.0.1:{broker.port}"
        with served(device) as url:
            async with bridging(config_for(url, sinks=(sink,))) as bridge:
                assert bridge.runners[0].problem == ""
                birth = await heard(
                    f"j2a/DBIRTH/{HOST}/robot", lambda about: len(about.get("topics", ())) == 3
                )
                device.sense("quad", 1, 45.5)
                data = await heard(f"j2a/DDATA/{HOST}/robot/quad")
                order = f"j2a/DCMD/{HOST}/robot/servo"
                answers = []
                for about in (
                    {"values": [10, -20]},
                    {"values": [101]},
                    {"values": [1], "channel": 7},
                    {"values": "x"},
                    [],
                    {"values": [1], "at_ns": -1},
                    {"settings": {"colour": 1}},
                ):
                    listener.client.publish(order, json.dumps(about), qos=1)
                    answers.append(await heard(f"j2a/DRES/{HOST}/robot/servo"))
                quad = f"j2a/DCMD/{HOST}/robot/quad"
                listener.client.publish(quad, json.dumps({"settings": {"period": 0.5}}), qos=1)
                settings = await heard(f"j2a/DRES/{HOST}/robot/quad")
                listener.client.publish(quad, b"\xff" * 5000, qos=1)
                long = await heard(f"j2a/DRES/{HOST}/robot/quad")
        await heard(f"j2a/NDEATH/{HOST}")
        return device, birth, data, answers, settings, long

    device, birth, data, answers, settings, long = asyncio.run(work())
    assert birth["topics"]["servo"]["range"] == [-100, 100]
    assert birth["topics"]["quad"]["unit"] == "deg"
    assert birth["topics"]["quad"]["range"] is None
    keys = ("decimation", "threshold", "trigger", "watchdog_ms", "safe")
    assert [birth["topics"]["servo"][key] for key in keys] == [None, None, False, None, 5]
    assert birth["topics"]["quad"]["units"] == {"value": "deg"}
    assert data["values"] == [None, 45.5]
    assert data["times_ns"][0] is None
    assert data["times_ns"][1] == pytest.approx(time.time_ns(), abs=PATIENCE_S * 1e9)
    assert ("servo", 1, -20) in device.was_set
    assert [one["ok"] for one in answers] == [True, *[False] * 6]
    assert "servo is -100 % to 100 %" in answers[1]["message"]
    assert all(one["message"] for one in answers[1:])
    assert settings["settings"] == {"enabled": True, "period": 0.5}
    assert "4096 bytes" in long["message"]


@pytest.mark.parametrize(
    "order",
    [
        *(
            f'{{"values": [1], "channel": {channel}}}'
            for channel in ("NaN", "Infinity", "1e999", "1.5", "true", '"0"', "null", "9" * 4000)
        ),
        '{"values": [1], "at_ns": true}',
        f'{{"values": [1], "at_ns": {"9" * 4000}}}',
        '{"values": [NaN]}',
        '{"values": [' + "[" * 900 + "]" * 900 + "]}",
        "[" * 100_000,
        "[" * 2000,
        "{",
    ],
    ids=lambda order: order[:40],
)
def test_an_order_that_makes_no_sense_is_refused_and_the_next_one_done(broker, listener, order):
    async def work():
        device = board_of()
        heard = lambda *words: asyncio.to_thread(listener.next, *words)  # noqa: E731
        sink = f"mqtt:127.0.0.1:{broker.port}"
        with served(device) as url:
            async with bridging(config_for(url, sinks=(sink,))):
                await heard(
                    f"j2a/DBIRTH/{HOST}/robot", lambda about: len(about.get("topics", ())) == 3
                )
                answers = []
                for about in (order, '{"values": [5]}'):
                    listener.client.publish(f"j2a/DCMD/{HOST}/robot/servo", about, qos=1)
                    answers.append(await heard(f"j2a/DRES/{HOST}/robot/servo"))
        return device, answers

    device, (refused, done) = asyncio.run(work())
    assert not refused["ok"] and refused["message"]
    assert done["ok"]
    assert device.was_set == [("servo", 0, 5)]


class Answers(Control):
    """What orders end with; notes what is published instead of a client of paho."""

    def __init__(self, result=None, fails_at_once=None):
        self.sent = []
        self._result = result
        self._fails_at_once = fails_at_once

    def configure(self, topic, settings):
        if self._fails_at_once:
            raise self._fails_at_once
        future = Future()
        if isinstance(self._result, Exception):
            future.set_exception(self._result)
        else:
            future.set_result(self._result)
        return future

    def publish(self, topic, data, qos, retain):
        self.sent.append((topic, json.loads(data)))


def sink_of(port, control=None):
    options = {name: option.default for name, option in MqttSink.OPTIONS.items()}
    return MqttSink(f"127.0.0.1:{port}", options, control)


def answer_of(control, topic=f"j2a/DCMD/{HOST}/board/s"):
    sink = sink_of(1883, control)
    sink._boards = {"board": {"s": topic_of("SENSOR(s, 0, s, M, 1, u8, none)")}}
    sink._client = control
    sink._connected.set()
    message = paho.MQTTMessage(topic=topic.encode("utf-8", "surrogateescape"))
    message.payload = b'{"settings": {}}'
    sink._on_message(None, None, message)
    (sent,) = control.sent
    return sent


def test_whatever_goes_wrong_with_an_order_is_answered():
    name = f"j2a/DRES/{HOST}/board/s"
    refused = {"ok": False, "settings": None}
    error = RuntimeError("the loop is closed")
    assert answer_of(Answers(error)) == (name, refused | {"message": str(error)})
    assert answer_of(Answers(fails_at_once=error)) == (name, refused | {"message": str(error)})
    assert answer_of(Answers(CancelledError())) == (name, refused | {"message": "CancelledError"})
    assert not answer_of(Answers({"period": object()}))[1]["ok"]
    assert answer_of(Answers({"period": float("nan")}))[1]["settings"] == {"period": "nan"}
    topic, answer = answer_of(Answers(), topic="j2a/DCMD/\udcff")
    assert topic == f"j2a/DRES/{HOST}" and "utf-8" in answer["message"]


def test_a_broker_that_reads_nothing_does_not_fill_the_memory(broker, monkeypatch):
    monkeypatch.setattr(mqtt, "_TAKEN_S", 0.5)
    topic = topic_of("SENSOR(s, 0, s, M, 1, array(u8, 200), none)")
    update = update_of(topic, struct.pack("<Q200s", 5, bytes(200)))
    sink = sink_of(broker.port)
    sink.open()
    sink.announce(topic)
    broker._process.send_signal(signal.SIGSTOP)
    try:
        with pytest.raises(SinkError, match="takes no samples"):
            for _ in range(50_000):  # 40 MB, more than the buffers of the kernel
                sink.publish(update)
        # Births, and what paho sends by itself.
        assert len(sink._client._out_packet) <= mqtt._MOST_UNSENT + 10
    finally:
        broker._process.send_signal(signal.SIGCONT)
        sink.close()


def test_a_connection_that_ends_while_a_sample_waits_fails_the_sink(monkeypatch):
    class Lost:
        def publish(self, *args, **more):
            info = paho.MQTTMessageInfo(1)
            info.rc = paho.MQTT_ERR_CONN_LOST
            return info

    monkeypatch.setattr(mqtt, "_MOST_UNSENT", 2)
    topic = topic_of("SENSOR(s, 0, s, M, 1, u8, none)")
    sink = sink_of(1883)
    sink._client = Lost()
    sink._connected.set()
    sink.publish(update_of(topic, bytes(9)))
    with pytest.raises(SinkError, match="takes no samples"):
        sink.publish(update_of(topic, bytes(9)))


def test_a_board_that_goes_dies_and_comes_again(broker, listener):
    async def work():
        port = free_port()
        sink = f"mqtt:127.0.0.1:{broker.port}"
        async with bridging(config_for(f"tcp://127.0.0.1:{port}", sinks=(sink,))):
            for _ in range(2):
                with served(board_of(serial="1"), port):
                    await asyncio.to_thread(
                        listener.next,
                        f"j2a/DBIRTH/{HOST}/robot",
                        lambda about: len(about.get("topics", ())) == 3,
                    )
                await asyncio.to_thread(listener.next, f"j2a/DDEATH/{HOST}/robot")

    asyncio.run(work())


@pytest.mark.parametrize("is_quiet", [False, True])
def test_a_broker_that_dies_is_found_again(tmp_path, monkeypatch, is_quiet):
    monkeypatch.setattr(MqttSink, "RETRY_S", 0.1)
    port = free_port()

    async def work():
        device = board_of()
        with served(device) as url:
            config = config_for(url, sinks=(f"mqtt:127.0.0.1:{port}", "kept"))
            async with bridging(config) as bridge:
                runner = bridge.runners[0]
                await until(lambda: "no broker answers" in runner.problem)
                assert "Errno" not in runner.problem
                for value in range(2):
                    broker = Broker(port, tmp_path)
                    try:
                        await until(lambda: runner.status.is_open)
                        listener = Listener(port)
                        got = asyncio.create_task(
                            asyncio.to_thread(listener.next, f"j2a/DDATA/{HOST}/robot/quad")
                        )
                        while not got.done():
                            device.sense("quad", 0, value, raw=True)
                            await asyncio.wait([got], timeout=0.05)
                        assert got.result()["values"][0] == value / 2
                        order = json.dumps({"values": [value + 1]})
                        listener.client.publish(f"j2a/DCMD/{HOST}/robot/servo", order, qos=1)
                        await until(lambda wanted=value + 1: ("servo", 0, wanted) in device.was_set)
                        listener.end()
                    finally:
                        broker.end()
                    await until(lambda: (is_quiet or device.sense("quad", 0, 5), runner.problem)[1])

    asyncio.run(work())


def test_births_that_paho_does_not_take_fail_the_sink_which_tells_them_anew(broker, monkeypatch):
    monkeypatch.setattr(mqtt, "_WAITING", 5)
    sink = sink_of(broker.port)
    sink.open()
    broker._process.send_signal(signal.SIGSTOP)
    topic = topic_of("SENSOR(s, 0, s, M, 1, u8, none)")
    try:
        with pytest.raises(SinkError, match="takes no births"):
            for _ in range(100):
                sink.announce(topic)
                sink.flush()
    finally:
        broker._process.send_signal(signal.SIGCONT)
        sink.close()


def test_bridges_on_one_computer_may_have_names_of_their_own(broker, listener):
    options = {name: option.default for name, option in MqttSink.OPTIONS.items()}
    for node in ("left", "right"):
        sink = MqttSink(f"127.0.0.1:{broker.port}", options | {"node": node}, None)
        sink.open()
        listener.next(f"j2a/NBIRTH/{node}")
        sink.close()
        listener.next(f"j2a/NDEATH/{node}")


def test_bridges_of_one_name_are_both_told_once(broker, listener, caplog):
    def warnings():
        return [one.message for one in caplog.records if "has the node" in one.message]

    sinks = [sink_of(broker.port) for _ in range(2)]
    try:
        for one in sinks:
            one.open()
        births = [listener.next(f"j2a/NBIRTH/{HOST}")["bridge"] for _ in range(4)]
        assert set(births) == {one._id for one in sinks}
        listener.client.publish(f"j2a/DCMD/{HOST}/robot/s", "{}", qos=1)
        for _ in sinks:  # each answers, behind the births
            listener.next(f"j2a/DRES/{HOST}/robot/s")
    finally:
        for one in sinks:
            one.close()
    assert len(warnings()) == 2
    assert f"127.0.0.1:{broker.port},node=NAME" in warnings()[0]


@pytest.mark.parametrize("payload", [b"", b"{}", b"[" * 100_000, b'{"bridge": ', b"1", b"\xff"])
def test_a_birth_that_makes_no_sense_is_no_bridge(caplog, payload):
    sink = sink_of(1883)
    message = paho.MQTTMessage(topic=f"j2a/NBIRTH/{HOST}".encode())
    message.payload = payload
    sink._on_message(None, None, message)
    assert not caplog.records


def test_births_without_end_are_neither_kept_nor_answered(monkeypatch, caplog):
    """Any client of the broker may publish them."""
    sink, told = sink_of(1883), []
    monkeypatch.setattr(sink, "_tell_birth", lambda: told.append(1))
    for number in range(1000):
        message = paho.MQTTMessage(topic=f"j2a/NBIRTH/{HOST}".encode())
        message.payload = json.dumps({"bridge": f"{number}" + "x" * 1000}).encode()
        sink._on_message(None, None, message)
    assert len(told) == len(sink._namesakes) == len(caplog.records) < 100
    assert max(map(len, sink._namesakes)) == len(sink._id)


def test_the_birth_of_a_bridge_that_has_ended_is_no_other_bridge(broker, listener, caplog):
    for _ in range(2):
        sink = sink_of(broker.port)
        sink.open()
        listener.next(f"j2a/NBIRTH/{HOST}")
        listener.client.publish(f"j2a/DCMD/{HOST}/robot/s", "{}", qos=1)
        listener.next(f"j2a/DRES/{HOST}/robot/s")
        sink.close()
        listener.next(f"j2a/NDEATH/{HOST}")
    assert not [one for one in caplog.records if "has the node" in one.message]


@pytest.mark.parametrize("count", [1, 2, 3])
def test_boards_that_went_while_the_broker_was_away_are_dead_when_it_is_back(
    broker, listener, count
):
    sink = sink_of(broker.port)
    sink.open()
    one = topic_of("SENSOR(s, 0, s, M, 1, u8, none)")
    topics = [replace(one, board=f"board{number}") for number in range(count)]

    def births():
        return [listener.next(f"j2a/DBIRTH/{HOST}/{topic.board}") for topic in topics]

    try:
        for topic in topics:
            sink.announce(topic)
        sink.flush()
        assert all(one["topics"] for one in births())
        sink.close()
        sink.open()
        # It stays with the broker, in place of the old one.
        for topic in topics:
            listener.next(f"j2a/DDEATH/{HOST}/{topic.board}")
            assert listener.next(f"j2a/DBIRTH/{HOST}/{topic.board}") == {}
        for topic in topics:
            sink.announce(topic)
        sink.flush()
        assert all(one["topics"] for one in births())
    finally:
        sink.close()


@pytest.mark.parametrize(
    "kind", ["SENSOR(s, 0, s, M, 1, u8, none)", "ACTUATOR(s, 0, s, M, 1, u8, 0)"]
)
def test_the_birth_of_a_board_has_all_that_is_here_of_it(broker, listener, kind):
    sink = sink_of(broker.port)
    sink.open()
    topics = [topic_of(kind, name=f"s{number}") for number in range(3)]

    def born():
        return sorted(listener.next(f"j2a/DBIRTH/{HOST}/board")["topics"])

    try:
        for count, topic in enumerate(topics, 1):
            sink.announce(topic)
            sink.flush()
            assert born() == [one.name for one in topics[:count]]
        for count in (2, 1):
            sink.retract(topics[count])
            sink.flush()
            assert born() == [one.name for one in topics[:count]]
    finally:
        sink.close()


class Sent:
    """A client of a broker that is there, and keeps what it was given."""

    def __init__(self):
        self.births = []

    def publish(self, topic, data, qos, retain):
        if "/DBIRTH/" in topic:
            self.births.append(sorted(json.loads(data).get("topics", {})))

    def is_connected(self):
        return False

    def disconnect(self):
        pass

    loop_stop = disconnect


def test_a_board_is_born_once_with_all_that_comes_at_once(monkeypatch):
    client = Sent()
    sink = sink_of(1883)

    def is_open():
        sink._client = client
        sink._connected.set()

    monkeypatch.setattr(sink, "open", is_open)
    runner = SinkRunner("mqtt", sink)
    topics = [
        topic_of("SENSOR(s, 0, s, M, 1, u8, none)", name=f"s{number}") for number in range(20)
    ]
    for topic in topics:
        runner.announce(topic)
    runner.start()
    until_then = time.monotonic() + PATIENCE_S
    while not client.births and time.monotonic() < until_then:
        time.sleep(0.01)
    runner.end()
    assert runner.join(PATIENCE_S)
    assert client.births == [sorted(one.name for one in topics)]


def test_a_board_is_born_before_its_first_sample():
    client = Sent()
    sink = sink_of(1883)
    sink._client = client
    sink._connected.set()
    topic = topic_of("SENSOR(s, 0, s, M, 1, u8, none)")
    sink.announce(topic)
    assert client.births == []
    sink.publish(update_of(topic, struct.pack("<QB", 7, 1)))
    assert client.births == [[topic.name]]


def test_who_comes_after_a_bridge_has_died_is_told_of_it(broker, listener):
    sink = sink_of(broker.port)
    sink.open()
    try:
        sink._client.socket().shutdown(socket.SHUT_RDWR)  # and it says no word
        listener.next(f"j2a/NDEATH/{HOST}")
        later = Listener(broker.port)
        later.next(f"j2a/NDEATH/{HOST}")
        later.end()
    finally:
        sink.close()


@pytest.mark.parametrize(
    ("argument", "host", "port"),
    [
        ("", "127.0.0.1", 1883),
        ("box", "box", 1883),
        ("box:2000", "box", 2000),
        ("[::1]:2000", "::1", 2000),
        ("[::1]", "::1", 1883),
    ],
)
def test_a_broker_is_a_name_or_an_address_with_or_without_a_port(argument, host, port):
    options = {name: option.default for name, option in MqttSink.OPTIONS.items()}
    sink = MqttSink(argument, options, None)
    assert (sink._host, sink._port) == (host, port)


@pytest.mark.parametrize("argument", ["box:", "box:0", "box:65536", "box:x", "[::1]x", "[::1]:x"])
def test_a_broker_that_cannot_be_is_refused(argument):
    options = {name: option.default for name, option in MqttSink.OPTIONS.items()}
    with pytest.raises(LocalError, match="mqtt speaks with HOST:PORT"):
        MqttSink(argument, options, None)


@pytest.mark.parametrize(("lost", "missed"), [(0, 0), (3, 0), (0, 4), (3, 4)])
def test_what_the_board_and_what_the_link_has_lost_counts(lost, missed):
    update = update_of(topic_of("SENSOR(s, 0, s, M, 1, u8, none)"), struct.pack("<QB", 7, 1))
    sample = replace(update.sample, lost=lost, missed=missed)
    assert mqtt.sample_object(replace(update, sample=sample))["lost"] == lost + missed


@pytest.mark.parametrize(("scale", "offset"), [(1, 0), (0.5, 0), (1, -40), (-0.25, 12)])
def test_the_range_of_a_birth_is_in_the_unit(scale, offset):
    more = f"(scale, {scale}), (offset, {offset})"
    topic = topic_of(f"SENSOR(s, 0, s, M, 1, i16, none, (unit, Cel), {more}, (range, -20, 60))")
    ends = [-20 * scale + offset, 60 * scale + offset]
    assert mqtt.transducer_object(topic)["range"] == pytest.approx(ends)
