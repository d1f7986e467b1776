"""Fleets that are closed, or whose beginning fails."""

import asyncio

import j2a_transports
import pytest

import j2a

from .support import PATIENCE_S, served
from .test_aio import in_event_loop
from .test_aio_fleet import fleet_of
from .test_fleet import FakeWatch, make_device, make_url


@pytest.fixture
def watch(monkeypatch):
    """The USB, whose watching thread the system does not give."""
    watch = FakeWatch()
    watch.was_closed = 0

    def close():
        watch.was_closed += 1

    def refuse(_target, name):
        raise j2a.OpenFailed(f"{name}: can't start new thread")

    watch.close = close
    monkeypatch.setattr(j2a_transports, "watch_usb", lambda: watch)
    monkeypatch.setattr("j2a.io.fleet_base.start_thread", refuse)
    return watch


class TestWithoutAThreadTheUsbIsWatchedNoMore:
    def test_by_a_fleet(self, watch):
        with pytest.raises(j2a.OpenFailed, match="can't start"):
            j2a.Fleet(usb=True)
        assert watch.was_closed

    @in_event_loop
    async def test_by_one_of_an_event_loop(self, watch):
        with pytest.raises(j2a.OpenFailed, match="can't start"):
            j2a.AsyncFleet(usb=True)
        assert watch.was_closed


class TestAHandlerOfChangesCloses:
    @in_event_loop
    @pytest.mark.parametrize("is_here", [True, False])
    async def test_in_a_task_of_its_own(self, caplog, monkeypatch, is_here):
        # Where the fleet waits for who waits for it, it waits so long.
        monkeypatch.setattr("j2a.aio_fleet._CLOSE_S", 0.5)
        done = asyncio.Event()
        with served(make_device("A3")) as url:
            async with fleet_of() as fleet:

                @fleet.on_change
                async def handler(change):
                    if change.is_here == is_here:
                        await asyncio.create_task(fleet.close())
                        done.set()

                fleet.add(url if is_here else make_url())
                await asyncio.wait_for(done.wait(), PATIENCE_S)
        assert "still busy" not in caplog.text

    @in_event_loop
    async def test_later_and_waits_for_the_board(self):
        tasks, gone = [], []
        with served(make_device("A3")) as url:
            async with fleet_of(url) as fleet:
                begin = asyncio.Event()

                async def close():
                    await begin.wait()
                    await fleet.close()
                    gone.append([task.done() for task in members])

                fleet.on_change(lambda _change: tasks.append(asyncio.create_task(close())))
                members = list(fleet._tasks)
                await fleet.wait("A3", timeout=PATIENCE_S)
                await asyncio.sleep(0)
                begin.set()
                await tasks[0]
        assert gone[0] == [True]
