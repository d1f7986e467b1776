"""USB devices in memory; `fake_usb_backend` is the bus that they are on.

In: what a test says about devices, and the bytes of their firmware.  Out: the devices, and their
end of each link as a `Transport`.
Rules: a device behaves as chapter 5 and 9 of the USB 2.0 specification say: bytes go in packets, a
short packet ends a transfer, a full buffer refuses packets (NAK), a halted endpoint stalls until
its halt is cleared, and what is unplugged answers nothing.
"""

from __future__ import annotations

import errno
import threading
from collections import deque
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import usb.backend
import usb.core
from j2a_transports import LinkClosed, LinkLost, Transport, WriteTimeout

# Packets that a device holds in each direction before it says NAK.
ROOM = 512


class Pipe:
    """One endpoint: packets on their way, and whether it is halted."""

    def __init__(self, device: FakeDevice, descriptor: SimpleNamespace) -> None:
        self.device = device
        self.address = descriptor.bEndpointAddress
        self.packet = descriptor.wMaxPacketSize
        self.packets: deque[bytes] = deque()
        self.halted = False
        self.failing = 0
        # Whether the firmware gives a bank back when it reads a byte of it, as that of 2014: an
        # empty packet then keeps its bank for good.
        self.needs_bytes = False
        self.wedged = False
        # All packets that ever came through, for what a test asserts of them.
        self.log: list[int] = []

    def push(self, packet: bytes) -> bool:
        """Add a packet; False when there is no room (NAK)."""
        if len(self.packets) >= ROOM or self.wedged:
            return False
        self.wedged = self.needs_bytes and not packet
        self.packets.append(packet)
        self.log.append(len(packet))
        self.device.changed.notify_all()
        return True

    def pull(self, room: int) -> bytes | None:
        """Take a packet; None when there is none (NAK)."""
        if not self.packets:
            return None
        if len(self.packets[0]) > room:
            raise usb_error(errno.EOVERFLOW)
        self.device.changed.notify_all()
        return self.packets.popleft()


class Job:
    """A transfer; `step` moves what can be moved now and tells whether it has ended."""

    def __init__(self, pipe: Pipe, data: bytes | int) -> None:
        self.pipe = pipe
        self.room = data if isinstance(data, int) else len(data)
        self.data = bytearray(b"" if isinstance(data, int) else data)
        self.done = 0

    def step(self) -> bool:
        pipe = self.pipe
        if pipe.device.gone:
            raise usb_error(errno.ENODEV)
        if pipe.device.reset:
            return True
        if pipe.failing:
            raise usb_error(pipe.failing)
        while True:
            if pipe.halted:
                raise usb_error(errno.EPIPE)
            if pipe.address & 0x80:
                packet = pipe.pull(self.room - self.done)
                if packet is None:
                    return False
                self.data += packet
                self.done += len(packet)
                if len(packet) < pipe.packet or self.done == self.room:
                    return True
            else:
                packet = bytes(self.data[self.done : self.done + pipe.packet])
                if not pipe.push(packet):
                    return False
                self.done += len(packet)
                if self.done == self.room:
                    return True


@dataclass(eq=False)
class FakeDevice:
    """A device; its interfaces are descriptors as pyusb wants them, see `interface`."""

    interfaces: list[SimpleNamespace]
    serial: str | None = "A1"
    vendor: int = 0x6666
    product: int = 0xCAFE
    bus: int = 1
    address: int = 4
    ports: tuple[int, ...] | None = (2, 3)
    speed: int = 2
    denied: bool = False
    # Interfaces that another program or a kernel driver has.
    busy: set[int] = field(default_factory=set)
    drivers: set[int] = field(default_factory=set)
    configuration: int = 1
    # What single requests raise, by the name of the backend's method.
    refuses: dict[str, Exception] = field(default_factory=dict)
    gone: bool = False
    # Whether another program has reset it: Linux ends transfers then as if they were complete.
    reset: bool = False
    calls: list[tuple[Any, ...]] = field(default_factory=list)
    handles: int = 0

    def __post_init__(self) -> None:
        self.changed = threading.Condition()
        self.pipes = {
            end.bEndpointAddress: Pipe(self, end)
            for each in self.interfaces
            for end in each.endpoints
        }

    def end(self, incoming: int = 0x02, outgoing: int = 0x81) -> DeviceEnd:
        """Return the device's side of a link."""
        return DeviceEnd(self, self.pipes[incoming], self.pipes[outgoing])

    def unplug(self) -> None:
        """Take it off the bus; what is not yet read is lost."""
        with self.changed:
            self.gone = True
            for pipe in self.pipes.values():
                if pipe.address & 0x80:
                    pipe.packets.clear()
            self.changed.notify_all()

    def reset_by_another(self) -> None:
        """Be reset, and claimed by nobody any more."""
        with self.changed:
            self.reset = True
            self.changed.notify_all()

    def halt(self, endpoint: int) -> None:
        """Halt an endpoint."""
        with self.changed:
            self.pipes[endpoint].halted = True
            self.changed.notify_all()

    def fail(self, number: int, *endpoints: int) -> None:
        """Let every transfer of these endpoints fail from now on, with this errno."""
        with self.changed:
            for endpoint in endpoints:
                self.pipes[endpoint].failing = number
            self.changed.notify_all()


