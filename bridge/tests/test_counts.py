"""Samples that come to nothing are counted, and counts outlive the board, the flow and the sink."""

import contextlib
import dataclasses

import pytest

from .support import board_of, bridging, config_for, free_port, served, until
from .test_bridge import announced, in_event_loop, learning_late


async def sensed(bridge, device, count):
    """Have a board send a sample of `quad`, until so many were counted."""
    for value in range(count - bridge._flows["quad"].samples):
        before = bridge._flows["quad"].samples
        device.sense("quad", 0, value, raw=True)
        await until(lambda least=before: bridge._flows["quad"].samples > least)


@in_event_loop
async def test_a_board_that_is_plugged_in_again_counts_on(kept):
    port = free_port()
    async with bridging(config_for(f"tcp://127.0.0.1:{port}")) as bridge:
        for count in (2, 5):
            device = board_of()
            with served(device, port):
                await until(lambda: "quad" in bridge._flows)
                await sensed(bridge, device, count)
                bridge._flows["quad"].lost += 3
            await until(lambda: "quad" not in bridge._flows)
        with served(board_of(), port):
            await until(lambda: "quad" in bridge._flows)
            assert bridge._flows["quad"].counts == (5, 6, 0)
            status = bridge._flows["quad"].status(1.0)
    assert (status.samples, status.lost, status.rate_hz) == (5, 6, 0.0)


@in_event_loop
async def test_samples_that_come_while_a_board_is_learnt_anew_are_lost(kept, monkeypatch):
    device = board_of()
    with served(device) as url:
        async with bridging(config_for(url)) as bridge:
            await announced(kept[0], "quad", "tank/level", "servo")
            [board] = bridge._boards.values()
            await sensed(bridge, device, 1)
            [update] = await until(lambda: list(kept[0].updates))
            flow = bridge._flows["quad"]
            with monkeypatch.context() as changed:
                changed.setattr(type(flow), "is_as_announced", lambda _: False)
                bridge._take(update.sample)
            assert flow.counts == (2, 1, 0)
            # One that it did not have before.
            level = board.flows.pop("level")
            bridge._take(dataclasses.replace(update.sample, name="level"))
            await bridge._learn(board)
            assert bridge._flows["tank/level"] is not level
            assert bridge._flows["tank/level"].counts == (1, 1, 0)


@in_event_loop
async def test_samples_of_a_board_that_went_before_it_was_known_are_lost(kept, monkeypatch):
    device, may_learn = board_of(), learning_late(monkeypatch)
    with served(device) as url:
        async with bridging(config_for(url)) as bridge:
            await until(lambda: bridge._boards)
            [(identity, board)] = bridge._boards.items()
            for count in (1, 2, 3):
                device.sense("quad", 0, count)
                await until(lambda least=count: len(board.early) == least)
            client = board.client
            bridge._go(identity, None)
            board.client = client
            may_learn.set()
            await until(lambda: "quad" in bridge._flows)
            assert bridge._flows["quad"].counts == (3, 3, 0)


@pytest.mark.parametrize("comes_first", [0, 1])
@in_event_loop
async def test_twins_keep_their_topics_whichever_is_plugged_in_again_first(kept, comes_first):
    ports = free_port(), free_port()

    def here(bridge):
        return {one.url: one.name for one in bridge._boards.values() if one.client is not None}

    config = config_for(*(f"tcp://127.0.0.1:{port}" for port in ports))
    async with bridging(config) as bridge:
        with contextlib.ExitStack() as stack:
            for count, port in enumerate(ports, 1):
                stack.enter_context(served(board_of(serial="1"), port))
                await until(lambda least=count: len(here(bridge)) == least)
            names = here(bridge)
        await until(lambda: not here(bridge))
        with served(board_of(serial="1"), ports[comes_first]):
            await until(lambda: here(bridge))
            with served(board_of(serial="1"), ports[not comes_first]):
                await until(lambda: len(here(bridge)) == len(ports))
                assert here(bridge) == names
    assert len(set(names.values())) == len(ports)
