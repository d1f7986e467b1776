"""The three ways of the test guest to a board, for jobs that do the same over each of them.

In: the name of a way.  Out: a `Link` with a board behind it, which can be unplugged and plugged in.
Rules: the way is the kernel's own, and only what is beyond it is ours: a simulated chip behind
vhci-hcd, a gadget behind dummy_hcd, a virtual Bluetooth controller; boards in Python run in a
process of their own.
"""

import contextlib
import fcntl
import multiprocessing
import subprocess
from collections.abc import Iterator
from pathlib import Path

import attach
import bluetooth
import j2a_transports
from j2a_transports import UsbBoard, usb_boards

from j2a.demo import DemoDevice

HOST = "10.0.2.2"
# The switch of the port at the hub of dummy_hcd, whatever number the bus has.
ROOT_HUBS = Path("/sys/devices/platform/dummy_hcd.0")
DUMMY_PORT = "usb*/*-0:1.0/usb*-port1/disable"
CHANNEL = 5
CONNECTION_TIMEOUT = 8
USBDEVFS_RESET = 0x5514


class Link:
    """A way to one board.

    Args:
        url: what a host opens.
        store: how many bytes the board's function `store` keeps, at least.
    """

    def __init__(self, url: str, store: int) -> None:
        self.url = url
        self.store = store

    def unplug(self) -> None:
        """Take the board away, as a hand does that pulls the plug."""
        raise NotImplementedError

    def plug(self) -> None:
        """Bring it back."""
        raise NotImplementedError

    def reset(self) -> None:
        """Make the board's end of the link begin anew."""
        raise NotImplementedError

    def close(self) -> None:
        """End what was started for it."""


class UsbLink(Link):
    """A board on the guest's USB."""

    def boards(self) -> list[UsbBoard]:
        """Return the boards that are found on the bus."""
        return usb_boards()

    def reset(self) -> None:
        """Reset the port of the hub, as the program usbreset does."""
        (board,) = usb_boards()
        assert board.device_file is not None
        with Path(board.device_file).open("wb") as file:
            fcntl.ioctl(file, USBDEVFS_RESET)


class SimulatedLink(UsbLink):
    """A chip that the host simulates behind a USB/IP server.

    Args:
        port: of the server, at the host's 127.0.0.1.
        busid: which of its boards.
    """

    def __init__(self, port: int, busid: str = "1-1", url: str = "usb://?wait=30") -> None:
        super().__init__(url, 256)
        self._server = port
        self._busid = busid
        self.plug()

    def plug(self) -> None:
        self._hub_port = attach.attach(HOST, self._server, self._busid)

    def unplug(self) -> None:
        attach.detach(self._hub_port)

    def close(self) -> None:
        self.unplug()


class GadgetLink(UsbLink):
    """The demo device of the library behind FunctionFS."""

    def __init__(self) -> None:
        super().__init__("usb://?wait=30", 20_000)
        self._board = Board("gadget:?serial=G1")

    def close(self) -> None:
        self._board.close()

    def plug(self) -> None:
        (port,) = ROOT_HUBS.glob(DUMMY_PORT)
        port.write_text("0")

    def unplug(self) -> None:
        """Let the hub switch its only port off."""
        (port,) = ROOT_HUBS.glob(DUMMY_PORT)
        port.write_text("1")


class BluetoothLink(Link):
    """The demo device of the library at another controller's RFCOMM channel.

    Args:
        device: address of the device's controller, hci0.
        adapter: address of the host's, hci1.
    """

    def __init__(self, device: str, adapter: str) -> None:
        super().__init__(f"bt://{device}/{CHANNEL}?adapter={adapter}", 20_000)
        self._device = device
        self._board = Board(f"bt://{device}/{CHANNEL}")

    def unplug(self) -> None:
        """Let the connection end as that to a board that is out of reach."""
        command = ["hcitool", "-i", "hci1", "dc", self._device, str(CONNECTION_TIMEOUT)]
        subprocess.run(command, check=True)

    def plug(self) -> None:
        """It has never been away."""

    def reset(self) -> None:
        """Kill the board and start it anew."""
        self._board.close()
        self._board = Board(self._board.url)

    def close(self) -> None:
        self._board.close()


class Board:
    """The demo device of the library at `url`, in a process of its own."""

    def __init__(self, url: str) -> None:
        self.url = url
        context = multiprocessing.get_context("fork")
        self._process = context.Process(target=self._serve, daemon=True)
        self._process.start()

    def _serve(self) -> None:
        with j2a_transports.listen(self.url) as listener, DemoDevice() as device:
            device.serve_forever(listener)

    def close(self) -> None:
        """Take it away without a chance to say so."""
        self._process.kill()
        self._process.join()


@contextlib.contextmanager
def link(name: str) -> Iterator[Link]:
    """Make a way to a board: `gadget`, `bt`, or `usbip:PORT` with a server of the host."""
    kind, _, port = name.partition(":")
    with contextlib.ExitStack() as stack:
        way: Link
        if kind == "usbip":
            way = SimulatedLink(int(port))
        elif kind == "gadget":
            way = GadgetLink()
        else:
            way = BluetoothLink(*stack.enter_context(bluetooth.controllers()))
        stack.callback(way.close)
        yield way
