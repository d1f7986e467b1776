"""Boards that come and go."""

from __future__ import annotations

import errno
import gc
import socket
import sys
from collections.abc import Callable, Iterator
from typing import Any

import j2a_transports
import pytest
from j2a_transports import LinkClosed, OpenFailed, UsbArrived, UsbLeft, UsbWatch
from j2a_transports._usb import watch as module

from .fake_usb import board, usb_error
from .fake_usb_backend import FakeBackend
from .suite import PATIENCE_S, SETTLE_S, Background
from .test_listeners import free_descriptors


@pytest.fixture
def bus() -> FakeBackend:
    return FakeBackend(board())


@pytest.fixture(params=["uevents", "polling"])
def watch(
    request: pytest.FixtureRequest, bus: FakeBackend, monkeypatch: pytest.MonkeyPatch
) -> Iterator[UsbWatch]:
    if request.param != "uevents":
        monkeypatch.setattr(module, "_uevent_socket", lambda: None)
    made = j2a_transports.watch_usb(0.01, bus)
    monkeypatch.undo()
    with made:
        yield made


def test_boards_that_are_there_come_first(bus: FakeBackend, watch: UsbWatch) -> None:
    bus.devices.append(board(serial="B2", address=5))
    events = [watch.next(0), watch.next(0)]
    assert [type(event) for event in events] == [UsbArrived, UsbArrived]
    assert [event.board.url for event in events if event] == ["usb://A1", "usb://B2"]
    assert watch.next(0) is None


def test_unplugging_and_plugging_in(bus: FakeBackend, watch: UsbWatch) -> None:
    first = watch.next(0)
    assert first is not None
    bus.devices[0].unplug()
    assert watch.next(PATIENCE_S) == UsbLeft(first.board)
    bus.devices[0] = board(address=9)
    again = watch.next(PATIENCE_S)
    assert isinstance(again, UsbArrived)
    assert (again.board.url, again.board.address) == ("usb://A1", 9)


def test_a_board_that_is_replaced_between_two_looks(bus: FakeBackend, watch: UsbWatch) -> None:
    watch.next(0)
    bus.devices[0] = board(address=9)
    assert [type(watch.next(0)), type(watch.next(0))] == [UsbLeft, UsbArrived]


@pytest.mark.skipif(sys.platform == "win32", reason="a limit of POSIX")
def test_with_too_many_open_files_it_goes_on(bus: FakeBackend, watch: UsbWatch) -> None:
    assert isinstance(watch.next(0), UsbArrived)
    with free_descriptors(0):
        assert watch.next(0.05) is None
    with free_descriptors(1), pytest.raises(OpenFailed, match="Too many open files"):
        j2a_transports.watch_usb(backend=bus)


def test_a_wait_ends_in_time(watch: UsbWatch) -> None:
    watch.next(0)
    assert watch.next(0.03) is None


def test_closing_ends_a_wait_and_the_iteration(watch: UsbWatch) -> None:
    events = Background(lambda: list(watch))
    events.thread.join(SETTLE_S)
    watch.close()
    assert [type(event) for event in events.result()] == [UsbArrived]
    watch.close()
    with pytest.raises(LinkClosed):
        watch.next(0)


def test_a_look_that_fails_is_no_event(bus: FakeBackend, watch: UsbWatch) -> None:
    watch.next(0)
    bus.broken = True
    assert watch.next(0.02) is None
    bus.broken = False
    assert watch.next(0) is None


def test_a_bus_that_cannot_be_listed_is_told_at_the_beginning(bus: FakeBackend) -> None:
    bus.broken = True
    with pytest.raises(OpenFailed, match="cannot be listed"):
        j2a_transports.watch_usb(0.01, bus)
    watches = [each for each in gc.get_objects() if isinstance(each, UsbWatch)]
    assert all(each._closed for each in watches)


def test_rights_that_come_later_are_told(bus: FakeBackend, watch: UsbWatch) -> None:
    watch.next(0)
    bus.devices.append(board(address=5, serial="B2", denied=True))
    bus.devices[0].denied = True
    events = [watch.next(PATIENCE_S), watch.next(PATIENCE_S)]
    assert [type(event) for event in events] == [UsbLeft, UsbArrived]
    assert [event.board.problem is None for event in events if event] == [True, False]
    bus.devices[0].denied = False
    left, back = watch.next(PATIENCE_S), watch.next(PATIENCE_S)
    assert (left, back) == (UsbLeft(events[1].board), UsbArrived(events[0].board))  # type: ignore[union-attr]


