"""Byte streams that carry J2A: serial ports, TCP, child processes, pseudo terminals, memory.

`open(url)` gives a `Transport`, `listen(url)` a `Listener`, `pair()` two transports joined in
memory. Importing this package loads no driver; a driver is loaded when its scheme is first used.

=============================================  ==================================================
URL                                            what it is
=============================================  ==================================================
``serial:///dev/ttyACM0?baud=115200``          a serial port (also ``serial:COM3``)
``serial:rfc2217://host:2217``                 anything that pyserial opens
``tcp://127.0.0.1:5000``                       a TCP connection; also a listener
``exec:./fw --flag``                           a child process, by pipes to its stdin and stdout
``pty:./fw``                                   a child process on a pseudo terminal
``pty:`` or ``pty:/tmp/name`` (listen only)    a pseudo terminal for others to open as serial port
``stdio:``                                     standard input and output of this process
``loopback:name``                              a meeting place inside this process
``faults:seed=1,drop=0.001:tcp://host:5000``   another transport, with seeded faults
=============================================  ==================================================

Every scheme has the option ``write_timeout``: seconds without progress before `WriteTimeout`
(default 5, ``none`` waits for ever).
"""

from __future__ import annotations

from ._base import (
    BadUrl,
    LinkClosed,
    LinkLost,
    Listener,
    MissingExtra,
    OpenFailed,
    Transport,
    TransportError,
    WriteTimeout,
)
from ._registry import listen, open, schemes
from ._url import Url

__all__ = [
    "BadUrl",
    "LinkClosed",
    "LinkLost",
    "Listener",
    "MissingExtra",
    "OpenFailed",
    "Transport",
    "TransportError",
    "Url",
    "WriteTimeout",
    "listen",
    "open",
    "pair",
    "schemes",
]


def pair() -> tuple[Transport, Transport]:
    """Return two transports joined in memory: what one writes the other reads."""
    from ._loopback import pair as make_pair  # noqa: PLC0415 - a driver, loaded when used

    return make_pair()
