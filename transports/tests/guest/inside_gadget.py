"""A gadget on a real USB stack: the tests that run inside the guest, both ends in one process.

In: the guest.  Out: what pytest says.
Rules: test_gadget.py starts it there; the device is `UsbGadget` over FunctionFS on dummy_hcd, the
host `usb://` or, where packets and requests matter, plain pyusb.
"""

import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import j2a_transports
import pytest
import usb.core
from j2a_spec import usb as descriptors
from j2a_transports import LinkLost, OpenFailed, Transport, UsbGadget

from ..suite import (
    PATIENCE_S,
    SETTLE_S,
    Background,
    BackToBack,
    read_exactly,
)
from .gadget import GADGETS, board, controllers, gone, raw, unbind, until

SERIAL = "G2"
UNKNOWN_REQUESTS = [
    # bmRequestType, bRequest, wIndex, data or length: vendor, class and reserved ones, to the
    # device, the interface, an endpoint, with and without data.
    *((0xC0, 1, 0, 10), (0x40, 1, 0, b"abc"), (0x40, 1, 0, None)),
    *((0xC1, 1, 0, 10), (0x41, 2, 0, b"abcd"), (0x41, 2, 0, None)),
    *((0xA1, 1, 0, 4), (0x21, 9, 0, b"\0"), (0xC1, 9, 1, 4), (0xC1, 1, 7, 4)),
    *((0xE1, 1, 0, 4), (0x80, 0x33, 0, 4), (0x81, 0x33, 0, 4)),
]


@pytest.fixture(scope="class")
def gadget() -> Iterator[UsbGadget]:
    with UsbGadget(serial=SERIAL) as gadget:
        yield gadget
    assert not list(GADGETS.iterdir())
    assert not list(Path("/run").glob("j2a-gadget*"))


def accepted(gadget: UsbGadget) -> Transport:
    transport = gadget.accept(PATIENCE_S)
    assert transport is not None
    return transport


@contextmanager
def device(gadget: UsbGadget) -> Iterator[Transport]:
    """The device on the bus; in the end it has left it."""
    with accepted(gadget) as transport:
        yield transport
    gone()


class TestUsb(BackToBack):
    """The suite that every transport passes."""

    # What is on its way when the bus ends it is dropped (USB-011).
    discards = frozenset({"near", "far"})

    @pytest.fixture(autouse=True)
    def there(self, gadget: UsbGadget) -> None:
        self.gadget = gadget

    @contextmanager
    def connect(self) -> Iterator[tuple[Transport, Transport]]:
        with (
            device(self.gadget) as far,
            j2a_transports.open(f"usb://{SERIAL}", wait=PATIENCE_S) as near,
        ):
            yield near, far

    def hang_up(self, end: str, transport: Transport) -> None:
        transport.close()
        if end == "near":
            # A board does not learn that a program has ended; the plug is what it sees.
            name = unbind(self.gadget)
            (GADGETS / "j2a/UDC").write_text(name)


@contextmanager
def echoing(gadget: UsbGadget) -> Iterator[list[Transport]]:
    """The device sends back all that it gets; yields the links it has had."""
    links: list[Transport] = []
    over = threading.Event()

    def serve() -> None:
        while not over.is_set():
            transport = gadget.accept(0.1)
            if transport is None:
                continue
            links.append(transport)
            try:
                while True:
                    transport.write(transport.read(None))
            except j2a_transports.TransportError:
                transport.close()

    thread = Background(serve)
    try:
        yield links
    finally:
        over.set()
        for transport in links:
            transport.close()
        thread.result()
        gone()


