"""The asyncio client: what it has in common with the blocking one, and what is its own."""

import asyncio
import contextlib
import functools
import gc
import math
import struct
import threading
import time

import j2a_transports
import pytest
from j2a_spec import oracle
from j2a_spec.constants import SOF, SOS

import j2a
from j2a.demo import DemoDevice

from .support import PATIENCE_S, OldDevice, served
from .wire import BrokenDriver


@contextlib.asynccontextmanager
async def linked(device=None, **options):
    options = {"timeout": PATIENCE_S, "boot_time": PATIENCE_S, **options}
    with served(device or DemoDevice()) as url:
        async with await j2a.aconnect(url, **options) as client:
            yield client


@contextlib.asynccontextmanager
async def wired(**options):
    """A client whose device is the test itself."""
    near, far = j2a_transports.pair()
    async with j2a.AsyncClient(near, timeout=PATIENCE_S, **options) as client:
        yield client, far
    far.close()


async def request(far) -> oracle.Frame:
    data = b""
    while True:
        data += await asyncio.to_thread(far.read, PATIENCE_S)
        (event,) = oracle.decode(data)
        if isinstance(event, oracle.Frame):
            return event


def in_event_loop(function):
    """Run a coroutine function as a test, with a limit."""

    @functools.wraps(function)
    def run(*args, **kwargs):
        asyncio.run(asyncio.wait_for(function(*args, **kwargs), 4 * PATIENCE_S))

    return run


class TestCalls:
    @in_event_loop
    async def test_calls_by_name_and_by_opcode(self):
        async with linked() as client:
            numbers = struct.pack("<ii", 20, 22)
            assert await client.call("add", numbers) == j2a.Reply(0, struct.pack("<i", 42))
            opcode = (await client.functions())["add"]
            assert (await client.call(opcode, numbers)).payload == struct.pack("<i", 42)
            for size in range(0, 256, 5):
                assert await client.echo(bytes(size)) == bytes(size)

    @in_event_loop
    async def test_properties_and_debug_text(self):
        async with linked() as client:
            assert (await client.properties())["j2a.spec"] == "1.1"
            for code in range(60):
                await client.call("ret", bytes((code,)))
            text = "".join(f"ret 0x{code:02X}\n" for code in range(60))
            assert await client.read_debug() == text
            assert await client.read_debug() == ""

    @in_event_loop
    async def test_many_calls_at_once(self):
        async with linked(window=8) as client:
            payloads = [b"%d" % n for n in range(200)]
            assert await asyncio.gather(*map(client.echo, payloads)) == payloads

    @in_event_loop
    async def test_errors(self):
        async with linked() as client:
            with pytest.raises(j2a.OpcodeRefused):
                await client.call(200)
            with pytest.raises(j2a.UnknownFunction, match="store"):
                await client.read_many("stor")
            for misuse in (
                client.call("add", "text"),
                client.call("add", bytes(256)),
                client.call("add", timeout=0),
                client.write_many("store", 5),
                client.refresh(boot_time=-1),
            ):
                with pytest.raises(j2a.LocalError):
                    await misuse

    @in_event_loop
    async def test_old_boards(self):
        async with linked(OldDevice(has_map=False)) as client:
            assert await client.functions() == {}
            assert await client.properties() == {}
            assert await client.call(4, b"x") == (0xBA, b"x")


