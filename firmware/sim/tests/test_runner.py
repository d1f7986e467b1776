"""The simulator on a listener, as a function and as a command."""

import contextlib
import io
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from argparse import ArgumentParser

import j2a_transports
import pytest
from j2a_sim import FirmwareStopped, Runner, SimError, run
from j2a_sim._command import add_arguments
from j2a_sim._command import run as run_command
from j2a_transports import LinkLost, OpenFailed

pytestmark = pytest.mark.avr

WAIT_S = 60


class Served:
    """run() in a thread."""

    def __init__(self, elf, speed=0.0, **options):
        self.out, self.err = io.StringIO(), io.StringIO()
        self.stop = threading.Event()
        self.error = None

        def target():
            try:
                run(
                    elf,
                    "tcp://127.0.0.1:0",
                    speed,
                    stop=self.stop,
                    out=self.out,
                    err=self.err,
                    **options,
                )
            except (SimError, j2a_transports.TransportError) as error:
                self.error = error

        self.thread = threading.Thread(target=target)
        self.thread.start()
        end = time.monotonic() + WAIT_S
        while "\n" not in self.out.getvalue():
            assert self.thread.is_alive(), self.error
            assert time.monotonic() < end
            time.sleep(0.01)
        self.url = self.out.getvalue().split()[-1]

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.stop.set()
        self.join()

    def join(self):
        self.thread.join(WAIT_S)
        assert not self.thread.is_alive()


def read_all(link, count):
    data = b""
    while len(data) < count:
        more = link.read(WAIT_S)
        assert more, f"{len(data)} of {count} bytes came"
        data += more
    return data


@pytest.mark.parametrize("speed", [0.0, 0.5, 1.0, 8.0])
def test_clients_one_after_the_other(firmware, speed):
    data = bytes(range(256)) * 2
    with Served(firmware("echo"), speed) as served:
        assert served.out.getvalue() == f"listening on {served.url}\n"
        for _ in range(2):
            with j2a_transports.open(served.url) as link:
                link.write(data)
                assert read_all(link, len(data)) == data
    assert served.error is None
    figures = dict(re.findall(r"(\w+)=([\d.]+)", served.err.getvalue()))
    assert (figures["bytes_in"], figures["bytes_out"], figures["overruns"]) == ("1024", "1024", "0")
    assert int(figures["cycles"]) >= 1024 * 1360
    assert float(figures["simulated_s"]) == pytest.approx(int(figures["cycles"]) / 16e6, abs=1e-6)


def test_real_time_is_not_faster_than_the_clock(firmware):
    with Served(firmware("echo"), 1.0) as served, j2a_transports.open(served.url) as link:
        began_s = time.monotonic()
        link.write(bytes(2000))
        read_all(link, 2000)
        # 85 us per byte
        assert time.monotonic() - began_s > 0.16


@pytest.mark.parametrize("speed", [0.0, 1.0])
def test_a_client_that_never_stops_sending(simulate, speed):
    """Time goes on for the firmware, and the client has to wait like at a serial port."""
    sim = simulate("echo", BAUD=1_000_000)
    sim.boot()
    stop = threading.Event()
    with j2a_transports.listen("tcp://127.0.0.1:0") as listener:
        server = threading.Thread(target=Runner(sim, listener, speed=speed).serve, args=[stop])
        server.start()
        link = j2a_transports.open(listener.url)

        def flood():
            while True:
                try:
                    link.write(bytes(4096))
                except j2a_transports.TransportError:
                    return

        writer = threading.Thread(target=flood)
        writer.start()
        try:
            assert not any(read_all(link, 20_000))
            most = sim.counters.queued
        finally:
            stop.set()
            server.join(WAIT_S)
            link.close()
            writer.join(WAIT_S)
        assert not server.is_alive()
        assert not writer.is_alive()
    assert most <= 250  # two slices of a millisecond, and some more


def leave_behind(url, size):
    """Connect, send as much of so many bytes as the system takes, and go."""
    host, _, port = url.removeprefix("tcp://").rpartition(":")
    with socket.create_connection((host, int(port))) as gone:
        gone.setblocking(False)
        rest = memoryview(bytes(size))
        with contextlib.suppress(BlockingIOError):
            while rest:
                rest = rest[gone.send(rest) :]


@pytest.mark.parametrize("size", [1, 300, 2**16, 2**22])
def test_what_a_host_that_is_gone_left_behind_is_dropped(firmware, size):
    with Served(firmware("echo"), 1.0) as served:
        leave_behind(served.url, size)
        with j2a_transports.open(served.url) as link:
            link.write(b"next")
            assert read_all(link, 4) == b"next"
    bytes_in = int(re.search(r"bytes_in=(\d+)", served.err.getvalue())[1])
    assert bytes_in < 4 + 2000


