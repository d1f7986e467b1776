"""A signal handler may close what its own thread waits for, at whatever line that is."""

import contextlib
import gc
import threading
from functools import partial
from itertools import count

import j2a_transports
import pytest
from j2a_spec.constants import SOF
from j2a_spec.oracle import Frame, encode

import j2a
from j2a.io.bell import Bell, Flag
from j2a.io.handlers import Handlers
from j2a.io.host_time import HostTime
from j2a.io.streams import SifStream
from j2a.recording import Recorder, Recording
from j2a.replay import ReplayBoard
from j2a.syncd import daemon as daemon_module
from j2a.syncd.daemon import Daemon
from j2a.types.transds_file import read_transds

SIF = j2a.Sif(1, b"", 0, 0)


@pytest.fixture
def client():
    """A function that connects a client over TCP, whose caller may read itself, or in memory."""
    with contextlib.ExitStack() as stack, j2a_transports.listen("tcp://127.0.0.1:0") as listener:
        device = stack.enter_context(j2a.Device())
        threading.Thread(target=device.serve_forever, args=(listener,), daemon=True).start()
        stack.callback(device.stop)
        yield lambda: stack.enter_context(j2a.connect(listener.url))


def stream_of(sifs):
    """A stream that holds so many SIFs, and its handlers."""
    handlers = Handlers()
    stream = SifStream(
        handlers, None, lambda: 0.0, max_waiting=9, dispatcher=None, slice_s=threading.TIMEOUT_MAX
    )
    for _ in range(sifs):
        deliver(handlers)
    return handlers, stream


def deliver(handlers):
    for one in handlers.matching(1):
        one(SIF)


@pytest.mark.parametrize("sifs", [0, 1, 3])
@pytest.mark.parametrize("is_of_the_link", [False, True])
def test_a_stream_is_closed(signal_at, sifs, is_of_the_link):
    for line in range(25 + 20 * sifs):
        handlers, stream = stream_of(sifs)
        end = partial(handlers.finish, j2a.LinkClosed("x")) if is_of_the_link else stream.close
        with signal_at(line, end) as was_called:
            assert sum(1 for _ in stream) == sifs
        assert was_called()


@pytest.mark.parametrize("sifs", [0, 1, 3])
def test_a_stream_gets_another_sif(signal_at, sifs):
    for line in range(25 + 15 * sifs):
        handlers, stream = stream_of(sifs)
        with signal_at(line, partial(deliver, handlers)) as was_called:
            for _ in range(sifs + 1):
                assert stream.wait(float("inf")) is SIF
        assert was_called()


@pytest.mark.parametrize("first", range(8))
def test_a_client_is_closed_amid_a_wait_for_sifs(signal_at, client, first):
    for line in range(first, 160, 8):
        board = client()
        with signal_at(line, board.close) as was_called, pytest.raises(j2a.LinkClosed):
            board.wait_sif(1, timeout=float("inf"))
        assert was_called()


def test_a_device_is_stopped_amid_its_service(signal_at):
    for line in range(60):
        device = j2a.Device()
        with j2a_transports.listen("tcp://127.0.0.1:0") as listener:
            with signal_at(line, device.stop) as was_called, contextlib.suppress(j2a.LocalError):
                device.serve_forever(listener)
            assert was_called()
            assert not device._listeners


@pytest.mark.parametrize("first", range(8))
def test_a_device_is_stopped_amid_the_service_of_a_host(signal_at, first):
    for line in range(first, 280, 8):
        device = j2a.Device({"name": "x"})
        left, right = j2a_transports.pair()
        with left, signal_at(line, device.stop) as was_called, contextlib.suppress(j2a.LocalError):
            left.write(encode(Frame(SOF, 0, 0, b"")) * 2)
            device.serve(right)
        assert was_called()
        assert right.closed
        assert not device._connections


def test_syncd_is_stopped(signal_at, monkeypatch):
    monkeypatch.setattr(daemon_module, "_LOOK_S", threading.TIMEOUT_MAX)
    for line in range(60):
        daemon = Daemon(interval_s=1.0, ports=None)
        with signal_at(line, daemon.stop) as was_called:
            daemon.run()
        assert was_called()


def test_threads_that_wait_for_one_stream_all_hear_of_its_end():
    handlers, stream = stream_of(0)
    ended = threading.Barrier(4)

    def wait():
        with pytest.raises(j2a.LinkClosed):
            stream.wait(float("inf"))
        ended.wait(60)

    for _ in range(3):
        threading.Thread(target=wait, daemon=True).start()
    handlers.finish(j2a.LinkClosed("x"))
    ended.wait(60)


