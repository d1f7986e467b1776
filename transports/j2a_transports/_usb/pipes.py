"""The two endpoints of a claimed interface by pyusb's blocking calls, for any backend.

In: the endpoints and bytes to send.  Out: the bytes that arrive, through a callback.
Rules: sent bytes are never sent again and received bytes are never dropped, even if a transfer
times out; a halt is cleared once, a second one without a byte in between ends the link. On a bulk
endpoint a write ends with a short packet, so with a zero-length packet (ZLP) if its length is a
multiple of the packet size (USB-014); an interrupt endpoint never gets a ZLP (USB-015). A board
that has taken all bytes but not the ZLP is not stuck: the ZLP stays pending until the board takes
it or the next write makes it unnecessary.
`Pipes` is also what `transfers` implements.
"""

from __future__ import annotations

import errno
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, Final

from .find import BULK, Pair

# The most packets in a transfer: enough to fill some frames of the bus, few enough that a slow
# board completes one within any sensible write timeout.
PACKETS: Final = 64
# How long a blocking transfer waits between checks whether it must end.
SLICE_MS: Final = 100
SLICE_END_S: Final = 2.0
# How long each attempt to send a pending zero-length packet may hold up reading.
ZLP_RETRY_MS: Final = 5


class Stuck(Exception):  # noqa: N818 - the board is, which is no error here
    """The board took no byte for the write timeout; `sent` bytes of this write had gone before."""

    def __init__(self, sent: int) -> None:
        super().__init__(sent)
        self.sent = sent


class Ended(Exception):  # noqa: N818
    """The pipes were cancelled or lost during the call."""


class Endpoint:
    """What the transfers of one endpoint need to know.

    Attributes:
        address: with the direction in bit 7.
        bulk: whether it is a bulk endpoint, else an interrupt one.
        packet: largest packet in bytes.
        size: largest transfer in bytes, a multiple of the packet, so that nothing overflows.
        halts: how often it was halted since a byte has gone through.
    """

    def __init__(self, descriptor: Any) -> None:
        self.address: int = descriptor.bEndpointAddress
        self.bulk: bool = descriptor.bmAttributes & 3 == BULK
        # Zero in a broken descriptor would make empty transfers for ever.
        self.packet: int = descriptor.wMaxPacketSize & 0x7FF or 64
        self.size = self.packet * PACKETS
        self.halts = 0

    def may_recover(self) -> bool:
        """Count a halt; False when it is the second in a row."""
        self.halts += 1
        return self.halts == 1


class Pipes(ABC):
    """Both endpoints, moved by a thread of their own until `close`.

    Args:
        pair: the endpoints.
        received: takes what has arrived, in order; may block only where the driver says so.
        lost: is called once, after all bytes, when nothing more will arrive.
        ours: tells whether the interface is still claimed. Linux ends the transfers without an
            error when another program resets the device, and takes new ones as if nothing had been.

    Attributes:
        failure: why the link is lost; None as long as it is not.
    """

    def __init__(
        self,
        pair: Pair,
        received: Callable[[bytes], None],
        lost: Callable[[], None],
        ours: Callable[[], bool],
    ) -> None:
        self.incoming = Endpoint(pair.incoming)
        self.outgoing = Endpoint(pair.outgoing)
        self.failure: Exception | None = None
        self._received = received
        self._lost = lost
        self._ours = ours

    @abstractmethod
    def taken(self, count: int) -> None:
        """The user has read so many of the bytes."""

    @abstractmethod
    def write(self, data: memoryview, timeout_s: float | None) -> None:
        """Send all bytes, at least one; one thread at a time.

        Raises:
            Stuck: the board took nothing for so long.
            Ended: the pipes were cancelled or lost.
        """

    @abstractmethod
    def cancel(self) -> None:
        """End the transfers and the calls that wait for them, from any thread."""

    @abstractmethod
    def close(self) -> bool:
        """End the threads; False when the driver does not give the transfers back."""


def reset() -> OSError:
    """Return the error for a device that was reset by somebody else."""
    return OSError(errno.ENODEV, "another program has reset the device")


