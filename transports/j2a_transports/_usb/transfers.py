"""The two endpoints by libusb's asynchronous API, several transfers under way each way.

In: the endpoints and bytes to send.  Out: the bytes that arrive, through a callback.
Rules: a thread of our own handles libusb's events; libusb may call our callback in any thread that
does so, hence the callback only notes, hands bytes on and submits again. While the user has not
read `LIMIT` bytes, nothing more is asked of the board. A transfer and its buffer live until libusb
has given it back; what it never gives back is kept for ever, rather than freed under its hands.
"""

from __future__ import annotations

import ctypes
import errno
import threading
from collections import deque
from collections.abc import Callable
from typing import Any, Final

from .find import Pair
from .libusb_async import (
    BULK_TRANSFER,
    CALLBACK,
    CANCELLED,
    COMPLETED,
    ERRORS,
    INTERRUPT_TRANSFER,
    NO_DEVICE,
    STALL,
    TIMED_OUT,
    Libusb,
    TransferPointer,
)
from .pipes import Ended, Endpoint, Pipes, Stuck, reset

LIMIT: Final = 65536
# How long cancelled transfers may take to come back.
BACK_S: Final = 5.0

_kept: list[AsyncPipes] = []


class _Slot:
    """A transfer with its buffer; `flying` from its submission until libusb gives it back."""

    def __init__(self, api: Libusb, handle: Any, end: Endpoint, callback: Any) -> None:
        self.pointer: TransferPointer = api.alloc()
        self.buffer = ctypes.create_string_buffer(end.size)
        self.flying = False
        transfer = self.pointer.contents
        transfer.dev_handle = handle
        transfer.endpoint = end.address
        transfer.type = BULK_TRANSFER if end.bulk else INTERRUPT_TRANSFER
        transfer.timeout = 0
        transfer.callback = callback
        transfer.buffer = ctypes.addressof(self.buffer)

    @property
    def status(self) -> int:
        """How the transfer has ended; one that sends has not `COMPLETED` before all has gone.

        Linux ends the transfers so when another program resets the device.
        """
        transfer = self.pointer.contents
        short = transfer.actual_length < transfer.length and not transfer.endpoint & 0x80
        return NO_DEVICE if transfer.status == COMPLETED and short else transfer.status

    @property
    def count(self) -> int:
        count: int = self.pointer.contents.actual_length
        return count


