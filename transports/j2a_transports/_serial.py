"""Serial ports through pyserial: `serial:///dev/ttyACM0?baud=115200`, `serial:COM3`, `serial:loop://`.

In: a port or any URL that pyserial opens, and options.  Out: bytes.
Rules: 115200 baud, 8 data bits, no parity, one stop bit unless told otherwise; a port is locked
against other programs; control lines are set before opening, so that they do not move twice.
On POSIX the driver polls pyserial's descriptor itself; other ports and pyserial's URLs go through
threads, because pyserial cannot end a blocked call of theirs. There a write that times out ends the
link in the end, because pyserial does not say how much it has sent.
"""

from __future__ import annotations

import errno
import os
import re
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from ._base import BadUrl, LinkLost, Listener, MissingExtra, OpenFailed, Transport
from ._poll import CHUNK, PolledTransport
from ._scheme import Option, Scheme, Usage
from ._solo import SoloListener
from ._threaded import ThreadedTransport
from ._url import Url
from .options import boolean, choice, integer, number

if TYPE_CHECKING:
    import serial

# How long pyserial blocks in one read where it cannot be interrupted.
SLICE_S: Final = 0.05
PIECE: Final = 256
# pyserial's ports whose descriptor carries the plain bytes.
# Their names tell that bytes leave at the bit rate; a port of CDC-ACM only has a number for it.
_UARTS: Final = ("ttyS", "ttyUSB", "ttyAMA", "ttymxc", "cu.usbserial")
POLLABLE: Final = ("serial.serialposix", "serial.urlhandler.protocol_socket")

_OPTIONS: Final = (
    Option("baud", integer(1, 50_000_000), "bit rate", "115200", "bit/s"),
    Option("bits", integer(5, 8), "data bits of a character", "8"),
    Option("parity", choice({name: name for name in "NEOMS"}), "parity bit", "N"),
    Option("stopbits", choice({"1": 1, "1.5": 1.5, "2": 2}), "stop bits of a character", "1"),
    Option("dtr", boolean, "level of the line DTR before the port is opened, else the driver's"),
    Option("rts", boolean, "level of the line RTS before the port is opened, else the driver's"),
    Option(
        "boot",
        number(0, 60),
        "time to wait after opening; bytes received meanwhile are discarded",
        "0",
        "s",
    ),
    Option(
        "xonxoff",
        boolean,
        "software flow control; it does not carry J2A, which uses all byte values",
        "0",
    ),
    Option("rtscts", boolean, "flow control by the lines RTS and CTS", "0"),
    Option("exclusive", boolean, "lock the port against other programs", "1"),
)
_OPEN: Final = Usage(
    "serial:PORT",
    "a serial port, or a URL of pyserial",
    ("serial:///dev/ttyACM0?baud=115200", "serial:COM3", "serial:rfc2217://host:2217"),
    _OPTIONS,
)
_LISTEN: Final = Usage(
    "serial:PORT",
    "a serial port",
    ("serial:///dev/ttyUSB0",),
    _OPTIONS,
)
SCHEME: Final = Scheme(
    name="serial",
    open=_OPEN,
    listen=_LISTEN,
    extra="serial",
    meant_by={
        r"(?i)(\\\\\.\\)?COM[0-9]+": r"serial:\g<0>",
        r"(?s)/dev/.*": r"serial://\g<0>",
        r"(?is)(loop|socket|rfc2217|spy|alt|hwgrep|cp2110)://.*": r"serial:\g<0>",
    },
)

_LOOK: Final = "`j2a list` or `python -m serial.tools.list_ports` shows the ports"
_ADVICE: Final = {
    errno.ENOENT: f"there is no such device; is it plugged in? {_LOOK}",
    errno.EISDIR: f"it is a folder; {_LOOK}",
    errno.ENXIO: "the device is gone; is it plugged in?",
    errno.ENODEV: "the device is gone; is it plugged in?",
    errno.EACCES: "not allowed; add yourself to the group that owns it, on most systems with "
    "`sudo usermod -aG dialout $USER`, and log in again",
    errno.EPERM: "not allowed; add yourself to the group that owns it, on most systems with "
    "`sudo usermod -aG dialout $USER`, and log in again",
    errno.EBUSY: "it is busy; close the other program that uses it",
    errno.EAGAIN: "it is busy; close the other program that uses it, or share it with exclusive=0",
}


class SerialTransport(PolledTransport):
    """A pyserial port on its own descriptor."""

    def __init__(self, url: str, port: serial.SerialBase, write_timeout_s: float | None) -> None:
        self._port = port
        fd = port.fileno()
        super().__init__(url, fd, fd, write_timeout_s)

    def _lost(self, error: OSError | None) -> LinkLost:
        return LinkLost(f"{self.url} is lost: {_reason(error)}")

    def _release(self) -> None:
        _close(self._port)


def check_url(url: Url) -> tuple[str, dict[str, Any]]:
    """Return port and options of `serial:PORT`; raises BadUrl."""
    name, options = _parse(url)
    if "://" in name:
        _new_port(url, name, options)  # pyserial alone knows its URLs
    return name, options


def open_url(url: Url) -> Transport:
    """Open a port and, with `boot`, wait for the board to start and discard what it says."""
    name, options = _parse(url)
    port = _open_port(url, name, options)
    is_pollable = os.name == "posix" and type(port).__module__ in POLLABLE
    make: Callable[..., Transport] = SerialTransport if is_pollable else _threaded
    try:
        transport = make(url.text, port, options["write_timeout"])
    except OSError as error:
        _close(port)
        raise OpenFailed(f"{url.text}: {error.strerror or error}") from error
    transport.byte_time_s = _byte_time_s(name, options)
    transport.bit_rate = options["baud"]
    try:
        _discard(transport, options["boot"])
    except LinkLost as error:
        transport.close()
        raise OpenFailed(f"{url.text}: the port went away while the board started") from error
    except BaseException:
        transport.close()
        raise
    return transport


