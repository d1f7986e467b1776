"""`gadget:`: this computer as a J2A board at its USB device port, over FunctionFS of Linux.

In: what the device is called.  Out: `UsbGadget`, a listener whose peers are the hosts that
configure the device; one after the other.
Rules: the kernel's files of endpoints block and cannot be polled, so threads read and write them;
what ends a blocked call there is that the endpoint is disabled, by the host or by leaving the bus.
Only the events on `ep0` say which host it is; they are looked at after each such call, before its
bytes are handed over, so that bytes get to the host that they are of.
"""

from __future__ import annotations

import atexit
import contextlib
import errno
import os
import platform
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final
from urllib.parse import quote

from j2a_transports._base import (
    DEFAULT_WRITE_TIMEOUT_S,
    BadUrl,
    LinkClosed,
    Listener,
    OpenFailed,
    Transport,
)
from j2a_transports._poll import READY, Readiness, Waker
from j2a_transports._scheme import Scheme
from j2a_transports._url import Url

from .descriptors import EVENT_SIZE, PRODUCT, SYNC_PACKET, SYNC_SIZE, VENDOR, Event
from .kernel import Kernel
from .link import CHUNK, GadgetTransport
from .setup import GadgetFiles, Identity
from .usage import LISTEN

# The endpoint is off, or was switched off and on during the call: an event says or will say why.
_OFF: Final = frozenset({errno.ESHUTDOWN, errno.EAGAIN, errno.ENODEV, errno.ECONNRESET})
RETRY_S: Final = 0.005
THREAD_END_S: Final = 5.0
_TO_HOST: Final = 0x80


SCHEME: Final = Scheme(name="gadget", listen=LISTEN, system="Linux, root")


