"""A gadget between a program and a host: the shared suite, and what USB has beside it."""

from __future__ import annotations

import errno
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import j2a_transports
import pytest
from j2a_transports import LinkClosed, LinkLost, OpenFailed, Transport

if sys.platform != "linux":
    pytest.skip("gadgets exist on Linux only", allow_module_level=True)

from j2a_transports import UsbGadget
from j2a_transports._gadget.descriptors import Event

from .fake_gadget import UDC, FakeKernel, Host, failure, installed
from .suite import PATIENCE_S, SETTLE_S, Background, BackToBack, read_exactly


@pytest.fixture
def kernel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> FakeKernel:
    """The system that a gadget finds."""
    return installed(tmp_path, monkeypatch)


@pytest.fixture
def gadget(kernel: FakeKernel, request: pytest.FixtureRequest) -> Iterator[UsbGadget]:
    with UsbGadget(serial="0001", name=_name(request)) as gadget:
        yield gadget
        for transport in list(gadget._accepted):
            transport.close()


def _name(request: pytest.FixtureRequest) -> str:
    """Each test has a name of its own, because the lock is the real one."""
    return f"test-{abs(hash(request.node.nodeid))}"[:32]


def accepted(gadget: UsbGadget) -> Transport:
    transport = gadget.accept(PATIENCE_S)
    assert transport is not None
    return transport


def until(condition: Callable[[], object]) -> None:
    """Wait for what another thread does."""
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.001)


def until_lost(transport: Transport) -> str:
    with pytest.raises(LinkLost) as caught:
        transport.read(PATIENCE_S)
    return str(caught.value)


class TestBackToBack(BackToBack):
    # The host's end of a link drops what was on the way (USB-011), the device's too.
    discards = frozenset({"near", "far"})

    @pytest.fixture(autouse=True)
    def system(self, kernel: FakeKernel, request: pytest.FixtureRequest) -> None:
        self.kernel, self.name = kernel, _name(request)

    @contextmanager
    def connect(self) -> Iterator[tuple[Transport, Transport]]:
        with UsbGadget(serial="0001", name=self.name) as gadget:
            near = accepted(gadget)
            yield near, Host(self.kernel.bus)
            near.close()

    def hang_up(self, end: str, transport: Transport) -> None:
        if end == "far":
            self.kernel.bus.disable()
        else:
            transport.close()