def _byte_time_s(name: str, options: dict[str, Any]) -> float:
    """Return how long a byte takes on the wire; 0 where there may be no wire, as on the USB."""
    if not Path(name).resolve().name.startswith(_UARTS):
        return 0.0
    bits = 1 + options["bits"] + (options["parity"] != "N") + options["stopbits"]
    return float(bits / options["baud"])


def listen_url(url: Url) -> Listener:
    """Serve at a serial port, for a device that is this program."""
    return SoloListener(url.text, lambda: open_url(url), again=True)


def _parse(url: Url) -> tuple[str, dict[str, Any]]:
    name, parts = url.split_query()
    if re.match(r"[A-Za-z0-9]+://", name):
        # One of pyserial's URLs, which may have parameters of its own.
        names = {option.name for option in _OPTIONS}
        foreign = [part for part in parts if part.partition("=")[0] not in names]
        foreign = [part for part in foreign if not part.startswith("write_timeout=")]
        parts = [part for part in parts if part not in foreign]
        if foreign:
            name += "?" + "&".join(foreign)
    else:
        name = name.removeprefix("//")
    if not name:
        raise BadUrl(
            f"{url.text}: name a port, such as serial:///dev/ttyACM0 or serial:COM3; {_LOOK}"
        )
    return name, url.options(parts, _OPEN)


def _new_port(url: Url, name: str, options: dict[str, Any]) -> serial.Serial:
    """Return a port that is not open yet."""
    try:
        import serial  # noqa: PLC0415 - an extra
    except ImportError:
        raise MissingExtra(url.text, "pyserial", SCHEME.extra) from None
    if not hasattr(serial, "serial_for_url"):
        raise OpenFailed(
            f"{url.text}: another package named serial hides pyserial: "
            "pip uninstall serial, then pip install pyserial"
        )
    try:
        return serial.serial_for_url(
            name,
            do_not_open=True,
            baudrate=options["baud"],
            bytesize=options["bits"],
            parity=options["parity"],
            stopbits=options["stopbits"],
            timeout=SLICE_S,
            # pyserial's RFC 2217 client knows none.
            write_timeout=None if name.startswith("rfc2217:") else options["write_timeout"],
            xonxoff=options["xonxoff"],
            rtscts=options["rtscts"],
            exclusive=options["exclusive"] or None,
        )
    except ValueError as error:
        raise _refused(url, error) from error


def _refused(url: Url, error: Exception) -> BadUrl:
    own = ", ".join(sorted(option.name for option in _OPTIONS))
    return BadUrl(f"{url.text}: pyserial refuses it ({error}); our options are: {own}")


def _open_port(url: Url, name: str, options: dict[str, Any]) -> serial.SerialBase:
    port = _new_port(url, name, options)
    try:
        if "dtr" in options:
            port.dtr = options["dtr"]
        if "rts" in options:
            port.rts = options["rts"]
        port.open()
    except (ValueError, KeyError) as error:
        # KeyError: pyserial 3.5 trips over its own message for an unknown loop:// parameter.
        raise _refused(url, error) from error
    except OSError as error:
        # pyserial quotes the system as a tuple: (25, 'Inappropriate ioctl for device').
        reason = re.sub(r"\(\d+, '([^']*)'\)", r"\1", str(error))
        advice = _ADVICE.get(error.errno or 0, f"{reason}; is it a serial port, and free?")
        raise OpenFailed(f"{url.text}: {advice}") from error
    except Exception as error:
        # termios.error is no OSError.
        raise OpenFailed(f"{url.text}: {error}; can the device do these settings?") from error
    return port


def _threaded(url: str, port: Any, write_timeout_s: float | None) -> Transport:
    def source() -> bytes:
        first = port.read(1)
        return first + port.read(min(port.in_waiting, CHUNK)) if first else b""

    given_up = threading.Event()

    def sink(data: bytes) -> None:
        # loop:// refuses at once what would take longer than the write timeout at its baud rate.
        for at in range(0, len(data), PIECE):
            if given_up.is_set():
                # A cancelled write returns as if it had been done.
                raise EOFError
            port.write(data[at : at + PIECE])

    def interrupt(stuck: bool) -> None:
        # Reading ends by itself after a slice.
        if stuck:
            given_up.set()
            if hasattr(port, "cancel_write"):
                port.cancel_write()
            port.reset_output_buffer()

    return ThreadedTransport(
        url,
        source=source,
        sink=sink,
        interrupt=interrupt,
        finish=lambda: None,
        release=lambda: _close(port),
        reason=_reason,
        write_timeout_s=write_timeout_s,
    )


def _close(port: Any) -> None:
    sock = getattr(port, "_socket", None)
    port.close()
    # pyserial 3.5 leaves its socket open when the peer has hung up before.
    if sock is not None:
        sock.close()


def _reason(error: Exception | None) -> str:
    if error is None or isinstance(error, EOFError):
        return "the device was unplugged or the other side closed"
    return f"the device was unplugged or failed: {getattr(error, 'strerror', None) or error}"


def _discard(transport: Transport, duration_s: float) -> None:
    deadline = time.monotonic() + duration_s
    while (left_s := deadline - time.monotonic()) > 0:
        transport.read(left_s)
