"""Systems that have no thread to give, and functions that end the thread they run in."""

import asyncio
import threading

import j2a_transports
import pytest

import j2a
from j2a.io.threads import LinkThreads
from j2a.types.transds_file import read_transds

from .support import PATIENCE_S, linked, served
from .wire import Background, Watched


@pytest.fixture
def scarce(monkeypatch):
    """A function that lets the system give so many threads to the library, and no more."""

    def limit(number):
        start, started = threading.Thread.start, []

        def refuse(thread):
            if thread.name.startswith("j2a ") and not thread.name.startswith("j2a device"):
                if len(started) == number:
                    raise RuntimeError("can't start new thread")
                started.append(thread)
            start(thread)

        monkeypatch.setattr(threading.Thread, "start", refuse)
        return started

    return limit


@pytest.mark.parametrize("number", range(3))
class TestTooManyThreads:
    def test_for_a_client(self, scarce, number):
        with served(j2a.Device()) as url:
            j2a.connect(url, boot_time=PATIENCE_S).close()
            started = scarce(number)
            with pytest.raises(j2a.OpenFailed, match="can't start new thread") as failed:
                j2a.connect(url)
            assert failed.value.outcome is j2a.Outcome.NOT_SENT
            started.clear()
            with j2a_transports.open(url) as transport:
                with pytest.raises(j2a.OpenFailed):
                    j2a.Client(transport)
                with pytest.raises(j2a_transports.LinkClosed):
                    transport.read(0)
            for thread in started:
                thread.join(PATIENCE_S)
                assert not thread.is_alive()

    def test_for_an_asyncio_client(self, scarce, number):
        async def main():
            with pytest.raises(j2a.OpenFailed, match="can't start new thread"):
                await j2a.aconnect(url)
            for thread in started:
                await asyncio.to_thread(thread.join, PATIENCE_S)
                assert not thread.is_alive()
            others = asyncio.all_tasks() - {asyncio.current_task()}
            if others:
                await asyncio.wait(others, timeout=PATIENCE_S)
            assert all(task.done() for task in others)

        with served(j2a.Device()) as url:
            j2a.connect(url, boot_time=PATIENCE_S).close()
            started = scarce(number)
            asyncio.run(main())


def test_without_a_thread_for_it_a_sif_comes_with_the_next_reply(scarce):
    device = j2a.Device()
    with linked(device) as client:
        seen = []
        client.on_sif(None, lambda sif: seen.append(sif.opcode))
        scarce(0)
        assert device.send_sif(7) == 1
        client.echo()
        client.close()
        assert seen == [7]


class TestWithoutAThreadForTransducers:
    @pytest.fixture
    def refuses(self, monkeypatch):
        """The system has no such thread to give as long as this event is set."""
        start, scarce = threading.Thread.start, threading.Event()

        def refuse(thread):
            if thread.name == "j2a transducers" and scarce.is_set():
                raise RuntimeError("can't start new thread")
            start(thread)

        scarce.set()
        monkeypatch.setattr(threading.Thread, "start", refuse)
        return scarce

    @pytest.fixture
    def device(self):
        with j2a.Device(
            transducers=read_transds("SENSOR(level, 0, level, X, 2, u8, none)")
        ) as made:
            yield made

    def test_a_host_is_refused_and_the_next_one_served(self, refuses, device, caplog):
        with served(device) as url:
            with j2a_transports.open(url) as transport, pytest.raises(j2a_transports.LinkLost):
                transport.read(PATIENCE_S)
            assert not device._connections
            refuses.clear()
            with j2a.connect(url, timeout=PATIENCE_S, boot_time=PATIENCE_S) as board:
                samples = board.transducers["level"].samples()
                device.sense("level", 0, 7)  # one channel of two, which that thread sends
                assert samples.wait(PATIENCE_S).values[0] == 7
        assert "can't start new thread" in caplog.text

    def test_a_single_host_is_given_back(self, refuses, device):
        near, far = j2a_transports.pair()
        with near, pytest.raises(j2a.OpenFailed, match="can't start new thread"):
            device.serve(far)
        assert far.closed
        assert not device._connections


def test_who_waits_for_the_reading_thread_goes_on_when_it_ends(monkeypatch):
    class Dead(j2a_transports.Transport):
        """A transport that is lost when somebody waits for its reader."""

        closed = False

        def read(self, timeout_s):
            assert changed.is_waited_for.wait(PATIENCE_S)
            raise j2a_transports.LinkLost("gone")

        def wake_reader(self):
            return True

        def write(self, data):
            pass

        def close(self):
            pass

    monkeypatch.setattr("j2a.io.threads._PATIENCE_S", 3 * PATIENCE_S)
    changed = Watched()
    link = LinkThreads(Dead("dead:"), lambda _: None, lambda _: None, lambda _: None)
    link._changed = changed
    look = Background(link.wait_for_look)
    assert changed.is_waited_for.wait(PATIENCE_S)
    link.start()
    look.result()
    link.stop()
    for thread in link.threads:
        thread.join(PATIENCE_S)
        assert not thread.is_alive()


@pytest.mark.requirement("J2A-DISP-003")
@pytest.mark.parametrize("kind", ["function", "many"])
@pytest.mark.parametrize("error", [SystemExit, KeyboardInterrupt, asyncio.CancelledError])
class TestFunctionsThatEndTheirThread:
    def device(self, kind, error):
        def end(_request):
            raise error

        device = j2a.Device()
        getattr(device, kind)("end")(end)
        return device

    def test_have_failed(self, kind, error):
        with linked(self.device(kind, error)) as client:
            if kind == "many":
                with pytest.raises(j2a.FunctionFailed):
                    client.read_many("end")
            else:
                assert client.call("end") == (0xFF, b"")
            assert client.echo(b"still there") == b"still there"

    def test_end_the_program_in_its_main_thread(self, kind, error):
        device = self.device(kind, error)
        opcode = device.functions["end"]
        payload = bytes((opcode, 0, 0, 0, 0, 0)) if kind == "many" else b""
        asked = 1 if kind == "many" else opcode
        assert threading.current_thread() is threading.main_thread()
        with pytest.raises(error):
            device._execute(asked, payload)
