"""The bridge: boards in, sinks out."""

import asyncio
import contextlib
import dataclasses
import functools
import itertools
import re
import struct
import time
from collections import Counter

import pytest
from j2a_bridge.bridge import _EARLY, _MAX_ORDERS, Bridge
from j2a_bridge.config import BoardConfig, Config, SensorConfig
from j2a_bridge.sink import SinkError
from j2a_bridge.sink_request import SinkRequest
from j2a_bridge.topics import _OF_ROS
from j2a_spec import constants as c

import j2a
from j2a.aio import AsyncTransducers
from j2a.io.async_clock import AsyncClock
from j2a.io.async_transducers import AsyncSensor
from j2a.types.transds_file import read_transds

from .support import (
    PATIENCE_S,
    TRANSDS,
    Kept,
    board_of,
    bridging,
    config_for,
    free_port,
    served,
    until,
)


def in_event_loop(test):
    @functools.wraps(test)
    def run(*args, **kwargs):
        return asyncio.run(test(*args, **kwargs))

    return run


def names(sink, what):
    return [name for kind, name in sink.events if kind == what]


def restart(device, text):
    """Have a board say that it has restarted, and what it has now."""
    device._runner._server.content = str(read_transds(text)).encode()
    [connection] = device._connections
    connection.send_sif(c.BOOT, struct.pack("<BHI", 0, 1, 0))


def unit_of(client, name):
    """Return the unit of a transducer, None while it is not known what the board has."""
    with contextlib.suppress(j2a.UnknownTransducer):
        return client.transducers[name].unit
    return None


def learning_late(monkeypatch):
    """Have topics of boards learnt when the event that is returned is set."""
    learn, may_learn = Bridge._learn, asyncio.Event()

    async def late(self, board):
        await may_learn.wait()
        return await learn(self, board)

    monkeypatch.setattr(Bridge, "_learn", late)
    return may_learn


async def announced(sink, *wanted):
    await until(lambda: set(wanted) <= set(names(sink, "announce")), wanted)


