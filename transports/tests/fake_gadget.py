"""A USB device port in memory: configfs in a folder, FunctionFS, and a host at the other end.

In: what a gadget does to the system, what a test does as host.  Out: the same effects on both.
Rules: configfs has the files that the kernel makes and refuses to remove what is in use; an
endpoint moves packets, blocks until its transfer is over, and fails where the kernel's would.
"""

from __future__ import annotations

import errno
import os
import shutil
import socket
import struct
import threading
import time
from collections import deque
from pathlib import Path

import pytest
from j2a_transports import LinkClosed, LinkLost, Transport, WriteTimeout
from j2a_transports._gadget.descriptors import Event
from j2a_transports._gadget.kernel import Kernel

UDC = "fake_udc.0"
ATTRIBUTES = ("UDC", "idVendor", "idProduct", "bcdDevice", "bcdUSB", "max_speed")


def failure(number: int) -> OSError:
    return OSError(number, os.strerror(number))


class Endpoint:
    """Packets on their way in one direction.

    Attributes:
        room: how many packets the host may have on the way before it is NAKed.
        sizes: what the gadget asked for in its reads.
    """

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self.packets: deque[bytes] = deque()
        self.room = 64
        self.sizes: list[int] = []

    def receive(self, size: int) -> bytes:
        """The gadget reads: a transfer ends with a short packet or a full buffer."""
        with self._bus.changed:
            self.sizes.append(size)
            session = self._enabled()
            got = b""
            while True:
                if self._bus.session != session:
                    raise failure(errno.ESHUTDOWN)
                if self._bus.fault is not None:
                    raise self._bus.fault
                if not self.packets:
                    self._bus.changed.wait()
                    continue
                packet = self.packets.popleft()
                self._bus.changed.notify_all()
                got += packet
                if len(packet) < self._bus.packet or len(got) >= size:
                    return got[:size]

    def send(self, data: bytes) -> None:
        """The gadget writes: it takes as long as the host takes to read all packets."""
        with self._bus.changed:
            session = self._enabled()
            size = self._bus.packet
            own = [data[at : at + size] for at in range(0, len(data), size)] or [b""]
            self.packets.extend(own)
            self._bus.changed.notify_all()
            while self.packets and self._bus.session == session:
                self._bus.changed.wait()
            if self._bus.session != session:
                raise failure(errno.ESHUTDOWN)

    def _enabled(self) -> int:
        if self._bus.session is None:
            raise failure(errno.EAGAIN)
        return self._bus.session


class Bus:
    """The cable, and what the controller knows.

    Attributes:
        session: number of the present configuration, None while there is none.
        fault: what every call on the endpoint from the host fails with.
        stalled: the direction of each control request that the gadget stalled.
    """

    def __init__(self) -> None:
        self.changed = threading.Condition()
        self.packet = 64
        self.session: int | None = None
        self.fault: OSError | None = None
        self._sessions = 0
        self.stalled: list[str] = []
        self.to_host, self.from_host, self.sync = Endpoint(self), Endpoint(self), Endpoint(self)
        self.events: socket.socket | None = None

    def tell(self, event: Event, setup: bytes = bytes(8)) -> None:
        if self.events is not None:
            self.events.send(struct.pack("<8sB3x", setup, event))

    def configure(self) -> None:
        """The host sets the configuration; all endpoints begin anew."""
        self._end()
        with self.changed:
            self._sessions += 1
            self.session = self._sessions
        self.tell(Event.ENABLE)

    def disable(self, event: Event = Event.DISABLE) -> None:
        """The device is reset, unplugged, or leaves the bus."""
        self._end()
        self.tell(event)

    def rebind(self) -> None:
        """The device leaves the bus and comes back before the gadget has read an event.

        The kernel drops UNBIND for BIND then (__ffs_event_add in its f_fs.c).
        """
        self._end()
        self.tell(Event.BIND)

    def _end(self) -> None:
        with self.changed:
            self.session = None
            for endpoint in (self.to_host, self.from_host, self.sync):
                endpoint.packets.clear()
            self.changed.notify_all()


