"""Serial ports: pyserial's URLs, options, faults; pseudo terminals stand for real ports."""

from __future__ import annotations

import errno
import os
import socket
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import j2a_transports
import pytest
import serial
import serial.rfc2217
from j2a_transports import (
    BadUrl,
    LinkClosed,
    LinkLost,
    Listener,
    OpenFailed,
    Transport,
    WriteTimeout,
    _serial,
)
from j2a_transports._loopback import LIMIT
from j2a_transports._poll import Waker
from j2a_transports._threaded import ThreadedTransport

from .suite import PATIENCE_S, Background, fill, read_exactly, read_to_end

if sys.platform != "win32":
    import termios

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no pseudo terminals")

ALL = bytes(range(256))


@pytest.fixture
def terminal() -> Iterator[Listener]:
    with j2a_transports.listen("pty:") as listener:
        yield listener


def accepted(listener: Listener) -> Transport:
    transport = listener.accept(PATIENCE_S)
    assert transport is not None
    return transport


def test_pyserials_loop() -> None:
    with j2a_transports.open("serial:loop://?baud=9600&parity=E&stopbits=2&dtr=0&rts=1") as port:
        port.write(ALL)
        assert read_exactly(port, 256) == ALL
        assert port.read(0.05) == b""
    with pytest.raises(LinkClosed):
        port.read(0)


def test_closing_a_full_loop_ends() -> None:
    port = j2a_transports.open("serial:loop://", write_timeout=0.5)
    with pytest.raises((WriteTimeout, LinkLost)):
        fill(port)
    port.close()


def test_closing_ends_also_where_a_write_waits_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("j2a_transports._threaded.SINK_END_S", 0.1)
    port = j2a_transports.open("serial:loop://", write_timeout=None)
    writing = Background(lambda: port.write(bytes(1 << 20)))
    while len(port._incoming._data) < LIMIT:
        time.sleep(0.01)
    closing = Background(port.close)
    assert closing.result() is None
    with pytest.raises(LinkClosed):
        writing.result()


@pytest.mark.parametrize("started", range(2))
def test_without_a_thread_a_port_is_given_back(
    monkeypatch: pytest.MonkeyPatch, started: int
) -> None:
    start, closed, threads = threading.Thread.start, [], []

    def refuse(thread: threading.Thread) -> None:
        if len(threads) == started:
            raise RuntimeError("can't start new thread")
        threads.append(thread)
        start(thread)

    monkeypatch.setattr("threading.Thread.start", refuse)
    monkeypatch.setattr("j2a_transports._serial._close", closed.append)
    with pytest.raises(OpenFailed, match="can't start new thread"):
        j2a_transports.open("serial:loop://")
    assert len(closed) == 1
    assert not any(thread.is_alive() for thread in threads)