def endpoint(address: int, kind: int = 2, packet: int = 64) -> SimpleNamespace:
    return SimpleNamespace(
        bLength=7,
        bDescriptorType=5,
        bEndpointAddress=address,
        bmAttributes=kind,
        wMaxPacketSize=packet,
        bInterval=1,
        bRefresh=0,
        bSynchAddress=0,
        extra_descriptors=[],
    )


def interface(
    number: int = 0,
    kind: tuple[int, int, int] = (0xFF, 0x12, 0xEF),
    endpoints: list[SimpleNamespace] | None = None,
    alternate: int = 0,
) -> SimpleNamespace:
    ends = [endpoint(0x81), endpoint(0x02)] if endpoints is None else endpoints
    return SimpleNamespace(
        bLength=9,
        bDescriptorType=4,
        bInterfaceNumber=number,
        bAlternateSetting=alternate,
        bNumEndpoints=len(ends),
        bInterfaceClass=kind[0],
        bInterfaceSubClass=kind[1],
        bInterfaceProtocol=kind[2],
        iInterface=0,
        extra_descriptors=[],
        endpoints=ends,
    )


SYNC = interface(1, (0xFF, 0x34, 0x01), [endpoint(0x03, 3, 16)])


def board(*, packet: int = 64, kind: int = 2, **settings: Any) -> FakeDevice:
    """Return a board with the two interfaces of J2A."""
    ends = [endpoint(0x81, kind, packet), endpoint(0x02, kind, packet)]
    return FakeDevice([interface(endpoints=ends), SYNC], **settings)


def usb_error(number: int) -> usb.core.USBError:
    kind = usb.core.USBTimeoutError if number == errno.ETIMEDOUT else usb.core.USBError
    return kind(errno.errorcode[number], None, number)


class DeviceEnd(Transport):
    """What the firmware of a device has: the other end of the two pipes."""

    def __init__(self, device: FakeDevice, incoming: Pipe, outgoing: Pipe) -> None:
        super().__init__("device:")
        self.device = device
        self._incoming = incoming
        self._outgoing = outgoing
        self._changed = device.changed
        self._writing = threading.Lock()
        self._closed = False

    def read(self, timeout_s: float | None) -> bytes:
        packets = self._incoming.packets
        with self._changed:
            self._changed.wait_for(
                lambda: any(packets) or self._closed or self.device.gone, timeout_s
            )
            if self._closed:
                raise LinkClosed("device: is closed")
            data = b"".join(packets)
            packets.clear()
            self._changed.notify_all()
            if not data and self.device.gone:
                raise LinkLost("device: is lost: unplugged")
            return data

    def write(self, data: bytes | bytearray | memoryview) -> None:
        data = bytes(data)
        size = self._outgoing.packet
        # A burst ends with a short packet, so with an empty one after full ones.
        packets = [data[at : at + size] for at in range(0, len(data) + 1, size)] if data else []
        with self._writing, self._changed:
            for packet in packets:
                self._changed.wait_for(
                    lambda: self._closed or self.device.gone or len(self._outgoing.packets) < ROOM,
                    self.write_timeout_s,
                )
                self._check()
                if not self._outgoing.push(packet):
                    raise WriteTimeout(f"device: took no byte for {self.write_timeout_s} s")
            self._check()

    def _check(self) -> None:
        if self._closed:
            raise LinkClosed("device: is closed")
        if self.device.gone:
            raise LinkLost("device: is lost: unplugged")

    @property
    def closed(self) -> bool:
        return self._closed

    def close(self) -> None:
        with self._changed:
            self._closed = True
            self._changed.notify_all()