def test_a_second_host_is_refused_at_once_and_told_why(firmware):
    with Served(firmware("echo")) as served, j2a_transports.open(served.url) as first:
        for _ in range(3):
            with (
                j2a_transports.open(served.url) as second,
                pytest.raises(LinkLost, match="may be busy with another host"),
            ):
                second.read(WAIT_S)
        first.write(b"first")
        assert read_all(first, 5) == b"first"
        assert served.err.getvalue().count("refused tcp://127.0.0.1:") == 3
        first.close()
        with j2a_transports.open(served.url) as third:
            third.write(b"third")
            assert read_all(third, 5) == b"third"


def test_a_host_that_is_far_behind_gives_way(firmware):
    with Served(firmware("echo"), 1.0) as served, j2a_transports.open(served.url) as first:
        with pytest.raises(j2a_transports.WriteTimeout):
            first.write_timeout_s = 0.5
            while True:
                first.write(bytes(2**16))
        with j2a_transports.open(served.url) as second:
            second.write(b"x")
            assert read_all(second, 1) == b"x"
        assert "another came" in served.err.getvalue()


def test_a_host_that_does_not_read_holds_up_no_end(simulate):
    class Stuck(j2a_transports.Transport):
        closed = False

        def __init__(self):
            super().__init__("stuck:", None)
            self.ended = threading.Event()

        def read(self, timeout_s):
            return b"x"

        def write(self, data):
            assert self.ended.wait(WAIT_S)
            raise j2a_transports.LinkClosed("stuck: is closed")

        def close(self):
            self.ended.set()

    class One(j2a_transports.Listener):
        given = False

        def accept(self, timeout_s):
            was, self.given = self.given, True
            return None if was else Stuck()

        def close(self):
            pass

    sim = simulate("echo")
    sim.boot()
    stop = threading.Event()
    timer = threading.Timer(0.3, stop.set)
    timer.start()
    Runner(sim, One("one:")).serve(stop)
    timer.join()


def test_a_pause_of_the_client_is_no_longer_for_the_firmware(firmware):
    """At speed 0 only the traffic is fast."""
    with Served(firmware("echo"), 0.0) as served:
        began_s = time.monotonic()
        with j2a_transports.open(served.url) as link:
            for byte in b"pause":
                link.write(bytes([byte]))
                assert link.read(WAIT_S) == bytes([byte])
                time.sleep(0.05)
        served.stop.set()
        served.join()
        wall_s = time.monotonic() - began_s
    simulated = re.search(r"simulated_s=([\d.]+)", served.err.getvalue())
    # The start, and what passes at full speed around each byte, come on top.
    assert float(simulated[1]) < wall_s + 0.2


def test_once_ends_with_the_client(firmware):
    served = Served(firmware("echo"), once=True)
    with j2a_transports.open(served.url) as link:
        link.write(b"x")
        assert link.read(WAIT_S) == b"x"
    served.join()
    assert served.error is None
    assert "bytes_in=1 " in served.err.getvalue()


def test_reset_for_each_client(firmware):
    with Served(firmware("stop"), reset=True) as served:
        for _ in range(2):
            with j2a_transports.open(served.url) as link:
                assert link.read(WAIT_S) == b"0"


def test_without_reset_the_firmware_goes_on(firmware):
    with Served(firmware("stop")) as served:
        # Between two clients time passes, so that the first byte is gone.
        j2a_transports.open(served.url).close()
        with j2a_transports.open(served.url) as link:
            assert link.read(0.2) == b""


def test_a_stopped_firmware_ends_the_run(firmware):
    served = Served(firmware("stop"))
    with j2a_transports.open(served.url) as link:
        link.write(b"i")
        with pytest.raises(LinkLost):
            while True:
                assert link.read(WAIT_S)
    served.join()
    assert isinstance(served.error, FirmwareStopped)
    assert "cycles=" in served.err.getvalue()


def test_a_place_that_is_taken(firmware):
    with Served(firmware("echo")) as served, pytest.raises(OpenFailed):
        run(firmware("echo"), served.url)


def test_a_wrong_speed_is_refused(simulate):
    sim = simulate("echo")
    with j2a_transports.listen("tcp://127.0.0.1:0") as listener:
        for speed in (-1.0, float("inf"), float("nan")):
            with pytest.raises(SimError, match="speed"):
                Runner(sim, listener, speed=speed)