@pytest.mark.skipif(sys.platform == "win32", reason="no pseudo terminals")
def test_without_a_file_a_port_is_given_back(
    terminal: Listener, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(_: Waker) -> None:
        raise OSError(errno.EMFILE, "Too many open files")

    before = len([*Path("/dev/fd").iterdir()])
    with monkeypatch.context() as patched:
        patched.setattr("j2a_transports._poll.Waker.__init__", refuse)
        with pytest.raises(OpenFailed, match="Too many open files") as failed:
            j2a_transports.open(terminal.url)
    assert failed.value.__cause__ is None  # nor keeps a frame of the traceback the port
    assert len([*Path("/dev/fd").iterdir()]) == before


def test_closing_a_stuck_port_ends_its_threads(
    terminal: Listener, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Although pyserial would wait much longer for its own timeout."""
    monkeypatch.setattr("j2a_transports._serial.POLLABLE", ())
    port = j2a_transports.open(terminal.url, write_timeout=PATIENCE_S)
    with accepted(terminal):
        port.write_timeout_s = 0.1
        with pytest.raises(WriteTimeout):
            fill(port)
        port.close()
        assert isinstance(port, ThreadedTransport)
        assert not any(thread.is_alive() for thread in port._threads)


@pytest.mark.filterwarnings("ignore:.*FileIO.*:pytest.PytestUnraisableExceptionWarning")
def test_pyserials_spy_gets_its_own_parameter(terminal: Listener, tmp_path: Path) -> None:
    log = tmp_path / "log"
    device = terminal.url.removeprefix("serial://")
    url = f"serial:spy://{device}?file={log}&baud=9600"
    with j2a_transports.open(url) as port, accepted(terminal) as far:
        port.write(b"hello")
        assert read_exactly(far, 5) == b"hello"
    assert "hello" in log.read_text()


def test_pyserials_socket() -> None:
    with j2a_transports.listen("tcp://127.0.0.1:0") as listener:
        url = listener.url.replace("tcp:", "serial:socket:")
        with j2a_transports.open(url) as port, accepted(listener) as far:
            port.write(ALL)
            assert read_exactly(far, 256) == ALL
            far.write(ALL)
            far.close()
            assert read_to_end(port) == ALL


class Rfc2217Server:
    """A network serial server whose port sends back what it gets."""

    def __init__(self) -> None:
        # A pseudo terminal has no modem lines, which the server must report; pyserial's loop has.
        self.port = serial.serial_for_url("loop://", timeout=0.02)
        self.listening = socket.create_server(("127.0.0.1", 0))
        self.url = f"serial:rfc2217://127.0.0.1:{self.listening.getsockname()[1]}"
        self.ended = threading.Event()
        self.connection: socket.socket | None = None

    def write(self, data: bytes) -> None:
        assert self.connection is not None
        self.connection.sendall(data)

    def run(self) -> None:
        self.connection, _ = self.listening.accept()
        with self.listening, self.connection, self.port:
            manager = serial.rfc2217.PortManager(self.port, self)
            reader = Background(lambda: self.from_port(manager))
            while data := self.connection.recv(1024):
                self.port.write(b"".join(manager.filter(data)))
            self.ended.set()
            reader.result()

    def from_port(self, manager: serial.rfc2217.PortManager) -> None:
        while not self.ended.is_set():
            if data := self.port.read(256):
                self.write(b"".join(manager.escape(data)))


@pytest.mark.filterwarnings("ignore:set(Daemon|Name):DeprecationWarning")
def test_pyserials_rfc2217() -> None:
    server = Rfc2217Server()
    running = Background(server.run)
    with j2a_transports.open(server.url, baud=57600) as port:
        assert server.port.baudrate == 57600
        port.write(ALL)
        assert read_exactly(port, 256) == ALL
    running.result()


@pytest.mark.parametrize("options", ["", "?dtr=0", "?dtr=1&rts=0", "?rts=1", "?exclusive=0"])
def test_a_terminal_without_control_lines_opens_all_the_same(
    terminal: Listener, options: str
) -> None:
    with j2a_transports.open(terminal.url + options) as port, accepted(terminal) as far:
        port.write(ALL)
        assert read_exactly(far, 256) == ALL


def test_options_reach_pyserial(terminal: Listener) -> None:
    url = f"{terminal.url}?baud=9600&bits=7&stopbits=1.5&xonxoff=1&rtscts=1&dtr=0&rts=0"
    settings = recorded_settings(url)
    assert settings["baudrate"] == 9600
    assert settings["bytesize"] == 7
    assert settings["stopbits"] == 1.5
    assert settings["xonxoff"] is True
    assert settings["rtscts"] is True
    assert settings["dtr"] is False
    assert settings["rts"] is False


def test_defaults_are_115200_8n1(terminal: Listener) -> None:
    settings = recorded_settings(terminal.url)
    assert [settings[name] for name in ("baudrate", "bytesize", "parity", "stopbits")] == [
        115200,
        8,
        "N",
        1,
    ]
    assert settings["xonxoff"] is settings["rtscts"] is False
    assert settings["exclusive"] is True


def recorded_settings(url: str) -> dict[str, object]:
    """Return what the port had when it was opened; pseudo terminals take only part of it."""
    settings: dict[str, object] = {}

    class Recorder(serial.Serial):
        def open(self) -> None:
            settings.update(self.get_settings(), dtr=self.dtr, rts=self.rts)
            settings["exclusive"] = self.exclusive
            raise serial.SerialException("recorded")

    def serial_for_url(url: str, *, do_not_open: bool, **options: object) -> serial.Serial:
        assert do_not_open
        port = Recorder(None, **options)
        port.port = url
        return port

    with pytest.MonkeyPatch.context() as patch, pytest.raises(OpenFailed, match="recorded"):
        patch.setattr(serial, "serial_for_url", serial_for_url)
        j2a_transports.open(url)
    return settings


def test_boot_discards_what_the_board_says_first(terminal: Listener) -> None:
    def board() -> Transport:
        far = accepted(terminal)
        far.write(b"bootloader 1.0\r\n")
        return far

    booting = Background(board)
    start = time.monotonic()
    with j2a_transports.open(terminal.url, boot=1.5) as port, booting.result() as far:
        assert time.monotonic() - start >= 1.4
        assert port.read(0.05) == b""
        far.write(b"ready")
        assert read_exactly(port, 5) == b"ready"


def test_a_board_that_goes_away_while_booting(
    terminal: Listener, monkeypatch: pytest.MonkeyPatch
) -> None:
    discard, is_set_up = _serial._discard, threading.Event()

    def discarding(transport: Transport, duration_s: float) -> None:
        is_set_up.set()
        discard(transport, duration_s)

    def board() -> None:
        far = accepted(terminal)
        assert is_set_up.wait(PATIENCE_S)
        far.close()
        terminal.close()

    monkeypatch.setattr(_serial, "_discard", discarding)
    booting = Background(board)
    with pytest.raises(OpenFailed, match="went away while the board started"):
        j2a_transports.open(terminal.url, boot=60)
    booting.result()


def test_unplugging_is_a_lost_link(terminal: Listener) -> None:
    with j2a_transports.open(terminal.url) as port:
        far = accepted(terminal)
        far.write(b"x")
        assert port.read(PATIENCE_S) == b"x"
        far.close()
        terminal.close()
        with pytest.raises(LinkLost, match="unplugged"):
            port.read(PATIENCE_S)
        with pytest.raises(LinkLost, match="unplugged"):
            port.write(b"x")


def test_a_port_is_not_shared_unless_asked(terminal: Listener) -> None:
    with j2a_transports.open(terminal.url):
        with pytest.raises(OpenFailed, match="busy; close the other program"):
            j2a_transports.open(terminal.url)
        j2a_transports.open(f"{terminal.url}?exclusive=0").close()


def test_a_missing_port_says_where_to_look() -> None:
    with pytest.raises(OpenFailed, match=r"no such device; is it plugged in\? `j2a list`"):
        j2a_transports.open("serial:///dev/ttyNoSuchPort")


def test_what_is_no_port_says_so(tmp_path: Path) -> None:
    with pytest.raises(OpenFailed, match="is it a serial port"):
        j2a_transports.open(f"serial://{os.devnull}")
    with pytest.raises(OpenFailed, match=r": it is a folder; `j2a list`"):
        j2a_transports.open(f"serial://{tmp_path}")


@pytest.mark.parametrize(
    ("number", "says"),
    [
        (errno.EACCES, "usermod -aG dialout"),
        (errno.EPERM, "usermod -aG dialout"),
        (errno.EBUSY, "close the other program"),
        (errno.ENODEV, "is it plugged in"),
    ],
)
def test_errors_of_the_system_say_what_to_do(
    monkeypatch: pytest.MonkeyPatch, number: int, says: str
) -> None:
    # Root may open everything, so the system's answer is made up.
    def refuse(*_: object) -> int:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr("serial.serialposix.os.open", refuse)
    with pytest.raises(OpenFailed, match=says):
        j2a_transports.open("serial:///dev/ttyS99")


def test_a_setting_that_the_device_refuses(
    monkeypatch: pytest.MonkeyPatch, terminal: Listener
) -> None:
    def refuse(*_: object) -> None:
        raise termios.error(errno.EINVAL, "Invalid argument")

    monkeypatch.setattr("serial.serialposix.termios.tcsetattr", refuse)
    with pytest.raises(OpenFailed, match="can the device do these settings"):
        j2a_transports.open(terminal.url)


def test_listening_at_a_port_serves_one_peer_after_the_other(terminal: Listener) -> None:
    with j2a_transports.listen(f"{terminal.url}?baud=9600") as listener:
        peer = accepted(terminal)
        for word in (b"one", b"two"):
            with accepted(listener) as device:
                assert listener.accept(0) is None
                peer.write(word)
                assert read_exactly(device, 3) == word
    with pytest.raises(LinkClosed):
        listener.accept(0)
    assert read_to_end(peer) == b""
    peer.close()


def test_listening_at_a_missing_port_fails_at_once() -> None:
    with pytest.raises(OpenFailed, match="no such device"):
        j2a_transports.listen("serial:///dev/ttyNoSuchPort")
    with pytest.raises(BadUrl, match="unknown option"):
        j2a_transports.listen("serial:///dev/ttyNoSuchPort?speed=1")


@pytest.mark.parametrize(
    ("name", "options", "us"),
    [
        ("/dev/ttyUSB0", {}, 10e6 / 115200),
        ("/dev/ttyS3", {"baud": 9600, "parity": "E", "stopbits": 2}, 12e6 / 9600),
        ("/dev/ttyACM0", {}, 0.0),  # a number that the USB does not go by
        ("/dev/pts/5", {}, 0.0),
        ("socket://host:5000", {}, 0.0),
        ("COM3", {}, 0.0),
    ],
)
def test_bytes_of_a_uart_take_their_time(name: str, options: dict[str, object], us: float) -> None:
    given = {"baud": 115200, "bits": 8, "parity": "N", "stopbits": 1} | options
    assert _serial._byte_time_s(name, given) * 1e6 == pytest.approx(us)