class TestOnTheBus:
    @pytest.mark.requirement("USB-001", "USB-004", "USB-005", "SYNC-001")
    def test_descriptors_and_strings(self, gadget: UsbGadget) -> None:
        with device(gadget):
            found = board(SERIAL)
            assert (found.vendor, found.product) == (0x6666, 0xCAFE)
            assert (found.manufacturer, found.name) == ("J2A", "J2A device")
            assert (found.speed, found.sync, found.problem) == (480, True, None)
            data = Path(f"/sys/bus/usb/devices/{found.port_path}/descriptors").read_bytes()
            head = descriptors.device.parse(data[:18])
            assert head.iSerialNumber
            frames, sync = descriptors.configuration.parse(data[18:]).interfaces
            assert {endpoint.bmAttributes for endpoint in frames.endpoints} == {descriptors.BULK}
            assert len(frames.endpoints) == 2
            assert (sync.bInterfaceSubClass, sync.bInterfaceProtocol) == (0x34, 0x01)
            (endpoint,) = sync.endpoints
            assert endpoint.bmAttributes == descriptors.INTERRUPT
            with raw(SERIAL) as host:
                assert usb.util.get_string(host.device, sync.iInterface) == "SyncUSB"
                assert usb.util.get_string(host.device, frames.iInterface) == "J2A"

    @pytest.mark.requirement("USB-007", "USB-014", "USB-009")
    def test_sizes_around_packets(self, gadget: UsbGadget) -> None:
        sizes = [*range(1, 6), 63, 64, 65, 511, 512, 513, 1023, 1024, 1025, 16383, 16384, 16385]
        with echoing(gadget), raw(SERIAL) as host:
            for size in [*sizes, 40000]:
                assert host.echoes(os.urandom(size)), size
            # A host that reads by packets sees the empty one.
            host.write(bytes(host.packet))
            assert len(host.read(host.packet)) == host.packet
            assert host.read(host.packet) == b""
            host.device.write(host.from_host, b"", 1000)
            assert host.echoes(b"and on")

    @pytest.mark.requirement("USB-006")
    def test_requests_that_are_not_known_stall_and_all_goes_on(self, gadget: UsbGadget) -> None:
        with echoing(gadget) as links, raw(SERIAL) as host:
            for kind, request, index, data in UNKNOWN_REQUESTS:
                with pytest.raises(usb.core.USBError, match="Pipe error"):
                    host.device.ctrl_transfer(kind, request, 0, index, data, 5000)
                status = host.device.ctrl_transfer(0x80, 0, 0, 0, 2, 5000)
                assert len(status) == 2, (kind, request)
            assert host.echoes(b"and on")
            assert len(links) == 1

    def test_halted_endpoints(self, gadget: UsbGadget) -> None:
        with echoing(gadget) as links, raw(SERIAL) as host:
            for endpoint in (host.from_host, host.to_host):
                host.device.ctrl_transfer(0x02, 3, 0, endpoint)
            with pytest.raises(usb.core.USBError, match="Pipe error"):
                host.device.write(host.from_host, b"x", 5000)
            for endpoint in (host.from_host, host.to_host):
                host.device.clear_halt(endpoint)
            assert host.echoes(b"and on")
            assert len(links) == 1

    @pytest.mark.requirement("USB-011")
    def test_a_configuration_and_a_reset_begin_anew(self, gadget: UsbGadget) -> None:
        with echoing(gadget) as links:
            with raw(SERIAL) as host:
                assert host.echoes(b"first")
                for number in (0, 1):
                    usb.util.release_interface(host.device, number)
                host.device.set_configuration(1)
                until(lambda: len(links) == 2)
                assert host.echoes(b"second")
            with raw(SERIAL) as host:
                host.device.reset()
            until(lambda: len(links) == 3)
            with raw(SERIAL) as host:
                assert host.echoes(b"third")

    @pytest.mark.requirement("SYNC-003")
    def test_the_time_of_the_host(self, gadget: UsbGadget) -> None:
        got: list[bytes] = []
        gadget.on_sync = got.append
        packets = [b"short", bytes(range(10)), bytes(11), bytes(range(10, 20))]
        with device(gadget), raw(SERIAL) as host:
            for packet in packets:
                host.device.write(host.sync, packet, 5000)
            until(lambda: len(got) == 2)
        gadget.on_sync = None
        assert got == [packets[1], packets[3]]

    def test_suspend_is_no_loss(self, gadget: UsbGadget) -> None:
        with echoing(gadget) as links:
            power = Path(f"/sys/bus/usb/devices/{board(SERIAL).port_path}/power")
            (power / "autosuspend_delay_ms").write_text("0")
            (power / "control").write_text("auto")
            until(lambda: (power / "runtime_status").read_text() == "suspended\n")
            with raw(SERIAL) as host:
                assert host.echoes(b"woken")
            assert len(links) == 1

    def test_another_program_takes_it_off_the_bus_in_the_middle_of_calls(
        self, gadget: UsbGadget
    ) -> None:
        with accepted(gadget) as transport:
            transport.write_timeout_s = None
            tasks = [
                Background(lambda: transport.read(None)),
                Background(lambda: transport.write(bytes(1 << 20))),
            ]
            time.sleep(SETTLE_S)
            name = unbind(gadget)
            for task in tasks:
                with pytest.raises(LinkLost):
                    task.result()
            gone()
            assert gadget.accept(0) is None
        (GADGETS / "j2a/UDC").write_text(name)
        with device(gadget) as transport, raw(SERIAL) as host:
            host.write(b"again")
            assert read_exactly(transport, 5) == b"again"

    @pytest.mark.requirement("USB-010")
    def test_a_device_that_does_not_read_keeps_the_host_waiting(self, gadget: UsbGadget) -> None:
        data = os.urandom(1 << 20)
        with device(gadget) as transport, raw(SERIAL) as host:
            writer = Background(lambda: host.write(data))
            time.sleep(10 * SETTLE_S)
            assert writer.thread.is_alive()
            assert read_exactly(transport, len(data)) == data
            writer.result()