class TestTopics:
    @in_event_loop
    async def test_one_board_has_short_names(self, kept):
        with served(board_of()) as url:
            async with bridging(config_for(url)):
                await announced(kept[0], "quad", "tank/level", "servo")

    @pytest.mark.parametrize("style", ["board", ""])
    @in_event_loop
    async def test_several_have_the_name_of_the_board_before(self, kept, style):
        with served(board_of(name="left")) as one, served(board_of(name="right one")) as other:
            async with bridging(config_for(one, other, names=style)):
                await announced(kept[0], "left/quad", "right_one/tank/level")

    @in_event_loop
    async def test_two_transducers_never_share_a_topic(self, kept):
        one, other = board_of(serial="1"), board_of(serial="2")
        with served(one) as first, served(other) as second:
            async with bridging(config_for(first, second, names="short")):
                await until(lambda: len(names(kept[0], "announce")) == 6)
        found = names(kept[0], "announce")
        assert len(set(found)) == 6
        assert {"quad", "servo"} <= set(found)

    @in_event_loop
    async def test_boards_that_were_built_with_equal_serial_numbers_are_both_there(self, kept):
        with served(board_of(serial="0001")) as first, served(board_of(serial="0001")) as second:
            async with bridging(config_for(first, second)):
                await announced(kept[0], "robot/quad", "robot_0001/quad")

    @in_event_loop
    async def test_very_many_boards_are_not_remembered_for_ever(self, kept, monkeypatch):
        monkeypatch.setattr("j2a_bridge.bridge._MAX_BOARDS", 3)
        port = free_port()
        async with bridging(config_for(f"tcp://127.0.0.1:{port}", names="board")) as bridge:
            for number in range(8):
                with served(board_of(serial=f"S{number}"), port):
                    await until(lambda: bridge._flows)
                await until(lambda: not bridge._flows)
            assert len(bridge._boards) <= 4
            assert len(bridge._names._boards) <= 4
            assert len(bridge._names._topics) <= len(_OF_ROS) + 4 * 3

    @in_event_loop
    async def test_the_topic_of_a_transducer_that_is_gone_is_free(self, kept):
        first, second = free_port(), free_port()
        urls = [f"tcp://127.0.0.1:{port}" for port in (first, second)]
        async with bridging(config_for(*urls, names="short")):
            with served(board_of(serial="1"), first):
                await announced(kept[0], "quad")
            await until(lambda: "quad" in names(kept[0], "retract"))
            with served(board_of("SENSOR(only, 0, o, M, 1, u8, none)", serial="1"), first):
                await announced(kept[0], "only")
                kept[0].events.clear()
                with served(board_of(serial="2"), second):
                    await announced(kept[0], "quad", "servo")

    @in_event_loop
    async def test_a_transducer_with_another_name_has_the_topic_that_one_before_had(
        self, kept, caplog
    ):
        device = board_of("SENSOR(a, 0, a, M, 1, i16, none, (topic, pos))", boot=True)
        with served(device) as url:
            async with bridging(config_for(url, clock="off")) as bridge:
                await announced(kept[0], "pos")
                restart(device, "SENSOR(b, 0, b, M, 1, i16, none, (topic, pos))")
                [board] = bridge._boards.values()
                await until(lambda: list(board.flows) == ["b"])
                assert list(bridge._flows) == ["pos"]
        assert "is taken" not in caplog.text

    @in_event_loop
    async def test_transducers_may_change_their_topics_round(self, kept):
        text = "".join(
            f"SENSOR({one}, {at}, {one}, M, 1, u8, none, (topic, {one}))\n"
            for at, one in enumerate("xy")
        )
        with served(board_of(text)) as url:
            async with bridging(config_for(url, clock="off")) as bridge:
                await announced(kept[0], "x", "y")
                control = kept[0].control
                for topic, wish in (("x", "y"), ("y", "x")):
                    await asyncio.wrap_future(control.configure(topic, {"topic": wish}))
                found = {name: one.topic.transducer.name for name, one in bridge._flows.items()}
        assert found == {"y": "x", "x": "y"}

    # The fleet asks for the properties first, to know the board.
    @pytest.mark.parametrize(
        ("kind", "name", "late"),
        [(j2a.AsyncClient, "properties", 2), (AsyncTransducers, "__call__", 1)],
    )
    @in_event_loop
    async def test_a_board_that_did_not_answer_is_asked_again(
        self, kept, monkeypatch, kind, name, late
    ):
        answer, calls = getattr(kind, name), []

        async def once_late(self):
            calls.append(name)
            if len(calls) == late:
                raise j2a.CallTimeout("no answer")
            return await answer(self)

        monkeypatch.setattr(kind, name, once_late)
        with served(board_of()) as url:
            async with bridging(config_for(url)):
                await announced(kept[0], "quad", "tank/level", "servo")
        assert len(calls) > late

    @in_event_loop
    async def test_a_board_that_restarts_again_and_again_is_asked_by_one_at_a_time(
        self, kept, monkeypatch
    ):
        answer, may_answer = AsyncTransducers.__call__, False

        async def late(self):
            if not may_answer:
                raise j2a.CallTimeout("no answer")
            return await answer(self)

        monkeypatch.setattr(AsyncTransducers, "__call__", late)
        with served(board_of()) as url:
            async with bridging(config_for(url, clock="off")) as bridge:
                [board] = await until(lambda: list(bridge._boards.values()))
                for _ in range(20):
                    await bridge._persist(board.client, bridge._learn, board)
                assert len(bridge._tasks) == 1
                may_answer = True
                await announced(kept[0], "quad")
                await until(lambda: not bridge._tasks and not bridge._retried)

    @in_event_loop
    async def test_a_board_that_restarts_while_it_is_learnt_is_learnt_again(
        self, kept, monkeypatch, caplog
    ):
        answer, sources = AsyncTransducers.__call__, []

        async def forgotten_at_once(self):
            found = await answer(self)
            if not sources:  # as at a restart, until all is known anew
                sources.append(found["quad"]._source)
                monkeypatch.setattr(sources[0], "codec", lambda _name: None)
            else:
                monkeypatch.delattr(sources[0], "codec", raising=False)
            return found

        monkeypatch.setattr(AsyncTransducers, "__call__", forgotten_at_once)
        with served(board_of()) as url:
            async with bridging(config_for(url, clock="off")):
                await announced(kept[0], "quad", "tank/level", "servo")
        assert f"{url} has no transducer 'quad' any more" in caplog.text

    @in_event_loop
    async def test_a_sample_of_before_a_restart_is_left_out(self, kept, monkeypatch, caplog):
        device = board_of()
        with served(device) as url:
            async with bridging(config_for(url)) as bridge:
                await announced(kept[0], "quad")
                device.sense("quad", 0, 1, raw=True)
                await until(lambda: kept[0].updates)
                [board] = bridge._boards.values()
                source = board.flows["quad"].transducer._source
                sample, count = kept[0].updates[-1].sample, len(kept[0].updates)
                with monkeypatch.context() as restarting:
                    restarting.setattr(source, "codec", lambda _name: None)
                    bridge._take(sample)
                bridge._take(sample)
                await until(lambda: len(kept[0].updates) > count)
        assert len(kept[0].updates) == count + 1

    @in_event_loop
    async def test_what_is_learnt_of_a_board_that_has_gone_meanwhile_changes_nothing(self, kept):
        with served(board_of()) as url:
            async with bridging(config_for(url)) as bridge:
                await announced(kept[0], "quad", "tank/level", "servo")
                [board] = bridge._boards.values()
                before, client = board.flows, board.client
                learning = asyncio.create_task(bridge._learn(board))
                await asyncio.sleep(0)
                board.client = None
                await learning
                assert board.flows is before
                board.client = client

    @in_event_loop
    async def test_a_board_keeps_its_name_wherever_it_is_plugged_in(self, kept):
        ports = free_port(), free_port()
        urls = [f"tcp://127.0.0.1:{port}" for port in ports]
        async with bridging(config_for(*urls)):
            for port in ports:
                kept[0].events.clear()
                with served(board_of(name="arm", serial="S1"), port):
                    await announced(kept[0], "arm/quad")
                await until(lambda: "arm/quad" in names(kept[0], "retract"))

    @in_event_loop
    async def test_what_the_file_says_of_a_board(self, kept):
        transducers = {
            "quad": SensorConfig(topic="wheel/left"),
            "level": SensorConfig(is_published=False),
        }
        with served(board_of()) as url:
            board = BoardConfig(url=url, name="base", transducers=transducers)
            async with bridging(Config((board,), (SinkRequest("kept"),), names="board")):
                await announced(kept[0], "base/wheel/left", "base/servo")
        assert "base/tank/level" not in names(kept[0], "announce")