def command(*arguments, **options):
    return subprocess.Popen(
        [sys.executable, "-m", "j2a_sim", "avr", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        **options,
    )


@pytest.fixture
def heeds_sighup():
    """Nothing has SIGHUP ignored, as nohup does."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
@pytest.mark.usefixtures("heeds_sighup")
def test_command_ends_cleanly_by_signal(firmware, number):
    with command(firmware("echo"), "--listen", "tcp://127.0.0.1:0", "--speed", "0") as process:
        line = process.stdout.readline().decode()
        url = re.fullmatch(r"listening on (tcp://127\.0\.0\.1:\d+)\n", line)[1]
        with j2a_transports.open(url) as link:
            link.write(b"hello")
            assert read_all(link, 5) == b"hello"
        process.send_signal(number)
        out, err = process.communicate(timeout=WAIT_S)
    assert process.returncode == 128 + number
    assert out == b""
    assert re.fullmatch(rb"figures of the run: cycles=\d+ .*bytes_in=5 bytes_out=5 .*\n", err)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize("hosts", [0, 1])
def test_a_slow_simulation_ends_at_once(firmware, number, hosts):
    """Simulated time is ahead by some milliseconds, which at this speed are minutes."""
    with command(firmware("echo"), "--speed", "0.00001") as process:
        url = process.stdout.readline().decode().split()[-1]
        with contextlib.ExitStack() as stack:
            for _ in range(hosts):
                stack.enter_context(j2a_transports.open(url)).write(b"hello")
            process.send_signal(number)
            process.communicate(timeout=WAIT_S)
    assert process.returncode == 128 + number


def test_command_ends_quietly_when_the_reader_of_its_output_goes_away(firmware):
    reader, writer = os.pipe()
    os.close(reader)
    words = [sys.executable, "-m", "j2a_sim", "avr", str(firmware("echo"))]
    result = subprocess.run(
        [*words, "--listen", "tcp://127.0.0.1:0"],
        stdout=writer,
        stderr=subprocess.PIPE,
        text=True,
        timeout=WAIT_S,
        check=False,
    )
    os.close(writer)
    assert (result.returncode, result.stderr) == (141, "")


def test_command_on_standard_streams(firmware):
    options = ["--listen", "stdio:", "--speed", "0", "--once"]
    with command(firmware("echo"), *options, stdin=subprocess.PIPE) as process:
        process.stdin.write(b"through a pipe")
        process.stdin.flush()
        assert process.stdout.read(14) == b"through a pipe"
        out, err = process.communicate(timeout=WAIT_S)
    assert process.returncode == 0
    assert out == b""
    assert err.startswith(b"listening on stdio:")


def test_command_explains_failures(tmp_path):
    with command(tmp_path / "none.elf") as process:
        out, err = process.communicate(timeout=WAIT_S)
    assert process.returncode == 2
    assert out == b""
    assert err.decode().startswith("j2a sim: cannot read ")
    assert err.count(b"\n") == 1


def test_command_options_reach_the_simulator(firmware, capsys):
    parser = ArgumentParser()
    add_arguments(parser)
    elf = str(firmware("echo"))
    for options, text in [
        (["--mcu", "atmega9"], "does not know this MCU"),
        (["--uart", "1"], "no such UART"),
        (["--baud", "9e9"], "host_baud"),
        (["--listen", "nowhere:"], "unknown scheme"),
    ]:
        assert run_command(parser.parse_args(["avr", elf, *options])) == 2
        assert text in capsys.readouterr().err
    for wrong, text in [
        (["--speed", "-1"], "argument --speed: '-1' is not 0 for as fast as possible, or a number"),
        (["--freq", "0"], "argument --freq: '0' is not a clock in Hz from 1 to 100000000"),
        (["--baud", "fast"], "argument --baud: 'fast' is not a number above 0"),
        (["--uart", "7"], "argument --uart: invalid choice: '7'"),
    ]:
        with pytest.raises(SystemExit) as stopped:
            parser.parse_args(["avr", elf, *wrong])
        assert stopped.value.code == 2
        assert text in capsys.readouterr().err


def test_command_fails_like_the_other_commands(firmware, capsys):
    parser = ArgumentParser()
    add_arguments(parser)
    with j2a_transports.listen("tcp://127.0.0.1:0") as taken:
        place = ["--listen", taken.url]
        assert run_command(parser.parse_args(["avr", str(firmware("echo")), *place])) == 3
    assert "another program listens there" in capsys.readouterr().err


def test_command_whose_firmware_stops(firmware):
    options = ["--listen", "stdio:", "--speed", "0"]
    with command(firmware("stop"), *options, stdin=subprocess.PIPE) as process:
        out, err = process.communicate(b"i", timeout=WAIT_S)
    assert process.returncode == 3
    assert out == b"0"
    assert b"j2a sim: the firmware stopped: illegal instruction" in err
