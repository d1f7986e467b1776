"""A J2A board on the USB: what tells it from other devices, and what is known of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

# Class, subclass and protocol of the interface that carries the bytes, and of SyncUSB.
LINK_CLASS: Final = (0xFF, 0x12, 0xEF)
SYNC_CLASS: Final = (0xFF, 0x34, 0x01)


@dataclass(frozen=True, slots=True)
class UsbBoard:
    """One J2A interface on the USB.

    Attributes:
        url: what `open` takes: the serial number where that is enough to tell the board, so that
            the name stays when it is plugged in elsewhere; else the path of ports.
        vendor: vendor id.
        product: product id.
        manufacturer: string of the device, None when there is none or it cannot be read.
        name: product string, likewise.
        serial: serial number, likewise.
        bus: number of the bus.
        address: address on the bus; another one after each plugging in.
        port_path: bus and ports up to the board, such as "1-2.3"; None where it is not known.
        speed: of the bus in Mbit/s (1.5, 12, 480 ...), None where it is not known.
        interface: number of the interface.
        device_file: such as "/dev/bus/usb/001/004"; None where there are no such files.
        sync: whether the board has the interface SyncUSB.
        problem: why the board cannot be opened and what to do; None when nothing is known of it.
    """

    url: str
    vendor: int
    product: int
    manufacturer: str | None
    name: str | None
    serial: str | None
    bus: int
    address: int
    port_path: str | None
    speed: float | None
    interface: int
    device_file: str | None
    sync: bool
    problem: str | None
