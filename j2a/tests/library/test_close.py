"""The end of both clients: SIFs that have come, dropped clients, forked children."""

import asyncio
import contextlib
import gc
import os
import signal
import threading
import time
import weakref
from concurrent.futures import ThreadPoolExecutor

import j2a_transports
import pytest
from j2a_spec import oracle
from j2a_spec.constants import SOF, SOS

import j2a
from j2a.demo import DemoDevice

from .support import PATIENCE_S, served
from .wire import Background, Wire


def sifs(numbers):
    return [oracle.Frame(SOS, n, n, b"") for n in numbers]


@contextlib.contextmanager
def tcp_pair():
    """Both ends of a connection whose bytes wait in the kernel."""
    with j2a_transports.listen("tcp://127.0.0.1:0") as listener:
        near = j2a_transports.open(listener.url)
        far = listener.accept(PATIENCE_S)
        with near, far:
            yield near, far


def wire_bytes(frames):
    return b"".join(map(oracle.encode, frames))


class TestSifsAtClose:
    @pytest.mark.requirement("J2A-SIF-007")
    def test_those_that_came_are_handled(self, caplog):
        with Wire() as wire:
            seen = []
            wire.client.on_sif(None, lambda sif: (time.sleep(0.002), seen.append(sif.opcode)))
            wire.send(*sifs(range(40)))
            wire.client.close()
            assert seen == list(range(40))
            assert wire.client.counters.sifs_dropped == 0
        assert caplog.records == []

    def test_also_from_the_kernel(self):
        with tcp_pair() as (near, far):
            client, seen = j2a.Client(near), []
            client.on_sif(None, lambda sif: seen.append(sif.opcode))
            with client._engine._state:  # the reader stops at the first
                far.write(wire_bytes(sifs(range(200))))
            client.close()
            assert seen == list(range(200))

    def test_their_handlers_may_call(self):
        with served(DemoDevice()) as url, j2a.connect(url, timeout=PATIENCE_S) as client:
            seen = []
            client.on_sif(7, lambda sif: seen.append(client.echo(sif.payload)))
            for n in range(20):
                client.call("sif", bytes((7, n)))
            client.close()
            assert seen == [bytes((n,)) for n in range(20)]

    def test_also_when_the_block_is_left_by_an_exception(self):
        with Wire() as wire:
            seen = []
            wire.client.on_sif(None, lambda sif: seen.append(sif.opcode))
            with pytest.raises(ZeroDivisionError), wire.client:
                wire.send(*sifs(range(40)))
                raise ZeroDivisionError
            assert seen == list(range(40))

    def test_when_the_link_was_lost_before(self):
        with Wire() as wire:
            seen, gate = [], threading.Event()
            wire.client.on_sif(None, lambda sif: (gate.wait(PATIENCE_S), seen.append(sif.opcode)))
            wire.send(*sifs(range(40)))
            wire.far.close()
            while wire.client.is_open:
                time.sleep(0.001)
            gate.set()
            wire.client.close()
            assert seen == list(range(40))

    def test_a_failed_write_loses_neither_sifs_nor_a_reply(self):
        class NoWrite(j2a_transports.Transport):
            """A transport that has bytes to read when writing fails."""

            closed = False

            def __init__(self, inner):
                super().__init__("no-write:")
                self.inner = inner
                self.read, self.wake_reader, self.close = (
                    inner.read,
                    inner.wake_reader,
                    inner.close,
                )

            read = close = None

            def write(self, data):
                [request] = oracle.decode(data)
                reply = oracle.Frame(SOF, request.seq, 0, b"done")
                far.write(wire_bytes([*sifs(range(9)), reply]))
                raise j2a_transports.LinkLost("gone")

        with tcp_pair() as (near, far), j2a.Client(NoWrite(near)) as client:
            seen = []
            client.on_sif(None, lambda sif: seen.append(sif.opcode))
            assert client.call(1).payload == b"done"
            client.close()
            assert seen == list(range(9))

    def test_a_handler_that_is_stuck_is_left_and_the_others_are_counted(self, monkeypatch, caplog):
        monkeypatch.setattr("j2a.io.blocking.JOIN_S", 0.05)
        monkeypatch.setattr("j2a.io.blocking._LEAVE_S", 0.01)
        with Wire() as wire:
            seen, gate, started = [], threading.Event(), threading.Event()

            def stuck(sif):
                seen.append(sif.opcode)
                started.set()
                gate.wait(PATIENCE_S)

            wire.client.on_sif(None, stuck)
            wire.send(*sifs(range(40)))
            assert started.wait(PATIENCE_S)
            wire.client.close()
            assert wire.client.counters.sifs_dropped == 39
            assert "before 39 SIFs reached" in caplog.text
            gate.set()
            wire.client._engine.dispatcher.join(PATIENCE_S)
            assert seen == [0]

    def test_a_handler_that_closes_is_the_last(self):
        with Wire() as wire:
            seen = []
            wire.client.on_sif(None, lambda sif: (seen.append(sif.opcode), wire.client.close()))
            wire.send(*sifs(range(40)))
            wire.client._engine.dispatcher.join(PATIENCE_S)
            assert seen == [0]
            assert wire.client.counters.sifs_dropped == wire.client.counters.sifs - 1

    def test_the_link_is_closed_with_the_client(self, caplog):
        with tcp_pair() as (near, _):
            client = j2a.Client(near)
            client.close()
            assert near.closed
            assert not any(thread.is_alive() for thread in client._engine._link.threads)
        assert caplog.records == []

    def test_several_threads_close(self):
        with Wire() as wire:
            seen = []
            wire.client.on_sif(None, lambda sif: (time.sleep(0.002), seen.append(sif.opcode)))
            wire.send(*sifs(range(20)))
            closers = [Background(wire.client.close) for _ in range(5)]
            for closer in closers:
                closer.result()
                assert seen == list(range(20))

    def test_with_asyncio(self):
        async def main():
            near, far = j2a_transports.pair()
            with far:
                seen = []

                async def handler(sif):
                    await asyncio.sleep(0.001)
                    seen.append(sif.opcode)

                async with j2a.AsyncClient(near) as client:
                    client.on_sif(None, handler)
                    far.write(wire_bytes(sifs(range(40))))
                assert seen == list(range(40))
                assert client.counters.sifs_dropped == 0

        asyncio.run(main())

    def test_with_asyncio_those_behind_a_stuck_handler_are_counted(self, monkeypatch, caplog):
        monkeypatch.setattr("j2a.io.loop.JOIN_S", 0.05)

        async def main():
            near, far = j2a_transports.pair()
            with far:
                async with j2a.AsyncClient(near) as client:
                    client.on_sif(None, lambda _sif: asyncio.Event().wait())
                    far.write(wire_bytes(sifs(range(40))))
                assert client.counters.sifs_dropped == 39

        asyncio.run(main())
        assert "before 39 SIFs reached" in caplog.text

    @pytest.mark.parametrize(
        "way",
        [lambda close: asyncio.wait_for(close, PATIENCE_S), asyncio.create_task],
        ids=["wait_for", "task"],
    )
    @pytest.mark.parametrize("is_coroutine", [False, True])
    def test_with_asyncio_a_handler_closes_in_another_task(self, caplog, way, is_coroutine):
        async def main():
            near, far = j2a_transports.pair()
            with far:
                client, seen = j2a.AsyncClient(near), []

                def close(sif):
                    seen.append(sif.opcode)
                    return way(client.close())

                async def close_and_go_on(sif):
                    await close(sif)
                    seen.append("went on")

                client.on_sif(None, close_and_go_on if is_coroutine else close)
                far.write(wire_bytes(sifs([3])))
                await asyncio.wait_for(client._engine.dispatcher, PATIENCE_S)
                assert seen == [3, "went on"][: 1 + is_coroutine]

        asyncio.run(main())
        assert caplog.records == []

    def test_with_asyncio_a_task_of_a_handler_that_has_ended_delivers_what_came(self, caplog):
        async def main():
            near, far = j2a_transports.pair()
            with far:
                client, seen, tasks = j2a.AsyncClient(near), [], []
                all_came = asyncio.Event()

                async def close():
                    await all_came.wait()
                    await client.close()

                async def handler(sif):
                    if not seen:
                        tasks.append(asyncio.create_task(close()))
                    seen.append(sif.opcode)
                    if len(seen) == 2:
                        all_came.set()
                    await asyncio.sleep(0.001)

                client.on_sif(None, handler)
                far.write(wire_bytes(sifs(range(40))))
                await asyncio.wait_for(all_came.wait(), PATIENCE_S)
                await asyncio.wait_for(tasks[0], PATIENCE_S)
                assert seen == list(range(40))

        asyncio.run(main())
        assert caplog.records == []


