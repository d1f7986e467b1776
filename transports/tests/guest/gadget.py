"""The gadget of the test guest: speeds of its controller, and the device as a host sees it.

In: the guest, whose dummy_hcd is a device controller and a host controller with a cable between.
Out: that controller at another speed or twice, and pyusb's view of a board on it.
Rules: what is here knows the guest's kernel; needs root.
"""

import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import usb.core
import usb.util
from j2a_transports import UsbBoard, UsbGadget, usb_boards
from j2a_transports._usb.find import libusb

PATIENCE_S = 60.0
PATIENCE_MS = 60_000
CONTROLLERS = Path("/sys/class/udc")
GADGETS = Path("/sys/kernel/config/usb_gadget")
# What the module is told for the speed that the host sees, in Mbit/s.
SPEEDS = {12: "is_high_speed=0", 480: "", 5000: "is_super_speed=1"}


def until(condition: Callable[[], Any]) -> Any:
    """Wait for what the kernel does."""
    deadline = time.monotonic() + PATIENCE_S
    while not (found := condition()):
        assert time.monotonic() < deadline
        time.sleep(0.01)
    return found


def board(serial: str) -> UsbBoard:
    """Wait for the board with this serial number and return it."""
    boards: list[UsbBoard] = until(
        lambda: [found for found in usb_boards() if found.serial == serial]
    )
    return boards[0]


def gone() -> None:
    """Wait until there is no board on the bus."""
    until(lambda: not usb_boards())


def controllers(module: Path, *parameters: str) -> list[str]:
    """Load the driver of the controller anew and return the names of its controllers.

    Args:
        module: file of dummy_hcd, which has to be in no use.
        parameters: what the module is told, such as `num=2`.
    """
    subprocess.run(["busybox", "rmmod", "dummy_hcd"], check=True)
    words = [word for word in parameters if word]
    subprocess.run(["busybox", "insmod", str(module), *words], check=True)
    return until(lambda: sorted(path.name for path in CONTROLLERS.iterdir()))


class Raw:
    """A board for a host that minds packets: plain pyusb, both interfaces claimed.

    Args:
        serial: its serial number.
    """

    def __init__(self, serial: str) -> None:
        found = board(serial)
        backend = libusb()
        self.device = until(
            lambda: usb.core.find(backend=backend, bus=found.bus, address=found.address)
        )
        frames, sync = list(self.device.get_active_configuration())
        endpoints = [endpoint.bEndpointAddress for endpoint in frames]
        (self.to_host,) = [number for number in endpoints if number & 0x80]
        (self.from_host,) = [number for number in endpoints if not number & 0x80]
        self.sync = sync[0].bEndpointAddress
        self.packet = frames[0].wMaxPacketSize
        for number in (0, 1):
            usb.util.claim_interface(self.device, number)

    def write(self, data: bytes) -> None:
        """Send these bytes and what has to end them."""
        self.device.write(self.from_host, data, PATIENCE_MS)
        if data and len(data) % self.packet == 0:
            self.device.write(self.from_host, b"", PATIENCE_MS)

    def read(self, size: int) -> bytes:
        """Make one transfer of at most `size` bytes."""
        return bytes(self.device.read(self.to_host, size, PATIENCE_MS))

    def echoes(self, data: bytes) -> bool:
        """Whether the board sends back what it is sent."""
        self.write(data)
        back = b""
        while len(back) < len(data):
            back += self.read(16384)
        return back == data

    def close(self) -> None:
        usb.util.dispose_resources(self.device)


@contextmanager
def raw(serial: str) -> Iterator[Raw]:
    """Open a board with plain pyusb."""
    host = Raw(serial)
    try:
        yield host
    finally:
        host.close()


def unbind(gadget: UsbGadget, name: str = "j2a") -> str:
    """Take a gadget off the bus as another program does; returns the controller for `bind`."""
    attribute = GADGETS / name / "UDC"
    controller = attribute.read_text().strip()
    attribute.write_text("\n")
    return controller
