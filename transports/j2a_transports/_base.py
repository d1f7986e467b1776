"""The interface and the errors of a transport.

In: nothing.  Out: the abstract classes `Transport` and `Listener`, and the errors of every driver.
Rules: a transport is a pair of byte streams and knows no frame; every wait can be ended by
`close()` from another thread; for a fault of the link a driver raises a `TransportError`, nothing
else.
"""

from __future__ import annotations

import re
import time
from abc import ABC, abstractmethod
from typing import Final, Self

DEFAULT_WRITE_TIMEOUT_S: Final = 5.0


class TransportError(Exception):
    """Base of every error that a transport raises.

    Args:
        message: begins with the URL and a colon; a URL that is only a scheme, such as `usb:`, has
            its colon already.
    """

    def __init__(self, message: str = "") -> None:
        super().__init__(re.sub(r"^([a-z]+:): ", r"\1 ", message))


class LinkLost(TransportError):  # noqa: N818 - the name says what happened to the link
    """The other side is gone: end of stream, unplugged, connection reset, child process ended."""


class LinkClosed(TransportError):  # noqa: N818
    """This side has closed the transport, before the call or while it waited."""


class WriteTimeout(TransportError):  # noqa: N818
    """The peer took no byte for `Transport.write_timeout_s` seconds; a part may have been sent."""


class OpenFailed(TransportError):  # noqa: N818
    """The URL is well formed, but what it names cannot be opened; the message says what to do."""


class BadUrl(TransportError, ValueError):  # noqa: N818
    """The URL or one of its options is wrong; the message names what is allowed."""


class MissingExtra(OpenFailed):
    """A Python package that this transport needs is not installed.

    Args:
        what: the URL that was to be opened, or what else needs it.
        packages: what pip has to install, with spaces between.
        extra: the extra of the `j2a` distribution that brings it.
    """

    def __init__(self, what: str, packages: str, extra: str) -> None:
        super().__init__(
            f"{what}: a Python package is missing: pip install {packages} (the extra j2a[{extra}])"
        )
        self.extra = extra


class _Closable(ABC):
    """A resource with a URL, closed at the end of its `with` block."""

    def __init__(self, url: str) -> None:
        self.url = url

    @abstractmethod
    def close(self) -> None: ...

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.url}>"


class Transport(_Closable):
    """A byte stream in each direction.

    One thread may read while others write and another closes; calls of `write` do not interleave.
    A transport is a context manager: leaving the block closes it.

    Attributes:
        url: what was opened, for messages.
        write_timeout_s: seconds without any progress after which `write` gives up; None is never.
        is_simulated: the time of `clock` is simulated, and passes only in `read` and `sleep`.
        byte_time_s: how long a byte takes on the wire, in seconds; 0 where nobody knows it.
        bit_rate: to which the user can set the link, in bit/s, as it is set; 0 where it has none.
    """

    is_simulated: bool = False
    byte_time_s: float = 0.0
    bit_rate: int = 0

    def __init__(self, url: str, write_timeout_s: float | None = DEFAULT_WRITE_TIMEOUT_S) -> None:
        super().__init__(url)
        self.write_timeout_s = write_timeout_s

    @abstractmethod
    def read(self, timeout_s: float | None) -> bytes:
        """Return the bytes that have arrived, waiting for the first one if none has arrived.

        Chunks say nothing about how the peer wrote them.

        Args:
            timeout_s: how long to wait, in seconds; 0 does not wait, None waits for ever.

        Returns:
            At least one byte, or `b""` when the time ran out.

        Raises:
            LinkLost: the peer is gone, and everything it had sent has been returned.
            LinkClosed: this side is closed, also when that happens during the wait.
        """

    def wake_reader(self) -> bool:
        """Make a `read(None)` that waits in another thread, or else the next one, return early.

        It returns what has arrived, or `b""`. A `read` with a time limit may wait until that.

        Returns:
            Whether the transport can do it. It cannot where a thread of its own stands between
            the link and `read`, because a read that finds nothing would then prove nothing.
        """
        return False

    @abstractmethod
    def write(self, data: bytes | bytearray | memoryview) -> None:
        """Hand all of `data` to the link; returning does not mean that the peer has read it.

        Args:
            data: the bytes, any number.

        Raises:
            LinkLost: the peer is gone.
            LinkClosed: this side is closed, also when that happens during the wait.
            WriteTimeout: the peer took nothing for `write_timeout_s` seconds.
        """

    def try_write(self, data: bytes) -> int:
        """Hand to the link what it takes at once, without waiting and without raising.

        Args:
            data: the bytes, any number.

        Returns:
            How many bytes were taken; 0 as well where another thread writes, the link does not
            work (`write` says why), or the transport cannot tell without waiting.
        """
        return 0

    def fileno(self) -> int:
        """Return a descriptor that is readable when `read(0)` returns bytes or raises, or -1.

        It is for waiting only: with `select`, an event loop, or `wait`. Where it is -1, a thread of
        the transport stands between the link and `read`.
        """
        return -1

    def wait(self, timeout_s: float) -> bool:
        """Wait until `read(0)` returns bytes or raises; for transports with a descriptor.

        Unlike `read` it takes nothing, so an exception of a signal handler loses nothing.

        Args:
            timeout_s: how long to wait, in seconds.

        Returns:
            Whether it does. False as well after `wake_reader`, and when the time ran out.
        """
        raise NotImplementedError(f"{type(self).__name__} has no descriptor to wait for")

    def clock(self) -> float:
        """Return the time on which time limits of this link run, in seconds: time.monotonic."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """Let so many seconds of that time pass."""
        time.sleep(seconds)

    @property
    @abstractmethod
    def closed(self) -> bool:
        """Whether this side has been closed; a lost link is not closed until `close` is called."""

    @abstractmethod
    def close(self) -> None:
        """Close the link; may be called again and from any thread, and wakes blocked calls."""


class Listener(_Closable):
    """A place where peers arrive, each as a `Transport`; a context manager like a transport.

    Attributes:
        url: what a client opens to get here, with the real port or device name.
    """

    @abstractmethod
    def accept(self, timeout_s: float | None) -> Transport | None:
        """Wait for the next peer.

        Args:
            timeout_s: how long to wait, in seconds; 0 does not wait, None waits for ever.

        Returns:
            The transport to that peer, or None when the time ran out.

        Raises:
            LinkClosed: the listener is closed, also when that happens during the wait.
            TransportError: it cannot accept further peers; the message says why.
        """

    @abstractmethod
    def close(self) -> None:
        """Stop listening; idempotent, from any thread. Transports already accepted stay open."""
