"""What a broker keeps of a bridge says whether it is there, for who comes later."""

import asyncio
import json

import pytest

from .support import PATIENCE_S, board_of, bridging, config_for, served, until
from .test_bridge import in_event_loop
from .test_mqtt import HOST, Listener, broker, pytestmark  # noqa: F401 - a fixture, and marks


def kept(port):
    """Return what the broker keeps, by what stands behind the group."""
    listener = Listener(port)
    found = {}
    try:
        # Behind what is kept comes what is published now.
        listener.client.publish("end", b"", qos=1)
        while True:
            topic, payload, is_retained = listener.messages.get(timeout=PATIENCE_S)
            if topic == "end":
                return found
            if is_retained:
                found[topic.removeprefix("j2a/")] = json.loads(payload)
    finally:
        listener.end()


@pytest.mark.parametrize("times", [1, 2])
@in_event_loop
async def test_a_bridge_is_dead_for_who_comes_later_only_while_it_is(broker, times):  # noqa: F811
    config = config_for("loopback:none", sinks=(f"mqtt:127.0.0.1:{broker.port}",))
    for _ in range(times):
        async with bridging(config):
            await until(lambda: kept(broker.port).keys() == {f"NBIRTH/{HOST}"})
        assert f"NDEATH/{HOST}" in kept(broker.port)


@in_event_loop
async def test_boards_that_a_bridge_had_before_it_was_started_anew_are_told_no_more(broker):  # noqa: F811
    listener = Listener(broker.port)
    try:
        birth = json.dumps({"topics": {"old": {}}})
        for board in ("ghost", "robot"):
            listener.client.publish(f"j2a/DBIRTH/{HOST}/{board}", birth, qos=1, retain=True)
            await asyncio.to_thread(listener.next, f"j2a/DBIRTH/{HOST}/{board}")
        with served(board_of()) as url:
            sinks = (f"mqtt:127.0.0.1:{broker.port}",)
            async with bridging(config_for(url, sinks=sinks)):
                await asyncio.to_thread(listener.next, f"j2a/DDEATH/{HOST}/ghost")
                await asyncio.to_thread(
                    listener.next,
                    f"j2a/DBIRTH/{HOST}/robot",
                    lambda about: about.get("topics", {}).keys() == {"quad", "tank/level", "servo"},
                )
                there = await asyncio.to_thread(kept, broker.port)
    finally:
        listener.end()
    assert there[f"DBIRTH/{HOST}/ghost"] == {}
    assert "quad" in there[f"DBIRTH/{HOST}/robot"]["topics"]
