"""A fleet in one event loop: what it has in common with the blocking one, and what is its own."""

import asyncio
import contextlib
import random
import socket
import threading
from types import SimpleNamespace

import j2a_transports
import pytest

import j2a
from j2a.fleet import by_url
from j2a.io.async_streams import is_set_within

from .support import PATIENCE_S, served
from .test_aio import in_event_loop
from .test_fleet import SOON_S, FakeWatch, make_device, make_url, silent


@contextlib.asynccontextmanager
async def fleet_of(*urls, **options):
    options.setdefault("timeout", PATIENCE_S)
    options.setdefault("boot_time", PATIENCE_S)
    options.setdefault("retry", SOON_S)
    options.setdefault("heartbeat", None)
    async with j2a.AsyncFleet(*urls, **options) as fleet:
        yield fleet


def changes_of(fleet):
    changes = fleet.changes()
    return lambda: changes.wait(PATIENCE_S)


@contextlib.contextmanager
def harmful(kind):
    """A TCP server that is no board: it hangs up, or sends noise or zeros without end."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        links, threads = [], []

        def harm(link):
            with contextlib.suppress(OSError), link:
                while kind != "hangs up":
                    link.sendall(random.randbytes(4096) if kind == "noise" else bytes(4096))

        def accept():
            with contextlib.suppress(OSError):
                while True:
                    links.append(listener.accept()[0])
                    threads.append(threading.Thread(target=harm, args=(links[-1],)))
                    threads[-1].start()

        accepting = threading.Thread(target=accept)
        accepting.start()
        try:
            yield f"tcp://127.0.0.1:{listener.getsockname()[1]}"
        finally:
            listener.shutdown(socket.SHUT_RDWR)
            accepting.join(PATIENCE_S)
            for link in links:
                with contextlib.suppress(OSError):
                    link.shutdown(socket.SHUT_RDWR)
            for thread in threads:
                thread.join(PATIENCE_S)
                assert not thread.is_alive()


class TestBoards:
    @in_event_loop
    async def test_each_is_known_by_its_serial_number(self):
        with (
            served(make_device("B7")) as first,
            served(make_device("A3")) as second,
            served(make_device()) as nameless,
        ):
            async with fleet_of(first, second, nameless) as fleet:
                await fleet.wait(3, timeout=PATIENCE_S)
                assert set(fleet) == {"A3", "B7", nameless}
                assert (fleet["B7"].url, fleet["A3"].url) == (first, second)
                assert await fleet["B7"].echo(b"hi") == b"hi"
                assert fleet.problems == {}
                assert repr(fleet) == "<j2a.AsyncFleet 3 of 3 boards are here>"
                found = fleet.transducers
                await found["A3", "quad"].configure(period=0.5)
                assert await fleet["A3"].transducers["quad"].setting("period") == 0.5
                assert await found["B7", "quad"].setting("period") == 0.0

    @in_event_loop
    async def test_one_that_comes_later_and_goes_and_comes_again(self):
        url = make_url()
        async with fleet_of() as fleet:
            change = changes_of(fleet)
            fleet.add(url)
            vain = await change()
            assert (vain.board, vain.url, vain.is_here) == (None, url, False)
            assert isinstance(fleet.problems[url], j2a.LinkError)
            for _ in range(2):
                with served(make_device("A3"), url):
                    here = await change()
                    assert here == j2a.BoardChange("A3", url, is_here=True)
                    assert fleet["A3"].is_open
                    assert fleet.problems == {}
                gone = await change()
                assert (gone.board, gone.is_here) == ("A3", False)
                assert isinstance(gone.reason, j2a.LinkLost)
                assert len(fleet) == 0
                # What it is tried for again in vain is told once.
                vain = await change()
                assert (vain.board, vain.is_here) == (None, False)

    @in_event_loop
    async def test_a_silent_one_delays_none(self):
        url = make_url()
        with silent(url), served(make_device("A3")) as other:
            async with fleet_of(url, other, boot_time=0.5) as fleet:
                change = changes_of(fleet)
                await fleet.wait("A3", timeout=PATIENCE_S)
                while url not in fleet.problems:
                    await change()
                assert isinstance(fleet.problems[url], j2a.CallTimeout)
                assert "A3" in fleet

    @in_event_loop
    async def test_ones_that_mean_harm_keep_no_other_from_its_samples(self):
        device = make_device("A3")
        with contextlib.ExitStack() as stack:
            bad = [stack.enter_context(harmful(kind)) for kind in ("hangs up", "noise", "zeros")]
            good = stack.enter_context(served(device))
            async with fleet_of(*bad, good, boot_time=0.5, retry=0.1) as fleet:
                await fleet.wait("A3", timeout=PATIENCE_S)
                with contextlib.closing(fleet.samples()) as samples:
                    value = 0
                    while value < 20 or len(fleet.problems) < len(bad):
                        value += 1
                        device.sense("level", 0, value % 256)
                        assert (await samples.wait(PATIENCE_S)).values == (value % 256,)
                assert set(fleet.problems) == set(bad)
                assert list(fleet) == ["A3"]

    @in_event_loop
    async def test_one_that_falls_silent_is_gone_and_tried_again(self):
        device, url = make_device("A3"), make_url()
        mute, mute_over = threading.Event(), threading.Event()
        execute = device._execute

        def execute_late(opcode, payload):
            if mute.is_set():
                mute_over.wait(PATIENCE_S)
            return execute(opcode, payload)

        device._execute = execute_late
        async with fleet_of(timeout=0.2, heartbeat=0.05) as fleet:
            change = changes_of(fleet)
            with served(device, url):
                fleet.add(url)
                assert (await change()).is_here
                mute.set()
                gone = await change()
                assert (gone.board, gone.is_here) == ("A3", False)
                assert isinstance(gone.reason, j2a.CallTimeout)
                mute.clear()
                mute_over.set()
                assert (await change()).is_here

    @in_event_loop
    async def test_one_whose_handler_of_changes_meets_a_cancelled_future_is_tried_again(self):
        url, errors = make_url(), []

        async def meet(_change):
            future = asyncio.get_running_loop().create_future()
            future.cancel()
            await future

        async with fleet_of(on_handler_error=lambda *what: errors.append(what)) as fleet:
            fleet.on_change(meet)
            change = changes_of(fleet)
            with served(make_device("A3"), url):
                fleet.add(url)
                here = await change()
                assert await fleet["A3"].echo(b"hi") == b"hi"
                assert [(type(error), one) for error, one in errors] == [
                    (asyncio.CancelledError, here)
                ]
            gone = await change()
            assert (gone.board, gone.is_here, len(fleet)) == ("A3", False, 0)
            assert (await change()).board is None  # cannot be opened
            with served(make_device("A3"), url):
                assert (await change()).is_here

    @in_event_loop
    async def test_one_that_meets_a_cancelled_future_when_it_is_asked_who_it_is(self):
        answers = iter([asyncio.CancelledError(), "A3"])

        async def identify(_client):
            answer = next(answers)
            if isinstance(answer, asyncio.CancelledError):
                raise answer
            return answer

        with served(make_device()) as url:
            async with fleet_of(identify=identify) as fleet:
                change = changes_of(fleet)
                fleet.add(url)
                failed = await change()
                assert not failed.is_here
                assert str(failed.reason) == "identify failed: CancelledError: "
                assert (await change()).board == "A3"

    @in_event_loop
    async def test_one_that_is_cancelled_from_outside_ends(self):
        async with fleet_of(identify=lambda _client: asyncio.sleep(PATIENCE_S)) as fleet:
            with served(make_device()) as url:
                fleet.add(url)
                [task] = fleet._tasks
                await asyncio.sleep(SOON_S)
                task.cancel()
                await asyncio.wait([task], timeout=PATIENCE_S)
                assert task.cancelled()

    @in_event_loop
    async def test_two_with_one_serial_number(self, caplog):
        with served(make_device("A3")) as first, served(make_device("A3")) as second:
            async with fleet_of(first) as fleet:
                await fleet.wait("A3", timeout=PATIENCE_S)
                change = changes_of(fleet)
                fleet.add(second)
                twin = f"A3@{second}"
                assert (await change()).board == twin
                assert (fleet["A3"].url, fleet[twin].url) == (first, second)
                for board in ("A3", twin):
                    fleet.remove(board)
                    assert (await change()).board == board
                for url, board in ((second, twin), (first, "A3")):
                    fleet.add(url)
                    assert (await change()).board == board
                    assert fleet[board].url == url
                [warning] = [one for one in caplog.messages if "identity" in one]
                assert "identify=j2a.fleet.by_url" in warning

    @in_event_loop
    async def test_identities_of_ones_own(self):
        with served(make_device("A3")) as first, served(make_device("A3")) as second:
            async with fleet_of(first, second, identify=by_url) as fleet:
                await fleet.wait(first, second, timeout=PATIENCE_S)
            async with fleet_of(identify=lambda client: 1 // 0) as fleet:
                change = changes_of(fleet)
                fleet.add(first)
                assert "identify failed: ZeroDivisionError" in str((await change()).reason)

    @in_event_loop
    async def test_one_that_is_taken_out(self):
        with served(make_device("A3")) as url:
            async with fleet_of(url) as fleet:
                await fleet.wait("A3", timeout=PATIENCE_S)
                client = fleet["A3"]
                change = changes_of(fleet)
                fleet.remove("A3")
                with pytest.raises(j2a.UnknownBoard, match=r"'A3' is not here \(here: none\)"):
                    fleet["A3"]
                assert await change() == j2a.BoardChange("A3", url, is_here=False)
                assert not client.is_open
                fleet.add(url)
                await fleet.wait("A3", timeout=PATIENCE_S)

    @in_event_loop
    async def test_one_that_is_taken_out_while_it_is_opened(self):
        url = make_url()
        with silent(url):
            async with fleet_of(url) as fleet:
                while not fleet._roster.members[url]._can_stop:
                    await asyncio.sleep(0)
                fleet.remove(url)
                assert fleet.problems == {}

    @in_event_loop
    async def test_what_can_be_done_in_a_handler(self):
        done = asyncio.Event()
        with served(make_device("A3")) as first, served(make_device("B7")) as second:
            async with fleet_of() as fleet:

                async def follow(change):
                    if change.board == "A3" and change.is_here:
                        assert await fleet["A3"].echo(b"x") == b"x"
                        fleet.add(second)
                    elif change.board == "B7" and change.is_here:
                        fleet.remove("A3")
                        await fleet.close()
                        done.set()

                fleet.on_change(follow)
                fleet.add(first)
                await asyncio.wait_for(done.wait(), PATIENCE_S)

    @pytest.mark.parametrize("way", [asyncio.wait_for, lambda close, _limit_s: close])
    @in_event_loop
    async def test_a_handler_of_samples_closes_the_fleet(self, way, caplog):
        device = make_device("A3")
        closed = asyncio.Event()
        with served(device) as url:
            async with fleet_of(url) as fleet:

                async def end(_sample):
                    await way(fleet.close(), PATIENCE_S)
                    closed.set()

                fleet.on_sample(end)
                await fleet.wait("A3", timeout=PATIENCE_S)
                client = fleet["A3"]
                device.sense("level", 0, 1)
                await asyncio.wait_for(closed.wait(), PATIENCE_S)
            while client.is_open:
                await asyncio.sleep(SOON_S)
        assert caplog.records == []


class TestArguments:
    def test_without_a_loop(self):
        with pytest.raises(j2a.LocalError, match="no event loop"):
            j2a.AsyncFleet()

    @in_event_loop
    async def test_misuse(self):
        url = make_url()
        with pytest.raises(j2a.BadUrl):
            j2a.AsyncFleet(url, "no-scheme://x")
        with pytest.raises(j2a.LocalError, match="the fleet has loopback"):
            j2a.AsyncFleet(url, url)
        async with fleet_of(url) as fleet:
            with pytest.raises(j2a.LocalError, match="the fleet has loopback"):
                fleet.add(url)
            with pytest.raises(j2a.UnknownBoard, match="no board 'C9'"):
                fleet.remove("C9")
            with pytest.raises(j2a.LocalError, match="identities, or one number"):
                await fleet.wait(1, 2)
            with pytest.raises(j2a.CallTimeout, match=rf"no board C9 within 0.5 s; {url}: "):
                await fleet.wait("C9", timeout=0.5)
            with pytest.raises(j2a.CallTimeout, match="0 of 2 boards"):
                await fleet.wait(2, timeout=0.01)
        await fleet.close()
        with pytest.raises(j2a.LocalError, match="is closed"):
            fleet.add(make_url())
        with pytest.raises(j2a.LinkClosed):
            await fleet.wait(1)

    def test_nothing_is_left_behind(self):
        tasks = []

        @in_event_loop
        async def use():
            with served(make_device("A3")) as url, silent(mute := make_url()):
                async with fleet_of(url, mute, make_url()) as fleet:
                    await fleet.wait("A3", timeout=PATIENCE_S)
                    tasks.extend(fleet._tasks)
                assert all(task.done() and not task.cancelled() for task in tasks)
                assert len(tasks) == 3

        before = set(threading.enumerate())
        use()
        for thread in set(threading.enumerate()) - before:
            thread.join(PATIENCE_S)
            assert not thread.is_alive()

    @in_event_loop
    async def test_links_with_a_descriptor_have_no_thread(self):
        count = 4
        with contextlib.ExitStack() as stack:
            devices = [make_device(str(number)) for number in range(count)]
            urls = [
                stack.enter_context(
                    served(device, "tcp://127.0.0.1:0")  # the URL has the port that it got
                )
                for device in devices
            ]
            async with fleet_of(*urls) as fleet:
                await fleet.wait(count, timeout=PATIENCE_S)
                names = [thread.name for thread in threading.enumerate()]
                while any(name.startswith("j2a opener") for name in names):
                    await asyncio.sleep(SOON_S)
                    names = [thread.name for thread in threading.enumerate()]
                assert not [name for name in names if any(url in name for url in urls)]


class TestSamples:
    @in_event_loop
    async def test_boards_are_told_apart(self):
        left, right = make_device("left"), make_device("right")
        with served(left) as first, served(right) as second:
            async with fleet_of(first, second) as fleet:
                await fleet.wait(2, timeout=PATIENCE_S)
                levels = asyncio.Queue()
                subscription = fleet.on_sample(levels.put, "level")
                async with fleet.samples() as every, fleet.samples("quad") as quads:
                    left.sense("quad", 1, 7)
                    right.sense("quad", 0, 9)
                    right.sense("level", 0, 3)
                    found = [await every.wait(PATIENCE_S) for _ in range(3)]
                    assert {(one.board, one.name, one.values) for one in found} == {
                        ("left", "quad", (None, 7)),
                        ("right", "quad", (9, None)),
                        ("right", "level", (3,)),
                    }
                    both = [await quads.wait(PATIENCE_S) for _ in range(2)]
                    assert {one.board for one in both} == {"left", "right"}
                    assert (await levels.get()).board == "right"
                    subscription.cancel()
                    right.sense("level", 0, 4)
                    assert (await every.wait(PATIENCE_S)).values == (4,)
                    assert levels.empty()

    @in_event_loop
    async def test_samples_go_on_when_the_board_is_back(self):
        url = make_url()
        async with fleet_of(url) as fleet:
            samples = fleet.samples()
            for value in (1, 2):
                device = make_device("A3")
                with served(device, url):
                    await fleet.wait("A3", timeout=PATIENCE_S)
                    device.sense("level", 0, value)
                    sample = await anext(aiter(samples))
                    assert (sample.board, sample.values, sample.sequence) == ("A3", (value,), 0)
                    change = changes_of(fleet)
                while "A3" in fleet:
                    await change()
            await fleet.close()
            assert [sample async for sample in samples] == []

    @in_event_loop
    async def test_a_slow_handler_holds_up_its_board_only(self):
        left, right = make_device("left"), make_device("right")
        stuck, seen = asyncio.Event(), asyncio.Queue()

        async def take(sample):
            if sample.board == "left":
                await stuck.wait()
            await seen.put((sample.board, sample.values[0]))

        with served(left) as first, served(right) as second:
            async with fleet_of(first, second) as fleet:
                fleet.on_sample(take)
                await fleet.wait(2, timeout=PATIENCE_S)
                left.sense("level", 0, 1)
                for value in (2, 3):
                    right.sense("level", 0, value)
                    assert await seen.get() == ("right", value)
                stuck.set()
                assert await seen.get() == ("left", 1)

    @in_event_loop
    @pytest.mark.parametrize("raised", [AttributeError, asyncio.CancelledError])
    async def test_a_handler_that_fails_stops_no_other(self, raised):
        device, errors, seen = make_device("A3"), [], asyncio.Queue()

        async def fail(_sample):
            raise raised

        with served(device) as url:
            async with fleet_of(url, on_handler_error=lambda *what: errors.append(what)) as fleet:
                fleet.on_sample(fail)
                fleet.on_sample(seen.put)
                await fleet.wait("A3", timeout=PATIENCE_S)
                device.sense("level", 0, 1)
                sample = await asyncio.wait_for(seen.get(), PATIENCE_S)
                assert [(type(error), one) for error, one in errors] == [(raised, sample)]


class TestUsb:
    @in_event_loop
    async def test_boards_come_and_go(self, monkeypatch):
        watch = FakeWatch()
        monkeypatch.setattr(j2a_transports, "watch_usb", lambda: watch)
        with served(make_device("A3")) as url:
            async with fleet_of(usb=True) as fleet:
                board = SimpleNamespace(url=url)
                watch.events.put(j2a_transports.UsbArrived(board))
                await fleet.wait("A3", timeout=PATIENCE_S)
                change = changes_of(fleet)
                watch.events.put(j2a_transports.UsbArrived(board))  # is in already
                watch.events.put(j2a_transports.UsbLeft(board))
                watch.events.put(j2a_transports.UsbLeft(board))
                assert not (await change()).is_here
                assert len(fleet) == 0
                watch.events.put(j2a_transports.UsbArrived(board))
                await fleet.wait("A3", timeout=PATIENCE_S)

    @in_event_loop
    async def test_without_the_usb(self, monkeypatch):
        def missing():
            raise j2a_transports.MissingExtra("USB", "pyusb", "usb")

        monkeypatch.setattr(j2a_transports, "watch_usb", missing)
        with pytest.raises(j2a.OpenFailed, match="pyusb"):
            j2a.AsyncFleet(usb=True)


@pytest.mark.parametrize("turns", range(8))
@in_event_loop
async def test_a_task_that_is_cancelled_when_its_link_ends_is_cancelled(turns):
    ended = asyncio.Event()
    waits = asyncio.create_task(is_set_within(ended, PATIENCE_S))
    for _ in range(4):
        await asyncio.sleep(0)
    ended.set()
    for _ in range(turns):
        await asyncio.sleep(0)
    is_cancelled = waits.cancel()
    await asyncio.wait([waits])
    assert waits.cancelled() == is_cancelled
