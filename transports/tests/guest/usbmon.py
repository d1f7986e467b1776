"""What usbmon of the kernel tells of the transfers on a bus, as root.

In: the number of a bus. Out: its events since, with the times that the kernel noted.
Rules: times are turned into those of the monotonic clock; what the kernel dropped is an error.
"""

import ctypes
import fcntl
import os
import struct
import time
from dataclasses import dataclass
from typing import Self

GETX = 0x4018920A
"""MON_IOCX_GETX: take one event with its long header."""
RING_SIZE, SET_RING = 1 << 20, 0x9204
HEADER = struct.Struct("<QBBBBHBBqiiII8siiII")
ISOCHRONOUS = 0
MOST_EVENTS = 100_000


@dataclass(frozen=True)
class Event:
    """A transfer that was submitted, or has ended.

    Attributes:
        at_us: when, on the monotonic clock.
        endpoint: its address.
        start_frame: as the kernel has it; of isochronous transfers.
    """

    at_us: float
    is_completion: bool
    is_isochronous: bool
    endpoint: int
    start_frame: int


class Monitor:
    """Watches a bus.

    Args:
        bus: its number.
    """

    def __init__(self, bus: int) -> None:
        self._file = os.open(f"/dev/usbmon{bus}", os.O_RDONLY | os.O_NONBLOCK)
        fcntl.ioctl(self._file, SET_RING, RING_SIZE)
        self._real_less_monotonic_us = (time.time_ns() - time.monotonic_ns()) / 1000

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._file)

    def events(self) -> list[Event]:
        """Return what has happened since the last call."""
        header, data = ctypes.create_string_buffer(HEADER.size), ctypes.create_string_buffer(4096)
        request = struct.pack("<QQQ", ctypes.addressof(header), ctypes.addressof(data), len(data))
        found: list[Event] = []
        while len(found) < MOST_EVENTS:
            try:
                fcntl.ioctl(self._file, GETX, request)
            except BlockingIOError:
                return found
            fields = HEADER.unpack(header.raw)
            kind, transfer, endpoint = fields[1], fields[2], fields[3]
            seconds, microseconds = fields[8], fields[9]
            found.append(
                Event(
                    seconds * 1e6 + microseconds - self._real_less_monotonic_us,
                    kind == ord("C"),
                    transfer == ISOCHRONOUS,
                    endpoint,
                    fields[15],
                )
            )
        raise AssertionError(f"more than {MOST_EVENTS} events")