class TestDropped:
    def register(self, client):
        """A handler that knows its client does not keep it."""
        client.on_sif(2, lambda _sif: client.echo())

    def test_a_client_warns_and_ends(self):
        near, far = j2a_transports.pair()
        client = j2a.Client(near)
        self.register(client)
        client.on_sif(1, lambda _sif: done.set())
        done = threading.Event()
        far.write(wire_bytes(sifs([1])))
        assert done.wait(PATIENCE_S)
        threads = [*client._engine._link.threads, client._engine.dispatcher]
        gone = weakref.ref(client)
        with pytest.warns(ResourceWarning, match=r"unclosed <j2a\.Client loopback: open>"):
            del client
            # The dispatcher may still be leaving the handler, which knows the client.
            end = time.monotonic() + PATIENCE_S
            while gone() is not None and time.monotonic() < end:
                gc.collect()
        assert gone() is None
        for thread in threads:
            thread.join(PATIENCE_S)
            assert not thread.is_alive()
        with pytest.raises(j2a_transports.LinkLost):
            far.read(PATIENCE_S)

    def test_the_warning_says_how_the_client_was_found(self, monkeypatch):
        near, _far = j2a_transports.pair()
        client = j2a.Client(near)
        abandon = client._engine.abandon

        def end_at_once():
            was_open = abandon()
            client.close()  # as the reading thread does when it sees that the link is gone
            return was_open

        monkeypatch.setattr(client._engine, "abandon", end_at_once)
        with pytest.warns(ResourceWarning, match=r"unclosed <j2a\.Client loopback: open>"):
            client.__del__()

    def test_with_asyncio_too(self):
        async def main():
            near, far = j2a_transports.pair()
            client = j2a.AsyncClient(near)
            self.register(client)
            threads, dispatcher = client._engine._link.threads, client._engine.dispatcher
            with pytest.raises(j2a.CallTimeout):
                await client.call(1, timeout=0.01)
            with pytest.warns(ResourceWarning, match=r"unclosed <j2a\.AsyncClient loopback: open>"):
                del client
                gc.collect()
            await asyncio.wait_for(dispatcher, PATIENCE_S)
            for thread in threads:
                await asyncio.to_thread(thread.join, PATIENCE_S)
                assert not thread.is_alive()
            with pytest.raises(j2a_transports.LinkLost):
                far.read(PATIENCE_S)
                far.read(PATIENCE_S)

        asyncio.run(main())

    def test_one_that_was_closed_or_never_made_does_not_warn(self):
        near, far = j2a_transports.pair()
        with far:
            j2a.Client(near).close()
            with pytest.raises(j2a.LocalError):
                j2a.Client(near, window=0)
            gc.collect()

    def test_one_whose_event_loop_is_closed_ends_without_it(self):
        near, far = j2a_transports.pair()

        async def main():
            return j2a.AsyncClient(near)

        client = asyncio.run(main())
        with pytest.raises(j2a.LocalError, match="another event loop"):
            asyncio.run(client.call(1))
        asyncio.run(client.close())
        for thread in client._engine._link.threads:
            assert not thread.is_alive()
        with pytest.raises(j2a_transports.LinkLost):
            far.read(PATIENCE_S)

    def test_bytes_for_a_closed_event_loop_end_the_threads(self):
        near, far = j2a_transports.pair()

        async def main():
            return j2a.AsyncClient(near)

        client = asyncio.run(main())
        with contextlib.suppress(j2a_transports.LinkLost):
            while True:
                far.write(bytes(1000))
        for thread in client._engine._link.threads[:1]:
            thread.join(PATIENCE_S)
            assert not thread.is_alive()
        asyncio.run(client.close())


