"""What a Linux kernel makes of the simulated boards: run in the guest by test_usbip.py.

In: the port of a USB/IP server on the host, which exports two boards with the firmware
firmware/sim/tests/firmware/usb_board.c, and a port where a connection has it begin to serve them.
Out: a line for each thing that is so, or an error.
"""

import errno
import socket
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import libusb_package
import usb.backend.libusb1
import usb.core
import usb.util

from .attach import Refused, attach, detach, device, wait_gone

HOST = "10.0.2.2"
BUSY = 2
HALT, HOLD, DETACH, STOP, KEEP, BURST = range(1, 7)
TIMEOUT_MS = 10_000


def backend() -> object:
    """Return libusb."""
    return usb.backend.libusb1.get_backend(find_library=lambda _: libusb_package.get_library_path())


def find(serial: str) -> usb.core.Device:
    """Open a board by its serial number, once the kernel has it."""
    device(serial)
    found = usb.core.find(backend=backend(), serial_number=serial)
    assert found is not None, serial
    found.default_timeout = TIMEOUT_MS
    return found


def echo(board: usb.core.Device, data: bytes) -> None:
    """Send a packet there and back."""
    assert board.write(0x02, data) == len(data)
    assert bytes(board.read(0x81, 64)) == data


def fails(number: int, function: Callable[..., object], *args: object) -> None:
    """Check the errno that a call fails with."""
    try:
        function(*args)
    except usb.core.USBError as error:
        assert error.errno == number, error
    else:
        raise AssertionError(f"{function} did not fail")


def reading(board: usb.core.Device) -> tuple[threading.Thread, list[int]]:
    """Read without an end in a thread; returns it and where it puts the errno."""
    errors: list[int] = []

    def read() -> None:
        try:
            board.read(0x81, 64, 0)
        except usb.core.USBError as error:
            errors.append(error.errno)

    thread = threading.Thread(target=read)
    thread.start()
    time.sleep(0.3)  # until it is in the kernel
    return thread, errors


def enumerated(folder: Path) -> None:
    """The kernel's own view, in sysfs."""

    def said(name: str) -> str:
        return (folder / name).read_text().strip()

    assert [said(n) for n in ("idVendor", "idProduct", "bcdDevice")] == ["6666", "cafe", "1234"]
    assert [said(n) for n in ("manufacturer", "product", "serial")] == ["J2A", "Echo", "SNA"]
    assert (said("speed"), said("bConfigurationValue"), said("bNumInterfaces")) == ("12", "1", "2")
    interfaces = [folder / f"{folder.name}:1.{n}" for n in (0, 1)]
    names = ("bInterfaceClass", "bInterfaceSubClass", "bInterfaceProtocol")
    kinds = [[(i / name).read_text().strip() for name in names] for i in interfaces]
    assert kinds == [["ff", "12", "ef"], ["ff", "34", "01"]]
    assert (interfaces[1] / "interface").read_text().strip() == "SyncUSB"


def transfers(board: usb.core.Device) -> None:
    """Echoes, timeouts, halts, requests, reset, configuration."""
    for size in (0, 1, 63, 64, *range(2, 62)):
        echo(board, bytes(range(size)))
    fails(errno.ETIMEDOUT, board.read, 0x81, 64, 100)
    echo(board, b"after a timeout")
    board.ctrl_transfer(0x40, BURST, 128)
    assert len(board.read(0x81, 640, 500)) == 128, "what came before a timeout is lost"
    echo(board, b"after a part")
    board.write(0x03, b"0123456789")
    board.ctrl_transfer(0x40, KEEP, 0, 0, b"sixteen bytes...")
    assert bytes(board.ctrl_transfer(0xC0, KEEP, 0, 0, 64)) == b"sixteen bytes..."
    fails(errno.EPIPE, board.ctrl_transfer, 0xC0, 99, 0, 0, 8)
    for endpoint in (0x81, 0x02):
        board.ctrl_transfer(0x40, HALT, endpoint)
        call = (board.read, 0x81, 64) if endpoint & 0x80 else (board.write, 0x02, b"x")
        fails(errno.EPIPE, *call)
        board.clear_halt(endpoint)
        echo(board, b"after a halt")
    print("transfers")
    # A board that holds its bytes lets go of them only at a bus reset.
    board.ctrl_transfer(0x40, HOLD, 1)
    board.write(0x02, b"held")
    board.reset()
    echo(board, b"after a reset")
    print("reset")
    usb.util.dispose_resources(board)
    for _ in range(2):
        board.set_configuration()
        echo(board, b"odd number of packets")
        usb.util.dispose_resources(board)
    print("configuration")


def main() -> None:
    """Attach, use and lose the boards."""
    port, bell = map(int, sys.argv[1:])
    socket.create_connection((HOST, bell)).close()
    began_s = time.monotonic()
    first = attach(HOST, port, "1-1")
    folder = device("SNA")
    print(f"enumerated after {time.monotonic() - began_s:.2f} s")
    enumerated(folder)
    try:
        attach(HOST, port, "1-1")
    except Refused as error:
        assert error.args == (BUSY,)
    else:
        raise AssertionError("a board was given twice")
    board = find("SNA")
    transfers(board)

    thread, errors = reading(board)
    detach(first)
    thread.join(10)
    assert errors == [errno.ENODEV], errors
    usb.util.dispose_resources(board)
    wait_gone(folder)
    print("unplugged in mid call")

    # The server notices within moments that the kernel has let go of the board.
    end = time.monotonic() + 10
    while True:
        try:
            first = attach(HOST, port, "1-1")
            break
        except Refused:
            assert time.monotonic() < end
            time.sleep(0.05)
    attach(HOST, port, "1-2")
    boards = [find("SNA"), find("SNB")]
    boards[0].ctrl_transfer(0x40, HOLD, 1)
    boards[0].write(0x02, b"held")
    for i in range(50):
        echo(boards[1], bytes([i]))
    boards[0].ctrl_transfer(0x40, HOLD, 0)
    assert bytes(boards[0].read(0x81, 64)) == b"held"
    print("two boards")

    folder = device("SNA")
    thread, errors = reading(boards[0])
    boards[0].ctrl_transfer(0x40, DETACH)
    thread.join(10)
    assert errors in ([errno.ENODEV], [errno.EIO]), errors
    usb.util.dispose_resources(boards[0])
    wait_gone(folder)
    echo(boards[1], b"still there")
    print("a board that went by itself")


if __name__ == "__main__":
    main()