class TestSamples:
    @in_event_loop
    async def test_all_come_in_order_with_values_and_unit(self, kept):
        device = board_of()
        with served(device) as url:
            async with bridging(config_for(url)):
                await announced(kept[0], "quad")
                for value in range(20):
                    device.sense("quad", value % 2, value, raw=True)
                    await until(lambda count=value + 1: len(kept[0].updates) >= count)
        found = [update.sample.values[at % 2] for at, update in enumerate(kept[0].updates)]
        assert found == [value / 2 for value in range(20)]
        assert {update.sample.unit for update in kept[0].updates} == {"deg"}

    @pytest.mark.parametrize("clock", ["discipline", "follow", "off"])
    @in_event_loop
    async def test_stamps_are_times_of_this_computer(self, kept, clock):
        device = board_of()
        with served(device) as url:
            async with bridging(config_for(url, clock=clock)):
                await announced(kept[0], "quad")
                before = time.time_ns()
                device.sense("quad", 0, 1)
                [update] = await until(lambda: list(kept[0].updates))
                after = time.time_ns()
        slack_ns = 2_000_000_000  # of a machine that is busy while the clock is read
        assert before - slack_ns <= update.stamp_ns <= after + slack_ns
        assert update.stamps_ns[0] == update.stamp_ns
        assert update.stamps_ns[1] is None
        assert (update.uncertainty_us is None) == (clock == "off")

    @in_event_loop
    async def test_a_clock_whose_first_exchanges_contradict_each_other_is_kept(
        self, kept, monkeypatch
    ):
        async def contradict(_clock, _rounds):
            raise j2a.LocalError("nothing is known of the clock yet")

        monkeypatch.setattr(AsyncClock, "measure", contradict)
        with served(board_of(clock=20.0)) as url:
            async with bridging(config_for(url)):
                await until(
                    lambda: [
                        one
                        for status in kept[0].statuses
                        for one in status.boards
                        if one.clock in ("settling", "locked")
                    ]
                )

    @in_event_loop
    async def test_a_clock_that_jumps_between_its_first_exchanges_is_kept(self, kept, monkeypatch):
        device, pause, jumps = board_of(clock=20.0), AsyncClock._pause, []

        async def jumping(self, seconds):
            if not jumps:
                jumps.append(seconds)
                device._start_ns -= 10_000_000_000
            await pause(self, seconds)

        monkeypatch.setattr(AsyncClock, "_pause", jumping)
        with served(device) as url:
            async with bridging(config_for(url)) as bridge:
                [board] = await until(lambda: list(bridge._boards.values()))
                await until(lambda: board.flows)
                assert board.has_clock
                await until(lambda: board.uncertainty_us)

    @in_event_loop
    async def test_the_clock_that_a_board_has_since_a_restart_only_is_kept(self, kept):
        device = board_of(boot=True)
        device._runner._server.content = b""
        with served(device) as url:
            async with bridging(config_for(url)) as bridge:
                [board] = await until(lambda: list(bridge._boards.values()))
                await until(lambda: board.flows == {})
                assert not board.has_clock
                restart(device, TRANSDS)
                await announced(kept[0], "quad")
                await until(lambda: board.uncertainty_us)
                device.sense("quad", 0, 1)
                [update] = await until(lambda: list(kept[0].updates))
        assert update.uncertainty_us is not None

    @in_event_loop
    async def test_a_channel_that_was_read_before_the_clock_was_set_has_no_stamp(self, kept):
        device = board_of()
        with served(device) as url:
            device.sense("quad", 0, 7, raw=True)
            async with bridging(config_for(url)) as bridge:
                await announced(kept[0], "quad")
                [board] = bridge._boards.values()
                await until(lambda: board.has_clock)
                year_us = 365 * 86_400 * 1_000_000
                device.sense("quad", 1, 8, raw=True)
                [update] = await until(lambda: list(kept[0].updates))
                early, payload = update.sample, bytearray(update.sample.payload)
                for now, then, stamps in [
                    (2 * year_us, year_us, [True, True]),
                    (2 * year_us, year_us - 1, [False, True]),
                    (2 * year_us, 0, [False, True]),
                ]:
                    kept[0].updates.clear()
                    struct.pack_into("<Q", payload, 0, then)
                    struct.pack_into("<Q", payload, 10, now)
                    bridge._take(dataclasses.replace(early, payload=bytes(payload)))
                    [update] = await until(lambda: list(kept[0].updates))
                    assert [one is not None for one in update.stamps_ns] == stamps
                    assert max(update.times_us) == now

    @pytest.mark.parametrize("is_known", [False, True])
    @in_event_loop
    async def test_a_channel_that_was_read_before_the_clock_went_back_has_no_stamp(
        self, kept, is_known
    ):
        """It would be in the future, or what is read now in the past."""
        shift_us, ahead_us, found = 1_700_000_000_000_000, 3_600_000_000, []
        device, board = board_of(), BoardConfig(transducers={"quad": SensorConfig(rate_hz=100.0)})
        with served(device) as url:
            board = dataclasses.replace(board, url=url)
            async with bridging(Config((board,), (SinkRequest("kept"),))) as bridge:
                await announced(kept[0], "quad")
                device.sense("quad", 0, 1, raw=True)
                [update] = await until(lambda: list(kept[0].updates))
                for times, is_reset in (
                    ((5, ahead_us), False),
                    ((ahead_us + 20_000, ahead_us), False),
                    ((20_000, ahead_us), True),
                    ((40_000, ahead_us), False),
                    ((60_000, ahead_us), False),
                    ((60_000, 80_000), True),
                ):
                    made = dataclasses.replace(
                        update.sample,
                        payload=struct.pack("<QhQh", times[0], 1, times[1], 1),
                        host_us=shift_us + max(times) if is_known else None,
                        is_reset=is_reset,
                    )
                    kept[0].updates.clear()
                    bridge._take(made)
                    found += await until(lambda: list(kept[0].updates))
        for one in found:
            is_right = one.shift_us == shift_us
            assert is_right if is_known else 0 <= one.arrived_ns - one.stamp_ns < 1000
        there = [[stamp is not None for stamp in one.stamps_ns] for one in found]
        assert there == [[True, True]] * 2 + [[True, False]] * 3 + [[True, True]]

    @in_event_loop
    async def test_rates_are_limited_by_the_times_of_the_source(self, kept):
        device = board_of("SENSOR(s, 0, s, M, 1, u8, none, (queue, 8))")
        board = BoardConfig(transducers={"s": SensorConfig(rate_hz=10.0)})
        with served(device) as url:
            config = Config(
                (BoardConfig(url=url, transducers=board.transducers),), (SinkRequest("kept"),)
            )
            async with bridging(config) as bridge:
                await announced(kept[0], "s")
                flow = bridge._flows["s"]
                while flow.samples < 30:  # the queue overflows where the link is slow
                    device.sense("s", 0, 1)
                    await asyncio.sleep(0.01)
                times = [update.sample.time_us for update in kept[0].updates]
        assert flow.skipped > 0
        assert all(before < after for before, after in itertools.pairwise(times))
        assert len(times) <= (times[-1] - times[0]) / 100_000 + 2

    @in_event_loop
    async def test_what_a_board_says_that_it_lost_is_told(self, kept):
        device = board_of("SENSOR(s, 0, s, M, 1, u8, none, (queue, 2), (period, 300000))")

        def lost():
            return sum(update.sample.lost for update in list(kept[0].updates))

        def told():
            boards = [board for status in kept[0].statuses[-1:] for board in status.boards]
            return [topic.lost for board in boards for topic in board.topics]

        with served(device) as url:
            async with bridging(config_for(url)) as bridge:
                await announced(kept[0], "s")
                while not lost():  # what is given slowly is all sent
                    for value in range(8):
                        device.sense("s", 0, value)
                    await asyncio.sleep(0.05)
                await until(lambda: told() == [bridge._flows["s"].lost] == [lost()])

    @in_event_loop
    async def test_what_the_link_lost_counts_as_lost(self, kept):
        device = board_of()
        with served(device) as url:
            async with bridging(config_for(url)) as bridge:
                await announced(kept[0], "quad")
                device.sense("quad", 0, 1)
                [update] = await until(lambda: list(kept[0].updates))
                bridge._take(dataclasses.replace(update.sample, missed=3, lost=4))
                assert bridge._flows["quad"].lost == 7

    @in_event_loop
    async def test_a_clock_that_is_lost_has_no_uncertainty(self, kept):
        device = board_of()
        with served(device) as url:
            async with bridging(config_for(url)) as bridge:
                [board] = await until(lambda: list(bridge._boards.values()))
                await until(lambda: board.has_clock and board.uncertainty_us is not None)
                board.has_clock = False
                await until(lambda: board.uncertainty_us is None)

    @in_event_loop
    async def test_samples_that_come_before_the_topics_are_known_are_not_lost(
        self, kept, monkeypatch
    ):
        device, may_learn = board_of(), learning_late(monkeypatch)
        with served(device) as url:
            async with bridging(config_for(url)) as bridge:
                await until(lambda: bridge._boards)
                board = next(iter(bridge._boards.values()))
                for value in range(5):
                    device.sense("quad", 0, value, raw=True)
                    await until(lambda count=value + 1: len(board.early) == count)
                may_learn.set()
                await until(lambda: len(kept[0].updates) == 5)
        assert [update.sample.readings[0].raw for update in kept[0].updates] == list(range(5))

    @in_event_loop
    async def test_those_of_before_a_restart_are_not_published_as_what_the_board_has_then(
        self, kept, monkeypatch
    ):
        sensor = "SENSOR(quad, 0, quad, M, 1, i16, none, (unit, {}))"
        device = board_of(sensor.format("deg"), boot=True)
        may_learn = learning_late(monkeypatch)
        with served(device) as url:
            async with bridging(config_for(url, clock="off")) as bridge:
                board = (await until(lambda: list(bridge._boards.values())))[0]
                device.sense("quad", 0, 1, raw=True)
                await until(lambda: board.early)
                restart(device, sensor.format("mm"))
                await until(lambda: unit_of(board.client, "quad") == "mm")
                device.sense("quad", 0, 2, raw=True)
                may_learn.set()
                await until(lambda: kept[0].updates)
                flow = bridge._flows["quad"]
                assert (flow.samples, flow.lost) == (2, 1)
        [update] = kept[0].updates
        assert update.topic.transducer.unit == update.sample.unit == "mm"
        assert update.sample.values == (2,)

    @pytest.mark.parametrize("clock", ["discipline", "off"])
    @in_event_loop
    async def test_those_before_the_topics_are_known_have_the_time_when_they_came(
        self, kept, monkeypatch, clock
    ):
        device, may_learn = board_of(), learning_late(monkeypatch)
        with served(device) as url:
            async with bridging(config_for(url, clock=clock)) as bridge:
                board = (await until(lambda: list(bridge._boards.values())))[0]
                device.sense("quad", 0, 1, raw=True)
                await until(lambda: board.early)
                come_ns = time.time_ns()
                monkeypatch.setattr(time, "time_ns", lambda: come_ns + 60_000_000_000)
                may_learn.set()
                [update] = await until(lambda: list(kept[0].updates))
        assert update.arrived_ns <= come_ns
        assert update.stamp_ns <= come_ns + 1_000_000_000  # of the error of the clock

    @in_event_loop
    async def test_those_that_are_too_many_before_the_topics_are_known_count_as_lost(
        self, kept, monkeypatch
    ):
        device, may_learn = board_of(), learning_late(monkeypatch)
        monkeypatch.setattr(Kept, "WAITING", 2 * _EARLY)
        with served(device) as url:
            async with bridging(config_for(url)) as bridge:
                board = (await until(lambda: list(bridge._boards.values())))[0]
                device.sense("quad", 0, 1, raw=True)
                await until(lambda: board.early)
                [(sample, _)] = board.early
                for _ in range(_EARLY + 6):
                    bridge._take(sample)
                assert len(board.early) == _EARLY
                may_learn.set()
                await until(lambda: len(kept[0].updates) == _EARLY)
                flow = bridge._flows["quad"]
                assert (flow.samples, flow.lost) == (_EARLY + 7, 7)

    @in_event_loop
    async def test_those_that_come_before_the_properties_are_known_count_as_lost(
        self, kept, monkeypatch
    ):
        device, meet, take = board_of(), Bridge._meet, Bridge._take
        may_meet, taken = asyncio.Event(), []

        async def late(self, *about):
            await may_meet.wait()
            return await meet(self, *about)

        def noted(self, sample):
            take(self, sample)
            taken.append(sample)

        monkeypatch.setattr(Bridge, "_meet", late)
        monkeypatch.setattr(Bridge, "_take", noted)
        with served(device) as url:
            async with bridging(config_for(url)) as bridge:
                while len(taken) < 3:
                    device.sense("quad", 0, 1, raw=True)
                    await asyncio.sleep(0.02)
                assert not bridge._boards
                may_meet.set()
                flow = await until(lambda: bridge._flows.get("quad"))
                await until(lambda: flow.samples == len(taken))
                assert 3 <= flow.lost <= len(taken)
                assert not bridge._unmet

    @pytest.mark.parametrize("host_us", [-1, 0, (1 << 64) - 1])
    @in_event_loop
    async def test_a_time_that_cannot_be_counts_as_that_of_arrival(self, kept, host_us):
        device = board_of()
        with served(device) as url:
            async with bridging(config_for(url)) as bridge:
                await announced(kept[0], "quad")
                device.sense("quad", 0, 1, raw=True)
                [update] = await until(lambda: list(kept[0].updates))
                for time_us in (1, (1 << 64) - 1):
                    payload = bytearray(update.sample.payload)
                    struct.pack_into("<Q", payload, 0, time_us)
                    made = dataclasses.replace(
                        update.sample, payload=bytes(payload), host_us=host_us
                    )
                    kept[0].updates.clear()
                    bridge._take(made)
                    [found] = await until(lambda: list(kept[0].updates))
                    assert 0 <= found.arrived_ns - found.stamp_ns < 1000
                    assert found.uncertainty_us is None

    @in_event_loop
    async def test_a_board_that_comes_back_goes_on(self, kept):
        port = free_port()
        async with bridging(config_for(f"tcp://127.0.0.1:{port}")):
            for value in range(3):
                kept[0].events.clear()
                kept[0].updates.clear()
                device = board_of(serial="X")
                with served(device, port):
                    await announced(kept[0], "quad")
                    device.sense("quad", 0, value, raw=True)
                    [update] = await until(lambda: list(kept[0].updates))
                    assert update.sample.readings[0].raw == value
                await until(lambda: "quad" in names(kept[0], "retract"))