class TestSessions:
    def test_a_host_that_comes_back_is_accepted_anew(
        self, gadget: UsbGadget, kernel: FakeKernel
    ) -> None:
        first = accepted(gadget)
        assert gadget.accept(0) is None
        kernel.bus.disable()
        assert "gone" in until_lost(first)
        kernel.bus.configure()
        with accepted(gadget) as second:
            Host(kernel.bus).write(b"again")
            assert read_exactly(second, 5) == b"again"
        with pytest.raises(LinkLost):
            first.write(b"x")

    @pytest.mark.requirement("USB-011")
    def test_a_configuration_set_twice_drops_all_that_was_on_the_way(
        self, gadget: UsbGadget, kernel: FakeKernel
    ) -> None:
        first, host = accepted(gadget), Host(kernel.bus)
        host.write(b"not read")
        until(lambda: first.used)
        first.write(b"not sent")
        until(lambda: kernel.bus.to_host.packets)
        kernel.bus.configure()
        until(lambda: first.lost)
        assert "anew" in until_lost(first)
        with accepted(gadget) as second:
            host = Host(kernel.bus)
            host.write(b"new")
            second.write(b"reply")
            assert (read_exactly(second, 3), read_exactly(host, 5)) == (b"new", b"reply")

    def test_the_second_interface_of_one_configuration_is_no_second_host(
        self, gadget: UsbGadget, kernel: FakeKernel
    ) -> None:
        """The kernel enables the endpoints for each interface, so it reports twice."""
        first = accepted(gadget)
        kernel.bus.configure()
        Host(kernel.bus).write(b"ab")
        assert read_exactly(first, 2) == b"ab"
        assert gadget.accept(0) is None

    def test_a_host_that_was_not_accepted_in_time(
        self, gadget: UsbGadget, kernel: FakeKernel
    ) -> None:
        kernel.bus.disable()
        kernel.bus.configure()
        kernel.bus.disable()
        time.sleep(SETTLE_S)
        assert gadget.accept(0) is None
        kernel.bus.configure()
        accepted(gadget).close()

    def test_suspend_is_no_loss(self, gadget: UsbGadget, kernel: FakeKernel) -> None:
        transport = accepted(gadget)
        kernel.bus.tell(Event.SUSPEND)
        assert transport.read(0.05) == b""
        kernel.bus.tell(Event.RESUME)
        Host(kernel.bus).write(b"on")
        assert read_exactly(transport, 2) == b"on"

    def test_leaving_the_bus_and_coming_back_at_once_ends_a_blocked_read(
        self, gadget: UsbGadget, kernel: FakeKernel
    ) -> None:
        """No byte was exchanged, so the next configuration alone would not tell."""
        transport = accepted(gadget)
        reader = Background(lambda: transport.read(None))
        time.sleep(SETTLE_S)
        kernel.bus.rebind()
        kernel.bus.configure()
        with pytest.raises(LinkLost, match="left the bus"):
            reader.result()
        with accepted(gadget) as second:
            Host(kernel.bus).write(b"anew")
            assert read_exactly(second, 4) == b"anew"

    def test_leaving_the_bus_ends_blocked_calls(
        self, gadget: UsbGadget, kernel: FakeKernel
    ) -> None:
        transport = accepted(gadget)
        transport.write_timeout_s = None
        tasks = [
            Background(lambda: transport.read(None)),
            Background(lambda: transport.write(bytes(200_000))),
        ]
        time.sleep(SETTLE_S)
        # As another program does it, through configfs.
        kernel.write(next((kernel.config / "usb_gadget").iterdir()) / "UDC", "\n")
        for task in tasks:
            with pytest.raises(LinkLost):
                task.result()
        assert gadget.accept(0) is None

    def test_closing_leaves_the_bus_until_the_next_accept(
        self, gadget: UsbGadget, kernel: FakeKernel
    ) -> None:
        transport, host = accepted(gadget), Host(kernel.bus)
        Background(lambda: read_exactly(host, 3))
        transport.write(b"bye")
        transport.close()
        assert not kernel.bound
        with pytest.raises(LinkLost):
            host.read(PATIENCE_S)
        accepted(gadget).close()
        assert kernel.bus.session is None

    def test_closing_a_lost_link_leaves_the_device_on_the_bus(
        self, gadget: UsbGadget, kernel: FakeKernel
    ) -> None:
        transport = accepted(gadget)
        kernel.bus.disable()
        until_lost(transport)
        transport.close()
        assert kernel.bound

    def test_a_controller_that_somebody_took_meanwhile(
        self, gadget: UsbGadget, kernel: FakeKernel
    ) -> None:
        accepted(gadget).close()
        kernel.bind_error = errno.EBUSY
        with pytest.raises(OpenFailed, match=f"the controller {UDC} is used by"):
            gadget.accept(0)
        kernel.bind_error = None

    def test_the_transport_outlives_the_listener(
        self, gadget: UsbGadget, kernel: FakeKernel
    ) -> None:
        transport, host = accepted(gadget), Host(kernel.bus)
        waiting = Background(lambda: gadget.accept(None))
        time.sleep(SETTLE_S)
        gadget.close()
        with pytest.raises(LinkClosed):
            waiting.result()
        host.write(b"still")
        assert read_exactly(transport, 5) == b"still"
        transport.close()
        assert list((kernel.config / "usb_gadget").iterdir()) == []
        gadget.close()

    def test_no_thread_is_left(self, gadget: UsbGadget, kernel: FakeKernel) -> None:
        accepted(gadget).close()
        mine = [thread for thread in threading.enumerate() if thread.name.startswith("gadget:")]
        assert len(mine) >= 3
        gadget.close()
        assert not [thread for thread in mine if thread.is_alive()]

    def test_a_strange_error_of_an_endpoint_ends_the_link(
        self, gadget: UsbGadget, kernel: FakeKernel
    ) -> None:
        transport = accepted(gadget)
        with kernel.bus.changed:
            kernel.bus.fault = failure(errno.EOVERFLOW)
            kernel.bus.changed.notify_all()
        assert "too large" in until_lost(transport)
        kernel.bus.fault = None
        transport.close()
        accepted(gadget).close()


