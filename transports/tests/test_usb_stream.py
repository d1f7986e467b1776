"""The stream through USB packets: short and empty ones, halts, slow boards, many transfers."""

from __future__ import annotations

import errno
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import j2a_transports
import pytest
import usb.core
from j2a_transports import LinkLost, Transport, WriteTimeout
from j2a_transports._usb.link import UsbTransport
from j2a_transports._usb.transfers import LIMIT

from .fake_libusb import FakeLibusb, give_libusb
from .fake_usb import ROOM, DeviceEnd, FakeDevice, board, usb_error
from .fake_usb_backend import FakeBackend
from .suite import PATIENCE_S, SETTLE_S, Background, read_exactly


class Link(NamedTuple):
    near: Transport
    far: DeviceEnd
    device: FakeDevice


Apis = dict[FakeDevice, FakeLibusb]


@contextmanager
def linked(device: FakeDevice, **options: Any) -> Iterator[Link]:
    (found,) = usb.core.find(find_all=True, backend=FakeBackend(device))
    with j2a_transports.open_usb_device(found, **options) as near:
        yield Link(near, device.end(), device)


@pytest.fixture
def apis(monkeypatch: pytest.MonkeyPatch) -> Apis:
    """The tests with it are about the asynchronous way."""
    return give_libusb(monkeypatch)