class TestSinks:
    @in_event_loop
    async def test_a_slow_one_loses_its_own_samples_and_delays_nobody(self, kept):
        device = board_of()
        with served(device) as url:
            async with bridging(config_for(url, sinks=("kept:a", "kept:b"))) as bridge:
                slow, other = kept
                await announced(slow, "quad")
                await announced(other, "quad")
                slow.may_go.clear()
                for value in range(200):
                    device.sense("quad", 0, value, raw=True)
                    await until(lambda count=value + 1: len(other.updates) >= count)
                slow.may_go.set()
                status = bridge.runners[0].status
                await until(lambda: len(slow.updates) + bridge.runners[0].dropped >= 200)
        assert [update.sample.readings[0].raw for update in other.updates] == list(range(200))
        newest = [update.sample.readings[0].raw for update in slow.updates]
        assert newest[-64:] == list(range(136, 200))
        assert status.dropped == 200 - len(newest)

    @in_event_loop
    async def test_one_that_fails_is_opened_anew_with_its_topics(self, kept, monkeypatch, caplog):
        monkeypatch.setattr(Kept, "RETRY_S", 0.01)
        device = board_of()
        with served(device) as url:
            async with bridging(config_for(url, sinks=("kept:a", "kept:b"))) as bridge:
                broken, other = kept
                await announced(broken, "quad")
                await announced(other, "quad")
                broken.error = SinkError("the other end is gone")
                for value in range(10):
                    device.sense("quad", 0, value, raw=True)
                    await until(lambda count=value + 1: len(other.updates) >= count)
                await until(lambda: bridge.runners[0].problem)
                assert not bridge.runners[0].status.is_open
                broken.events.clear()
                broken.error = None
                await announced(broken, "quad", "servo", "tank/level")
                assert names(broken, "open") == [None]
                device.sense("quad", 0, 77, raw=True)
                await until(lambda: broken.updates)
                assert broken.updates[-1].sample.readings[0].raw == 77
        told = [one.message for one in caplog.records if "the other end is gone" in one.message]
        assert len(told) == 1

    @in_event_loop
    async def test_status_tells_boards_and_sinks(self, kept):
        def is_met(status):  # before that its URL is told
            return any(one.is_here for one in status.boards)

        with served(board_of(serial="S")) as url:
            missing = f"tcp://127.0.0.1:{free_port()}"
            async with bridging(config_for(url, missing), boot_time=0.1):
                await announced(kept[0], "robot/quad")
                status = await until(
                    lambda: next(
                        (s for s in kept[0].statuses if len(s.boards) == 2 and is_met(s)), None
                    )
                )
        here, gone = sorted(status.boards, key=lambda one: not one.is_here)
        assert (here.name, here.identity, here.problem) == ("robot", "S", "")
        assert {one.name for one in here.topics} == {"robot/quad", "robot/tank/level"}
        assert gone.url == missing
        assert "nothing listens" in gone.problem
        assert status.sinks[0].is_open


