"""libusb's asynchronous functions by ctypes, on the library that pyusb has loaded.

In: pyusb's libusb backend.  Out: `Libusb`, one method for each function that is needed, and the
layout of a transfer.
Rules: the functions get prototypes of their own, so that pyusb's stay as they are; no function
takes a `struct timeval`, whose size depends on how the system was built.
"""

from __future__ import annotations

import ctypes
import errno
from ctypes import POINTER, Structure, byref, c_int, c_ubyte, c_uint, c_void_p
from typing import TYPE_CHECKING, Any, Final

from .find import is_libusb

COMPLETED: Final = 0
TIMED_OUT: Final = 2
CANCELLED: Final = 3
STALL: Final = 4
NO_DEVICE: Final = 5
# What the other states of a transfer mean.
ERRORS: Final = {
    1: errno.EIO,
    STALL: errno.EPIPE,
    NO_DEVICE: errno.ENODEV,
    6: errno.EOVERFLOW,
}
# What the functions return, where an errno says more than "failed".
CODES: Final = {-4: errno.ENODEV, -5: errno.ENODEV, -9: errno.EPIPE, -11: errno.ENOMEM}
INTERRUPTED: Final = -10

BULK_TRANSFER: Final = 2
INTERRUPT_TRANSFER: Final = 3

# The calling convention that libusb declares; on Windows of 32 bits it is another.
_FUNCTION: Final = getattr(ctypes, "WINFUNCTYPE", ctypes.CFUNCTYPE)


class Transfer(Structure):
    """struct libusb_transfer, without the packets of isochronous transfers at its end."""


CALLBACK: Final = _FUNCTION(None, POINTER(Transfer))
Transfer._fields_ = [
    ("dev_handle", c_void_p),
    ("flags", c_ubyte),
    ("endpoint", c_ubyte),
    ("type", c_ubyte),
    ("timeout", c_uint),
    ("status", c_int),
    ("length", c_int),
    ("actual_length", c_int),
    ("callback", CALLBACK),
    ("user_data", c_void_p),
    ("buffer", c_void_p),
    ("num_iso_packets", c_int),
]

if TYPE_CHECKING:
    TransferPointer = ctypes._Pointer[Transfer]
else:
    TransferPointer = Any


class Libusb:
    """The functions of one libusb context.

    Args:
        library: the `ctypes.CDLL`.
        context: its `libusb_context *`.

    Raises:
        AttributeError: the library is older than 1.0.21 and lacks one.
    """

    def __init__(self, library: Any, context: c_void_p) -> None:
        self._context = context

        def function(name: str, result: Any, *arguments: Any) -> Any:
            return _FUNCTION(result, *arguments)((name, library))

        transfer = POINTER(Transfer)
        self._alloc = function("libusb_alloc_transfer", transfer, c_int)
        self._free = function("libusb_free_transfer", None, transfer)
        self._submit = function("libusb_submit_transfer", c_int, transfer)
        self._cancel = function("libusb_cancel_transfer", c_int, transfer)
        self._clear = function("libusb_clear_halt", c_int, c_void_p, c_ubyte)
        self._events = function("libusb_handle_events_completed", c_int, c_void_p, POINTER(c_int))
        self._interrupt = function("libusb_interrupt_event_handler", None, c_void_p)

    def alloc(self) -> TransferPointer:
        """Return a new transfer."""
        pointer: TransferPointer = self._alloc(0)
        if not pointer:
            raise MemoryError("libusb has no memory for a transfer")
        return pointer

    def free(self, transfer: TransferPointer) -> None:
        """Free a transfer that is not under way."""
        self._free(transfer)

    def submit(self, transfer: TransferPointer) -> None:
        """Start a transfer; its callback is called when it has ended, in whatever way."""
        check(self._submit(transfer))

    def cancel(self, transfer: TransferPointer) -> None:
        """Ask for a transfer back; one that has ended meanwhile is none to complain about."""
        self._cancel(transfer)

    def clear_halt(self, handle: Any, endpoint: int) -> None:
        """Clear the halt of an endpoint; not from a callback."""
        check(self._clear(handle, endpoint))

    def handle_events(self, stop: c_int) -> None:
        """Wait for an event and call the callbacks of what has ended; at once with `stop` set."""
        code = self._events(self._context, byref(stop))
        if code != INTERRUPTED:
            check(code)

    def interrupt(self) -> None:
        """Make `handle_events` return in the threads that wait there."""
        self._interrupt(self._context)


def check(code: int) -> None:
    """Raise an OSError for a result of libusb that is one."""
    if code < 0:
        raise OSError(CODES.get(code, errno.EIO), f"libusb error {code}")


def asynchronous(device: Any) -> tuple[Libusb, Any] | None:
    """Return the functions and the handle of an open device, or None where they are not to be had.

    Args:
        device: a `usb.core.Device`.
    """
    backend = device.backend
    try:
        if not is_libusb(backend):
            return None
        # pyusb keeps both to itself; another version of it may have them elsewhere.
        return Libusb(backend.lib, backend.ctx), device._ctx.handle.handle
    except AttributeError:
        return None