class TestPackets:
    @pytest.mark.requirement("USB-014")
    @pytest.mark.parametrize("size", [63, 64, 65, 128, 512, 16384, 16448])
    def test_a_burst_ends_with_a_packet_that_is_not_full(
        self, gadget: UsbGadget, kernel: FakeKernel, size: int
    ) -> None:
        with accepted(gadget) as transport:
            transport.write(bytes(size))
            packets = []
            while not packets or len(packets[-1]) == kernel.bus.packet:
                with kernel.bus.changed:
                    assert kernel.bus.changed.wait_for(
                        lambda: kernel.bus.to_host.packets, PATIENCE_S
                    )
                    packets.append(kernel.bus.to_host.packets.popleft())
                    kernel.bus.changed.notify_all()
            assert [len(packet) for packet in packets] == [64] * (size // 64) + [size % 64]

    def test_no_empty_packet_between_bytes_that_follow_each_other(
        self, gadget: UsbGadget, kernel: FakeKernel
    ) -> None:
        with accepted(gadget) as transport:
            transport.write(bytes(64))
            with kernel.bus.changed:
                kernel.bus.changed.wait_for(lambda: kernel.bus.to_host.packets, PATIENCE_S)
            # Written while the first packet waits for the host.
            transport.write(bytes(65))
            host = Host(kernel.bus)
            assert [len(host.read(PATIENCE_S)) for _ in range(3)] == [64, 64, 1]

    @pytest.mark.requirement("USB-007", "USB-009")
    def test_packets_and_empty_ones_are_one_stream(
        self, gadget: UsbGadget, kernel: FakeKernel
    ) -> None:
        with accepted(gadget) as transport:
            host = Host(kernel.bus)
            for packet in (b"", b"a" * 64, b"b", b"", b"", b"c" * 64, b"c" * 64, b"", b"d"):
                host.write_packet(packet)
            expected = b"a" * 64 + b"b" + b"c" * 128 + b"d"
            assert read_exactly(transport, len(expected)) == expected

    @pytest.mark.parametrize(("packet", "buffer", "asked"), [(64, 1, 64), (512, 16384, 16384)])
    def test_reads_ask_for_whole_packets(
        self, kernel: FakeKernel, request: pytest.FixtureRequest, packet: int, buffer: int,
        asked: int,
    ) -> None:  # fmt: skip
        kernel.bus.packet = packet
        name = _name(request)
        with UsbGadget(serial="1", buffer=buffer, name=name) as gadget:
            transport = accepted(gadget)
            Host(kernel.bus).write(b"x")
            assert read_exactly(transport, 1) == b"x"
            assert set(kernel.bus.from_host.sizes) == {asked}
            transport.close()

    @pytest.mark.requirement("USB-010")
    def test_a_host_that_sends_too_much_is_kept_waiting(
        self, gadget: UsbGadget, kernel: FakeKernel
    ) -> None:
        data = bytes(range(256)) * 2000
        with accepted(gadget) as transport:
            host = Host(kernel.bus)
            host.write_timeout_s = None
            writer = Background(lambda: host.write(data))
            time.sleep(SETTLE_S)
            assert writer.thread.is_alive()
            assert read_exactly(transport, len(data)) == data
            writer.result()

    @pytest.mark.requirement("USB-006")
    @pytest.mark.parametrize(
        ("request_type", "direction"),
        [(0xC1, "to host"), (0x41, "from host"), (0xA1, "to host"), (0x21, "from host")],
    )
    def test_control_requests_are_stalled(
        self, gadget: UsbGadget, kernel: FakeKernel, request_type: int, direction: str
    ) -> None:
        with accepted(gadget) as transport:
            for _ in range(2):
                kernel.bus.tell(Event.SETUP, bytes([request_type, 1, 0, 0, 0, 0, 4, 0]))
            Host(kernel.bus).write(b"and on")
            assert read_exactly(transport, 6) == b"and on"
        assert kernel.bus.stalled == [direction] * 2

    @pytest.mark.requirement("SYNC-003")
    def test_packets_of_sync_usb(self, gadget: UsbGadget, kernel: FakeKernel) -> None:
        good = bytes.fromhex("40420f0000000000ff07")
        got: list[bytes] = []
        arrived = threading.Event()
        gadget.on_sync = lambda packet: (got.append(packet), arrived.set())[0]
        with accepted(gadget):
            with kernel.bus.changed:
                kernel.bus.sync.packets.extend([b"", good[:9], bytes(11), good])
                kernel.bus.changed.notify_all()
            assert arrived.wait(PATIENCE_S)
        assert got == [good]

    def test_an_error_of_the_program_does_not_end_sync_usb(
        self, gadget: UsbGadget, kernel: FakeKernel, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        told: list[str] = []
        monkeypatch.setattr(threading, "excepthook", lambda args: told.append(str(args.exc_value)))
        arrived = threading.Event()

        def on_sync(packet: bytes) -> None:
            if packet[0]:
                raise ZeroDivisionError("a fault of the program")
            arrived.set()

        gadget.on_sync = on_sync
        with accepted(gadget):
            with kernel.bus.changed:
                kernel.bus.sync.packets.extend([b"\1" + bytes(9), bytes(10)])
                kernel.bus.changed.notify_all()
            assert arrived.wait(PATIENCE_S)
        assert told == ["a fault of the program"]


def test_nothing_of_a_gadget_is_loaded_before_it_is_used() -> None:
    code = "import sys, j2a_transports; print([n for n in sys.modules if '_gadget' in n])"
    result = subprocess.run(
        [sys.executable, "-c", code], check=False, capture_output=True, text=True
    )
    assert result.stdout == "[]\n", result.stderr


def test_a_gadget_is_not_opened() -> None:
    with pytest.raises(j2a_transports.BadUrl, match="can only listen"):
        j2a_transports.open("gadget:")