def test_udev_gets_a_moment_to_give_the_permission(
    bus: FakeBackend, watch: UsbWatch, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "SETTLING_S", 0.01)
    watch.next(0)
    bus.devices.append(board(address=5, serial="B2", denied=True))
    assert watch.next(0.03) is None
    bus.devices[1].denied = False
    event = watch.next(PATIENCE_S)
    assert event is not None
    assert (event.board.serial, event.board.problem) == ("B2", None)
    # One that gets none comes in the end, with what to do.
    monkeypatch.setattr(module, "SETTLE_S", 0.03)
    bus.devices.append(board(address=6, serial="C3", denied=True))
    event = watch.next(PATIENCE_S)
    assert event is not None
    assert "udev" in str(event.board.problem)


def test_the_system_gets_a_moment_to_read_the_serial_number(
    bus: FakeBackend, watch: UsbWatch, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "SETTLING_S", 0.01)
    watch.next(0)
    bus.devices.append(board(address=5, serial="B2"))
    bus.devices[1].refuses["ctrl_transfer"] = usb_error(errno.EIO)
    assert watch.next(0.03) is None
    bus.devices[1].refuses.clear()
    event = watch.next(PATIENCE_S)
    assert event is not None
    assert (type(event), event.board.url) == (UsbArrived, "usb://B2")
    # One that leaves may lose its number first.
    bus.devices[1].refuses["ctrl_transfer"] = usb_error(errno.EIO)
    assert watch.next(0.03) is None
    bus.devices[1].unplug()
    assert watch.next(PATIENCE_S) == UsbLeft(event.board)
    # One whose number cannot be read comes in the end, and again when it can.
    monkeypatch.setattr(module, "SETTLE_S", 0.03)
    bus.devices[1] = board(address=6, serial="C3", ports=(2, 4))
    bus.devices[1].refuses["ctrl_transfer"] = usb_error(errno.EIO)
    unknown = watch.next(PATIENCE_S)
    assert isinstance(unknown, UsbArrived)
    assert unknown.board.url == "usb://1-2.4"
    bus.devices[1].refuses.clear()
    assert watch.next(PATIENCE_S) == UsbLeft(unknown.board)
    known = watch.next(PATIENCE_S)
    assert isinstance(known, UsbArrived)
    assert known.board.url == "usb://C3"


@pytest.mark.skipif(sys.platform != "linux", reason="uevents are Linux's")
def test_a_message_of_the_system_ends_the_wait_for_the_next_look(
    bus: FakeBackend, monkeypatch: pytest.MonkeyPatch
) -> None:
    here, there = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    here.setblocking(False)
    monkeypatch.setattr(module, "_uevent_socket", lambda: here)
    with there, UsbWatch(PATIENCE_S * 10, bus) as watch:
        watch.next(0)
        waiting = Background(lambda: watch.next(PATIENCE_S))
        waiting.thread.join(SETTLE_S)
        bus.devices[0].unplug()
        for _ in range(3):
            there.send(b"remove@/devices/usb1/1-2")
        assert isinstance(waiting.result(), UsbLeft)


@pytest.mark.skipif(sys.platform != "linux", reason="uevents are Linux's")
def test_a_system_that_gives_no_messages_is_polled(
    bus: FakeBackend, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = socket.socket

    def refuse(*arguments: Any) -> Any:
        if arguments[0] == socket.AF_NETLINK:
            raise PermissionError(errno.EPERM, "not here")
        return made(*arguments)

    monkeypatch.setattr(socket, "socket", refuse)
    with UsbWatch(0.01, bus) as watch:
        watch.next(0)
        bus.devices[0].unplug()
        assert isinstance(watch.next(PATIENCE_S), UsbLeft)


def test_a_signal_handler_may_close_it_at_any_line(
    bus: FakeBackend, signal_at: Callable[..., Any]
) -> None:
    for line in range(0, 400, 7):
        watch = UsbWatch(PATIENCE_S * 10, bus)
        with signal_at(line, watch.close) as was_called:
            for _ in watch:
                pass
        assert was_called()
        assert watch._waker.fileno() == -1
        watch.close()
