"""libusb's asynchronous functions on USB devices in memory.

In: the transfers of the transport.  Out: their completions, on the devices of `fake_usb`.
Rules: as libusb's: transfers of an endpoint take turns in the order of their submission, each comes
back once by its callback, in a thread that handles events; none is freed or submitted under way.
"""

from __future__ import annotations

import ctypes
import errno
from types import SimpleNamespace
from typing import Any

import pytest
import usb.core
from j2a_transports._usb.libusb_async import CANCELLED, COMPLETED, NO_DEVICE, STALL, Transfer

from .fake_usb import FakeDevice, Job
from .fake_usb_backend import FakeBackend


def give_libusb(monkeypatch: pytest.MonkeyPatch) -> dict[FakeDevice, FakeLibusb]:
    """Let the transport find the asynchronous functions on fake devices; returns them by device."""
    made: dict[FakeDevice, FakeLibusb] = {}

    def asynchronous(device: Any) -> tuple[FakeLibusb, int]:
        handle = device._ctx.handle
        made[handle.dev] = FakeLibusb(handle.dev, device.backend)
        return made[handle.dev], handle.handle

    monkeypatch.setattr("j2a_transports._usb.link.asynchronous", asynchronous)
    return made


STATES = {errno.EPIPE: STALL, errno.ENODEV: NO_DEVICE, errno.EIO: 1, errno.EOVERFLOW: 6}


class FakeLibusb:
    """The functions of `libusb_async.Libusb` on a `FakeDevice`, with libusb's rules asserted."""

    def __init__(self, device: FakeDevice, backend: FakeBackend) -> None:
        self.device = device
        self.backend = backend
        self.allocated: dict[int, Any] = {}
        self.flying: list[tuple[Job, Any]] = []
        self.cancelled: set[int] = set()
        self.interrupted = False
        self.events_fail = False
        self.most = 0

    def alloc(self) -> Any:
        transfer = Transfer()
        self.allocated[ctypes.addressof(transfer)] = transfer
        return ctypes.pointer(transfer)

    def free(self, pointer: Any) -> None:
        assert all(other is not pointer for _, other in self.flying), "freed while under way"
        del self.allocated[ctypes.addressof(pointer.contents)]

    def submit(self, pointer: Any) -> None:
        transfer = pointer.contents
        with self.device.changed:
            if self.device.gone:
                raise OSError(errno.ENODEV, "gone")
            key = ctypes.addressof(transfer)
            assert all(ctypes.addressof(other.contents) != key for _, other in self.flying)
            pipe = self.device.pipes[transfer.endpoint]
            data: bytes | int = transfer.length
            if not transfer.endpoint & 0x80:
                data = ctypes.string_at(transfer.buffer, transfer.length)
            self.flying.append((Job(pipe, data), pointer))
            reading = [1 for job, _ in self.flying if job.pipe.address & 0x80]
            self.most = max(self.most, len(reading))
            self.device.changed.notify_all()

    def cancel(self, pointer: Any) -> None:
        key = ctypes.addressof(pointer.contents)
        with self.device.changed:
            # One that has ended is not found, although its callback may still be to come.
            if any(ctypes.addressof(other.contents) == key for _, other in self.flying):
                self.cancelled.add(key)
            self.device.changed.notify_all()

    def clear_halt(self, handle: Any, address: int) -> None:
        try:
            self.backend.clear_halt(SimpleNamespace(dev=self.device), address)
        except usb.core.USBError as error:
            raise OSError(error.errno, str(error)) from None

    def interrupt(self) -> None:
        with self.device.changed:
            self.interrupted = True
            self.device.changed.notify_all()

    def handle_events(self, stop: Any) -> None:
        with self.device.changed:
            while not (done := self._done()):
                if self.events_fail:
                    raise OSError(errno.EIO, "no events any more")
                if stop.value or self.interrupted:
                    self.interrupted = False
                    return
                self.device.changed.wait()
        for job, pointer, status in done:
            transfer = pointer.contents
            transfer.status = status
            transfer.actual_length = job.done
            if job.pipe.address & 0x80:
                ctypes.memmove(transfer.buffer, bytes(job.data), job.done)
            transfer.callback(pointer)

    def _done(self) -> list[tuple[Job, Any, int]]:
        """Move what can be moved; transfers of an endpoint take turns in their order."""
        done = []
        waiting: set[int] = set()
        for job, pointer in list(self.flying):
            key = ctypes.addressof(pointer.contents)
            status = None
            if key in self.cancelled:
                status = CANCELLED
            elif job.pipe.address not in waiting:
                try:
                    status = COMPLETED if job.step() else None
                except usb.core.USBError as error:
                    status = STATES[error.errno]
            if status is None:
                waiting.add(job.pipe.address)
                continue
            self.cancelled.discard(key)
            self.flying.remove((job, pointer))
            done.append((job, pointer, status))
        return done
