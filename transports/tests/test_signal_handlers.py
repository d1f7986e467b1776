"""A signal handler may close what its own thread is closing, at whatever line that is."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import j2a_transports
import pytest
import usb.core
from j2a_transports import Transport

from .fake_libusb import give_libusb
from .fake_usb import board
from .fake_usb_backend import FakeBackend
from .suite import PATIENCE_S

SignalAt = Callable[[int, Callable[[], object]], AbstractContextManager[Callable[[], bool]]]
Opened = Callable[[], AbstractContextManager[Transport]]


@contextmanager
def _threaded() -> Iterator[Transport]:
    yield j2a_transports.open("serial:loop://")


@contextmanager
def _usb() -> Iterator[Transport]:
    (found,) = usb.core.find(find_all=True, backend=FakeBackend(board()))
    yield j2a_transports.open_usb_device(found)


@pytest.fixture(params=["threaded", "usb-blocking", "usb-asynchronous", "gadget"])
def opened(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> Opened:
    """What opens a transport that threads move."""
    if request.param == "threaded":
        return _threaded
    if request.param == "gadget":
        if sys.platform != "linux":
            pytest.skip("gadgets exist on Linux only")
        return _gadget_of(tmp_path, monkeypatch)
    monkeypatch.setattr("j2a_transports._usb.pipes.SLICE_MS", 10)
    if request.param == "usb-asynchronous":
        give_libusb(monkeypatch)
    return _usb


def _gadget_of(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Opened:
    from j2a_transports import UsbGadget  # noqa: PLC0415 - Linux only

    from .fake_gadget import installed  # noqa: PLC0415 - Linux only

    installed(tmp_path, monkeypatch)

    @contextmanager
    def opened() -> Iterator[Transport]:
        with UsbGadget(serial="0001", name=f"test-{abs(hash(tmp_path))}"[:32]) as gadget:
            transport = gadget.accept(PATIENCE_S)
            assert transport is not None
            yield transport

    return opened


@pytest.mark.parametrize("first", range(4))
def test_a_transport_is_closed_amid_its_closing(
    signal_at: SignalAt, opened: Opened, first: int
) -> None:
    for line in range(first, 80, 4):
        with opened() as transport:
            with signal_at(line, transport.close) as was_called:
                transport.close()
            assert was_called()
            assert transport.closed