class FakeKernel(Kernel):
    """Linux with one device controller in a folder.

    Attributes:
        bus: what the gadget is connected to.
        has: modules that there are.
        descriptors: the blocks that `ep0` was given.
        configures: whether a host is there, which configures every device that appears.
        bind_error: error number of the next bindings.
        root: whether the program runs as root.
    """

    def __init__(self, folder: Path) -> None:
        self.config = folder / "config"
        self.controllers = folder / "udc"
        self.run = folder / "run"
        for path in (self.config, self.controllers / UDC, self.run):
            path.mkdir(parents=True, exist_ok=True)
        self.bus = Bus()
        self.has = {"configfs", "libcomposite", "usb_f_fs"}
        self.descriptors: list[bytes] = []
        self.configures = True
        self.bind_error: int | None = None
        self.bound = False
        self.root = True
        self._mounts: set[Path] = set()
        self._names: dict[int, str] = {}
        self._loaded: set[str] = set()

    def is_root(self) -> bool:
        return self.root

    # modules and mounts

    def load(self, module: str) -> None:
        if module in self.has:
            self._loaded.add(module)
            self._gadgets()

    def _gadgets(self) -> None:
        if "libcomposite" in self._loaded and self.config in self._mounts:
            (self.config / "usb_gadget").mkdir(exist_ok=True)

    def mount(self, kind: str, source: str, target: Path) -> None:
        module = {"configfs": "configfs", "functionfs": "usb_f_fs"}[kind]
        if module not in self.has:
            raise failure(errno.ENODEV)
        assert target not in self._mounts
        self._mounts.add(target)
        if kind == "configfs":
            self._gadgets()
        else:
            assert (self.config / "usb_gadget" / source / "functions" / f"ffs.{source}").is_dir()

    def unmount(self, target: Path) -> None:
        if self.bound or self._names:
            raise failure(errno.EBUSY)
        self._mounts.remove(target)

    def is_mounted(self, target: Path) -> bool:
        return target in self._mounts

    # FunctionFS

    def open(self, path: Path) -> int:
        assert path.parent in self._mounts
        if path.name == "ep0":
            assert self.bus.events is None
            self.descriptors = []
            near, self.bus.events = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            number = near.detach()
        else:
            assert len(self.descriptors) == 2, "descriptors and strings come first"
            number = os.open(os.devnull, os.O_RDWR)
        self._names[number] = path.name
        return number

    def close(self, number: int) -> None:
        if self._names.pop(number) == "ep0" and self.bus.events is not None:
            self.bus.events.close()
            self.bus.events = None
        super().close(number)

    def receive(self, endpoint: int, size: int) -> bytes:
        name = self._names[endpoint]
        if name != "ep0":
            return (self.bus.from_host if name == "ep2" else self.bus.sync).receive(size)
        if size == 0:
            self.bus.stalled.append("to host")
            raise failure(errno.EL2HLT)
        return os.read(endpoint, size)

    def send(self, endpoint: int, data: bytes) -> None:
        if self._names[endpoint] != "ep0":
            self.bus.to_host.send(data)
        elif data:
            self.descriptors.append(data)
        else:
            self.bus.stalled.append("from host")
            raise failure(errno.EL2HLT)

    def packet_size(self, endpoint: int) -> int:
        if self.bus.session is None:
            raise failure(errno.ENODEV)
        return self.bus.packet

    # configfs

    def make(self, folder: Path) -> None:
        if folder.parent.name == "functions" and "usb_f_fs" not in self.has:
            raise failure(errno.ENOENT)
        folder.mkdir()
        names: tuple[str, ...] = ()
        if folder.parent.name == "usb_gadget":
            names = ATTRIBUTES
            for group in ("functions", "configs", "strings"):
                (folder / group).mkdir()
        elif folder.parent.name == "strings":
            names = ("manufacturer", "product", "serialnumber")
        for name in names:
            (folder / name).touch()

    def remove(self, folder: Path) -> None:
        made = [folder / group for group in ("functions", "configs", "strings")]
        if any(path.is_dir() and list(path.iterdir()) for path in made):
            raise failure(errno.ENOTEMPTY)
        gadget = folder.parent.parent
        if folder.parent.name == "functions" and list(gadget.glob(f"configs/*/{folder.name}")):
            raise failure(errno.EBUSY)
        if any(path.is_symlink() for path in folder.iterdir()):
            raise failure(errno.ENOTEMPTY)
        shutil.rmtree(folder)

    def write(self, path: Path, text: str) -> None:
        if path.name == "UDC":
            self._bind(path, text.strip())
        path.write_text(text) if path.exists() else self._no_attribute(path)

    def _no_attribute(self, path: Path) -> None:
        raise FileNotFoundError(errno.ENOENT, "No such file or directory", str(path))

    def _bind(self, path: Path, name: str) -> None:
        if not name:
            if not self.bound:
                raise failure(errno.ENODEV)
            self.bound = False
            self.bus.disable(Event.UNBIND)
            return
        if self.bound or self.bind_error is not None:
            raise failure(self.bind_error or errno.EBUSY)
        assert len(self.descriptors) == 2
        assert [link.resolve() for link in path.parent.glob("configs/*/ffs.*")]
        self.bound = True
        self.bus.tell(Event.BIND)
        if self.configures:
            self.bus.configure()