def timed_out(error: Exception) -> bool:
    """Tell whether pyusb, or a backend that is none of its own, says that the time is over."""
    return getattr(error, "errno", None) == errno.ETIMEDOUT or isinstance(error, TimeoutError)


class BlockingPipes(Pipes):
    """Pipes on a `usb.core.Device`; see `Pipes`. `received` may block."""

    def __init__(
        self,
        device: Any,
        pair: Pair,
        received: Callable[[bytes], None],
        lost: Callable[[], None],
        ours: Callable[[], bool],
    ) -> None:
        super().__init__(pair, received, lost, ours)
        self._device = device
        self._ended = threading.Event()
        self._telling = threading.Lock()
        self._writing = threading.Lock()
        self._zlp_pending = False
        self._reader = threading.Thread(target=self._read, name="usb reader", daemon=True)
        self._reader.start()

    def taken(self, count: int) -> None:
        """See `Pipes.taken`."""

    def _read(self) -> None:
        end = self.incoming
        while not self._ended.is_set():
            if self._zlp_pending:
                self._send_pending_zlp()
            try:
                data = bytes(self._device.read(end.address, end.size, SLICE_MS))
            except Exception as error:
                # A foreign backend may raise anything; whatever it is, it is a fault of the link.
                self._failed(end, error if self._ours() else reset())
                continue
            if data:
                end.halts = 0
                self._received(data)
            elif not self._ours():
                self._failed(end, reset())

    def _send_pending_zlp(self) -> None:
        """Try the pending ZLP once, unless a write begins, which makes it unnecessary."""
        if not self._writing.acquire(blocking=False):
            return
        try:
            if self._zlp_pending:
                self._device.write(self.outgoing.address, b"", ZLP_RETRY_MS)
                self._zlp_pending = False
        except Exception as error:
            # The next read or write meets any other error and handles it.
            self._zlp_pending = timed_out(error)
        finally:
            self._writing.release()

    def write(self, data: memoryview, timeout_s: float | None) -> None:
        """See `Pipes.write`."""
        with self._writing:
            self._zlp_pending = False
            self._write(data, timeout_s)

    def _write(self, data: memoryview, timeout_s: float | None) -> None:
        end = self.outgoing
        sent = 0
        last = False
        since = time.monotonic()
        while not last:
            if self._ended.is_set():
                raise Ended
            piece = data[sent : sent + end.size]
            left_ms = SLICE_MS
            if timeout_s is not None:
                left_ms = min(SLICE_MS, int((since + timeout_s - time.monotonic()) * 1000) + 1)
                if left_ms <= 0:
                    self._zlp_pending = sent == len(data)
                    if self._zlp_pending:
                        return
                    raise Stuck(sent)
            try:
                count = self._device.write(end.address, bytes(piece), left_ms)
            except Exception as error:
                # pyusb does not say what has gone before a halt; of one packet, nothing.
                self._failed(end, error if self._ours() else reset(), len(piece) <= end.packet)
                continue
            if count < len(piece) and not self._ours():
                self._failed(end, reset())
            if count:
                end.halts = 0
                since = time.monotonic()
            sent += count
            # A transfer that has timed out on the way was shorter than it should be.
            whole = count == len(piece)
            ends = not end.bulk or not piece or count % end.packet != 0
            last = whole and sent == len(data) and ends

    def _failed(self, end: Endpoint, error: Exception, again: bool = True) -> None:
        """Do what a failed transfer asks for: nothing, clear the halt, or end everything.

        Args:
            end: where it failed.
            error: what pyusb raised.
            again: whether the transfer can be repeated after a halt.
        """
        if timed_out(error):
            return
        if getattr(error, "errno", None) == errno.EPIPE and again and end.may_recover():
            try:
                self._device.clear_halt(end.address)
                return
            except Exception as second:
                error = second
        with self._telling:
            if self.failure is None:
                self.failure = error
                self._ended.set()
                self._lost()

    def cancel(self) -> None:
        """See `Pipes.cancel`."""
        self._ended.set()

    def close(self) -> bool:
        """See `Pipes.close`."""
        self.cancel()
        self._reader.join(SLICE_END_S)
        return not self._reader.is_alive()