class UsbGadget(Listener):
    """A J2A board made of this computer, its USB device controller and FunctionFS.

    A host that configures the device is a peer. When the transport to it is closed, the device
    leaves the bus, and comes back with the next `accept`. Closing the listener and its last
    transport undoes all that was set up.

    Args:
        url: for messages; the attribute `url` is what the host opens.
        name: of the gadget in configfs.
        serial: serial number string; None takes the computer's.
        vendor: vendor id.
        product: product id.
        manufacturer: manufacturer string.
        product_name: product string.
        udc: name of the device controller; None takes the only one.
        sync: whether to have the interface SyncUSB.
        on_sync: called in a thread of the gadget with each 10 bytes that the host sends there
            (SYNC-002); can be set later. What it raises goes to `threading.excepthook`.
        buffer: bytes that are asked for at once, rounded up to whole packets. With one packet
            (64) also a host is understood that sends no empty packets after full ones.
        write_timeout_s: given to the transports.

    Raises:
        OpenFailed: it cannot be set up; the message says what to do.
    """

    def __init__(
        self,
        url: str = "gadget:",
        *,
        name: str = "j2a",
        serial: str | None = None,
        vendor: int = VENDOR,
        product: int = PRODUCT,
        manufacturer: str = "J2A",
        product_name: str = "J2A device",
        udc: str | None = None,
        sync: bool = True,
        on_sync: Callable[[bytes], None] | None = None,
        buffer: int = CHUNK,
        write_timeout_s: float | None = DEFAULT_WRITE_TIMEOUT_S,
    ) -> None:
        serial = serial or _own_serial()
        super().__init__(f"usb://{vendor:04x}:{product:04x}/{quote(serial, safe='')}")
        self.on_sync = on_sync
        self._write_timeout_s = write_timeout_s
        self._kernel = Kernel()
        # A child process has neither the threads nor the right to end what is its parent's.
        self._process = os.getpid()
        self._buffer = buffer
        self._packet = 64
        identity = Identity(name, serial, vendor, product, manufacturer, product_name, udc, sync)
        try:
            self._waker = Waker()
        except OSError as error:
            raise OpenFailed(f"{url}: {error.strerror}") from error
        try:
            self._files = GadgetFiles(url, identity, self._kernel)
        except BaseException:
            self._waker.close()
            raise
        # Guards all that follows, and the reading of events; a signal handler may come in between.
        self._changed = threading.Condition(threading.RLock())
        self._enabled = False
        self._link: GadgetTransport | None = None
        self._waiting = False
        self._accepted: set[GadgetTransport] = set()
        self._closed = False
        self._ending = False
        # Guards binding and removing, which are done without holding the lock above.
        self._bound = False
        self._setting_up = threading.RLock()
        self._sending = threading.Lock()
        # One for the thread that waits, one for who holds the lock: neither can be shared.
        self._event = Readiness(self._files.control, self._waker, write=False)
        self._pending = Readiness(self._files.control, self._waker, write=False)
        self._threads: list[threading.Thread] = []
        # For a program that ends without closing.
        atexit.register(self._remove)
        try:
            for target, title in (
                (self._watch, "events"),
                (self._read_all, "reader"),
                (self._read_sync, "sync"),
            ):
                thread = threading.Thread(target=target, name=f"{url} {title}", daemon=True)
                thread.start()
                self._threads.append(thread)
            self._bind()
        except BaseException as error:
            self.close()
            if isinstance(error, RuntimeError):  # the system has no thread to give
                raise OpenFailed(f"{url}: {error}") from error
            raise

    # ------------------------------------------------------------------ for the program

    def accept(self, timeout_s: float | None) -> Transport | None:
        """See `Listener.accept`; connects to the bus again after a transport was closed.

        Raises:
            OpenFailed: the controller cannot be had again.
        """
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        with self._setting_up:
            if not self._bound and not self._closed:
                self._bind()
        with self._changed:
            while True:
                if self._closed:
                    raise LinkClosed(f"{self.url} is closed")
                link = self._link
                if self._waiting and link is not None and not link.lost:
                    self._waiting = False
                    self._accepted.add(link)
                    return link
                wait_s = None if deadline is None else deadline - time.monotonic()
                if wait_s is not None and wait_s <= 0:
                    return None
                self._changed.wait(wait_s)

    def close(self) -> None:
        """See `Listener.close`; with the last transport all that was set up is undone."""
        if os.getpid() != self._process:
            return
        with self._changed:
            self._closed = True
            self._changed.notify_all()
            unused = not self._accepted
        if unused:
            self._remove()

    def _left(self, link: GadgetTransport) -> None:
        """A transport was closed."""
        with self._changed:
            self._accepted.discard(link)
            last = self._closed and not self._accepted
            hang_up = link is self._link and self._enabled
        if last:
            self._remove()
        elif hang_up:
            with self._setting_up:
                self._bound = False
                self._files.unbind()

    # ------------------------------------------------------------------ setting up

    def _bind(self) -> None:
        with self._setting_up:
            self._files.bind()
            self._bound = True

    def _remove(self) -> None:
        """Leave the bus, end the threads, undo everything; idempotent."""
        if os.getpid() != self._process:
            return
        with self._setting_up:
            with self._changed:
                if self._ending:
                    return
                self._ending = self._closed = True
                self._lose("the device was closed")
                self._changed.notify_all()
            self._files.unbind()
            self._waker.wake()
            for thread in self._threads:
                if thread is not threading.current_thread():
                    thread.join(THREAD_END_S)
            self._files.remove()
            self._waker.close()
            atexit.unregister(self._remove)

    # ------------------------------------------------------------------ events

    def _watch(self) -> None:
        while not self._ending:
            if self._event.wait(None) & READY:
                self._catch_up()

    def _catch_up(self) -> None:
        """Act on all events that have come so far."""
        with self._changed:
            while not self._ending and self._pending.wait(0) & READY:
                try:
                    event = self._kernel.receive(self._files.control, EVENT_SIZE)
                except OSError:
                    # Another event has just taken the place of the one that was there.
                    return
                if len(event) == EVENT_SIZE:
                    self._act(event[8], event[:8])

    def _act(self, kind: int, setup: bytes) -> None:
        if kind == Event.ENABLE:
            self._configured()
        elif kind == Event.DISABLE:
            self._lose("the host is gone, or has reset the device")
        elif kind in {Event.UNBIND, Event.BIND}:
            # The kernel drops events that are not yet read when a new one comes: of a device that
            # left the bus and came back, BIND may be all that is told.
            self._lose("the device has left the bus")
        elif kind == Event.SETUP:
            self._stall(setup)
        # A suspended bus comes back as it was.

    def _configured(self) -> None:
        """The host has set the configuration, or an alternate setting of one interface."""
        with contextlib.suppress(OSError):
            self._packet = self._kernel.packet_size(self._files.to_host)
        link = self._link
        self._enabled = True
        # The kernel enables all endpoints anew for each interface of one configuration.
        if link is None or link.used or link.lost or link.closed:
            self._lose("the host has configured the device anew")
            self._enabled = True
            self._link = link = GadgetTransport(self.url, self._write_timeout_s, self._left)
            self._waiting = True
            writer = threading.Thread(
                target=self._send_all, args=(link,), name=f"{self.url} writer", daemon=True
            )
            self._threads = [thread for thread in self._threads if thread.is_alive()] + [writer]
            writer.start()
        self._changed.notify_all()

    def _lose(self, reason: str) -> None:
        self._enabled = False
        if self._link is not None:
            self._link.lose(reason)

    def _stall(self, setup: bytes) -> None:
        """Refuse a control request: FunctionFS stalls it on a call in the wrong direction."""
        # It always fails, with EL2HLT for done, or EIDRM when the host has given up.
        with contextlib.suppress(OSError):
            if setup[0] & _TO_HOST:
                self._kernel.receive(self._files.control, 0)
            else:
                self._kernel.send(self._files.control, b"")

    # ------------------------------------------------------------------ endpoints

    def _wait_enabled(self) -> bool:
        """Wait until the endpoints can be used; False at the end of the gadget."""
        with self._changed:
            self._changed.wait_for(self._readable_or_ending)
            return not self._ending

    def _readable_or_ending(self) -> bool:
        usable = self._enabled and self._link is not None and not self._link.lost
        return usable or self._ending

    def _read_all(self) -> None:
        while self._wait_enabled():
            # Not a multiple of the packet would lose what does not fit.
            size = -(-self._buffer // self._packet) * self._packet
            data, error = b"", None
            try:
                data = self._kernel.receive(self._files.from_host, size)
            except OSError as raised:
                error = raised
            self._catch_up()
            link = self._link
            if data and link is not None:
                link.take(data)
            elif error is not None:
                self._failed(link, error)

    def _read_sync(self) -> None:
        while self._files.sync is not None and self._wait_enabled():
            try:
                packet = self._kernel.receive(self._files.sync, SYNC_PACKET)
            except OSError:
                time.sleep(RETRY_S)
                continue
            # A packet of another length is ignored (SYNC-003).
            if len(packet) == SYNC_SIZE and self.on_sync is not None:
                try:
                    self.on_sync(packet)
                except Exception:
                    # The next packet is another chance, so the thread does not end.
                    report = (*sys.exc_info(), threading.current_thread())
                    threading.excepthook(threading.ExceptHookArgs(report))

    def _send_all(self, link: GadgetTransport) -> None:
        def send(data: bytes) -> bool:
            while True:
                self._catch_up()
                if link.lost or self._ending:
                    return False
                try:
                    self._kernel.send(self._files.to_host, data)
                except OSError as error:
                    self._failed(link, error)
                else:
                    return True

        # The one before may still be on its way out of its last call.
        with self._sending:
            link.send_all(send, lambda: self._packet)

    def _failed(self, link: GadgetTransport | None, error: OSError) -> None:
        """A call on a bulk endpoint has failed: wait for the event, or give the link up."""
        if error.errno in _OFF:
            time.sleep(RETRY_S)
            return
        if link is not None:
            # The device is still configured; closing the transport makes the host do it anew.
            link.lose(error.strerror or str(error))


def listen_url(url: Url) -> Listener:
    """Set up the device that `gadget:?serial=0001` describes."""
    rest, query = url.split_query()
    options = url.options(query, LISTEN)
    if rest not in ("", "//"):
        raise BadUrl(f"{url.text}: write gadget: or gadget:?name=value&name=value")
    options["write_timeout_s"] = options.pop("write_timeout")
    return UsbGadget(url.text, **options)


def _own_serial() -> str:
    """Return the serial number of the board, or the name of the computer."""
    with contextlib.suppress(OSError):
        text = Path("/proc/device-tree/serial-number").read_text(errors="replace").strip("\0\n ")
        if text:
            return text
    return platform.node() or "j2a"
