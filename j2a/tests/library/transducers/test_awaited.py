"""Transducers in an event loop."""

import asyncio
import math

import pytest

import j2a
from j2a.tests.library.support import PATIENCE_S, served
from j2a.tests.library.test_aio import in_event_loop

from .boards import make_device, skip


class TestAsyncio:
    @in_event_loop
    async def test_all_of_it(self):
        device = make_device()
        with served(device) as url:
            async with await j2a.aconnect(url) as board:
                quad, servo = board.transducers["quad"], board.transducers["servo"]
                assert isinstance(quad, j2a.AsyncSensor)
                assert isinstance(servo, j2a.AsyncActuator)
                async with quad.samples() as samples:
                    device.sense("quad", 0, 12)
                    assert (await samples.wait(PATIENCE_S)).values == (12.0, None)
                assert quad.latest().values == (12.0, None)
                await quad.configure(period=0.5, threshold=2)
                assert await quad.setting("period") == 0.5
                with pytest.raises(j2a.WrongArgument, match="no setting"):
                    await quad.setting("color")
                with pytest.raises(AttributeError, match=r"await .*configure.*period"):
                    quad.period = 0.25
                with pytest.raises(AttributeError, match=r"await .*setting.*period"):
                    _ = quad.period
                with pytest.raises(AttributeError, match="no attribute color"):
                    _ = quad.color
                assert await quad.setting("period") == 0.5
                assert [one.value for one in await quad.read()] == [12.0, None]
                await servo.set(3, channel=1, at_us=await servo.time_us())
                assert (await servo.read())[1].value == 3
                with pytest.raises(j2a.WrongArgument):
                    await servo.set(101)
                with pytest.raises(j2a.FunctionFailed):
                    await quad.save()
                with pytest.raises(j2a.LocalError, match="a timeout is"):
                    await quad.save(math.nan)
                device.on_trigger("imu")(
                    lambda: device.sense("imu", 0, [(1, 1, 1), True], raw=True)
                )
                async with board.transducers["log"].samples() as samples:
                    for value in range(10):
                        device.sense("log", 0, value)
                        assert (await samples.wait(PATIENCE_S)).values == (value,)
                        skip(device, 254)
                imu, seen = board.transducers["imu"], asyncio.Event()
                imu.on_sample(lambda _: seen.set())
                await imu.trigger()
                await asyncio.wait_for(seen.wait(), PATIENCE_S)
                assert list(await board.transducers()) == list(board.transducers)

    @in_event_loop
    async def test_a_batch_whose_time_ends_between_two_waits_hands_over_what_came(
        self, monkeypatch
    ):
        pytest.importorskip("numpy")
        device, times = make_device(), iter([0.0, 0.0])
        with served(device) as url:
            async with await j2a.aconnect(url) as board:
                quad = board.transducers["quad"]
                batch = asyncio.create_task(quad.read_batch(9, timeout=PATIENCE_S))

                def now():  # over at once behind the first wait of the batch
                    return next(times, 10 * PATIENCE_S) if asyncio.current_task() is batch else 0.0

                monkeypatch.setattr(board, "now", now)
                await asyncio.sleep(0)
                device.sense("quad", 1, 12)
                with pytest.raises(j2a.BatchTimeout, match="1 of 9 samples of quad") as late:
                    await batch
                assert late.value.batch.values[0, 1] == 12.0

    @in_event_loop
    async def test_a_batch(self):
        pytest.importorskip("numpy")
        device = make_device()
        with served(device) as url:
            async with await j2a.aconnect(url) as board:
                quad = board.transducers["quad"]
                batch = asyncio.create_task(quad.read_batch(1, timeout=PATIENCE_S))
                await asyncio.sleep(0)
                device.sense("quad", 1, 12)
                assert (await batch).values[0, 1] == 12.0
                with pytest.raises(j2a.WrongArgument, match="1 sample or more"):
                    await quad.read_batch(0)
                with pytest.raises(
                    j2a.CallTimeout, match=r"no sample of quad .* 0\.01 s: it may be"
                ):
                    await quad.wait(0.01)
                with pytest.raises(j2a.CallTimeout, match="0 of 9 samples of quad came in time"):
                    await quad.read_batch(9, timeout=0.05)
                late = asyncio.create_task(quad.read_batch(2, timeout=1.0))
                await asyncio.sleep(0)
                device.sense("quad", 1, 15)
                with pytest.raises(j2a.BatchTimeout) as caught:
                    await late
                assert caught.value.batch.values[0, 1] == 15.0
                lost = asyncio.create_task(quad.read_batch(2, timeout=PATIENCE_S))
                seen = asyncio.Event()
                quad.on_sample(lambda _: seen.set())
                await asyncio.sleep(0)
                device.sense("quad", 1, 17)
                await asyncio.wait_for(seen.wait(), PATIENCE_S)
                device.stop()
                with pytest.raises(j2a.BatchLost) as lost_error:
                    await lost
                assert isinstance(lost_error.value, j2a.LinkLost)
                assert lost_error.value.batch.values[0, 1] == 17.0