class TestPrograms:
    """`j2a serve --listen gadget:` and how it ends."""

    @contextmanager
    def serving(self, *options: str) -> Iterator[subprocess.Popen[str]]:
        url = "gadget:?" + "&".join(options)
        with subprocess.Popen(
            ["j2a", "serve", "--listen", url],
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
        ) as process:
            try:
                assert process.stdout is not None
                assert re.match(r"listening on usb://6666:cafe/", process.stdout.readline())
                yield process
            finally:
                process.kill()

    def test_killed_and_started_again_and_ended(self) -> None:
        with self.serving("serial=K1") as process:
            assert board("K1").problem is None
            process.kill()
            process.wait()
        gone()
        assert (GADGETS / "j2a").is_dir()
        for number in (signal.SIGTERM, signal.SIGINT):
            with self.serving("serial=K2") as process:
                until(lambda: board("K2"))
                with pytest.raises(OpenFailed, match="another program is the gadget j2a"):
                    UsbGadget(serial="K3")
                with pytest.raises(OpenFailed, match="is used by the gadget j2a; free it with"):
                    UsbGadget(serial="K3", name="other")
                info = subprocess.run(
                    ["j2a", "info", "usb://K2"], capture_output=True, text=True, check=True
                )
                assert "J2A demo" in info.stdout
                process.send_signal(number)
                process.wait(PATIENCE_S)
            assert not list(GADGETS.iterdir())
            assert not list(Path("/run").glob("j2a-gadget*"))
            gone()

    def test_without_rights(self) -> None:
        code = (
            "import os, j2a_transports, j2a_transports._gadget.gadget as gadget; os.setuid(65534)\n"
            "try: gadget.UsbGadget()\n"
            "except j2a_transports.OpenFailed as error: print(error)"
        )
        done = subprocess.run(
            [sys.executable, "-c", code], check=False, capture_output=True, text=True
        )
        assert "run it as root, with sudo" in done.stdout, done.stderr


def test_two_controllers(dummy_hcd: Path) -> None:
    assert len(controllers(dummy_hcd, "num=2")) == 2
    with pytest.raises(OpenFailed, match=r"udc=dummy_udc\.0, udc=dummy_udc\.1"):
        UsbGadget()
    with (
        UsbGadget(serial="A", name="a", udc="dummy_udc.0") as first,
        UsbGadget(serial="B", name="b", udc="dummy_udc.1") as second,
        accepted(first) as one,
        accepted(second) as two,
        j2a_transports.open("usb://B") as host_of_two,
        j2a_transports.open("usb://A") as host_of_one,
    ):
        host_of_one.write(b"one")
        host_of_two.write(b"two")
        assert (read_exactly(one, 3), read_exactly(two, 3)) == (b"one", b"two")
    gone()


@pytest.fixture
def dummy_hcd() -> Path:
    return Path(os.environ["J2A_DUMMY_HCD"])
