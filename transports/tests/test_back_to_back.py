"""Every transport of this package in the shared suite."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import j2a_transports
import pytest
import usb.core
from j2a_transports import Listener, Transport, faults
from j2a_transports._process import Child, threaded

from .fake_libusb import give_libusb
from .fake_usb import board
from .fake_usb_backend import FakeBackend
from .suite import PATIENCE_S, BackToBack

RELAY = [sys.executable, str(Path(__file__).with_name("relay.py"))]
PLAIN_RELAY = [sys.executable, "-S", "-E", str(Path(__file__).with_name("plain_relay.py"))]


def accepted(listener: Listener) -> Transport:
    transport = listener.accept(PATIENCE_S)
    assert transport is not None
    return transport


@contextmanager
def through_listener(
    listen_url: str, open_url: str = "{}"
) -> Iterator[tuple[Transport, Transport]]:
    with j2a_transports.listen(listen_url) as listener:
        near = j2a_transports.open(open_url.format(listener.url))
        yield near, accepted(listener)


@contextmanager
def through_relay(
    start: Callable[[list[str]], Transport], relay: Sequence[str] = RELAY
) -> Iterator[tuple[Transport, Transport]]:
    with j2a_transports.listen("tcp://127.0.0.1:0") as listener:
        near = start([*relay, listener.url.rpartition(":")[2]])
        yield near, accepted(listener)


class TestPair(BackToBack):
    @contextmanager
    def connect(self) -> Iterator[tuple[Transport, Transport]]:
        yield j2a_transports.pair()


class TestLoopback(BackToBack):
    def connect(self):
        return through_listener("loopback:suite")


class TestTcp(BackToBack):
    def connect(self):
        return through_listener("tcp://127.0.0.1:0")


class TestTcpBySelect(TestTcp):
    """The way of systems without poll()."""

    @pytest.fixture(autouse=True)
    def no_poll(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.delattr("select.poll", raising=False)


class TestExec(BackToBack):
    has_exit_code = True

    def connect(self):
        return through_relay(lambda command: j2a_transports.open(f"exec:{' '.join(command)}"))


class TestExecByThreads(BackToBack):
    """The way that Windows needs, run here too."""

    def connect(self):
        def start(command: list[str]) -> Transport:
            child = Child("exec:relay", command, None, subprocess.PIPE, subprocess.PIPE)
            return threaded("exec:relay", child, 5.0)

        return through_relay(start, PLAIN_RELAY)


@pytest.mark.skipif(sys.platform == "win32", reason="no pseudo terminals")
class TestPtyChild(BackToBack):
    has_exit_code = True
    # The kernel empties a terminal whose master is closed.
    discards = frozenset({"near"})

    def connect(self):
        return through_relay(
            lambda command: j2a_transports.open(f"pty:{' '.join(command)}"), PLAIN_RELAY
        )


@pytest.mark.skipif(sys.platform == "win32", reason="no pseudo terminals")
class TestSerialOnPty(BackToBack):
    # The same: the far end is the master.
    discards = frozenset({"far"})

    @contextmanager
    def connect(self) -> Iterator[tuple[Transport, Transport]]:
        with j2a_transports.listen("pty:") as self.listener:
            near = j2a_transports.open(self.listener.url)
            yield near, accepted(self.listener)

    def hang_up(self, end: str, transport: Transport) -> None:
        transport.close()
        if end == "far":
            self.listener.close()


@pytest.mark.skipif(sys.platform == "win32", reason="no pseudo terminals")
class TestSerialByThreads(TestSerialOnPty):
    """The way of ports that cannot be polled, such as those of Windows and of `spy://`."""

    @pytest.fixture(autouse=True)
    def nothing_is_pollable(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr("j2a_transports._serial.POLLABLE", ())
        # Closing waits for the end of a slice.
        monkeypatch.setattr("j2a_transports._serial.SLICE_S", 0.01)


class TestUsb(BackToBack):
    """The way of backends other than libusb: one transfer after the other."""

    # What the host has not read yet leaves with the board; and only that is a hang-up, because a
    # board does not notice that a program closes the link.
    discards = frozenset({"far"})

    @pytest.fixture(autouse=True)
    def short_slices(self, monkeypatch: pytest.MonkeyPatch) -> None:
        # Closing waits for the end of one.
        monkeypatch.setattr("j2a_transports._usb.pipes.SLICE_MS", 10)

    @contextmanager
    def connect(self) -> Iterator[tuple[Transport, Transport]]:
        self.board = board()
        (device,) = usb.core.find(find_all=True, backend=FakeBackend(self.board))
        yield j2a_transports.open_usb_device(device), self.board.end()

    def hang_up(self, end: str, transport: Transport) -> None:
        self.board.unplug()


class TestUsbByInterruptEndpoints(TestUsb):
    """As the firmware of 2014 declared them, and with larger packets."""

    @contextmanager
    def connect(self) -> Iterator[tuple[Transport, Transport]]:
        self.board = board(kind=3, packet=512)
        (device,) = usb.core.find(find_all=True, backend=FakeBackend(self.board))
        yield j2a_transports.open_usb_device(device), self.board.end()


class TestUsbByTransfersAtOnce(TestUsb):
    """The way of libusb, here with functions that stand for it."""

    @pytest.fixture(autouse=True)
    def libusb(self, monkeypatch: pytest.MonkeyPatch) -> None:
        give_libusb(monkeypatch)


class TestFaultsWithoutFaults(BackToBack):
    def connect(self):
        return through_listener("faults::tcp://127.0.0.1:0", "faults:seed=1:{}")


class TestFaultsThatLoseNothing(BackToBack):
    """Cuts and short delays change no byte."""

    @contextmanager
    def connect(self) -> Iterator[tuple[Transport, Transport]]:
        near, far = j2a_transports.pair()
        yield faults.wrap(near, seed=7, split=0.001, delay=0.0001, delay_ms=1), far
