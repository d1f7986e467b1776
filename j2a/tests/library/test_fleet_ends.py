"""Fleets that are closed, or whose beginning fails."""

import asyncio
import math
import os
import threading
from types import SimpleNamespace

import j2a_transports
import pytest

import j2a

from . import test_fleet
from .rebooting import Rebooting
from .support import PATIENCE_S, served
from .test_aio import in_event_loop
from .test_aio_fleet import fleet_of
from .test_fleet import FakeWatch, changes_of, make_device, make_url
from .wire import Background


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


class TestStreamsOfAClosedFleetEnd:
    def test_also_those_that_are_asked_for_then(self):
        with test_fleet.fleet_of() as fleet:
            fleet.samples("quad")
        for stream in (fleet.samples("quad"), fleet.samples("lamp"), fleet.samples()):
            with pytest.raises(j2a.LinkClosed, match="the fleet was closed"):
                stream.wait(PATIENCE_S)
            assert list(stream) == []

    @in_event_loop
    async def test_of_an_event_loop(self):
        async with fleet_of() as fleet:
            pass
        with pytest.raises(j2a.LinkClosed, match="the fleet was closed"):
            await fleet.samples("lamp").wait(PATIENCE_S)


def test_a_thread_that_the_system_does_not_give_ends_the_watching_of_no_other_board(
    monkeypatch, caplog
):
    watch, start = FakeWatch(), j2a.fleet.start_thread
    refused = []

    def scarce(target, name):
        if not refused:
            refused.append(name)
            raise j2a.OpenFailed(f"{name}: can't start new thread")
        return start(target, name)

    monkeypatch.setattr(j2a_transports, "watch_usb", lambda: watch)
    monkeypatch.setattr("j2a.fleet.start_thread", scarce)
    with (
        served(make_device("A1")) as first,
        served(make_device("A2")) as second,
        test_fleet.fleet_of(usb=True) as fleet,
    ):
        for url in (first, second):
            watch.events.put(j2a_transports.UsbArrived(SimpleNamespace(url=url)))
        fleet.wait("A2", timeout=PATIENCE_S)
        assert list(fleet) == ["A2"]
    assert f"{first} was plugged in, but is not opened" in caplog.text


def test_close_waits_for_a_board_that_was_taken_out():
    gate, entered = threading.Event(), threading.Event()

    with served(make_device("A3")) as url, test_fleet.fleet_of(url) as fleet:
        fleet.wait("A3", timeout=PATIENCE_S)

        @fleet.on_change
        def handler(_change):
            entered.set()
            gate.wait(PATIENCE_S)

        fleet.remove("A3")
        assert entered.wait(PATIENCE_S)
        [thread] = [one.thread for one in fleet._running]
        assert thread.is_alive()
        gate.set()
        fleet.close()
        assert not thread.is_alive()
        assert not fleet._running


@pytest.mark.parametrize("kind", [test_fleet.fleet_of, fleet_of])
def test_silence_has_a_limit_where_calls_have_none(kind, monkeypatch):
    opened = []

    def connect(_url, timeout, **_options):
        assert timeout == math.inf
        board = Rebooting(make_device("A3"))
        opened.append(board)
        return board.near

    monkeypatch.setattr("j2a.client.open_transport", lambda url, options: connect(url, math.inf))
    monkeypatch.setattr("j2a.aio.open_transport", lambda url, options: connect(url, math.inf))

    def mute():
        opened[0].is_mute = True

    async def run():
        async with fleet_of(make_url(), timeout=math.inf, heartbeat=0.05) as fleet:
            changes = fleet.changes()
            await fleet.wait("A3", timeout=PATIENCE_S)
            mute()
            while (await changes.wait(PATIENCE_S)).is_here:
                pass

    if kind is fleet_of:
        asyncio.run(run())
    else:
        with test_fleet.fleet_of(make_url(), timeout=math.inf, heartbeat=0.05) as fleet:
            changes = changes_of(fleet)
            fleet.wait("A3", timeout=PATIENCE_S)
            mute()
            while changes.get(timeout=PATIENCE_S).is_here:
                pass


def test_a_board_that_is_taken_out_amid_its_coming_does_not_come():
    identified, goes_on = threading.Event(), threading.Event()

    def identify(_client):
        identified.set()
        goes_on.wait(PATIENCE_S)
        return "A3"

    with served(make_device()) as url, test_fleet.fleet_of(url, identify=identify) as fleet:
        changes = changes_of(fleet)
        assert identified.wait(PATIENCE_S)
        [member] = fleet._roster.members.values()
        asked, ask = threading.Event(), member.ask_to_stop
        member.ask_to_stop = lambda: (asked.wait(PATIENCE_S), ask())
        removing = Background(fleet.remove, url)
        while len(fleet._roster.members):
            pass
        goes_on.set()
        assert not changes.get(timeout=PATIENCE_S).is_here
        asked.set()
        removing.result()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the system has no fork")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_child_process_does_not_wait_for_the_lock_of_its_parent():
    locked, goes_on = threading.Event(), threading.Event()
    with test_fleet.fleet_of() as fleet:

        def hold():
            with fleet._lock:
                locked.set()
                goes_on.wait(PATIENCE_S)

        holding = Background(hold)
        assert locked.wait(PATIENCE_S)
        child = os.fork()
        if child == 0:
            closing = threading.Thread(target=fleet.close, daemon=True)
            closing.start()
            closing.join(PATIENCE_S)
            os._exit(closing.is_alive())
        assert os.waitpid(child, 0)[1] == 0
        goes_on.set()
        holding.result()
