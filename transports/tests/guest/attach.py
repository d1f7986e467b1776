"""Attaches a board that a USB/IP server exports to this kernel, without the program usbip.

In: a server, and the kernel with vhci-hcd; needs root. Out: a USB device of this kernel.
Rules: the handshake is ours, then the connection is the kernel's. As a program, with HOST PORT
BUSID, it prints the port of the virtual hub, to which `detach` refers.
"""

import contextlib
import socket
import struct
import sys
import time
from pathlib import Path

VHCI = Path("/sys/devices/platform/vhci_hcd.0")
DEVICES = Path("/sys/bus/usb/devices")
VERSION, REQ_IMPORT, REP_IMPORT = 0x0111, 0x8003, 0x0003
RECORD = struct.Struct(">256s32sIIIHHHBBBBBB")
FREE = "004"  # what vhci's status says of a port without a device
PATIENCE_S = 30.0


class Refused(Exception):  # noqa: N818 - the name says what the server did
    """The server does not give the board; the first argument is its status."""


def _receive(connection: socket.socket, size: int) -> bytes:
    data = b""
    while len(data) < size:
        chunk = connection.recv(size - len(data))
        if not chunk:
            raise ConnectionError("the USB/IP server closed the connection")
        data += chunk
    return data


def import_board(host: str, port: int, busid: str) -> tuple[socket.socket, int, int]:
    """Take a board from a server.

    Returns:
        The connection, the number by which commands name the board, and its speed.

    Raises:
        Refused: there is no such board, or somebody else has it.
    """
    connection = socket.create_connection((host, port))
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    request = struct.pack(">HHI32s", VERSION, REQ_IMPORT, 0, busid.encode())
    connection.sendall(request)
    version, code, status = struct.unpack(">HHI", _receive(connection, 8))
    if (version, code) != (VERSION, REP_IMPORT) or status:
        connection.close()
        raise Refused(status)
    fields = RECORD.unpack(_receive(connection, RECORD.size))
    busnum, devnum, speed = fields[2:5]
    return connection, busnum << 16 | devnum, speed


def free_port() -> int:
    """Return a port of the virtual hub for full speed that has no device."""
    for line in (VHCI / "status").read_text().splitlines()[1:]:
        hub, port, status = line.split()[:3]
        if hub == "hs" and status == FREE:
            return int(port)
    raise OSError("all ports of vhci-hcd are taken")


def attach(host: str, port: int, busid: str) -> int:
    """Attach a board; returns its port on the virtual hub. The kernel enumerates it soon after."""
    connection, devid, speed = import_board(host, port, busid)
    with connection:  # the kernel keeps it open
        hub_port = free_port()
        (VHCI / "attach").write_text(f"{hub_port} {connection.fileno()} {devid} {speed}")
    return hub_port


def detach(hub_port: int) -> None:
    """Pull a board out of its port on the virtual hub."""
    (VHCI / "detach").write_text(str(hub_port))


def device(serial: str, patience_s: float = PATIENCE_S) -> Path:
    """Wait until the kernel has configured a board; returns its directory in sysfs.

    Raises:
        TimeoutError: it did not come.
    """
    end = time.monotonic() + patience_s
    while time.monotonic() < end:
        for folder in DEVICES.iterdir():
            with contextlib.suppress(OSError):
                if (folder / "serial").read_text().strip() == serial and (
                    folder / "bConfigurationValue"
                ).read_text().strip():
                    return folder
        time.sleep(0.02)
    raise TimeoutError(f"no USB device with serial number {serial} in {patience_s} s")


def wait_gone(folder: Path, patience_s: float = PATIENCE_S) -> None:
    """Wait until the kernel has removed a device.

    Raises:
        TimeoutError: it is still there.
    """
    end = time.monotonic() + patience_s
    while folder.exists():
        if time.monotonic() > end:
            raise TimeoutError(f"{folder} is still there after {patience_s} s")
        time.sleep(0.02)


if __name__ == "__main__":
    print(attach(sys.argv[1], int(sys.argv[2]), sys.argv[3]))