def test_the_asyncio_client_needs_nobody_elses_threads_to_close():
    gate = threading.Event()

    async def main(url):
        loop = asyncio.get_running_loop()
        loop.set_default_executor(ThreadPoolExecutor(1))
        client = await j2a.aconnect(url)
        busy = loop.run_in_executor(None, gate.wait, PATIENCE_S)
        await client.close()
        assert not busy.done()
        gate.set()
        await busy

    with served(j2a.Device(), "tcp://127.0.0.1:0") as url:
        asyncio.run(main(url))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
class TestFork:
    def child(self, work):
        """Run something in a forked child; return what it said."""
        reading, writing = os.pipe()
        pid = os.fork()
        if pid == 0:
            text = "nothing"
            try:
                text = work()
            except BaseException as error:
                text = f"{type(error).__name__}: {error}"
            finally:
                os.write(writing, text.encode())
                os._exit(0)
        os.close(writing)
        with os.fdopen(reading, "rb") as pipe:
            said = pipe.read().decode()
        os.waitpid(pid, 0)
        return said

    def test_a_client_says_so_and_goes_on_in_the_parent(self):
        device = DemoDevice()
        with served(device, "tcp://127.0.0.1:0") as url, j2a.connect(url) as client:

            def works():
                errors = []
                for use in (lambda: client.echo(b"x"), lambda: client.on_sif(1, print)):
                    with pytest.raises(j2a.LocalError, match="connect again in the child") as error:
                        use()
                    errors.append(error.value.outcome)
                with client:
                    pass
                client.close()
                client.__del__()
                gc.collect()
                return str(errors[0])

            assert self.child(works) == "Outcome.NOT_SENT"
            assert client.echo(b"still there") == b"still there"

    @pytest.mark.parametrize("url", ["tcp://127.0.0.1:0", "pty:{folder}/board"])
    def test_a_device_that_a_child_stops_goes_on_in_the_parent(self, url, tmp_path):
        device = DemoDevice()
        with served(device, url.format(folder=tmp_path)) as url, j2a.connect(url) as client:
            client.echo(b"x")
            [listener] = device._listeners

            def works():
                signal.setitimer(
                    signal.ITIMER_REAL, PATIENCE_S
                )  # ends a child that waits for threads of its parent
                device.stop()
                listener.close()
                with pytest.raises(j2a.LocalError, match="was stopped"):
                    device.serve(j2a_transports.pair()[0])
                return "stopped"

            assert self.child(works) == "stopped"
            with pytest.raises(BlockingIOError):  # the threads of the parent were not woken
                listener._waker._receiver.recv(1)
            assert client.echo(b"still there") == b"still there"

    def test_a_child_serves_and_stops_a_device_of_before(self):
        device = DemoDevice()

        def works():
            signal.setitimer(signal.ITIMER_REAL, PATIENCE_S)
            near, far = j2a_transports.pair()
            thread = threading.Thread(target=device.serve, args=(near,))
            thread.start()
            with j2a.Client(far) as client:
                told = client.echo(b"by the child").decode()
                device.stop()
                thread.join()
            return told

        assert self.child(works) == "by the child"

    def test_what_is_iterated_says_so_too(self):
        with (
            served(DemoDevice(), "tcp://127.0.0.1:0") as url,
            j2a.connect(url) as client,
            j2a.Fleet(url) as fleet,
        ):
            fleet.wait(1, timeout=PATIENCE_S)
            with client.sifs() as sifs, fleet.changes() as changes, fleet.samples() as samples:

                def works():
                    for one in (sifs, changes, samples):
                        with pytest.raises(j2a.LocalError, match="connect again there"):
                            next(one)
                        with pytest.raises(j2a.LocalError, match="connect again there"):
                            one.wait(0.1)
                    return "refused"

                assert self.child(works) == "refused"

    def test_in_whatever_state_the_parent_is(self):
        """Locks that another thread held at the fork stay locked in the child."""
        with Wire() as wire:
            call = Background(wire.client.call, 1)
            request = wire.request()
            engine = wire.client._engine
            with engine._turn, engine._state, engine._link._changed:

                def works():
                    with pytest.raises(j2a.LocalError), wire.client:
                        wire.client.call(1)
                    return "ended"

                assert self.child(works) == "ended"
            wire.send(oracle.Frame(SOF, request.seq, 0, b"done"))
            assert call.result().payload == b"done"

    def test_with_asyncio(self):
        async def main():
            with served(DemoDevice(), "tcp://127.0.0.1:0") as url:
                async with await j2a.aconnect(url) as client:

                    def works():
                        async def use():
                            with pytest.raises(j2a.LocalError, match="in the child"):
                                await client.echo(b"x")
                            await client.close()
                            return "ended"

                        # The child has the parent's loop, which does not run there.
                        asyncio._set_running_loop(None)
                        return asyncio.run(use())

                    assert self.child(works) == "ended"
                    assert await client.echo(b"still there") == b"still there"

        asyncio.run(main())
