"""Isochronous transfers by usbfs, which pyusb does not let a program see whole.

In: the audio device of QEMU. Out: what a transfer returns, with its field start_frame.
Rules: a transfer has a deadline.
"""

import ctypes
import fcntl
import os
import time
from dataclasses import dataclass
from typing import Self

CLAIM, RELEASE, SET_INTERFACE = 0x8004550F, 0x80045510, 0x80085504
SUBMIT, REAP_NOW = 0x8038550A, 0x4008550D
AS_SOON_AS_POSSIBLE = 2
ISOCHRONOUS = 0
INTERFACE, SETTING, ENDPOINT, PACKET = 1, 1, 0x01, 192
PATIENCE_S = 20.0


class _Urb(ctypes.Structure):
    """struct usbdevfs_urb with one packet."""

    _fields_ = (
        ("type", ctypes.c_uint8),
        ("endpoint", ctypes.c_uint8),
        ("status", ctypes.c_int),
        ("flags", ctypes.c_uint),
        ("buffer", ctypes.c_void_p),
        ("buffer_length", ctypes.c_int),
        ("actual_length", ctypes.c_int),
        ("start_frame", ctypes.c_int),
        ("number_of_packets", ctypes.c_int),
        ("error_count", ctypes.c_int),
        ("signr", ctypes.c_uint),
        ("usercontext", ctypes.c_void_p),
        ("packet", ctypes.c_uint * 3),
    )


@dataclass(frozen=True)
class Completion:
    """A transfer that has ended.

    Attributes:
        at_us: when the program had it, on the monotonic clock.
        start_frame: what the kernel has left in that field.
    """

    at_us: float
    start_frame: int


class IsochronousOut:
    """The stream of samples to the audio device.

    Args:
        bus, address: of the device.
    """

    def __init__(self, bus: int, address: int) -> None:
        self._file = os.open(f"/dev/bus/usb/{bus:03}/{address:03}", os.O_RDWR)
        fcntl.ioctl(self._file, CLAIM, ctypes.c_uint(INTERFACE))
        fcntl.ioctl(self._file, SET_INTERFACE, (ctypes.c_uint * 2)(INTERFACE, SETTING))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        fcntl.ioctl(self._file, RELEASE, ctypes.c_uint(INTERFACE))
        os.close(self._file)

    def send(self, start_frame: int) -> Completion:
        """Make one transfer of one packet.

        Args:
            start_frame: what is in that field before.

        Raises:
            TimeoutError: it does not end.
        """
        data = ctypes.create_string_buffer(PACKET)
        urb = _Urb(
            type=ISOCHRONOUS,
            endpoint=ENDPOINT,
            flags=AS_SOON_AS_POSSIBLE,
            buffer=ctypes.addressof(data),
            buffer_length=PACKET,
            start_frame=start_frame,
            number_of_packets=1,
            packet=(PACKET, 0, 0),
        )
        fcntl.ioctl(self._file, SUBMIT, urb)
        end = time.monotonic() + PATIENCE_S
        pointer = ctypes.c_void_p()
        while True:
            try:
                fcntl.ioctl(self._file, REAP_NOW, pointer)
                break
            except BlockingIOError:
                if time.monotonic() > end:
                    raise TimeoutError("an isochronous transfer does not end") from None
        return Completion(time.monotonic_ns() / 1000, urb.start_frame)