class AsyncPipes(Pipes):
    """Pipes on libusb; see `Pipes`. `received` must not block.

    Args:
        api: the functions.
        handle: libusb's handle of the device.
        pair: the endpoints.
        received: see `Pipes`.
        lost: see `Pipes`.
        ours: see `Pipes`.
        count: transfers under way in each direction.
    """

    def __init__(
        self,
        api: Libusb,
        handle: Any,
        pair: Pair,
        received: Callable[[bytes], None],
        lost: Callable[[], None],
        *,
        ours: Callable[[], bool],
        count: int,
    ) -> None:
        super().__init__(pair, received, lost, ours)
        self._api = api
        self._handle = handle
        self._changed = threading.Condition()
        self._callback = CALLBACK(self._given_back)
        self._slots: dict[int, _Slot] = {}
        # Transfers at hand; and those that read, in the order in which they were submitted.
        self._to_read = [self._new_slot(self.incoming) for _ in range(count)]
        self._to_write = [self._new_slot(self.outgoing) for _ in range(count)]
        self._reading: deque[_Slot] = deque()
        # The empty packet that ends a write, left under way where the board takes its time.
        self._zlps: deque[_Slot] = deque()
        self._unread = 0
        self._halted = False
        self._ended = False
        self._told = False
        self._stopping = False
        # libusb looks at it before it waits: set when the thread has something else to do.
        self._attention = ctypes.c_int(0)
        self._thread = threading.Thread(target=self._run, name="usb events", daemon=True)
        self._thread.start()  # first: without it no transfer would come back
        with self._changed:
            self._ask()

    def _new_slot(self, end: Endpoint) -> _Slot:
        slot = _Slot(self._api, self._handle, end, self._callback)
        self._slots[ctypes.addressof(slot.pointer.contents)] = slot
        return slot

    # Everything below but `_run` and the public methods is called with the lock held.

    def _submit(self, slot: _Slot, length: int) -> bool:
        slot.pointer.contents.length = length
        slot.pointer.contents.actual_length = 0
        slot.flying = True
        try:
            self._api.submit(slot.pointer)
        except OSError as error:
            slot.flying = False
            self._fail(error)
        return slot.flying

    def _ask(self) -> None:
        """Submit the transfers that shall read, as long as the user reads too."""
        if not self._reading and not self._ours():
            self._fail(reset())  # none was under way that could have told
        while self._to_read and not (self._ended or self._halted or self._unread >= LIMIT):
            slot = self._to_read.pop()
            if self._submit(slot, self.incoming.size):
                self._reading.append(slot)
            else:
                self._to_read.append(slot)

    def _given_back(self, pointer: TransferPointer) -> None:
        """Libusb's callback: this transfer has ended."""
        with self._changed:
            slot = self._slots[ctypes.addressof(pointer.contents)]
            slot.flying = False
            if slot in self._reading:
                self._hand_on()
            self._changed.notify_all()

    def _hand_on(self) -> None:
        """Hand on what has come, in the order of submission."""
        while self._reading and not self._reading[0].flying:
            slot = self._reading.popleft()
            self._to_read.append(slot)
            if slot.count:
                self.incoming.halts = 0
                self._unread += slot.count
                self._received(ctypes.string_at(slot.buffer, slot.count))
            if slot.status == STALL and not self._halted:
                self._halted = True
                self._take_back(self._reading)
            elif slot.status not in (COMPLETED, TIMED_OUT, CANCELLED, STALL):
                self._fail(_error(slot.status))
            elif not (slot.status or slot.count or self._ours()):
                self._fail(reset())
        self._ask()
        self._tell()
        if self._halted and not self._reading:
            self._wake()

    def _wake(self) -> None:
        self._attention.value = 1
        self._api.interrupt()

    def _take_back(self, slots: deque[_Slot]) -> None:
        # The last first: none of them may go while one before it does not.
        for slot in reversed(slots):
            if slot.flying:
                self._api.cancel(slot.pointer)

    def _fail(self, error: Exception) -> None:
        self.failure = self.failure or error
        self._end()
        self._tell()

    def _end(self) -> None:
        self._ended = True
        for slot in self._slots.values():
            if slot.flying:
                self._api.cancel(slot.pointer)
        self._changed.notify_all()

    def _tell(self) -> None:
        """Say that the link is lost, after the last byte."""
        if self.failure is not None and not self._reading and not self._told:
            self._told = True
            self._lost()

    def _run(self) -> None:
        while True:
            try:
                self._api.handle_events(self._attention)
            except OSError as error:
                # No transfer will come back any more, nor be waited for.
                with self._changed:
                    self._reading.clear()
                    self._fail(error)
                return
            with self._changed:
                if self._stopping:
                    return
                self._attention.value = 0
                recover = self._halted and not self._reading and not self._ended
            if recover:
                self._clear_halt(self.incoming)
                with self._changed:
                    self._halted = False
                    self._ask()

    def _clear_halt(self, end: Endpoint) -> None:
        """Clear a halt, or give the link up; without the lock, because it may handle events."""
        error: OSError | None = _error(STALL)
        if end.may_recover():
            try:
                self._api.clear_halt(self._handle, end.address)
                return
            except OSError as second:
                error = second
        with self._changed:
            self._fail(error or _error(STALL))

    def taken(self, count: int) -> None:
        """See `Pipes.taken`."""
        with self._changed:
            self._unread -= count
            self._ask()

    def write(self, data: memoryview, timeout_s: float | None) -> None:
        """See `Pipes.write`."""
        flying: deque[_Slot] = deque()
        sent = 0
        with self._changed:
            # Bytes follow, so it is not needed; a halt meets the first of them again.
            self._recall(self._zlps)
        try:
            while True:
                with self._changed:
                    gone, status, finished = self._stream(data, sent, flying, timeout_s)
                    sent += gone
                    if finished:
                        return
                    if self._ended:
                        raise Ended
                    if status == CANCELLED and sent == len(data):
                        if self.outgoing.bulk:
                            self._leave_zlp()
                        return
                    if status == CANCELLED and not gone:
                        raise Stuck(sent)
                    if status not in (COMPLETED, CANCELLED, STALL):
                        self._fail(_error(status))
                        raise Ended
                if status == STALL:
                    self._clear_halt(self.outgoing)
        finally:
            # Only an exception from outside, such as Ctrl-C, leaves some.
            with self._changed:
                self._recall(flying)

    def _leave_zlp(self) -> None:
        slot = self._to_write.pop()
        if self._submit(slot, 0):
            self._zlps.append(slot)
        else:
            self._to_write.append(slot)

    def _stream(
        self, data: memoryview, start: int, flying: deque[_Slot], timeout_s: float | None
    ) -> tuple[int, int, bool]:
        """Send from `start` on until all has gone, or one transfer does not go through.

        Returns:
            How many bytes have gone, how the transfer that stopped it ended, whether that was all.
        """
        end = self.outgoing
        at = start
        gone = 0
        empty = end.bulk and len(data) % end.packet == 0
        while not self._ended:
            while self._to_write and (at < len(data) or empty):
                piece = data[at : at + end.size]
                slot = self._to_write.pop()
                ctypes.memmove(slot.buffer, bytes(piece), len(piece))
                if not self._submit(slot, len(piece)):
                    self._to_write.append(slot)
                    break
                flying.append(slot)
                at += len(piece)
                empty = empty and bool(piece)
            if not flying:
                return gone, COMPLETED, at == len(data) and not empty
            head = flying[0]
            self._changed.wait_for(lambda: self._ended or not flying[0].flying, timeout_s)
            if head.flying or head.status != COMPLETED:
                break
            self._to_write.append(flying.popleft())
            if head.count:
                end.halts = 0
            gone += head.count
        rest, status, whole = self._recall(flying)
        # All that was there to send may have gone in the very moment in which it was called back.
        return gone + rest, status, whole and at == len(data) and not empty

    def _recall(self, flying: deque[_Slot]) -> tuple[int, int, bool]:
        """Get transfers back; returns the bytes that went, the first bad end, whether all went."""
        self._take_back(flying)
        back = self._changed.wait_for(lambda: not any(slot.flying for slot in flying), BACK_S)
        if not back:
            self._fail(OSError(errno.EIO, "libusb does not give transfers back"))
        gone, status = 0, COMPLETED
        while flying:
            slot = flying.popleft()
            if slot.flying:
                continue
            self._to_write.append(slot)
            gone += slot.count
            status = slot.status if status == COMPLETED else status
        return gone, status, back and status == COMPLETED

    def cancel(self) -> None:
        """See `Pipes.cancel`."""
        with self._changed:
            self._end()

    def close(self) -> bool:
        """See `Pipes.close`."""
        with self._changed:
            self._end()
            back = self._changed.wait_for(
                lambda: not any(slot.flying for slot in self._slots.values()), BACK_S
            )
            self._stopping = True
            self._wake()
        self._thread.join(BACK_S)
        if not back or self._thread.is_alive():
            _kept.append(self)
            return False
        for slot in self._slots.values():
            self._api.free(slot.pointer)
        self._slots.clear()
        return True


def _error(status: int) -> OSError:
    number = ERRORS.get(status, errno.EIO)
    return OSError(number, f"transfer ended with state {status} of libusb")
