"""The sink `foxglove`, seen by a client that speaks its protocol."""

import asyncio
import json
import struct
from types import SimpleNamespace

import aiohttp
import pytest
from j2a_bridge.ros_messages import RosMessages
from j2a_bridge.sink_request import SinkRequest, make_sink
from j2a_bridge.sinks.foxglove import _Listener

from j2a import LocalError

from .support import PATIENCE_S, board_of, bridging, config_for, free_port, served, until
from .test_ros_messages import topic_of
from .test_zenoh import _descriptors

SUBPROTOCOL = "foxglove.sdk.v1"


async def connect(session, port):
    return await session.ws_connect(
        f"ws://127.0.0.1:{port}", protocols=(SUBPROTOCOL,), timeout=aiohttp.ClientWSTimeout(5)
    )


async def advertised(socket, *topics):
    """Return the channels by topic, when all of these were advertised."""
    found = {}
    while not set(topics) <= set(found):
        message = await socket.receive(timeout=PATIENCE_S)
        if message.type is aiohttp.WSMsgType.TEXT:
            about = json.loads(message.data)
            if about["op"] == "advertise":
                found |= {one["topic"]: one for one in about["channels"]}
    return found


def test_samples_come_as_messages_of_ros2_and_commands_go_back(caplog):
    async def work():
        device = board_of()
        with served(device) as url:
            config = config_for(url, sinks=("foxglove:127.0.0.1:0,commands=yes",))
            async with bridging(config) as bridge, aiohttp.ClientSession() as session:
                port = bridge.runners[0].sink.port
                socket = await connect(session, port)
                channels = await advertised(socket, "/quad", "/quad/joints")
                quad = channels["/quad"]
                await socket.send_json(
                    {"op": "subscribe", "subscriptions": [{"id": 5, "channelId": quad["id"]}]}
                )
                got = asyncio.create_task(binary(socket))
                while not got.done():
                    device.sense("quad", 1, 45.5)
                    await asyncio.wait([got], timeout=0.05)
                data, log_time_ns = got.result()
                await socket.send_json(
                    {
                        "op": "advertise",
                        "channels": [
                            {
                                "id": 1,
                                "topic": "/servo/cmd",
                                "encoding": "json",
                                "schemaName": "",
                            }
                        ],
                    }
                )

                async def order(data):
                    await socket.send_bytes(struct.pack("<BI", 1, 1) + data)

                await order(json.dumps({"values": [10, -20]}).encode())
                await until(lambda: ("servo", 1, -20) in device.was_set)
                for bad in (b"", b"[]", b'{"values": [101]}', b"\xff", b"[" * 4000, b"x" * 5000):
                    await order(bad)
                await until(lambda: "servo was not set" in caplog.text)
                await until(lambda: caplog.text.count("a command was refused") >= 5)
                await socket.close()
        return quad, data, log_time_ns

    quad, data, log_time_ns = asyncio.run(work())
    assert (quad["encoding"], quad["schemaName"]) == ("cdr", "j2a_msgs/msg/Quad")
    assert "int16[] values" in quad["schema"]
    ros = RosMessages("jazzy")
    message = ros.store_of(_descriptors()).deserialize_cdr(data, "j2a_msgs/msg/Quad")
    assert message.values.tolist() == [0, 91]
    # When it was measured, not when it came.
    assert log_time_ns == max(one.sec * 10**9 + one.nanosec for one in message.times)


def test_channels_of_a_board_that_has_gone_are_not_kept():
    sink = make_sink(SinkRequest.parse("foxglove:127.0.0.1:0"), None)
    sink.open()
    try:
        topic = topic_of("SENSOR(s, 0, s, M, 1, u8, none, (unit, deg))")
        kept = sink._foxglove.channel._channels_by_id
        before = len(kept)
        for _ in range(3):
            sink.announce(topic)
            assert len(kept) == before + 2
            sink.retract(topic)
        assert len(kept) == before
    finally:
        sink.close()


def test_no_page_commands_actuators_unless_the_user_says_so(caplog):
    sink = make_sink(SinkRequest.parse("foxglove:127.0.0.1:0"), None)
    sink.open()
    try:
        sink.announce(topic_of("ACTUATOR(servo, 1, servo, M, 1, i8, 0)"))
        sink.take("/servo/cmd", b'{"values": [1]}')
        assert "the option commands=yes" in caplog.text
    finally:
        sink.close()


async def binary(socket):
    while True:
        message = await socket.receive(timeout=PATIENCE_S)
        if message.type is aiohttp.WSMsgType.BINARY and message.data[0] == 1:
            return message.data[13:], int.from_bytes(message.data[5:13], "little")


def test_a_viewer_that_reads_nothing_delays_nobody(kept):
    async def work():
        device = board_of()
        with served(device) as url:
            port = free_port()
            config = config_for(url, sinks=(f"foxglove:127.0.0.1:{port}", "kept"))
            async with bridging(config), aiohttp.ClientSession() as session:
                socket = await connect(session, port)
                channels = await advertised(socket, "/quad")
                subscription = {"id": 5, "channelId": channels["/quad"]["id"]}
                await socket.send_json({"op": "subscribe", "subscriptions": [subscription]})
                for value in range(1500):
                    device.sense("quad", 0, value % 1000, raw=True)
                    await until(lambda count=value: len(kept[0].updates) > count)
                await socket.close()

    asyncio.run(work())


@pytest.mark.parametrize("word", ["127.0.0.1", "x", "127.0.0.1:70000"])
def test_an_address_that_is_none_is_told(word):
    with pytest.raises(LocalError, match="foxglove listens at HOST:PORT"):
        make_sink(SinkRequest.parse(f"foxglove:{word}"), None)


@pytest.mark.parametrize(
    ("host", "told"), [("127.0.0.1", "ws://127.0.0.1:"), ("[::1]", "ws://[::1]:")]
)
def test_what_to_open_is_a_url(host, told):
    sink = make_sink(SinkRequest.parse(f"foxglove:{host}:0"), None)
    sink.open()
    try:
        assert sink.told() == f"open {told}{sink.port} in Foxglove"
    finally:
        sink.close()


def test_viewers_number_their_channels_each_for_itself():
    taken = []
    listener = _Listener(SimpleNamespace(take=lambda name, data: taken.append((name, data))))
    viewers = [SimpleNamespace(id=number) for number in (1, 2, 7)]
    for at, viewer in enumerate(viewers):
        for channel in (1, 2):
            about = SimpleNamespace(id=channel, topic=f"/{at}/{channel}")
            listener.on_client_advertise(viewer, about)
    listener.on_client_unadvertise(viewers[0], 2)
    for viewer in viewers:
        for channel in (1, 2):
            listener.on_message_data(viewer, channel, b"")
    names = [name for name, _ in taken]
    assert names == ["/0/1", "", "/1/1", "/1/2", "/2/1", "/2/2"]