def test_threads_that_wait_for_one_stream_each_get_a_sif():
    handlers, stream = stream_of(0)
    got = threading.Barrier(4)

    def wait():
        stream.wait(float("inf"))
        got.wait(60)

    for _ in range(3):
        threading.Thread(target=wait, daemon=True).start()
    for _ in range(3):
        deliver(handlers)
    got.wait(60)


def test_a_bell():
    bell = Bell()
    assert not bell.wait(0)
    bell.ring()
    bell.ring()
    assert bell.wait(0)
    assert not bell.wait(0)


def test_a_flag_is_set_for_all():
    flag = Flag()
    assert not flag.wait(0)
    assert not flag.is_set()
    ended = threading.Barrier(4)

    def wait():
        assert flag.wait()
        ended.wait(60)

    for _ in range(3):
        threading.Thread(target=wait, daemon=True).start()
    flag.set()
    flag.set()
    ended.wait(60)
    assert flag.wait(0)
    assert flag.is_set()


def test_a_recording_that_is_played_is_stopped(signal_at, tmp_path):
    path = tmp_path / "a.mcap"
    known = read_transds("SENSOR(quad, 0, quad, X, 1, i16, none)\n")
    with Recorder(path) as recorder:
        recorder.add_board("cart", known)
        recorder.write("cart", j2a.Sample("x:", "quad", 0, (), 0.0, payload=bytes(10)), 1)
    for line in range(40):
        replayed = ReplayBoard(path)
        with signal_at(line, replayed.stop) as was_called:
            replayed.play()
        assert was_called()


@pytest.mark.parametrize("first", range(4))
@pytest.mark.parametrize("asked", ["write", "flush", "close"])
def test_a_recorder_is_asked_amid_a_write(signal_at, tmp_path, asked, first):
    known = read_transds("SENSOR(quad, 0, quad, X, 1, i16, none)\n")
    for line in count(first, 4):
        path = tmp_path / f"{line}.mcap"
        with Recorder(path) as recorder:

            def write(number, recorder=recorder):
                sample = j2a.Sample("x:", "quad", number, (), 0.0, payload=bytes(10))
                recorder.write("cart", sample, number)

            recorder.add_board("cart", known)
            write(1)
            ask = partial(write, 3) if asked == "write" else getattr(recorder, asked)
            with signal_at(line, ask) as was_called, contextlib.suppress(j2a.LocalError):
                write(2)  # unless it is closed before that begins
            if not was_called():  # a write has no more lines
                assert line > 60
                break
            if asked == "close":
                with pytest.raises(j2a.LocalError, match="is closed"):
                    write(4)
        recording = Recording(path)
        found = sorted(one.sequence for one in recording)
        assert recording.is_whole
        assert found == [1, 2, 3][: 3 if asked == "write" else recorder.samples]
        assert len(found) == recorder.samples


def test_streams_that_are_dropped_amid_the_delivery_do_no_harm():
    handlers = Handlers()
    for _ in range(50):
        one = SifStream(handlers, None, lambda: 0.0, max_waiting=9, dispatcher=None, slice_s=1.0)
        one.itself = one  # for the garbage collector
    before = gc.get_threshold()
    gc.set_threshold(1)
    try:
        while handlers._subscriptions:
            deliver(handlers)
            one = None
        handlers.finish(j2a.LinkClosed("x"))
    finally:
        gc.set_threshold(*before)


class _Host:
    """The clocks of a computer, on which each reading takes half a microsecond."""

    def __init__(self):
        self.now_us = 1_000_000.0
        self.shift_us = 10**15
        self.time = HostTime(self.counter_us, lambda: self.shift_us + int(self.counter_us()))

    def counter_us(self):
        self.now_us += 0.5
        return self.now_us

    def unix_us(self):
        return self.time.reference.to_unix(self.time.observe())


@pytest.mark.parametrize("is_first", [False, True])
def test_the_time_of_this_computer_is_asked_amid_itself(signal_at, is_first):
    for line in count():
        host, told = _Host(), []
        if not is_first:
            host.time.observe()
            host.shift_us += 3_600_000_000  # somebody sets the clock
        with signal_at(line, lambda host=host, told=told: told.append(host.unix_us())) as called:
            host.time.observe()
        if not called():  # it has no more lines
            assert line > 20
            break
        assert abs(host.unix_us() - host.shift_us - host.now_us) <= 20
        assert abs(told[0] - host.unix_us()) <= 20 + 3_600_000_000 * (not is_first)
        assert host.time.reference.steps == (not is_first)
