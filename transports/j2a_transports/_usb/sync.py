"""SyncUSB: the interface by which a program gives boards the time, beside the program that owns
their link.

In: a pyusb backend, or none for libusb.  Out: `SyncPort`s, one for each board with the interface.
Rules: the board is told by the class of the interface (LINKS.md, SYNC-001); only that interface is
claimed, so another program may have the link meanwhile; each transfer has a time limit.
"""

from __future__ import annotations

import contextlib
import errno
import os
import struct
from pathlib import Path
from typing import Any, Final, NamedTuple

from j2a_transports._base import LinkLost, OpenFailed, WriteTimeout

from .board import SYNC_CLASS
from .claim import dispose, explained
from .find import (
    SPEEDS,
    SYSFS,
    class_of,
    devices,
    is_libusb,
    libusb,
    strings_of_device,
    strings_of_sysfs,
)

__all__ = ["FrameSeen", "SyncPort", "sync_ports"]

# bmRequestType of a request to the interface: to the host, vendor (LINKS.md, SYNC-006).
_ASK: Final = 0xC1
_GET_FRAME: Final = 1
_REPLY: Final = struct.Struct("<HHH")
_PACKET: Final = struct.Struct("<QH")
_TIMEOUT_MS: Final = 500
NO_FRAME: Final = 0xFFFF


class FrameSeen(NamedTuple):
    """What a board says of a request.

    Attributes:
        frame: number of the frame in which it came, modulo 2048.
        age_us: from the start of that frame to when the board took the request, in microseconds.
    """

    frame: int
    age_us: int


class SyncPort:
    """The interface SyncUSB of one board; not thread-safe.

    Args:
        device: a `usb.core.Device`.
        interface: the interface, as pyusb describes it.

    Attributes:
        name: bus and ports up to the board, such as "1-2.3", or bus and address.
        bus: number of the bus.
        frames: names what the frames come from; boards of equal names see the same frames.
        serial: serial number of the board, None where there is none.
    """

    def __init__(self, device: Any, interface: Any) -> None:
        ports = device.port_numbers
        self.bus: int = device.bus or 0
        self.name = (
            f"{self.bus}-{'.'.join(map(str, ports))}"
            if ports
            else f"{self.bus:03}:{device.address or 0:03}"
        )
        self.frames = frames_of(self.bus, self.name)
        self.speed = SPEEDS.get(device.speed or 0)
        self.key = (self.bus, device.address or 0, self.name)
        self.serial = _serial(device, self.name)
        self._device = device
        self._number: int = interface.bInterfaceNumber
        self._out: int = next(
            one.bEndpointAddress for one in interface if not one.bEndpointAddress & 0x80
        )
        self._undo = contextlib.ExitStack()

    def open(self) -> None:
        """Claim the interface.

        Raises:
            OpenFailed: the system or the board refuses; the message says what to do.
        """
        import usb.util  # noqa: PLC0415 - an extra; the device comes from it

        with contextlib.ExitStack() as undo, explained(f"SyncUSB of {self.name}"):
            undo.callback(dispose, self._device)
            usb.util.claim_interface(self._device, self._number)
            self._undo = undo.pop_all()

    def frame(self, nonce: int) -> FrameSeen | None:
        """Ask the board in which frame this request comes.

        Args:
            nonce: 0 to 65535; the reply has to repeat it.

        Returns: None from a board of 2014, which does not know the request, from one that has seen
            no frame lately, and for a reply that is not the one to this request.

        Raises:
            LinkLost: the board is gone.
        """
        try:
            reply = bytes(
                self._device.ctrl_transfer(
                    _ASK, _GET_FRAME, nonce, self._number, _REPLY.size, _TIMEOUT_MS
                )
            )
        except OSError as error:
            if error.errno in (errno.EPIPE, errno.ETIMEDOUT):
                return None
            raise LinkLost(f"SyncUSB of {self.name}: the board is gone") from error
        if len(reply) != _REPLY.size:
            return None
        echoed, frame, age_us = _REPLY.unpack(reply)
        return FrameSeen(frame, age_us) if echoed == nonce and frame < 2048 else None

    def send(self, time_us: int, frame: int) -> None:
        """Tell the board when a frame began (SYNC-002).

        Args:
            time_us: microseconds since 1970.
            frame: number of the frame that began then, modulo 2048.

        Raises:
            WriteTimeout: the board does not take the packet.
            LinkLost: the board is gone.
        """
        try:
            self._device.write(self._out, _PACKET.pack(time_us, frame), _TIMEOUT_MS)
        except OSError as error:
            if error.errno == errno.ETIMEDOUT:
                raise WriteTimeout(f"SyncUSB of {self.name} does not accept packets") from error
            raise LinkLost(f"SyncUSB of {self.name}: the board is gone") from error

    def close(self) -> None:
        """Give the interface back; idempotent."""
        self._undo.close()


def frames_of(bus: int, name: str, sysfs: Path = SYSFS) -> str:
    """Return what the frames of a board come from: its bus, or itself where it is far away.

    A hub of USB/IP (vhci_hcd) carries the packets of each of its boards to a bus of another
    computer, so its boards have nothing in common.

    Args:
        bus: number of the bus.
        name: bus and ports.
        sysfs: the folder with the devices.
    """
    is_virtual = "vhci_hcd" in os.fspath((sysfs / f"usb{bus}").resolve())
    return f"usb {name}" if is_virtual else f"usb bus {bus}"


def sync_ports(backend: Any = None) -> list[SyncPort]:
    """Return the boards with SyncUSB; opens none of them where the system knows their strings.

    Args:
        backend: a pyusb backend, None for libusb.

    Raises:
        MissingExtra: pyusb is not installed.
        OpenFailed: the devices cannot be listed.
    """
    found = []
    try:
        for device in devices(backend or libusb()):
            interface = _interface(device)
            if interface is not None:
                found.append(SyncPort(device, interface))
    except (OSError, NotImplementedError) as error:
        raise OpenFailed(f"usb: the devices cannot be listed: {error}") from error
    return sorted(found, key=lambda one: one.key)


def _interface(device: Any) -> Any:
    """Return the interface SyncUSB with its endpoint to the board, None where there is none."""
    # Gone meanwhile, or descriptors that contradict each other.
    with contextlib.suppress(OSError, NotImplementedError, IndexError):
        for configuration in device:
            for interface in configuration:
                is_out = any(not endpoint.bEndpointAddress & 0x80 for endpoint in interface)
                if class_of(interface) == SYNC_CLASS and is_out:
                    return interface
    return None


def _serial(device: Any, name: str) -> str | None:
    if is_libusb(device.backend):
        return strings_of_sysfs(SYSFS / name)[2]
    return strings_of_device(device)[0][2]
