"""J2A boards on the USB: `usb://`, `usb://SERIAL`, `usb://6666:cafe`, `usb://1-2.3` and more.

In: a URL, or a pyusb device of a program that has its own way to find it.  Out: bytes.
Rules: the board is told by the class of its interface; only that interface is touched, and the
device gets a configuration only when it has none with it; a kernel driver of the interface is put
back at the end. With libusb several transfers are under way (`transfers`); other backends, and
`transfers=1`, make one after the other (`pipes`).
"""

from __future__ import annotations

import atexit
import contextlib
import errno
import os
import sys
import threading
import time
import weakref
from collections.abc import Mapping
from typing import Any, Final

from j2a_transports._base import (
    DEFAULT_WRITE_TIMEOUT_S,
    BadUrl,
    LinkClosed,
    LinkLost,
    MissingExtra,
    OpenFailed,
    Transport,
    WriteTimeout,
)
from j2a_transports._loopback import Channel
from j2a_transports._scheme import Option, Scheme, Usage
from j2a_transports._url import Url
from j2a_transports.options import integer, number, text

from .address import Address
from .claim import claim, claim_shown, clear_halt, dispose, explained
from .find import Found, Pair, is_open, libusb, scan
from .libusb_async import asynchronous
from .pipes import BlockingPipes, Ended, Pipes, Stuck
from .transfers import LIMIT, AsyncPipes

TRANSFERS: Final = 4
# How often a board that is not there yet is looked for.
LOOK_S: Final = 0.2

_OPEN: Final = Usage(
    "usb://BOARD",
    "the USB board, if there is only one; j2a list shows all",
    ("usb://", "usb://0001", "usb://6666:cafe", "usb://001:004", "usb://1-2.3"),
    (
        Option("serial", text, "the serial number, where it looks like something else"),
        Option(
            "interface",
            integer(0, 255),
            "number of an interface of your own with one IN and one OUT endpoint, instead of the "
            "one of J2A; the URL has to name the device",
        ),
        Option(
            "transfers",
            integer(1, 64),
            "transfers that wait for bytes at a time; 1 makes plain blocking reads",
            str(TRANSFERS),
        ),
        Option("wait", number(0, 3600), "time to wait for a board not yet plugged in", "0", "s"),
    ),
)
SCHEME: Final = Scheme(name="usb", open=_OPEN, extra="usb")

_NONE: Final = (
    "no J2A board is on the USB; is it plugged in, by a cable that carries data, and does its "
    "firmware run? `lsusb` (package usbutils) shows all devices"
)

# What could not be given back; it holds the devices, which pyusb would close otherwise.
_stranded: Final[list[contextlib.ExitStack]] = []
_open: Final[weakref.WeakSet[UsbTransport]] = weakref.WeakSet()
if hasattr(os, "register_at_fork"):
    # The transfers stay the parent's: a child that ends must not cancel them.
    os.register_at_fork(after_in_child=_open.clear)


class UsbTransport(Transport):
    """The stream through two endpoints of a claimed interface.

    Args:
        url: for messages.
        device: an open `usb.core.Device`.
        pair: interface and endpoints.
        transfers: how many are under way in each direction where the backend can; 1 does without.
        write_timeout_s: see `Transport`.
    """

    def __init__(
        self,
        url: str,
        device: Any,
        pair: Pair,
        *,
        transfers: int,
        write_timeout_s: float | None,
    ) -> None:
        super().__init__(url, write_timeout_s)
        # Gives the interface back; filled by who has claimed it.
        self.undo = contextlib.ExitStack()
        self._writing = threading.Lock()
        # Re-entrant, so that a signal handler may close what its own thread is closing.
        self._ending = threading.RLock()
        self._ended = False
        self._process = os.getpid()
        self._pipes: Pipes
        api = asynchronous(device) if transfers > 1 else None
        ours = claim_shown(device, pair)
        if api is None:
            self._incoming = Channel(LIMIT)
            self._pipes = BlockingPipes(
                device, pair, self._received, self._incoming.close_writer, ours
            )
        else:
            # Without a limit of its own: the pipes stop asking in time.
            self._incoming = Channel(sys.maxsize)
            self._pipes = AsyncPipes(
                *api,
                pair,
                self._received,
                self._incoming.close_writer,
                ours=ours,
                count=transfers,
            )
        _open.add(self)
        # Last come, first served: before pyusb ends libusb.
        atexit.unregister(_close_all)
        atexit.register(_close_all)

    def _received(self, data: bytes) -> None:
        rest = memoryview(data)
        while rest and (taken := self._incoming.put(rest, None)):
            rest = rest[taken:]

    def read(self, timeout_s: float | None) -> bytes:
        """See `Transport.read`."""
        data = self._incoming.get(timeout_s)
        # The last bytes may have come between that and the end of the wait.
        if not data and self._incoming.writer_closed:
            data = self._incoming.get(0)
        if self._incoming.reader_closed:
            raise LinkClosed(f"{self.url} is closed")
        if data:
            self._pipes.taken(len(data))
        elif self._incoming.writer_closed:
            raise self._lost()
        return data

    def write(self, data: bytes | bytearray | memoryview) -> None:
        """See `Transport.write`; when it returns, the board has taken the bytes."""
        view = memoryview(data).cast("B")
        with self._writing:
            if self.closed:
                raise LinkClosed(f"{self.url} is closed")
            if self._incoming.writer_closed:
                raise self._lost()
            if not view:
                return
            try:
                self._pipes.write(view, self.write_timeout_s)
            except Stuck as stuck:
                raise WriteTimeout(
                    f"{self.url} took no byte for {self.write_timeout_s} s "
                    f"({len(view) - stuck.sent} of {len(view)} bytes not sent): "
                    "the board does not read"
                ) from None
            except Ended:
                if self.closed:
                    raise LinkClosed(f"{self.url} is closed") from None
                raise self._lost() from None

    @property
    def closed(self) -> bool:
        """See `Transport.closed`."""
        return self._incoming.reader_closed

    def close(self) -> None:
        """See `Transport.close`."""
        if os.getpid() != self._process:
            # A child process only lets go: interface and transfers are its parent's.
            self._incoming.reader_closed = True
            return
        with self._ending:
            if self._ended:  # or it is being closed, and this is a signal handler amid that
                return
            self._ended = True
            try:
                self._incoming.close_reader()
                self._end()
            except BaseException:  # of a signal handler: the next call goes on
                self._ended = False
                raise
            _open.discard(self)

    def _end(self) -> None:
        self._pipes.cancel()
        # A blocked write has ended before its transfers are freed.
        with self._writing:
            back = self._pipes.close()
        if back:
            self.undo.close()
        else:
            # Closing the handle under transfers that still run would crash.
            _stranded.append(self.undo.pop_all())

    def _lost(self) -> LinkLost:
        return LinkLost(f"{self.url} is lost: {_reason(self._pipes.failure)}")