@pytest.fixture(params=["blocking", "asynchronous"])
def link(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[Link]:
    """A link in either way."""
    monkeypatch.setattr("j2a_transports._usb.pipes.SLICE_MS", 10)
    if request.param == "asynchronous":
        give_libusb(monkeypatch)
    with linked(board()) as made:
        yield made


@pytest.mark.requirement("USB-014")
@pytest.mark.parametrize("size", [1, 63, 64, 65, 128, 4095, 4096, 4097, 8192])
def test_a_write_ends_with_a_short_packet_and_only_there(link: Link, size: int) -> None:
    link.near.write(bytes(size))
    log = link.device.pipes[0x02].log
    assert log == [64] * (size // 64) + [size % 64]
    assert link.far.read(1) == bytes(size)


SIZES = [size + off for size in range(64, 64 * 9, 64) for off in (-1, 0, 1)]


@pytest.mark.requirement("USB-003", "USB-015")
@pytest.mark.parametrize("asynchronous", [False, True])
def test_an_interrupt_endpoint_gets_no_empty_packet(
    monkeypatch: pytest.MonkeyPatch, asynchronous: bool
) -> None:
    """The board takes nothing after one, as the first firmware."""
    if asynchronous:
        give_libusb(monkeypatch)
    with linked(board(kind=3)) as link:
        pipe = link.device.pipes[0x02]
        pipe.needs_bytes = True
        for size in SIZES:
            link.near.write(bytes(size))
            assert read_exactly(link.far, size) == bytes(size)
        # A write that times out leaves none behind either.
        link.near.write_timeout_s = 0.5
        with pytest.raises(WriteTimeout):
            link.near.write(bytes(64 * (ROOM + 1)))
        assert read_exactly(link.far, 64 * ROOM) == bytes(64 * ROOM)
        assert link.near.read(0.1) == b""
        link.near.write_timeout_s = PATIENCE_S
        link.near.write(b"on")
        assert read_exactly(link.far, 2) == b"on"
        assert 0 not in pipe.log


@pytest.mark.requirement("USB-014")
@pytest.mark.parametrize("asynchronous", [False, True])
def test_the_board_of_the_test_above_can_be_wedged(
    monkeypatch: pytest.MonkeyPatch, asynchronous: bool
) -> None:
    monkeypatch.setattr("j2a_transports._usb.pipes.SLICE_MS", 10)
    if asynchronous:
        give_libusb(monkeypatch)
    with linked(board(kind=2)) as link:
        link.device.pipes[0x02].needs_bytes = True
        link.near.write_timeout_s = 0.05
        link.near.write(bytes(64))
        with pytest.raises(WriteTimeout):
            link.near.write(b"on")


def test_an_empty_write_sends_nothing(link: Link) -> None:
    link.near.write(b"")
    assert link.device.pipes[0x02].log == []


@pytest.mark.requirement("USB-007", "USB-009")
def test_empty_packets_and_packet_boundaries_mean_nothing(link: Link) -> None:
    with link.device.changed:
        for packet in (b"", b"a", b"", b"", b"b" * 64, b"c" * 64, b"d", b""):
            link.device.pipes[0x81].push(packet)
    expected = b"a" + b"b" * 64 + b"c" * 64 + b"d"
    assert read_exactly(link.near, len(expected)) == expected
    assert link.near.read(0.02) == b""


@pytest.mark.requirement("USB-003", "USB-007")
@pytest.mark.parametrize("kind", [2, 3])
@pytest.mark.parametrize("packet", [8, 64, 512])
def test_no_packet_is_too_large_for_a_transfer(apis: Apis, packet: int, kind: int) -> None:
    # The fake says overflow as a host controller does.
    with linked(board(packet=packet, kind=kind)) as link:
        writer = Background(lambda: [link.far.write(bytes(count)) for count in range(1, 600)])
        assert read_exactly(link.near, 599 * 300) == bytes(599 * 300)
        writer.result()


def test_a_halt_on_the_way_is_cleared_and_nothing_is_lost(link: Link) -> None:
    for direction in range(3):
        link.device.halt(0x81)
        link.far.write(bytes([direction]))
        assert read_exactly(link.near, 1) == bytes([direction])
        link.device.halt(0x02)
        link.near.write(bytes([direction]))
        assert link.far.read(PATIENCE_S) == bytes([direction])
    cleared = [call[1] for call in link.device.calls if call[0] == "clear_halt"]
    assert cleared == [0x81, 0x02] * 4


@pytest.mark.parametrize("endpoint", [0x81, 0x02])
def test_an_endpoint_that_stays_halted_is_a_lost_link(link: Link, endpoint: int) -> None:
    link.device.refuses["clear_halt"] = usb_error(errno.EPIPE)
    link.device.halt(endpoint)
    with pytest.raises(LinkLost, match="halted the endpoint again"):
        link.near.write(b"x")
        link.near.read(PATIENCE_S)
    with pytest.raises(LinkLost):
        link.near.read(PATIENCE_S)


def test_a_board_that_halts_again_and_again_is_a_lost_link(
    link: Link, monkeypatch: pytest.MonkeyPatch
) -> None:
    def clear_halt(self: FakeBackend, handle: Any, ep: int) -> None:
        link.device.calls.append(("clear_halt", ep))

    link.device.calls.clear()
    monkeypatch.setattr(FakeBackend, "clear_halt", clear_halt)
    link.device.halt(0x81)
    with pytest.raises(LinkLost, match="halted the endpoint again"):
        link.near.read(PATIENCE_S)
    assert link.device.calls == [("clear_halt", 0x81)]


def test_a_write_that_times_out_is_not_sent_twice(link: Link) -> None:
    link.near.write_timeout_s = 0.05
    data = bytes(range(256)) * 256
    with pytest.raises(WriteTimeout, match=r"took no byte for 0\.05 s .* of 65536 bytes not sent"):
        link.near.write(data)
    # The board holds ROOM packets; it reads them, and the program goes on with the rest.
    sent = ROOM * 64
    assert read_exactly(link.far, sent) == data[:sent]
    link.near.write(data[sent : sent + 1000])
    assert read_exactly(link.far, 1000) == data[sent : sent + 1000]


FULL = bytes(range(64)) * ROOM


def fill(link: Link) -> None:
    """Write the last packet for which the board has room, so that it refuses the empty one."""
    with link.device.changed:
        for at in range(ROOM - 1):
            assert link.device.pipes[0x02].push(FULL[64 * at : 64 * at + 64])
    # Short, but enough for a loaded machine to send one packet.
    link.near.write_timeout_s = 0.5
    link.near.write(FULL[-64:])
    assert link.device.pipes[0x02].log == [64] * ROOM


@pytest.mark.requirement("USB-014")
def test_the_empty_packet_that_a_board_refuses_comes_later(link: Link) -> None:
    fill(link)
    assert read_exactly(link.far, len(FULL)) == FULL
    log = link.device.pipes[0x02].log
    with link.device.changed:
        assert link.device.changed.wait_for(lambda: len(log) > ROOM, PATIENCE_S)
    assert log == [64] * ROOM + [0]
    link.near.write_timeout_s = PATIENCE_S
    link.near.write(b"on")
    assert read_exactly(link.far, 2) == b"on"


def test_a_write_needs_no_empty_packet_before_it(link: Link) -> None:
    fill(link)
    link.near.write_timeout_s = None
    writer = Background(lambda: link.near.write(b"abc"))
    writer.thread.join(SETTLE_S)
    assert read_exactly(link.far, len(FULL) + 3) == FULL + b"abc"
    writer.result()
    # Nor does it come later.
    assert link.near.read(0.1) == b""
    assert link.device.pipes[0x02].log == [64] * ROOM + [3]


def test_after_the_empty_packet_bytes_can_be_refused_too(link: Link) -> None:
    fill(link)
    link.near.write_timeout_s = 0.05
    for _ in range(2):
        with pytest.raises(WriteTimeout, match="3 of 3 bytes not sent"):
            link.near.write(b"abc")
    link.near.close()
    assert link.device.busy == set()


def test_a_slow_board_is_no_stuck_one(link: Link) -> None:
    """It takes a packet now and then, and a transfer longer than the write timeout."""
    link.near.write_timeout_s = 0.1
    data = bytes(range(256)) * 160
    writer = Background(lambda: link.near.write(data))
    got = bytearray()
    wait = threading.Event()
    while len(got) < len(data):
        wait.wait(0.005)
        with link.device.changed:
            packets = link.device.pipes[0x02].packets
            for _ in range(4):
                got += packets.popleft() if packets else b""
            link.device.changed.notify_all()
    writer.result()
    assert got == data


def test_several_transfers_are_under_way_and_order_is_kept(apis: Apis) -> None:
    with linked(board(), transfers=6) as link:
        api = apis[link.device]
        assert api.most == 6
        # Completions are told in the reverse order: only the order of submission counts.
        plain = api._done
        api._done = lambda: list(reversed(plain()))  # type: ignore[method-assign]
        with link.device.changed:
            for value in range(200):
                link.device.pipes[0x81].push(bytes([value]))
        assert read_exactly(link.near, 200) == bytes(range(200))


def test_one_transfer_does_without_the_asynchronous_functions(apis: Apis) -> None:
    with linked(board(), transfers=1) as link:
        assert apis == {}
        link.far.write(b"x")
        assert link.near.read(PATIENCE_S) == b"x"


def test_a_user_who_does_not_read_stops_the_board_and_loses_nothing(apis: Apis) -> None:
    data = bytes(range(256)) * 1024
    with linked(board()) as link:
        writer = Background(lambda: link.far.write(data))
        # Both directions: the other one is not held up.
        link.near.write(b"x")
        assert link.far.read(PATIENCE_S) == b"x"
        writer.thread.join(SETTLE_S)
        assert writer.thread.is_alive()
        pipes = link.near._pipes  # type: ignore[attr-defined]
        with pipes._changed:
            assert pipes._changed.wait_for(lambda: pipes._unread >= LIMIT, PATIENCE_S)
            assert pipes._unread <= LIMIT + 4 * 4096
        assert read_exactly(link.near, len(data)) == data
        writer.result()


def test_an_interrupted_write_leaves_no_transfer_behind(
    apis: Apis, monkeypatch: pytest.MonkeyPatch
) -> None:
    with linked(board()) as link:
        api = apis[link.device]
        pipes = link.near._pipes  # type: ignore[attr-defined]
        wait_for = pipes._changed.wait_for

        def interrupted(predicate: Any, timeout: float | None = None) -> Any:
            if timeout == 4.25:
                raise KeyboardInterrupt
            return wait_for(predicate, timeout)

        monkeypatch.setattr(pipes._changed, "wait_for", interrupted)
        link.near.write_timeout_s = 4.25
        with pytest.raises(KeyboardInterrupt):
            link.near.write(bytes(200_000))
        assert all(job.pipe.address & 0x80 for job, _ in api.flying)
        monkeypatch.undo()
        with link.device.changed:
            link.device.pipes[0x02].packets.clear()
        link.near.write(b"goes on")
        assert read_exactly(link.far, 7) == b"goes on"


def test_closing_frees_every_transfer(apis: Apis) -> None:
    with linked(board()) as link:
        api = apis[link.device]
        assert len(api.allocated) == 8
    assert (api.allocated, api.flying) == ({}, [])


def test_transfers_that_never_come_back_are_kept_and_the_handle_too(
    apis: Apis, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("j2a_transports._usb.transfers.BACK_S", 0.05)
    kept: list[Any] = []
    monkeypatch.setattr("j2a_transports._usb.transfers._kept", kept)
    with linked(board()) as link:
        apis[link.device].cancel = lambda pointer: None  # type: ignore[method-assign]
    assert isinstance(link.near, UsbTransport)
    assert link.near.closed
    assert kept == [link.near._pipes]
    assert ("close_device",) not in link.device.calls
    assert len(apis[link.device].allocated) == 8


def test_a_libusb_that_handles_no_events_is_a_lost_link(
    apis: Apis, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("j2a_transports._usb.transfers.BACK_S", 0.05)
    monkeypatch.setattr("j2a_transports._usb.transfers._kept", [])
    with linked(board()) as link:
        api = apis[link.device]
        with link.device.changed:
            api.events_fail = True
            link.device.changed.notify_all()
        with pytest.raises(LinkLost, match="no events any more"):
            link.near.read(PATIENCE_S)
        with pytest.raises(LinkLost):
            link.near.write(b"x")


def test_a_submission_that_fails_is_a_lost_link(
    apis: Apis, monkeypatch: pytest.MonkeyPatch
) -> None:
    with linked(board()) as link:

        def no_memory(pointer: Any) -> None:
            raise OSError(errno.ENOMEM, "libusb error -11")

        monkeypatch.setattr(apis[link.device], "submit", no_memory)
        with pytest.raises(LinkLost, match="libusb error -11"):
            link.near.write(b"x")
        with pytest.raises(LinkLost, match="libusb error -11"):
            link.near.read(PATIENCE_S)