def installed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> FakeKernel:
    """Make a system in this folder the one that gadgets find."""
    kernel = FakeKernel(folder)
    monkeypatch.setattr("j2a_transports._gadget.gadget.Kernel", lambda: kernel)
    return kernel


class Host(Transport):
    """A program on the host that has opened the device.

    Args:
        bus: what it is connected to.
        session: the configuration that it has set; None takes the present one.
    """

    def __init__(self, bus: Bus) -> None:
        super().__init__("host:")
        self._bus = bus
        self._session = bus.session
        self._closed = False
        self._writing = threading.Lock()

    def _wait(self, ready: bool, deadline: float | None) -> bool:
        """Check the link, then wait once; called with the lock of the bus."""
        if self._closed:
            raise LinkClosed("host: is closed")
        if not ready and self._bus.session != self._session:
            raise LinkLost("host: is lost: the device is gone")
        if ready:
            return True
        left = None if deadline is None else deadline - time.monotonic()
        if left is not None and left <= 0:
            return False
        self._bus.changed.wait(left)
        return True

    def read(self, timeout_s: float | None) -> bytes:
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        packets = self._bus.to_host.packets
        with self._bus.changed:
            while True:
                if not self._wait(bool(packets), deadline):
                    return b""
                if packets:
                    data = packets.popleft()
                    self._bus.changed.notify_all()
                    if data:
                        return data

    def write(self, data: bytes | bytearray | memoryview) -> None:
        rest = bytes(data)
        packets = [rest[at : at + 64] for at in range(0, len(rest), 64)]
        if rest and len(rest) % 64 == 0:
            packets.append(b"")
        with self._writing:
            for packet in packets:
                self.write_packet(packet)
            with self._bus.changed:
                self._wait(self._bus.session == self._session, 0)

    def write_packet(self, packet: bytes) -> None:
        limit = self.write_timeout_s
        deadline = None if limit is None else time.monotonic() + limit
        target = self._bus.from_host
        with self._bus.changed:
            while True:
                room = self._bus.session == self._session and len(target.packets) < target.room
                if not self._wait(room, deadline):
                    raise WriteTimeout(f"host: took no byte for {limit} s: the device NAKs")
                if room:
                    target.packets.append(packet)
                    self._bus.changed.notify_all()
                    return

    @property
    def closed(self) -> bool:
        return self._closed

    def close(self) -> None:
        with self._bus.changed:
            self._closed = True
            self._bus.changed.notify_all()