class TestOrders:
    @in_event_loop
    async def test_actuators_are_set_by_their_topic_in_their_unit(self, kept):
        device = board_of()
        with served(device) as url:
            async with bridging(config_for(url)):
                await announced(kept[0], "servo")
                await asyncio.wrap_future(kept[0].control.set("servo", [40, -40]))
        assert device.was_set[-2:] == [("servo", 0, 40), ("servo", 1, -40)]

    @pytest.mark.parametrize(
        ("topic", "values", "error"),
        [
            ("servo", [101], j2a.WrongArgument),
            ("servo", [1, 2, 3], j2a.WrongArgument),
            ("servo", ["x"], j2a.WrongArgument),
            ("quad", [1], j2a.WrongArgument),
            ("nothing", [1], j2a.UnknownTransducer),
        ],
    )
    @in_event_loop
    async def test_what_cannot_be_is_refused_with_a_reason(self, kept, topic, values, error):
        device = board_of()
        with served(device) as url:
            async with bridging(config_for(url)):
                await announced(kept[0], "servo")
                device.was_set.clear()
                with pytest.raises(error) as caught:
                    await asyncio.wrap_future(kept[0].control.set(topic, values))
        assert str(caught.value)
        assert device.was_set == []

    @pytest.mark.parametrize("is_known", [True, False])
    @in_event_loop
    async def test_an_order_for_what_a_board_had_before_a_restart_is_refused(
        self, kept, monkeypatch, is_known
    ):
        """Its number is of another unit, and 90 degrees may be 90 metres."""
        servo = "ACTUATOR(servo, 2, servo, HS-311, 1, u8, 5, (unit, {}))"
        device = board_of(servo.format("deg"), boot=True)
        with served(device) as url:
            async with bridging(config_for(url, clock="off")) as bridge:
                await announced(kept[0], "servo")
                may_learn = learning_late(monkeypatch)
                [board] = bridge._boards.values()
                device.was_set.clear()
                restart(device, servo.format("m"))
                await until(lambda: unit_of(board.client, "servo") == "m")
                answer, source = AsyncTransducers.__call__, board.flows["servo"].transducer._source

                async def learnt(self):
                    vars(source).pop("codec", None)
                    return await answer(self)

                monkeypatch.setattr(AsyncTransducers, "__call__", learnt)
                for raw in (False, True):
                    if not is_known:
                        source.codec = lambda _name: None
                    with pytest.raises(j2a.InterfaceChanged, match="servo is another actuator now"):
                        await asyncio.wrap_future(kept[0].control.set("servo", [90], raw=raw))
                may_learn.set()
        assert device.was_set == []

    @in_event_loop
    async def test_settings_are_changed_and_told(self, kept):
        with served(board_of()) as url:
            async with bridging(config_for(url)):
                await announced(kept[0], "quad")
                control = kept[0].control
                before = await asyncio.wrap_future(control.settings("quad"))
                assert before == {"enabled": True, "period": 0.0}
                after = await asyncio.wrap_future(
                    control.configure("quad", {"enabled": False, "period": 0.5})
                )
        assert after == {"enabled": False, "period": 0.5}

    @in_event_loop
    async def test_another_topic_moves_the_samples(self, kept):
        device = board_of()
        with served(device) as url:
            async with bridging(config_for(url)):
                await announced(kept[0], "tank/level")
                future = kept[0].control.configure("tank/level", {"topic": "pool/depth"})
                await asyncio.wait_for(asyncio.wrap_future(future), PATIENCE_S)
                await announced(kept[0], "pool/depth")
                assert "tank/level" in names(kept[0], "retract")
                device.sense("level", 0, 3)
                await until(lambda: "pool/depth" in names(kept[0], "publish"))

    @in_event_loop
    async def test_a_board_may_come_while_another_topic_is_learnt(self, kept, monkeypatch):
        learn, may_learn = Bridge._learn_alone, asyncio.Event()
        port = free_port()
        with served(board_of(name="arm")) as url:
            async with bridging(config_for(url, f"tcp://127.0.0.1:{port}")) as bridge:
                await announced(kept[0], "arm/tank/level")

                async def late(self, board):
                    await may_learn.wait()
                    return await learn(self, board)

                monkeypatch.setattr(Bridge, "_learn_alone", late)
                future = kept[0].control.configure("arm/tank/level", {"topic": "pool"})
                with served(board_of(name="leg"), port):
                    await until(lambda: len(bridge._boards) == 2)
                    may_learn.set()
                    after = await asyncio.wait_for(asyncio.wrap_future(future), PATIENCE_S)
                    await announced(kept[0], "arm/pool", "leg/quad")
        assert after["topic"] == "pool"

    @in_event_loop
    async def test_another_topic_is_learnt_where_the_board_does_not_answer_at_first(
        self, kept, monkeypatch
    ):
        learn, calls = Bridge._learn_alone, []
        with served(board_of()) as url:
            async with bridging(config_for(url)):
                await announced(kept[0], "tank/level")

                async def once_late(self, board):
                    calls.append(board)
                    if len(calls) == 1:
                        raise j2a.CallTimeout("no answer")
                    return await learn(self, board)

                monkeypatch.setattr(Bridge, "_learn_alone", once_late)
                future = kept[0].control.configure("tank/level", {"topic": "pool"})
                await asyncio.wait_for(asyncio.wrap_future(future), PATIENCE_S)
                await announced(kept[0], "pool")

    @pytest.mark.parametrize(
        ("error", "topic"),
        [
            (j2a.CallTimeout("no answer"), "pool"),
            (j2a.ChecksumRefused("damaged", 0xFC, b""), "pool"),
            (j2a.OpcodeRefused("refused", 0xFF, b""), "tank/level"),
            (j2a.FunctionFailed("refused", 0x42, b""), "tank/level"),
        ],
    )
    @in_event_loop
    async def test_a_topic_that_is_not_told_at_first_is_asked_for_again(
        self, kept, monkeypatch, error, topic
    ):
        """One that is refused is that of the descriptor."""
        setting, asked = AsyncSensor.setting, []

        async def once(self, name):
            asked.append(name)
            if len(asked) == 1:
                raise error
            return "pool" if name == "topic" else await setting(self, name)

        monkeypatch.setattr(AsyncSensor, "setting", once)
        with served(board_of()) as url:
            async with bridging(config_for(url)) as bridge:
                await until(lambda: bridge._flows)
                assert topic in bridge._flows

    @in_event_loop
    async def test_topics_that_are_learnt_twice_at_once_leave_none_behind(self, kept, monkeypatch):
        chosen, may_tell = iter(("first", "second")), asyncio.Event()

        async def tell(self, transducer):
            if transducer.descriptor.name != "level":
                return ""
            name = next(chosen)
            if name == "first":
                await may_tell.wait()
            return name

        with served(board_of()) as url:
            async with bridging(config_for(url)) as bridge:
                await announced(kept[0], "tank/level")
                monkeypatch.setattr(Bridge, "_topic_setting", tell)
                [board] = bridge._boards.values()
                tasks = [asyncio.create_task(bridge._learn(board)) for _ in range(2)]
                await asyncio.wait(tasks, timeout=0.2)
                may_tell.set()
                await asyncio.gather(*tasks)
                await announced(kept[0], "first", "second")
                there, events = set(bridge._flows), list(kept[0].events)
        counts = Counter()
        for kind, name in events:
            counts[name] += {"announce": 1, "retract": -1}.get(kind, 0)
        assert there == {"quad", "servo", "second"}
        assert {name: count for name, count in counts.items() if count} == dict.fromkeys(there, 1)

    @in_event_loop
    async def test_those_that_are_too_many_are_refused(self, kept):
        device = board_of()
        with served(device) as url:
            async with bridging(config_for(url)):
                await announced(kept[0], "servo")
                control = kept[0].control
                futures = [control.set("servo", [0]) for _ in range(_MAX_ORDERS + 5)]
                done = await asyncio.gather(
                    *map(asyncio.wrap_future, futures), return_exceptions=True
                )
                assert [str(one) for one in done if one is not None] == [
                    f"{_MAX_ORDERS} orders wait already: this one was not done"
                ] * 5
                await asyncio.wrap_future(control.set("servo", [7]))
        assert device.was_set[-1] == ("servo", 0, 7)


