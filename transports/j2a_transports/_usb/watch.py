"""Hotplug: which boards come and go.

In: a pyusb backend, or none for libusb.  Out: `UsbArrived` and `UsbLeft`, one after the other.
Rules: the boards are looked for again and again, which works everywhere; Linux says at once when
something has changed. A board that may not be opened, or whose serial number is not there yet, is
held back for a moment, in which udev gives the permission and the kernel its strings.
"""

from __future__ import annotations

import contextlib
import selectors
import socket
import sys
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final, Self

from j2a_transports._base import LinkClosed, OpenFailed
from j2a_transports._in_use import InUse
from j2a_transports._poll import Waker

from .board import UsbBoard
from .find import libusb, scan

POLL_S: Final = 1.0
# How long a board that is not ready is held back, and how often it is looked at.
SETTLE_S: Final = 2.0
SETTLING_S: Final = 0.1
# The kernel's messages, and those of udev after its rules.
_UEVENTS: Final = 15
_GROUPS: Final = 1 | 2
# The default one takes a descriptor, and there may be none.
_Selector: Final = getattr(selectors, "PollSelector", selectors.DefaultSelector)


@dataclass(frozen=True, slots=True)
class UsbArrived:
    """A board has been plugged in, or was there when the watch began."""

    board: UsbBoard


@dataclass(frozen=True, slots=True)
class UsbLeft:
    """A board is gone; `board` is what was said when it arrived.

    It also comes, followed at once by `UsbArrived`, when `UsbBoard.problem` is another one
    (the board may be opened now, or no longer) or its serial number has become known.
    """

    board: UsbBoard


_Key = tuple[int, int, str | None, int, int, int]


class UsbWatch:
    """An iterator of `UsbArrived` and `UsbLeft`, and a context manager that closes it.

    The boards that are there come first. `close` from any thread ends the iteration.

    Args:
        interval_s: how often to look where the system does not say that something has changed.
        backend: a pyusb backend, None for libusb.

    Raises:
        MissingExtra: pyusb is not installed.
        OpenFailed: libusb is not there or cannot list what is on the USB. (Later that is taken for
            a moment in which devices come and go, and the watch goes on.)
    """

    def __init__(self, interval_s: float = POLL_S, backend: Any = None) -> None:
        self._backend = backend or libusb()
        self._interval_s = interval_s
        self._boards: dict[_Key, UsbBoard] = {}
        self._held_since: dict[_Key, float] = {}
        self._events: deque[UsbArrived | UsbLeft] = deque()
        self._closed = False
        self._in_use = InUse(self._release)
        self._first = True
        try:
            self._waker = Waker()
        except OSError as error:
            self._closed = True
            raise OpenFailed(f"usb: the devices cannot be watched: {error.strerror}") from error
        self._uevents = _uevent_socket()
        try:
            self._look()
        except OpenFailed:
            self.close()
            raise

    def next(self, timeout_s: float | None = None) -> UsbArrived | UsbLeft | None:
        """Wait for the next event; one thread at a time.

        Args:
            timeout_s: how long to wait, in seconds; 0 only looks, None waits for ever.

        Returns:
            The event, or None when the time ran out.

        Raises:
            LinkClosed: the watch is closed, also when that happens during the wait.
        """
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        return self._in_use.run(lambda: self._next(deadline))

    def _next(self, deadline: float | None) -> UsbArrived | UsbLeft | None:
        while True:
            if self._closed:
                raise LinkClosed("the watch of the USB is closed")
            if not self._events:
                self._look()
            if self._events:
                return self._events.popleft()
            wait_s = SETTLING_S if self._held_since else self._interval_s
            if deadline is not None:
                wait_s = min(wait_s, deadline - time.monotonic())
                if wait_s <= 0:
                    return None
            self._wait(wait_s)

    def __iter__(self) -> Iterator[UsbArrived | UsbLeft]:
        with contextlib.suppress(LinkClosed):
            while event := self.next():
                yield event

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()

    def close(self) -> None:
        """End the watch, and wake a blocked `next`.

        May be called twice, by any thread and by a signal handler.
        """
        self._closed = True
        self._waker.wake()
        self._in_use.end()

    def _release(self) -> None:
        self._waker.close()
        if self._uevents is not None:
            self._uevents.close()

    def _look(self) -> None:
        """Compare what is there with what was there."""
        now = time.monotonic()
        try:
            found = scan(self._backend)
        except OpenFailed:
            if self._first:
                raise
            # A moment in which devices come and go; the next look will tell.
            return
        there = {_key(each.board): each for each in found}
        for key in self._boards.keys() - there.keys():
            self._events.append(UsbLeft(self._boards.pop(key)))
        held = {}
        for key, each in there.items():
            board = each.board
            known = self._boards.get(key)
            if known is not None:
                # A serial number that is gone tells that the board is about to go.
                if known.problem == board.problem and board.serial in (None, known.serial):
                    continue
                self._events.append(UsbLeft(known))
            since = self._held_since.get(key, now)
            ready = not board.problem and (board.serial or not each.device.iSerialNumber)
            if not ready and known is None and not self._first and now - since < SETTLE_S:
                held[key] = since
                continue
            self._boards[key] = board
            self._events.append(UsbArrived(board))
        self._held_since = held
        self._first = False

    def _wait(self, wait_s: float) -> None:
        with _Selector() as selector:
            selector.register(self._waker, selectors.EVENT_READ)
            if self._uevents is not None:
                selector.register(self._uevents, selectors.EVENT_READ)
            selector.select(wait_s)
        self._drain()

    def _drain(self) -> None:
        """Throw the messages away: that there are some is all that counts."""
        if self._uevents is not None:
            # An error also says that messages were lost because there were so many.
            with contextlib.suppress(OSError):
                while self._uevents.recv(65536):
                    pass


def watch_usb(interval_s: float = POLL_S, backend: Any = None) -> UsbWatch:
    """Watch the boards come and go; see `UsbWatch`."""
    return UsbWatch(interval_s, backend)


def _key(board: UsbBoard) -> _Key:
    return (
        board.bus,
        board.address,
        board.port_path,
        board.vendor,
        board.product,
        board.interface,
    )


def _uevent_socket() -> socket.socket | None:
    """Return the kernel's messages about devices, None where there are none."""
    if sys.platform != "linux":
        return None
    uevents = None
    try:
        uevents = socket.socket(
            socket.AF_NETLINK, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK, _UEVENTS
        )
        uevents.bind((0, _GROUPS))
        return uevents
    except OSError:
        # Not allowed in some containers.
        if uevents is not None:
            uevents.close()
        return None
