"""SIFs by name: handlers, iterators and single waits."""

import asyncio
import gc
import math
import struct
import threading
import time

import pytest

import j2a
from j2a.demo import DemoDevice
from j2a.io.async_streams import AsyncSifStream
from j2a.io.handlers import Handlers

from .support import PATIENCE_S, linked, served
from .test_aio import in_event_loop


def make_device():
    """A device that sends SIFs when it is told to."""
    device = j2a.Device()
    count = device.describe_sif("counter", 0x20, "(count u32, name text)")

    @device.function
    def send(first: j2a.u16, number: j2a.u16) -> None:
        for n in range(first, first + number):
            count(n, f"n{n}")

    device.function("other", signature="()")(lambda: void(device.send_sif(0x21, b"x")))
    device.function("odd", signature="()")(lambda: void(device.send_sif(0x20, b"x")))
    device.function("end", signature="()")(lambda: void(device.send_sif(0x22)))
    return device


def void(_):
    return None


@pytest.fixture
def board():
    with linked(make_device()) as client:
        yield client


def test_handlers_by_name_get_values(board):
    seen, ended = [], threading.Event()

    @board.on_sif("counter")
    def count(sif):
        seen.append((sif.values.count, sif.values.name, sif.opcode))

    board.on_sif(0x20, lambda sif: seen.append(sif.values))  # by opcode: bytes
    board.on_sif(0x22, lambda sif: ended.set())
    board.functions.send(7, 2)
    board.functions.other()
    board.functions.end()
    assert ended.wait(PATIENCE_S)
    assert seen == [(7, "n7", 0x20), None, (8, "n8", 0x20), None]


def test_a_name_that_is_not_described(board):
    for use in (lambda: board.on_sif("count", print), lambda: board.sifs("count")):
        with pytest.raises(j2a.LocalError, match="no SIF 'count'; did you mean counter"):
            use()
    with (
        linked(DemoDevice(interface=False)) as untyped,
        pytest.raises(j2a.LocalError, match="no SIF 'counter'; it has: none"),
    ):
        untyped.sifs("counter")


def test_a_payload_that_is_not_as_described_is_reported():
    problems, ended = [], threading.Event()
    with linked(
        make_device(), on_handler_error=lambda error, sif: problems.append((error, sif.payload))
    ) as board:
        board.on_sif("counter", lambda sif: problems.append("never"))
        board.on_sif(0x22, lambda sif: ended.set())
        board.functions.odd()
        board.functions.end()
        assert ended.wait(PATIENCE_S)
        assert board.counters.handler_errors == 1
    [(error, payload)] = problems
    assert isinstance(error, j2a.ProtocolError)
    assert "SIF counter: the payload is not as described" in str(error)
    assert payload == b"x"


def test_names_follow_the_interface(board):
    stream = board.sifs("counter")
    shape = board._device.sifs["counter"]
    other = j2a.types.model.SifShape("counter", 0x21, shape.fields[1:])
    board._device._take_sifs([other], 0)
    board.functions.send(1, 1)
    board.functions.other()
    assert stream.wait(PATIENCE_S).values == ("x",)
    board._device._take_sifs([], 0)
    board.functions.send(1, 1)
    with pytest.raises(j2a.CallTimeout):
        stream.wait(0.05)


def test_who_asks_behind_the_end_is_told_the_first_reason():
    handlers, told = Handlers(), []
    handlers.at_end(told.append)
    first, second = j2a.LinkLost("the cable"), j2a.LinkClosed("closed")
    handlers.finish(first)
    handlers.finish(second)
    handlers.at_end(told.append)
    assert told == [first, first]


