"""The Linux interface of a gadget: mounts, modules, configfs files, packets of an endpoint.

In: paths.  Out: `Kernel`, whose methods are all that touches the system, so that tests put a
folder in its place.
Rules: errors are `OSError`, as the system gives them.
"""

from __future__ import annotations

import ctypes
import os
import shutil
import socket
import struct
import subprocess
import sys
from pathlib import Path
from typing import Final

if sys.platform != "win32":
    import fcntl

# _IOR('g', 130, struct usb_endpoint_descriptor), whose size there is 9.
_ENDPOINT_DESCRIPTOR: Final = 2 << 30 | 9 << 16 | ord("g") << 8 | 130
_PACKET_AT: Final = 4


class Kernel:
    """The running Linux.

    Attributes:
        config: where configfs is mounted, or is to be.
        controllers: folder with one entry for each USB device controller.
        run: folder for mount points.
    """

    def __init__(self) -> None:
        self.config = Path("/sys/kernel/config")
        self.controllers = Path("/sys/class/udc")
        self.run = Path("/run")

    def is_root(self) -> bool:
        """Whether this program runs as root, which may do all the rest."""
        return os.geteuid() == 0

    def load(self, module: str) -> None:
        """Try to load a module; the caller sees whether what it brings is there."""
        program = shutil.which("modprobe", path="/usr/sbin:/sbin:/usr/bin:/bin")
        if program is not None:
            subprocess.run([program, "-q", module], check=False, capture_output=True)

    def mount(self, kind: str, source: str, target: Path) -> None:
        """Mount a file system of `kind` at `target`."""
        libc = ctypes.CDLL(None, use_errno=True)
        if libc.mount(source.encode(), os.fsencode(target), kind.encode(), 0, None):
            number = ctypes.get_errno()
            raise OSError(number, os.strerror(number), str(target))

    def unmount(self, target: Path) -> None:
        """Undo `mount`."""
        libc = ctypes.CDLL(None, use_errno=True)
        if libc.umount2(os.fsencode(target), 0):
            number = ctypes.get_errno()
            raise OSError(number, os.strerror(number), str(target))

    def is_mounted(self, target: Path) -> bool:
        """Whether something is mounted at `target`."""
        return os.path.ismount(target)

    def lock(self, name: str) -> socket.socket | None:
        """Return a lock that is held until it is closed; None if another program holds it.

        The system lets go of it when the program ends, however that happens, and it is no file.
        """
        lock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            lock.bind(f"\0{name}")
        except OSError:
            lock.close()
            return None
        return lock

    def open(self, path: Path) -> int:
        """Open an endpoint file; a call on an endpoint that is not enabled does not block."""
        return os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)

    def close(self, endpoint: int) -> None:
        """Undo `open`."""
        os.close(endpoint)

    def receive(self, endpoint: int, size: int) -> bytes:
        """Read from an endpoint file; b"" is an empty packet, or an event that is not there."""
        return os.read(endpoint, size)

    def send(self, endpoint: int, data: bytes) -> None:
        """Write to an endpoint file all at once; nothing is an empty packet."""
        os.write(endpoint, data)

    def packet_size(self, endpoint: int) -> int:
        """Return the packet size of an enabled endpoint at the speed of the bus, in bytes."""
        descriptor = bytearray(9)
        fcntl.ioctl(endpoint, _ENDPOINT_DESCRIPTOR, descriptor)
        (size,) = struct.unpack_from("<H", descriptor, _PACKET_AT)
        # The bits above are transactions per microframe, which bulk endpoints do not have.
        return int(size) & 0x7FF

    def make(self, folder: Path) -> None:
        """Make a folder of configfs; the kernel fills it."""
        folder.mkdir()

    def remove(self, folder: Path) -> None:
        """Remove a folder of configfs, which may hold only what the kernel made."""
        folder.rmdir()

    def link(self, target: Path, name: Path) -> None:
        """Make a symbolic link; configfs takes it for a reference."""
        name.symlink_to(target)

    def unlink(self, name: Path) -> None:
        """Remove a symbolic link."""
        name.unlink()

    def write(self, path: Path, text: str) -> None:
        """Set an attribute, in one write as configfs wants it."""
        descriptor = os.open(path, os.O_WRONLY | os.O_CLOEXEC)
        try:
            os.write(descriptor, text.encode())
        finally:
            os.close(descriptor)

    def read(self, path: Path) -> str:
        """Return an attribute without its line end, "" when it cannot be read."""
        try:
            return path.read_text().strip()
        except OSError:
            return ""