class TestTransfers:
    @in_event_loop
    async def test_store(self):
        async with linked() as client:
            for size in (0, 1, 248, 249, 250, 498, 499, 600, 65536):
                data = bytes(index * 31 + index // 256 & 0xFF for index in range(size))
                seen = []
                await client.write_many(
                    "store", data, progress=lambda *at, seen=seen: seen.append(at)
                )
                assert seen[-1] == (size, size)
                assert await client.read_many("store") == data

    @in_event_loop
    async def test_echo_many(self):
        async with linked() as client:
            assert await client.echo_many(bytes(5000)) == bytes(5000)

    @in_event_loop
    async def test_a_cancelled_transfer_leaves_the_link_usable(self):
        async with linked() as client:
            with pytest.raises(TimeoutError):
                await asyncio.wait_for(client.echo_many(bytes(60_000_000)), 0.05)
            assert await client.echo(b"x") == b"x"


class TestTimeLimits:
    @in_event_loop
    async def test_a_late_reply_does_not_answer_the_next_call(self):
        device, gate = DemoDevice(), threading.Event()
        device.function("gate")(lambda _payload: (gate.wait(PATIENCE_S), b"late")[1])
        async with linked(device) as client:
            with pytest.raises(j2a.CallTimeout, match="gate"):
                await client.call("gate", timeout=0.05)
            gate.set()
            assert await client.echo(b"next") == b"next"
            assert client.counters.timeouts == 1
            assert client.counters.late_replies == 1

    @in_event_loop
    async def test_the_reply_to_a_cancelled_call_does_not_answer_the_next(self):
        device, gate = DemoDevice(), threading.Event()
        device.function("gate")(lambda _payload: (gate.wait(PATIENCE_S), b"late")[1])
        async with linked(device) as client:
            sent = client.counters.frames_sent
            call = asyncio.create_task(client.call("gate"))
            while client.counters.frames_sent == sent:
                await asyncio.sleep(0)
            call.cancel()
            with pytest.raises(asyncio.CancelledError):
                await call
            gate.set()
            assert await client.echo(b"next") == b"next"
            assert client.counters.late_replies == 1

    @in_event_loop
    async def test_a_call_cancelled_before_it_was_sent_is_never_sent(self):
        async with wired() as (client, far):
            first = asyncio.create_task(client.call(1))
            second = asyncio.create_task(client.call(2))
            third = asyncio.create_task(client.call(3))
            seq = (await request(far)).seq
            second.cancel()
            far.write(oracle.encode(oracle.Frame(SOF, seq, 0, b"first")))
            assert (await first).payload == b"first"
            assert (await request(far)).opcode == 3
            far.write(oracle.encode(oracle.Frame(SOF, (seq + 1) & 0xFF, 0, b"third")))
            assert (await third).payload == b"third"
            assert second.cancelled()

    @in_event_loop
    async def test_what_an_earlier_program_left_behind_answers_nothing(self):
        near, far = j2a_transports.pair()
        for seq in range(256):
            far.write(oracle.encode(oracle.Frame(SOF, seq, 0, b"stale")))
        async with j2a.AsyncClient(near) as client:
            with pytest.raises(j2a.CallTimeout):
                await client.call(1, timeout=0.02)
            assert client.counters.stray_replies == 256

    @in_event_loop
    async def test_a_shorter_limit_set_later_is_kept(self):
        async with wired() as (client, _far):
            slow = asyncio.create_task(client.call(1, timeout=PATIENCE_S))
            await asyncio.sleep(0)
            start = asyncio.get_running_loop().time()
            with pytest.raises(j2a.CallTimeout):
                await client.call(2, timeout=0.02)
            assert asyncio.get_running_loop().time() < start + PATIENCE_S / 2
            slow.cancel()


class TestSifs:
    @pytest.mark.requirement("J2A-SIF-007")
    @in_event_loop
    async def test_handlers_run_in_order_and_may_call(self):
        async with linked() as client:
            seen, done = [], asyncio.Event()

            @client.on_sif(range(4, 6))
            async def slow(sif):
                seen.append(("slow", await client.echo(sif.payload)))

            subscription = client.on_sif(None, lambda sif: seen.append(("plain", sif.payload)))
            client.on_sif(0xFF, lambda sif: done.set())
            await client.call("sif", b"\x04a")
            await client.call("sif", b"\x05b")
            await client.call("sif", b"\xff")
            await asyncio.wait_for(done.wait(), PATIENCE_S)
            assert seen == [
                ("slow", b"a"),
                ("plain", b"a"),
                ("slow", b"b"),
                ("plain", b"b"),
                ("plain", b""),
            ]
            subscription.cancel()
            done.clear()
            await client.call("sif", b"\xff")
            await asyncio.wait_for(done.wait(), PATIENCE_S)
            assert len(seen) == 5

    @in_event_loop
    async def test_exceptions_of_handlers_reach_the_hook(self):
        errors, done = [], asyncio.Event()

        def hook(error, sif):
            errors.append((str(error), sif.opcode))
            done.set()

        async with linked(on_handler_error=hook) as client:

            @client.on_sif()
            async def broken(sif):
                raise RuntimeError("broken on purpose")

            await client.call("sif", b"\x07")
            await asyncio.wait_for(done.wait(), PATIENCE_S)
            assert errors == [("broken on purpose", 7)]
            assert client.counters.handler_errors == 1

    @in_event_loop
    async def test_a_handler_may_close_the_client(self):
        async with linked() as client:
            closed = asyncio.Event()

            @client.on_sif()
            async def handler(sif):
                await client.close()
                closed.set()

            with contextlib.suppress(j2a.LinkClosed):
                await client.call("sif", b"\x01")
            await asyncio.wait_for(closed.wait(), PATIENCE_S)
            assert not client.is_open

    @in_event_loop
    async def test_a_cancelled_future_in_a_handler_does_not_end_the_others(self):
        async with linked() as client:
            seen = asyncio.Queue()

            @client.on_sif()
            async def handler(sif):
                seen.put_nowait(sif.opcode)
                future = asyncio.get_running_loop().create_future()
                future.cancel()
                await future

            await client.call("sif", b"\x01")
            await client.call("sif", b"\x02")
            assert [await asyncio.wait_for(seen.get(), PATIENCE_S) for _ in range(2)] == [1, 2]
            await client.close()
            assert client.counters.handler_errors == 2

    @pytest.mark.parametrize("closes", [False, True])
    @in_event_loop
    async def test_a_handler_that_waits_for_ever_is_cancelled_by_close(self, closes):
        ends = []
        with pytest.MonkeyPatch.context() as patched:
            patched.setattr("j2a.io.loop.JOIN_S", 0.05)
            async with linked() as client:
                started = asyncio.Event()

                async def close():
                    await started.wait()
                    await client.close()

                # No task of the handler's: that waits for the close, which waits for it.
                waits = asyncio.create_task(close() if closes else asyncio.Event().wait())

                @client.on_sif()
                async def handler(sif):
                    started.set()
                    try:
                        await waits
                    except asyncio.CancelledError:
                        ends.append("cancelled")
                        raise

                await client.call("sif", b"\x01")
                await asyncio.wait_for(started.wait(), PATIENCE_S)
            await asyncio.wait([client._engine.dispatcher])
        assert ends == ["cancelled"]


class TestTheEnd:
    @in_event_loop
    async def test_close_while_calls_wait(self):
        async with wired() as (client, far):
            calls = [asyncio.create_task(client.call(n)) for n in range(5)]
            await request(far)
            await client.close()
            ends = await asyncio.gather(*calls, return_exceptions=True)
            assert [type(end) for end in ends] == [j2a.LinkClosed] * 5
            with pytest.raises(j2a.LinkClosed):
                await client.call(1)
            await client.close()

    @pytest.mark.requirement("J2A-TIME-006")
    @in_event_loop
    async def test_a_lost_link_ends_all_calls_at_once(self):
        async with wired() as (client, far):
            calls = [asyncio.create_task(client.call(n)) for n in range(5)]
            await request(far)
            far.close()
            ends = await asyncio.gather(*calls, return_exceptions=True)
            assert [type(end) for end in ends] == [j2a.LinkLost] * 5
            assert not client.is_open

    @pytest.mark.parametrize("fails", ["read", "write"])
    @in_event_loop
    async def test_a_broken_driver_ends_all_calls(self, fails):
        async with j2a.AsyncClient(BrokenDriver(fails)) as client:
            with pytest.raises(j2a.LinkLost, match="ValueError: a bug in the driver"):
                await asyncio.wait_for(client.call(1, timeout=math.inf), PATIENCE_S)

    @in_event_loop
    async def test_a_device_that_does_not_read_does_not_block_the_event_loop(self):
        async with wired() as (client, far):
            client._engine._transport._outgoing._limit = 3
            call = asyncio.create_task(client.call(1, bytes(100)))
            far.write(oracle.encode(oracle.Frame(SOS, 0, 9, b"")))
            while not client.counters.sifs:
                await asyncio.sleep(0.001)
            assert not call.done()
            await client.close()
            with pytest.raises(j2a.LinkClosed):
                await call

    @in_event_loop
    async def test_the_threads_end(self):
        before = set(threading.enumerate())
        for _ in range(3):
            async with linked() as client:
                await client.echo(b"x")
        end = time.monotonic() + PATIENCE_S
        while True:
            names = [thread.name for thread in set(threading.enumerate()) - before]
            # asyncio keeps the threads of its executor; the client's own end. Those that serve the
            # device end when they see that.
            own = [n for n in names if n.startswith("j2a ") and not n.startswith("j2a device ")]
            if not own or time.monotonic() > end:
                break
            await asyncio.sleep(0.01)
        assert not own


class TestConnecting:
    @in_event_loop
    async def test_nobody_answers(self):
        with (
            j2a_transports.listen("loopback:silent board for asyncio") as listener,
            pytest.raises(j2a.CallTimeout, match="no device answered"),
        ):
            await j2a.aconnect(listener.url, boot_time=0.3)

    @in_event_loop
    async def test_a_link_that_fails_after_the_wait_was_cancelled_is_not_told_of(self, monkeypatch):
        began, goes_on = threading.Event(), threading.Event()

        def fail(*_args):
            began.set()
            assert goes_on.wait(PATIENCE_S)
            raise j2a.OpenFailed("nothing is there")

        monkeypatch.setattr("j2a.aio.open_transport", fail)
        told = []
        asyncio.get_running_loop().set_exception_handler(lambda _loop, about: told.append(about))
        connecting = asyncio.ensure_future(j2a.aconnect("tcp://127.0.0.1:1"))
        await asyncio.to_thread(began.wait, PATIENCE_S)
        connecting.cancel()
        with pytest.raises(asyncio.CancelledError):
            await connecting
        goes_on.set()
        while any(one.name.startswith("j2a opener") for one in threading.enumerate()):
            await asyncio.sleep(0.001)
        for _ in range(3):
            await asyncio.sleep(0)
            gc.collect()
        assert told == []

    @in_event_loop
    async def test_a_link_that_opens_after_the_wait_was_cancelled_is_closed(self):
        near, far = j2a_transports.pair()
        opening, gate = threading.Event(), threading.Event()

        def slow(_url, _options):
            opening.set()
            assert gate.wait(PATIENCE_S)
            return near

        with pytest.MonkeyPatch.context() as patched:
            patched.setattr("j2a.aio.open_transport", slow)
            connecting = asyncio.create_task(j2a.aconnect("loopback:slow"))
            assert await asyncio.to_thread(opening.wait, PATIENCE_S)
            connecting.cancel()
            with pytest.raises(asyncio.CancelledError):
                await connecting
        gate.set()
        with pytest.raises(j2a_transports.LinkLost):
            await asyncio.to_thread(far.read, PATIENCE_S)

    @in_event_loop
    async def test_urls_and_options(self):
        with pytest.raises(j2a.BadUrl):
            await j2a.aconnect("nosuch:thing")
        with pytest.raises(j2a.OpenFailed):
            await j2a.aconnect("loopback:nobody is here")
        with pytest.raises(j2a.LocalError):
            await j2a.aconnect("loopback:x", boot_time=0)