@pytest.mark.parametrize("url", ["serial:", "usb://zz:zz", "sim:none.elf?x"])
def test_a_url_that_can_never_be_opened_is_refused_before_a_sink_is_opened(kept, url):
    with pytest.raises(j2a.BadUrl, match=re.escape(url)):
        Bridge(config_for(url))
    assert not kept


@in_event_loop
async def test_it_ends_while_a_sink_is_not_open_yet(kept):
    bridge = Bridge(config_for(f"tcp://127.0.0.1:{free_port()}"))
    kept[0].may_go.clear()
    task = asyncio.create_task(bridge.run(lambda: pytest.fail("it is not open")))
    await until(bridge.runners[0]._thread.is_alive)
    bridge.stop()
    _, late = await asyncio.wait([task], timeout=PATIENCE_S / 3)
    kept[0].may_go.set()
    assert not late
    await task


@in_event_loop
async def test_orders_behind_the_end_are_refused(kept):
    bridge = Bridge(config_for(f"tcp://127.0.0.1:{free_port()}"))
    loop = asyncio.new_event_loop()
    bridge._loop = loop
    loop.close()
    with pytest.raises(j2a.LocalError, match="does not run"):
        bridge.set("servo", [1])


def test_nothing_flows_after_the_end(kept):
    async def work(url):
        async with bridging(config_for(url)):
            await announced(kept[0], "quad")

    with served(board_of(TRANSDS)) as url:
        asyncio.run(work(url))
    assert kept[0].events[-1][0] == "close"
