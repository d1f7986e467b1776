"""What opening and closing do to a USB device, and what is said when it refuses."""

from __future__ import annotations

import errno
import gc
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import j2a_transports
import pytest
import usb.core
import usb.util
from j2a_transports import LinkClosed, LinkLost, OpenFailed, Transport

from .fake_libusb import give_libusb
from .fake_usb import FakeDevice, board, endpoint, interface, usb_error
from .fake_usb_backend import FakeBackend
from .programs import run_program
from .suite import MEGABYTE, SETTLE_S, Background

Open = Callable[..., Transport]


TOLD = [("blocking", False), ("blocking", True), ("asynchronous", True)]


@pytest.fixture(params=["blocking", "asynchronous"])
def open_fake(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Open:
    """Open a fake device in either way."""
    monkeypatch.setattr("j2a_transports._usb.pipes.SLICE_MS", 10)
    if request.param == "asynchronous":
        give_libusb(monkeypatch)

    def open_device(device: FakeDevice, interface: int | None = None) -> Transport:
        (found,) = usb.core.find(find_all=True, backend=FakeBackend(device))
        return j2a_transports.open_usb_device(found, interface)

    return open_device


def asked(device: FakeDevice) -> list[str]:
    """What was asked of the device that changes something, in order."""
    quiet = ("get_configuration", "is_kernel_driver_active", "ctrl_transfer")
    return [" ".join(map(str, call)) for call in device.calls if call[0] not in quiet]


@contextmanager
def no_thread_is_left() -> Iterator[None]:
    before = set(threading.enumerate())
    yield
    assert set(threading.enumerate()) <= before


@pytest.mark.requirement("USB-012")
def test_opening_claims_and_clears_halts_and_closing_gives_all_back(open_fake: Open) -> None:
    device = board()
    with no_thread_is_left(), open_fake(device) as near:
        assert near.url == "usb://001:004"
        assert device.busy == {0}
    assert asked(device) == [
        "open_device",
        "claim_interface 0",
        f"clear_halt {0x81}",
        f"clear_halt {0x02}",
        "release_interface 0",
        "close_device",
    ]


@pytest.mark.requirement("USB-012")
def test_endpoints_that_were_halted_work(open_fake: Open) -> None:
    device = board()
    device.halt(0x81)
    device.halt(0x02)
    with open_fake(device) as near:
        far = device.end()
        near.write(b"out")
        assert far.read(1) == b"out"
        far.write(b"in")
        assert near.read(1) == b"in"


def test_a_configuration_is_only_set_where_there_is_none(open_fake: Open) -> None:
    device = board(configuration=0)
    open_fake(device).close()
    assert asked(device)[:3] == ["open_device", "set_configuration 1", "claim_interface 0"]


def test_a_kernel_driver_is_detached_and_comes_back(open_fake: Open) -> None:
    device = board(drivers={0, 1})
    with open_fake(device):
        assert device.drivers == {1}
    assert device.drivers == {0, 1}
    assert asked(device)[-3:] == ["release_interface 0", "attach_kernel_driver 0", "close_device"]


def test_a_kernel_driver_comes_back_when_opening_fails_later(open_fake: Open) -> None:
    device = board(drivers={0}, refuses={"claim_interface": usb_error(errno.EBUSY)})
    with pytest.raises(OpenFailed, match="another program uses it"):
        open_fake(device)
    assert (device.drivers, device.handles) == ({0}, 0)


def test_a_system_without_drivers_to_detach(open_fake: Open) -> None:
    device = board(refuses={"is_kernel_driver_active": NotImplementedError()})
    with open_fake(device):
        assert device.busy == {0}


def test_an_alternate_setting_with_the_endpoints_is_selected(open_fake: Open) -> None:
    device = FakeDevice([interface(endpoints=[]), interface(alternate=1)])
    open_fake(device).close()
    assert "set_interface_altsetting 0 1" in asked(device)


def test_a_device_that_knows_no_halts_is_opened(open_fake: Open) -> None:
    device = board(refuses={"clear_halt": usb_error(errno.EPIPE)})
    with open_fake(device) as near:
        near.write(b"x")
        assert device.end().read(1) == b"x"


@pytest.mark.parametrize(
    ("request_", "error", "said"),
    [
        ("open_device", usb_error(errno.EACCES), "setup udev` once"),
        ("get_configuration", usb_error(errno.ENODEV), "it went away while it was opened"),
        ("claim_interface", usb_error(errno.EBUSY), "another program uses it"),
        ("clear_halt", usb_error(errno.ENODEV), "it went away while it was opened"),
        ("clear_halt", usb_error(errno.EIO), "EIO; plug it in again"),
        ("claim_interface", NotImplementedError("no"), "its driver cannot do that: no"),
    ],
)
def test_a_refusal_says_what_to_do_and_leaves_nothing_open(
    open_fake: Open, request_: str, error: Exception, said: str
) -> None:
    device = board(refuses={request_: error})
    with no_thread_is_left(), pytest.raises(OpenFailed, match=f"^usb://001:004: .*{said}"):
        open_fake(device)
    assert (device.handles, device.busy) == (0, set())


def test_two_programs_cannot_have_the_same_board(open_fake: Open) -> None:
    device = board()
    with open_fake(device), pytest.raises(OpenFailed, match="another program uses it"):
        open_fake(device)
    open_fake(device).close()


def test_a_device_that_the_program_has_opened_stays_open() -> None:
    device = board()
    (found,) = usb.core.find(find_all=True, backend=FakeBackend(device))
    found.get_active_configuration()
    j2a_transports.open_usb_device(found).close()
    assert (device.handles, device.busy) == (1, set())
    usb.util.dispose_resources(found)


def test_closing_an_unplugged_board_hangs_on_nothing(open_fake: Open) -> None:
    device = board(drivers={0})
    with no_thread_is_left():
        near = open_fake(device)
        device.unplug()
        near.close()
    assert device.handles == 0


@pytest.mark.requirement("USB-013")
@pytest.mark.parametrize("failing", [[], [0x81, 0x02], [0x81], [0x02]])
def test_unplugging_ends_blocked_calls_at_once(open_fake: Open, failing: list[int]) -> None:
    """Unplugged, or transfers fail, in both directions or one: all calls end."""
    device = board()
    with open_fake(device) as near:
        near.write_timeout_s = None
        reader = Background(lambda: near.read(None))
        writer = Background(lambda: [near.write(bytes(100_000)) for _ in range(9)])
        reader.thread.join(SETTLE_S)
        if failing:
            device.fail(errno.EIO, *failing)
        else:
            device.unplug()
        for blocked in (reader, writer):
            with pytest.raises(LinkLost, match="lost: the board was unplugged or"):
                blocked.result()
        assert not near.closed
        with pytest.raises(LinkLost):
            near.write(b"")


@pytest.mark.requirement("USB-013")
def test_a_reset_by_another_program_is_a_lost_link(
    open_fake: Open, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("j2a_transports._usb.claim.is_libusb", lambda backend: True)
    monkeypatch.setattr("j2a_transports._usb.claim.SYSFS", tmp_path)
    driver = tmp_path / "1-2.3:1.0" / "driver"
    for writing in (False, True):
        driver.mkdir(parents=True, exist_ok=True)
        device = board()
        with open_fake(device) as near:
            # An empty packet is none: the interface is still ours.
            device.end().write(bytes(64))
            assert near.read(None) == bytes(64)
            near.write_timeout_s = None
            call = partial(near.write, bytes(MEGABYTE)) if writing else partial(near.read, None)
            blocked = Background(call)
            blocked.thread.join(SETTLE_S)
            driver.rmdir()
            device.reset_by_another()
            with pytest.raises(LinkLost, match="unplugged or reset"):
                blocked.result()


@pytest.mark.requirement("USB-013")
@pytest.mark.parametrize("writing", [False, True])
@pytest.mark.parametrize(("open_fake", "noticed"), TOLD, indirect=["open_fake"])
def test_a_reset_is_one_although_the_driver_is_bound_again(
    open_fake: Open,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    writing: bool,
    noticed: bool,
) -> None:
    """Also between two blocking transfers, of which none is given back then."""
    monkeypatch.setattr("j2a_transports._usb.claim.is_libusb", lambda backend: True)
    monkeypatch.setattr("j2a_transports._usb.claim.SYSFS", tmp_path)
    driver, other = tmp_path / "1-2.3:1.0" / "driver", tmp_path / "other"
    driver.mkdir(parents=True)
    other.mkdir()
    device = board()
    with open_fake(device) as near:
        near.write_timeout_s = None
        call = partial(near.write, bytes(MEGABYTE)) if writing else partial(near.read, None)
        blocked = Background(call)
        blocked.thread.join(SETTLE_S)
        other.replace(driver)
        if noticed:
            device.reset_by_another()
        with pytest.raises(LinkLost, match="unplugged or reset"):
            blocked.result()


def test_what_had_arrived_before_the_end_is_read_first(open_fake: Open) -> None:
    device = board()
    with open_fake(device) as near:
        device.end().write(bytes(1000))
        with device.changed:
            device.changed.wait_for(lambda: not device.pipes[0x81].packets)
        device.unplug()
        data = b""
        with pytest.raises(LinkLost):
            while True:
                data += near.read(None)
        assert data == bytes(1000)


def test_closing_from_another_thread_ends_a_blocked_write(open_fake: Open) -> None:
    device = board()
    with no_thread_is_left():
        near = open_fake(device)
        near.write_timeout_s = None
        writer = Background(lambda: near.write(bytes(1_000_000)))
        writer.thread.join(SETTLE_S)
        near.close()
        with pytest.raises(LinkClosed):
            writer.result()
    assert (device.handles, device.busy) == (0, set())


def test_two_boards_do_not_disturb_each_other(open_fake: Open) -> None:
    one, two = board(), board(address=5, serial="B2")
    with open_fake(one) as first, open_fake(two) as second:
        first.write_timeout_s = None
        blocked = Background(lambda: first.write(bytes(1_000_000)))
        for at in range(50):
            second.write(bytes([at]))
            assert two.end().read(1) == bytes([at])
        one.unplug()
        with pytest.raises(LinkLost):
            blocked.result()
        two.end().write(b"still here")
        assert second.read(1) == b"still here"


def test_nothing_is_left_in_memory_or_open(open_fake: Open) -> None:
    device = board()
    with no_thread_is_left():
        for _ in range(20):
            open_fake(device).close()
    gc.collect()
    assert not [each for each in gc.get_objects() if type(each).__name__ == "UsbTransport"]
    assert device.handles == 0


def test_interfaces_with_interrupt_endpoints_are_used_as_such() -> None:
    device = board(kind=3)
    (found,) = usb.core.find(find_all=True, backend=FakeBackend(device))
    with j2a_transports.open_usb_device(found) as near:
        near.write(b"x")
    assert ("intr_write", 0x02) in device.calls


def test_the_first_endpoint_of_each_direction_counts() -> None:
    ends = [endpoint(0x02), endpoint(0x04), endpoint(0x83), endpoint(0x81)]
    device = FakeDevice([interface(endpoints=ends)])
    (found,) = usb.core.find(find_all=True, backend=FakeBackend(device))
    with j2a_transports.open_usb_device(found) as near:
        device.end(0x02, 0x83).write(b"x")
        assert near.read(None) == b"x"


FORGETFUL = """
import usb.core, j2a_transports
from transports.tests.fake_usb import board
from transports.tests.fake_usb_backend import FakeBackend
(found,) = usb.core.find(find_all=True, backend=FakeBackend(board()))
near = j2a_transports.open_usb_device(found)
near.write(b"never closed")
print("end")
"""


def test_a_program_that_closes_nothing_ends_in_silence() -> None:
    assert run_program(FORGETFUL, "-W", "error") == (0, "end\n", "")


FORKING = """
import os, sys, usb.core, j2a_transports
from transports.tests.fake_usb import board
from transports.tests.fake_usb_backend import FakeBackend
one = board()
(found,) = usb.core.find(find_all=True, backend=FakeBackend(one))
near = j2a_transports.open_usb_device(found)
child = os.fork()
if child == 0:
    sys.exit(bool(near.closed))
child = os.fork()
if child == 0:
    near.close()
    sys.exit(not near.closed or not one.busy)  # it is the parent who gives the interface back
assert os.waitpid(-1, 0)[1] == 0
assert os.waitpid(-1, 0)[1] == 0
one.end().write(b"still the parent's")
print(near.read(None).decode())
near.close()
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
def test_a_child_process_leaves_the_link_to_its_parent() -> None:
    code, said, errors = run_program(FORKING)
    assert (code, said) == (0, "still the parent's\n"), errors
