"""`stdio:`: standard input and output of this process as a transport, for programs that are tested.

In: bytes from standard input.  Out: bytes to standard output.
Rules: while it is open, `print()` goes to standard error and `input()` finds nothing, so that stray
text cannot get between the bytes. The descriptors stay in blocking mode, because they may be
shared with other programs; a write is therefore done in pieces that fit once there is room.
"""

from __future__ import annotations

import contextlib
import errno
import os
import select
import sys
from collections.abc import Callable
from typing import Any, Final

from ._base import BadUrl, Listener, OpenFailed, Transport
from ._poll import READY, PolledTransport
from ._scheme import Scheme, Usage
from ._solo import SoloListener
from ._threaded import ThreadedTransport, sink_of, source_of
from ._url import Url

if sys.platform != "win32":
    import termios
    import tty

_USAGE: Final = Usage("stdio:", "standard input and output of this process", ("stdio:",))
SCHEME: Final = Scheme(name="stdio", open=_USAGE, listen=_USAGE, takes_stdio=True)


class StandardStreams:
    """Takes standard input and output away from the rest of the process.

    Attributes:
        read_fd: what was standard input.
        write_fd: what was standard output.
    """

    def __init__(self) -> None:
        if sys.stdout is not None:  # it is where the program began without standard output
            sys.stdout.flush()
        for fd in (0, 1):
            os.fstat(fd)  # a copy of the one would take the number of the other
        with contextlib.ExitStack() as undo:
            self.read_fd = os.dup(0)
            undo.callback(os.close, self.read_fd)
            self.write_fd = os.dup(1)
            undo.callback(os.close, self.write_fd)
            nothing = os.open(os.devnull, os.O_RDONLY)
            undo.pop_all()
        self._terminal: Any = None
        if sys.platform == "win32":
            import msvcrt  # noqa: PLC0415 - exists there only

            for fd in (self.read_fd, self.write_fd):
                msvcrt.setmode(fd, os.O_BINARY)
        elif os.isatty(self.read_fd):
            self._terminal = termios.tcgetattr(self.read_fd)
            tty.setraw(self.read_fd, termios.TCSANOW)
        os.dup2(nothing, 0)
        os.close(nothing)
        os.dup2(2, 1)

    def give_back(self) -> None:
        """Undo everything."""
        if sys.stdout is not None:
            # Where standard error is closed, too, stray text is lost.
            with contextlib.suppress(OSError):
                sys.stdout.flush()
        if sys.platform != "win32" and self._terminal is not None:
            with contextlib.suppress(termios.error):  # the terminal has hung up
                termios.tcsetattr(self.read_fd, termios.TCSADRAIN, self._terminal)
        for own, standard in ((self.read_fd, 0), (self.write_fd, 1)):
            os.dup2(own, standard)
            os.close(own)


class StdioTransport(PolledTransport):
    """Standard input and output on descriptors that can be polled."""

    def __init__(self, url: str, streams: StandardStreams, write_timeout_s: float | None) -> None:
        self._streams = streams
        # A pipe that is ready for writing has room for PIPE_BUF bytes, a terminal for one.
        self._piece = 1 if os.isatty(streams.write_fd) else select.PIPE_BUF
        super().__init__(url, streams.read_fd, streams.write_fd, write_timeout_s)

    def _send(self, data: bytes | memoryview) -> int:
        if not self._writable.wait(0) & READY:
            raise BlockingIOError
        return os.write(self._write_fd, data[: self._piece])

    def _release(self) -> None:
        if not self._is_fork:  # the terminal is shared
            self._streams.give_back()


def check_url(url: Url) -> dict[str, Any]:
    """Return the options of `stdio:`; raises BadUrl."""
    options = url.options([], _USAGE)
    if url.rest:
        raise BadUrl(f"{url.text}: write stdio: with nothing after the colon")
    return options


def open_url(url: Url) -> Transport:
    """Take over standard input and output."""
    options = check_url(url)
    try:
        streams = StandardStreams()
    except OSError as error:
        is_closed = error.errno == errno.EBADF
        reason = "standard input or output is closed" if is_closed else error.strerror
        raise OpenFailed(f"{url.text}: {reason}") from error
    make: Callable[..., Transport] = StdioTransport if os.name == "posix" else _threaded
    try:
        return make(url.text, streams, options["write_timeout"])
    except OSError as error:
        streams.give_back()
        raise OpenFailed(f"{url.text}: {error.strerror}") from error


def listen_url(url: Url) -> Listener:
    """Return a listener whose only peer is the one at standard input and output."""
    return SoloListener(url.text, lambda: open_url(url), again=False)


def _threaded(url: str, streams: StandardStreams, write_timeout_s: float | None) -> Transport:
    return ThreadedTransport(
        url,
        source=source_of(streams.read_fd),
        sink=sink_of(streams.write_fd),
        interrupt=lambda _: None,
        finish=lambda: None,
        release=streams.give_back,
        reason=lambda _: "the peer closed it",
        write_timeout_s=write_timeout_s,
    )
