"""The binding of libusb's asynchronous functions on the real library, as far as that goes without
a device; transfers on real devices are in transports/tests/guest."""

from __future__ import annotations

import ctypes
import errno
from types import SimpleNamespace
from typing import Any

import pytest
from j2a_transports import usb_boards
from j2a_transports._usb import libusb_async
from j2a_transports._usb.find import libusb
from j2a_transports._usb.libusb_async import Libusb, Transfer
from usb.backend import libusb1

from .fake_usb_backend import FakeBackend
from .programs import run_program
from .suite import SETTLE_S, Background


@pytest.fixture
def api() -> Libusb:
    backend = libusb()
    return Libusb(backend.lib, backend.ctx)


def test_the_layout_of_a_transfer_is_that_which_pyusb_knows() -> None:
    theirs = libusb1._libusb_transfer
    for name, *_ in Transfer._fields_:
        mine = getattr(Transfer, name)
        assert (mine.offset, mine.size) == (
            getattr(theirs, name).offset,
            getattr(theirs, name).size,
        )


def test_the_prototypes_of_pyusb_stay_as_they_are(api: Libusb) -> None:
    before = libusb().lib.libusb_submit_transfer.argtypes
    Libusb(libusb().lib, libusb().ctx)
    assert libusb().lib.libusb_submit_transfer.argtypes == before


def test_transfers_are_made_and_freed(api: Libusb) -> None:
    transfers = [api.alloc() for _ in range(100)]
    assert len({ctypes.addressof(each.contents) for each in transfers}) == 100
    for each in transfers:
        api.cancel(each)
        api.free(each)


def test_interrupting_ends_the_wait_for_events(api: Libusb) -> None:
    waiting = Background(lambda: api.handle_events(ctypes.c_int(0)))
    waiting.thread.join(SETTLE_S)
    assert waiting.thread.is_alive()
    api.interrupt()
    assert waiting.result() is None


def test_several_threads_wait_for_events_and_all_can_be_ended(api: Libusb) -> None:
    stops = [ctypes.c_int(0) for _ in range(3)]

    def run(stop: Any) -> None:
        while not stop.value:
            api.handle_events(stop)

    waiting = [Background(lambda stop=stop: run(stop)) for stop in stops]
    waiting[0].thread.join(SETTLE_S)
    for stop, each in zip(stops, waiting, strict=True):
        stop.value = 1
        api.interrupt()
        assert each.result() is None


def test_a_flag_that_is_set_makes_no_wait(api: Libusb) -> None:
    api.handle_events(ctypes.c_int(1))


def test_an_error_of_libusb_is_one_of_the_system() -> None:
    for code, number in ((-4, errno.ENODEV), (-9, errno.EPIPE), (-99, errno.EIO)):
        with pytest.raises(OSError) as caught:
            libusb_async.check(code)
        assert caught.value.errno == number
    libusb_async.check(0)


def test_other_backends_have_no_such_functions() -> None:
    assert libusb_async.asynchronous(SimpleNamespace(backend=FakeBackend())) is None


def test_a_library_or_a_pyusb_without_them_is_used_by_blocking_calls() -> None:
    real = libusb()
    # pyusb keeps the handle elsewhere.
    assert libusb_async.asynchronous(SimpleNamespace(backend=real)) is None
    # The C library knows none of the names.
    real_lib, real.lib = real.lib, ctypes.CDLL(None)
    try:
        device = SimpleNamespace(
            backend=real, _ctx=SimpleNamespace(handle=SimpleNamespace(handle=1))
        )
        assert libusb_async.asynchronous(device) is None
    finally:
        real.lib = real_lib


def test_looking_works_on_this_computer_whatever_is_plugged_in() -> None:
    assert all(each.url.startswith("usb://") for each in usb_boards())


PROGRAM = """
import ctypes, threading
from j2a_transports._usb.find import libusb
from j2a_transports._usb.libusb_async import Libusb
backend = libusb()
api = Libusb(backend.lib, backend.ctx)
stop = ctypes.c_int(0)
def run():
    while not stop.value:
        api.handle_events(stop)
thread = threading.Thread(target=run)
thread.start()
stop.value = 1
api.interrupt()
thread.join()
api.free(api.alloc())
"""


def test_the_real_library_leaves_in_silence() -> None:
    assert run_program(PROGRAM, "-W", "error", "-X", "dev") == (0, "", "")