class TestBlocking:
    def test_iteration(self, board):
        stream = board.sifs("counter")
        board.functions.send(0, 5)
        seen = []
        for sif in stream:
            seen.append(sif.values.count)
            if len(seen) == 5:
                break
        assert seen == [0, 1, 2, 3, 4]
        assert stream.lost == 0

    def test_it_ends_with_the_client(self):
        with linked(make_device()) as board:
            stream = board.sifs("counter")
            board.functions.send(0, 3)
        assert [sif.values.count for sif in stream] == [0, 1, 2]
        with pytest.raises(j2a.LinkClosed):
            stream.wait(PATIENCE_S)

    def test_close_wakes_one_that_waits(self):
        with linked(make_device()) as board:
            ended = []
            thread = threading.Thread(target=lambda: ended.append(list(board.sifs())))
            thread.start()
            while not board._handlers._subscriptions:
                pass
        thread.join(PATIENCE_S)
        assert ended == [[]]

    def test_a_lost_link_is_an_error(self):
        device = make_device()
        with served(device) as url, j2a.connect(url, timeout=PATIENCE_S) as board:
            stream = board.sifs("counter")
            board.functions.send(0, 1)
            device.stop()
            assert next(stream).values.count == 0
            with pytest.raises(j2a.LinkLost):
                next(stream)
            with pytest.raises(j2a.LinkLost):
                next(board.sifs())

    def test_too_many_drop_the_oldest(self, board):
        stream = board.sifs("counter", max_waiting=3)
        ended = board.sifs(0x22)
        board.functions.send(0, 10)
        board.functions.end()
        ended.wait(PATIENCE_S)
        assert [stream.wait(PATIENCE_S).values.count for _ in range(3)] == [7, 8, 9]
        assert stream.lost == 7

    @pytest.mark.parametrize("limit", [0, -1, 1.5, None])
    def test_a_limit_that_is_none(self, board, limit):
        with pytest.raises(j2a.LocalError, match="max_waiting"):
            board.sifs(max_waiting=limit)

    def test_one_that_is_dropped_or_closed_costs_nothing(self, board):
        handlers = board._handlers
        before = dict(handlers._subscriptions)  # that of the samples
        with board.sifs("counter") as stream:
            assert len(handlers._subscriptions) == len(before) + 1
            assert len(handlers._at_end) == 1
        assert handlers._subscriptions == before and not handlers._at_end
        stream.close()
        board.sifs("counter")
        gc.collect()
        assert handlers._subscriptions == before and not handlers._at_end
        assert list(stream) == []

    def test_waiting_for_one(self, board):
        with board.sifs("counter") as stream:
            board.functions.send(5, 1)
            assert stream.wait(PATIENCE_S).values == (5, "n5")
        with pytest.raises(j2a.CallTimeout, match=r"no SIF came within 0\.01 s") as caught:
            board.wait_sif("counter", timeout=0.01)
        assert caught.value.outcome is j2a.Outcome.NOT_SENT
        timer = threading.Timer(0.05, lambda: board.functions.send(6, 1))
        timer.start()
        assert board.wait_sif("counter", math.inf).values.count == 6
        timer.join()

    def test_a_handler_cannot_wait(self, board):
        caught, ended = [], threading.Event()

        @board.on_sif(0x22)
        def handler(sif):
            try:
                board.wait_sif()
            except j2a.LocalError as error:
                caught.append(error)
            ended.set()

        board.functions.end()
        assert ended.wait(PATIENCE_S)
        assert "a SIF handler cannot wait" in str(caught[0])


class TestAsyncio:
    @in_event_loop
    async def test_iteration_and_waiting(self):
        with served(make_device()) as url:
            async with await j2a.aconnect(url, timeout=PATIENCE_S) as board:
                handled = []

                @board.on_sif("counter")
                async def handler(sif):
                    handled.append(sif.values.count)

                stream = board.sifs("counter")
                await board.functions.send(0, 3)
                seen = []
                async for sif in stream:
                    seen.append(sif.values.count)
                    if len(seen) == 3:
                        break
                assert seen == handled == [0, 1, 2]
                with pytest.raises(j2a.CallTimeout):
                    await board.wait_sif("counter", timeout=0.01)
                waiting = asyncio.create_task(board.wait_sif("counter"))
                await asyncio.sleep(0)
                await board.functions.send(9, 1)
                assert (await waiting).values.count == 9
                left = board.sifs("counter")
                await board.functions.send(1, 1)
            assert [sif.values.count async for sif in left] == [1]
            with pytest.raises(j2a.LinkClosed):
                await left.wait(PATIENCE_S)

    @in_event_loop
    async def test_a_lost_link_is_an_error(self):
        device = make_device()
        with served(device) as url:
            async with await j2a.aconnect(url, timeout=PATIENCE_S) as board, board.sifs() as stream:
                device.stop()
                with pytest.raises(j2a.LinkLost):
                    await anext(stream)

    @in_event_loop
    async def test_a_handler_cannot_wait(self):
        with served(make_device()) as url:
            async with await j2a.aconnect(url, timeout=PATIENCE_S) as board:
                ended = asyncio.get_running_loop().create_future()

                @board.on_sif(0x22)
                async def handler(sif):
                    try:
                        await board.wait_sif()
                    except j2a.LocalError as error:
                        ended.set_result(str(error))

                await board.functions.end()
                assert "a SIF handler cannot wait" in await ended

    @pytest.mark.parametrize("turns", range(8))
    @in_event_loop
    async def test_a_cancelled_wait_ends_and_loses_nothing_whenever_a_sif_comes(self, turns):
        stream = AsyncSifStream(
            Handlers(),
            None,
            time.monotonic,
            max_waiting=4,
            dispatcher=None,
            slice_s=PATIENCE_S,
        )
        waits = asyncio.create_task(stream.wait(math.inf))
        for _ in range(4):
            await asyncio.sleep(0)
        stream._put(sif := j2a.Sif(7, b"", 0, 0))
        for _ in range(turns):
            await asyncio.sleep(0)
        is_cancelled = waits.cancel()
        await asyncio.wait([waits])
        assert waits.cancelled() == is_cancelled
        assert (stream._take() if is_cancelled else waits.result()) is sif


def test_bytes_of_the_demo():
    with linked() as board, board.sifs("counter") as stream:
        board.functions.sifPeriod(1)
        sif = stream.wait(PATIENCE_S)
        board.functions.sifPeriod(0)
        assert sif.payload == struct.pack("<I", sif.values.count)
