"""Pseudo terminals: `pty:command` runs a child on one; listening on `pty:` offers one to others.

In: a command line as for `exec:`, or, to listen, nothing or the path of a symbolic link to make.
Out: bytes in raw mode, nothing is echoed or translated.
Rules: the listener's terminal lives as long as the listener, through any number of openings; each
opening is one accepted transport, which is lost when the other program closes the terminal.
POSIX only; the hang-up of a terminal nobody has open is seen as Linux reports it.
"""

from __future__ import annotations

import contextlib
import os
import re
import sys
import time
from functools import partial
from pathlib import Path
from typing import Any, Final

from ._base import BadUrl, LinkClosed, LinkLost, Listener, OpenFailed, Transport, TransportError
from ._in_use import InUse
from ._poll import BROKEN, CHUNK, READY, PolledTransport, Readiness, Waker
from ._process import CWD, Child, ProcessTransport, parse_command, undone_on_error, uninterrupted
from ._scheme import Scheme, Usage
from ._solo import wait_to_look
from ._url import Url

if sys.platform != "win32":
    import termios
    import tty

_OPEN: Final = Usage("pty:COMMAND", "a program, on a pseudo terminal", ("pty:./firmware",), (CWD,))
_LISTEN: Final = Usage(
    "pty:PATH",
    "a new pseudo terminal, which others open as a serial port",
    ("pty:", "pty:/tmp/board"),
)
SCHEME: Final = Scheme(name="pty", open=_OPEN, listen=_LISTEN, system="POSIX", starts_device=True)


def _open_raw(url: Url) -> tuple[int, int]:
    """Return master and slave of a new pseudo terminal in raw mode."""
    if sys.platform == "win32":
        raise OpenFailed(f"{url.text}: there are no pseudo terminals on this system; use exec:")
    try:
        master, slave = os.openpty()  # that of the module pty hides why there is none
    except OSError as error:
        raise OpenFailed(f"{url.text}: no pseudo terminal: {error.strerror}") from error
    tty.setraw(slave, termios.TCSANOW)
    return master, slave


def check_url(url: Url) -> tuple[list[str], dict[str, Any]]:
    """Return command line and options of `pty:command args`; raises BadUrl."""
    return parse_command(url, _OPEN)


def open_url(url: Url) -> Transport:
    """Start the child of `pty:command args` with a pseudo terminal as its stdin and stdout."""
    return uninterrupted(lambda: _start(url))


def _start(url: Url) -> Transport:
    command, options = check_url(url)
    master, slave = _open_raw(url)
    try:
        child = Child(url.text, command, options.get("cwd"), slave, slave)
    except OpenFailed:
        os.close(master)
        raise
    finally:
        os.close(slave)
    with undone_on_error(url, child.stop, partial(os.close, master)):
        return ProcessTransport(url.text, child, master, master, options["write_timeout"])


class PtyTransport(PolledTransport):
    """One opening of a listener's pseudo terminal, from the listener's side.

    Args:
        url: for messages.
        master: descriptor of the master side; the transport owns it from now on.
        device: path of the terminal itself.
        write_timeout_s: see `Transport`.

    Attributes:
        finished: whether it is closed and the terminal is ready for the next peer.
    """

    def __init__(self, url: str, master: int, device: str, write_timeout_s: float | None) -> None:
        super().__init__(url, master, master, write_timeout_s)
        self._device = device
        self.finished = False

    def _lost(self, error: OSError | None) -> LinkLost:
        return LinkLost(f"{self.url} is lost: the other program closed the terminal")

    def _release(self) -> None:
        if sys.platform != "win32" and not self._is_fork and self._readable.hung_up():
            # What this peer has left behind, unread by either side, must not reach the next one.
            with contextlib.suppress(OSError):
                while os.read(self._read_fd, CHUNK):
                    pass
            with contextlib.suppress(OSError, termios.error):
                # Only the terminal itself can empty its input; from the master it cannot be done.
                terminal = os.open(self._device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
                try:
                    termios.tcflush(terminal, termios.TCIOFLUSH)
                finally:
                    os.close(terminal)
        super()._release()
        self.finished = True


class PtyListener(Listener):
    """A pseudo terminal for other programs to open as a serial port.

    Args:
        master: the master side; the listener owns it from now on.
        device: path of the terminal itself.
        link: the symbolic link to it that others open, to be removed in the end; None for none.
        write_timeout_s: given to the transports that are accepted.
    """

    def __init__(
        self, master: int, device: str, link: Path | None, write_timeout_s: float | None
    ) -> None:
        super().__init__(f"serial://{link or device}")
        os.set_blocking(master, False)
        self._device = device
        self._master = master
        self._link = link
        self._write_timeout_s = write_timeout_s
        self._waker = Waker()
        self._readable = Readiness(master, self._waker, write=False)
        self._in_use = InUse(self._release)
        self._current: PtyTransport | None = None
        self._closed = False

    def accept(self, timeout_s: float | None) -> Transport | None:
        """See `Listener.accept`; waits while the transport accepted before is not closed."""
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        return self._in_use.run(lambda: self._accept(deadline))

    def _accept(self, deadline: float | None) -> Transport | None:
        while True:
            if self._closed:
                raise LinkClosed(f"{self.url} is closed")
            if (self._current is None or self._current.finished) and self._occupied():
                self._current = self._opened()
                return self._current
            if not wait_to_look(deadline):
                return None

    def _opened(self) -> PtyTransport:
        with contextlib.ExitStack() as undo:
            try:
                fd = os.dup(self._master)
                undo.callback(os.close, fd)
                opened = PtyTransport(self.url, fd, self._device, self._write_timeout_s)
            except OSError as error:
                raise TransportError(f"{self.url}: cannot accept: {error.strerror}") from error
            undo.pop_all()
        return opened

    def _occupied(self) -> bool:
        """Whether somebody has the terminal open, or has left bytes in it."""
        state = self._readable.wait(0)
        return bool(state & READY) or not state & BROKEN

    def close(self) -> None:
        """See `Listener.close`."""
        self._closed = True
        self._in_use.end()  # nothing in a forked process, and the link stays

    def _release(self) -> None:
        # As long as the terminal is there, nobody takes the link for a left-over and makes another.
        if self._link is not None:
            self._link.unlink(missing_ok=True)
        os.close(self._master)
        self._waker.close()


def listen_url(url: Url) -> Listener:
    """Make a pseudo terminal, and for `pty:/some/path` a symbolic link to it."""
    options = url.options([], _LISTEN)
    if re.search(r"[?\0]", url.rest):
        raise BadUrl(
            f"{url.text}: no link can have that name; options go into keywords of listen()"
        )
    master, slave = _open_raw(url)
    device = os.ttyname(slave)
    # Closed, so that the master notices whether somebody else has it open; raw mode stays.
    os.close(slave)
    link = Path(url.rest).absolute() if url.rest else None
    with undone_on_error(url, partial(os.close, master)) as undo:
        if link is not None:
            _make_link(url, link, device)
            undo.callback(link.unlink)
        return PtyListener(master, device, link, options["write_timeout"])


def _make_link(url: Url, link: Path, device: str) -> None:
    try:
        if link.is_symlink() and not link.exists():
            # Left over from a program that was killed: the device it names is gone.
            link.unlink()
        link.symlink_to(device)
    except OSError as error:
        raise OpenFailed(f"{url.text}: cannot make the link: {error.strerror}") from error
