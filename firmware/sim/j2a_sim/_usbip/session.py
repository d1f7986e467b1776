"""One client of the USB/IP server that has imported a board: its commands, and their results.

In: a connection after the import, and the host that the board is plugged into. Out: transfers on
the simulated bus, and their results on the connection.
Rules: results are sent by the thread that runs the board, in the order in which transfers end. The
client has its own idea of the device's address, so SET_ADDRESS goes no further than here; and as a
reset of its port is not told to us, it is seen by the request with which every operating system
begins after one: the device descriptor, 64 bytes of it.
"""

from __future__ import annotations

import contextlib
import errno
import select
import socket
import threading
import time
from collections.abc import Callable
from typing import Any, Final

from j2a_sim._errors import SimError
from j2a_sim._usb.descriptors import IN, SETUP
from j2a_sim._usb.driver import UsbHost
from j2a_sim._usb.transfer import GET_DESCRIPTOR, SET_ADDRESS, Transfer
from j2a_sim._usbip import protocol

LOOK_S: Final = 0.2  # how often a waiting thread looks whether it shall end
SEND_TIMEOUT_S: Final = 5.0
# An operating system begins at once; one that goes silent afterwards has nothing to do.
FIRST_COMMAND_S: Final = 30.0
MOST_PENDING: Final = 256
DESCRIPTOR_DEVICE: Final = 0x0100  # wValue of GET_DESCRIPTOR
FIRST_LOOK_LENGTH: Final = 64

_STATUS: Final = {
    "ok": 0,
    "stall": -errno.EPIPE,
    "no_answer": -errno.EPROTO,
    "overflow": -errno.EOVERFLOW,
    "cancelled": -errno.ECONNRESET,
    "invalid": -errno.EINVAL,
    "unplugged": -errno.ENODEV,
    "stopped": -errno.EPROTO,
}


class Gone(Exception):  # noqa: N818 - the name says what the client is
    """The client has closed the connection, or the server does."""


def receive(connection: socket.socket, size: int, stopped: Callable[[], bool]) -> bytes:
    """Read exactly so many bytes.

    Raises:
        Gone: the connection ended before, or `stopped` says so.
    """
    data = bytearray()
    while len(data) < size:
        if stopped():
            raise Gone
        try:
            if not select.select([connection], [], [], LOOK_S)[0]:
                continue
            chunk = connection.recv(size - len(data))
        except (OSError, ValueError):  # ValueError: closed meanwhile
            raise Gone from None
        if not chunk:
            raise Gone
        data += chunk
    return bytes(data)


class Session:
    """A client and its board.

    Args:
        connection: where the commands come from.
        host: the board's host; the board is plugged in.
        devid: by which the client names the board.
    """

    def __init__(self, connection: socket.socket, host: UsbHost, devid: int) -> None:
        self._connection, self._host, self._devid = connection, host, devid
        self._lock = threading.Lock()  # for the connection's sending side and what is pending
        self._pending: dict[int, Transfer] = {}
        self._unlinks: dict[int, int] = {}  # seqnum of the transfer: seqnum of the unlink
        self._closed = threading.Event()
        connection.settimeout(SEND_TIMEOUT_S)

    def close(self) -> None:
        """End it, from any thread; does not wait."""
        self._closed.set()
        with contextlib.suppress(OSError):  # it is gone already
            self._connection.shutdown(socket.SHUT_RDWR)

    def run(self) -> None:
        """Take commands until the client goes, or does not begin, or `close` is called.

        Raises:
            BadMessage: the client sent what is no command.
        """
        begun, end = False, time.monotonic() + FIRST_COMMAND_S

        def stopped() -> bool:
            return self._closed.is_set() or (not begun and time.monotonic() > end)

        try:
            while True:
                head = receive(self._connection, protocol.HEADER_SIZE, stopped)
                begun = True
                header = protocol.parse_command(head)
                data = receive(self._connection, protocol.following(header), stopped)
                if header.devid != self._devid:
                    raise protocol.BadMessage(f"device {header.devid:#x} was not imported")
                if header.command == protocol.CMD_UNLINK:
                    self._unlink(header)
                elif header.u.number_of_packets > 0:
                    self._send(protocol.returned(header.seqnum, -errno.EINVAL))
                else:
                    self._submit(header, data)
        except Gone:
            pass
        finally:
            self._closed.set()

    def _submit(self, header: Any, data: bytes) -> None:
        number, length = header.seqnum, header.u.transfer_buffer_length
        to_host = header.direction == protocol.DIR_IN
        transfer = Transfer(
            header.ep | (IN if to_host else 0),
            data=data,
            length=length,
            zero_packet=bool(header.u.transfer_flags & protocol.URB_ZERO_PACKET),
            on_done=lambda done: self._done(number, done),
        )
        if header.ep == 0:
            setup = SETUP.parse(header.u.setup)
            is_in = bool(setup.bmRequestType & IN)
            if setup.wLength != length or (length and is_in != to_host):
                self._send(protocol.returned(number, -errno.EINVAL))
                return
            kind = (setup.bmRequestType, setup.bRequest)
            if kind == (0x00, SET_ADDRESS):
                self._send(protocol.returned(number, 0))
                return
            if (*kind, setup.wValue, setup.wLength) == (
                *(0x80, GET_DESCRIPTOR),
                *(DESCRIPTOR_DEVICE, FIRST_LOOK_LENGTH),
            ):
                self._reset()
            transfer.endpoint, transfer.setup = 0, header.u.setup
        with self._lock:
            if number in self._pending:
                raise protocol.BadMessage(f"sequence number {number} is in use")
            if len(self._pending) >= MOST_PENDING:
                raise protocol.BadMessage(f"more than {MOST_PENDING} transfers at once")
            self._pending[number] = transfer
        self._host.submit(transfer)

    def _reset(self) -> None:
        with contextlib.suppress(SimError):  # the transfer that follows tells
            self._host.reset()

    def _unlink(self, header: Any) -> None:
        target = header.u.unlink_seqnum
        with self._lock:
            transfer = self._pending.get(target)
            if transfer is not None:
                self._unlinks[target] = header.seqnum
        if transfer is not None:
            self._host.cancel(transfer)
        else:
            self._send(protocol.unlinked(header.seqnum, 0))

    def _done(self, number: int, transfer: Transfer) -> None:
        """Send what became of a transfer, in the thread that runs the board."""
        with self._lock:
            self._pending.pop(number, None)
            unlink = self._unlinks.pop(number, None)
        status = _STATUS[transfer.status]
        # A kernel that takes a transfer back for a timeout drops what RET_UNLINK could not carry,
        # so what the device has sent, and has had acknowledged, goes back as a transfer that ended.
        if unlink is not None and transfer.status == "cancelled":
            if not transfer.received:
                self._send(protocol.unlinked(unlink, -errno.ECONNRESET))
                return
            status = 0
        to_host = (transfer.setup[0] if transfer.setup else transfer.endpoint) & IN
        actual = None if to_host else transfer.transferred
        self._send(protocol.returned(number, status, transfer.received, actual))
        if unlink is not None:
            self._send(protocol.unlinked(unlink, 0))

    def _send(self, data: bytes) -> None:
        with self._lock:
            if self._closed.is_set():
                return
            try:
                self._connection.sendall(data)
            except OSError:  # gone, or it does not read
                self._closed.set()