def _close_all() -> None:
    """End the transfers at the end of the program: libusb must not go away under them."""
    for transport in list(_open):
        transport.close()


def check_url(url: Url) -> dict[str, Any]:
    """Return the options of `usb://ADDRESS`; raises BadUrl."""
    place, parts = url.split_query()
    options = url.options(parts, _OPEN)
    with contextlib.suppress(OpenFailed):  # a device file that is not there yet
        _address(url, place, options)
    return options


def open_url(url: Url) -> Transport:
    """Open the one board that the URL names."""
    options = check_url(url)
    place, _ = url.split_query()
    deadline = time.monotonic() + options["wait"]
    while True:
        try:
            address = _address(url, place, options)
            board, device = _find(url.text, address, options.get("interface"))
            break
        except MissingExtra:
            raise
        except OpenFailed:
            if time.monotonic() >= deadline:
                raise
            time.sleep(LOOK_S)
    return open_usb_device(
        device,
        board.interface,
        url=url.text,
        write_timeout_s=options["write_timeout"],
        transfers=options["transfers"],
    )


def _address(url: Url, place: str, options: Mapping[str, Any]) -> Address:
    """Return which board is meant.

    Raises:
        BadUrl: no board can be meant so.
        OpenFailed: a device file is not there.
    """
    address = Address.parse(url.text, place, options.get("serial"))
    interface = options.get("interface")
    if interface is not None and address == Address():
        # Any device has some interface: a stick would lose its driver.
        raise BadUrl(
            f"{url.text}: interface= needs to know of which device, for example "
            f"usb://6666:cafe?interface={interface}"
        )
    return address


def _find(url: str, address: Address, interface: int | None) -> Found:
    """Return the only board that fits."""
    found = scan(libusb(url), interface)
    fits = [each for each in found if address.fits(each.board)]
    if len(fits) == 1:
        return fits[0]
    if not found:
        if interface is not None:
            raise OpenFailed(
                f"{url}: no device on the USB has an interface {interface} with an endpoint in "
                "each direction, bulk or interrupt; `lsusb -v` shows what devices have"
            )
        raise OpenFailed(f"{url}: {_NONE}")
    if fits:
        what = "more than one fits; open one of these"
    elif address == Address(address.serial):
        what = f"no board has the serial number {address.serial!r}; there are only these"
    else:
        what = "not there; there are only these"
    raise OpenFailed(f"{url}: {what}: {', '.join(each.board.url for each in fits or found)}")


def open_usb_device(
    device: Any,
    interface: int | None = None,
    *,
    url: str | None = None,
    write_timeout_s: float | None = DEFAULT_WRITE_TIMEOUT_S,
    transfers: int = TRANSFERS,
) -> Transport:
    """Open a device that the program has found by pyusb itself, on whatever backend.

    Args:
        device: a `usb.core.Device`; it may be open already, and then stays so.
        interface: number of the interface; None takes the first of the J2A class.
        url: what messages call it; None makes a name of bus and address.
        write_timeout_s: see `Transport`.
        transfers: how many are under way in each direction where the backend is libusb.

    Returns:
        The open transport. The device must not be used for this interface meanwhile.

    Raises:
        OpenFailed: there is no such interface, or it cannot be had; the message says what to do.
    """
    url = url or f"usb://{device.bus or 0:03}:{device.address or 0:03}"
    with contextlib.ExitStack() as undo, explained(url):
        if not is_open(device):
            undo.callback(dispose, device)
        pair = claim(url, device, interface, undo)
        for endpoint in (pair.incoming, pair.outgoing):
            clear_halt(device, endpoint.bEndpointAddress)
        transport = UsbTransport(
            url, device, pair, transfers=transfers, write_timeout_s=write_timeout_s
        )
        transport.undo = undo.pop_all()
        return transport


def _reason(error: Exception | None) -> str:
    number = getattr(error, "errno", None)
    if number in (errno.ENODEV, errno.ESHUTDOWN, errno.ENOENT):
        return "the board was unplugged or reset"
    if number == errno.EPIPE:
        return "the board has halted the endpoint again"
    if number == errno.EOVERFLOW:
        return "the board sent more than was asked for"
    return f"the board was unplugged or failed: {getattr(error, 'strerror', None) or error}"
