"""Bluetooth: `bt://AA:BB:CC:DD:EE:FF/CHANNEL` over RFCOMM, as a client and as a listener.

In: a URL; without a channel, the device is asked for its Serial Port Profile (SDP).  Out: bytes.
Rules: while opening, what may pass by itself is tried again: a device that does not answer until
`connect_timeout` is over, one that is busy or refuses, as it may be after a link was lost, for
`MOMENT_S`. An open transport never connects again by itself: bytes would be missing in the stream
without anybody knowing, and what answers may be another device, or the same one restarted. Whoever
gets `LinkLost` opens the URL again, and may do so at once.
"""

from __future__ import annotations

import errno
import math
import re
import socket
import time
from typing import Any, Final

from j2a_transports._base import BadUrl, LinkLost, Listener, OpenFailed, Transport
from j2a_transports._poll import CHUNK, PolledTransport
from j2a_transports._scheme import Scheme
from j2a_transports._socket_listener import SocketListener
from j2a_transports._url import Url

from . import sdp, sockets
from .record import SERVICE, publish
from .usage import ADAPTER, ADDRESS, LISTEN, OPEN

MOMENT_S: Final = 1.0
_FIRST_PAUSE_S: Final = 0.05
_LONGEST_PAUSE_S: Final = 0.5


def _numbers(*names: str) -> frozenset[int]:
    """Return the error numbers of those names that this system has."""
    return frozenset(getattr(errno, name) for name in names if hasattr(errno, name))


_UNSUPPORTED: Final = _numbers("EAFNOSUPPORT", "EPROTONOSUPPORT", "ESOCKTNOSUPPORT")
_NO_ADAPTER: Final = _numbers("ENODEV", "ENETDOWN", "ENETUNREACH", "EHOSTUNREACH", "EADDRNOTAVAIL")
_ABSENT: Final = _numbers("EHOSTDOWN", "ETIMEDOUT")
_NOT_PAIRED: Final = _numbers("EACCES", "EBADE", "EPERM")
_REFUSED: Final = _numbers("ECONNREFUSED")
_BUSY: Final = _numbers("EBUSY", "EADDRINUSE")
# What the end of the last link may leave behind for a moment.
_MOMENTARY: Final = _REFUSED | _numbers(
    "EBUSY", "EALREADY", "EMLINK", "ECONNRESET", "ECONNABORTED", "EPROTO", "ENOTCONN"
)


SCHEME: Final = Scheme(
    name="bt",
    open=OPEN,
    listen=LISTEN,
    system="Linux",
    meant_by={rf"{ADDRESS}(/[0-9]*)?": r"bt://\g<0>"},
)


class BluetoothTransport(PolledTransport):
    """A connected RFCOMM socket; arguments and errors are those of `TcpTransport`."""

    def __init__(self, url: str, sock: socket.socket, write_timeout_s: float | None) -> None:
        self._sock = sock
        self._reason: str | None = None
        try:
            sock.setblocking(False)
            super().__init__(url, sock.fileno(), sock.fileno(), write_timeout_s)
        except OSError:
            sock.close()
            raise

    def _receive(self) -> bytes:
        try:
            return self._sock.recv(CHUNK)
        except BlockingIOError:
            if not self._readable.hung_up():
                raise
        # The system tells the error once, and a writer may have got it. What came just before the
        # end is still there.
        try:
            return self._sock.recv(CHUNK)
        except BlockingIOError:
            return b""

    def _send(self, data: bytes | memoryview) -> int:
        return self._sock.send(data)

    def _lost(self, error: OSError | None) -> LinkLost:
        if self._reason is None:
            self._reason = _reason(error)
        return LinkLost(f"{self.url} is lost: {self._reason}")

    def _release(self) -> None:
        self._sock.close()


class BluetoothListener(SocketListener):
    """A listening RFCOMM socket.

    Args:
        url: what a client opens.
        sock: bound and listening; the listener owns it from now on.
        record: the connection that keeps the service record alive, if there is one; owned too.
        write_timeout_s: given to the transports that are accepted.
    """

    def __init__(
        self,
        url: str,
        sock: socket.socket,
        record: socket.socket | None,
        write_timeout_s: float | None,
    ) -> None:
        super().__init__(url, sock)
        self._record = record
        self._write_timeout_s = write_timeout_s

    def _take(self) -> Transport:
        sock, address = sockets.accept(self._sock)
        url = f"bt://{address}/{self.url.rpartition('/')[2]}"
        return BluetoothTransport(url, sock, self._write_timeout_s)

    def _release(self) -> None:
        if self._record is not None:
            self._record.close()
        super()._release()


def check_url(url: Url) -> tuple[str, int | None, dict[str, Any]]:
    """Return address, channel and options of `bt://ADDRESS/CHANNEL`; raises BadUrl."""
    place, parts = url.split_query()
    match = re.fullmatch(rf"(?://)?({ADDRESS})(?:/([0-9]{{1,2}})?)?", place)
    if match is None or (match[2] and not 1 <= int(match[2]) <= 30):
        raise BadUrl(
            f"{url.text}: expected bt://ADDRESS/CHANNEL with a channel from 1 to 30, or without "
            "one, for example bt://00:1A:7D:DA:71:13/1; `bluetoothctl devices` shows addresses"
        )
    options = url.options(parts, OPEN)
    if match[2] and "service" in options:
        raise BadUrl(f"{url.text}: give a channel or service=NAME, not both")
    return match[1].upper(), int(match[2]) if match[2] else None, options


def open_url(url: Url) -> Transport:
    """Connect to `bt://ADDRESS/CHANNEL`, or to the serial port that `bt://ADDRESS` offers."""
    address, channel, options = check_url(url)
    _check_support(url)
    client = _Client(url, address, options)
    if channel is None:
        channel = client.look_up(options.get("service"))
    try:
        sock = client.connect(socket.SOCK_STREAM, channel)
        return BluetoothTransport(url.text, sock, options["write_timeout"])
    except OSError as error:
        raise client.failure(error, f"channel {channel}") from error


def listen_url(url: Url) -> Listener:
    """Listen at `bt://ADAPTER/CHANNEL`; without an adapter at all, channel 0 or none is any.

    The channel is published as `service=NAME`, else as J2A. That BlueZ does not take the record is
    an error only with the option: the URL of the listener has the channel.
    """
    place, parts = url.split_query()
    match = re.fullmatch(rf"(?://)?({ADAPTER})?(?:/([0-9]{{1,2}})?)?", place)
    if match is None or int(match[2] or 0) > 30:
        raise BadUrl(
            f"{url.text}: expected bt: for any adapter and channel, or bt://ADAPTER/CHANNEL with "
            "a channel from 1 to 30, for example bt://hci0/1 or bt:///1"
        )
    options = url.options(parts, LISTEN)
    _check_support(url)
    address = _address_of(url, match[1]) if match[1] else sockets.ANY
    record = sock = None
    try:
        sock = _create(socket.SOCK_STREAM, options)
        sockets.bind(sock, address, int(match[2] or 0))
        sock.listen()
        bound, channel = sockets.local(sock)
        if bound == sockets.ANY:
            bound = _first_up(url)
        try:
            record = publish(url, options.get("service", SERVICE), channel)
        except OpenFailed:
            # Who has not asked for it gets along without: the URL has the channel.
            if "service" in options:
                raise
        where = f"bt://{bound}/{channel}"
        return BluetoothListener(where, sock, record, options["write_timeout"])
    except (OSError, OpenFailed) as error:
        for one in (sock, record):
            if one is not None:
                one.close()
        if isinstance(error, OpenFailed):
            raise
        advice = _SUPPORT if error.errno in _UNSUPPORTED else error.strerror or str(error)
        if error.errno in _BUSY:
            advice += ": another program listens there; take another channel, or none for any"
        raise OpenFailed(f"{url.text}: cannot listen: {advice}") from error


class _Client:
    """What one opening needs: where to, from where, how long; and what to say when it fails."""

    def __init__(self, url: Url, address: str, options: dict[str, Any]) -> None:
        self._url = url
        self._address = address
        self._options = options
        self._wait_s: float | None = options["connect_timeout"]
        self._deadline = time.monotonic() + (math.inf if self._wait_s is None else self._wait_s)
        self._from = _address_of(url, options["adapter"]) if "adapter" in options else None

    def connect(self, kind: int, port: int) -> socket.socket:
        """Connect to a channel or PSM, again and again while it makes sense; OSError at last."""
        pause_s = _FIRST_PAUSE_S
        moment = math.inf
        while True:
            sock = _create(kind, self._options)
            try:
                if self._from is not None:
                    sockets.bind(sock, self._from, 0)
                sockets.connect(sock, self._address, port, self._left_s())
                return sock
            except OSError as error:
                sock.close()
                now = time.monotonic()
                if error.errno in _MOMENTARY:
                    moment = min(moment, now + MOMENT_S)
                elif error.errno not in _ABSENT:
                    raise
                if now + pause_s >= min(moment, self._deadline):
                    raise
            time.sleep(pause_s)
            pause_s = min(2 * pause_s, _LONGEST_PAUSE_S)

    def look_up(self, name: str | None) -> int:
        """Return the channel of the serial port of that name, or of the first one."""
        if not sockets.LINUX:
            raise OpenFailed(
                f"{self._url.text}: this system has no sockets to ask a device for its serial "
                f"port; give the channel, often 1: bt://{self._address}/1"
            )
        try:
            with self.connect(socket.SOCK_SEQPACKET, sdp.PSM) as sock:

                def exchange(packet: bytes) -> bytes:
                    sock.settimeout(self._left_s())
                    sock.send(packet)
                    sock.settimeout(self._left_s())
                    return sock.recv(sdp.PACKET)

                services = sdp.serial_services(exchange)
        except ConnectionRefusedError as error:
            raise OpenFailed(
                f"{self._url.text}: the device tells no services; give the channel, often 1: "
                f"bt://{self._address}/1"
            ) from error
        except OSError as error:
            raise self.failure(error, "its service discovery") from error
        except sdp.SdpError as error:
            raise OpenFailed(
                f"{self._url.text}: the device was asked for its serial port: {error}; "
                f"give the channel, often 1: bt://{self._address}/1"
            ) from error
        for service in services:
            if name is None or service.name == name:
                return service.channel
        offers = ", ".join(f"{service.name!r} (channel {service.channel})" for service in services)
        raise OpenFailed(
            f"{self._url.text}: the device publishes no serial port"
            + ("" if name is None else f" named {name!r}")
            + (f"; it has {offers}" if offers else "; start the program there that serves it")
            + ", or give the channel"
        )

    def failure(self, error: OSError, what: str) -> OpenFailed:
        """Say why connecting to `what` failed, and what to do."""
        number = error.errno
        if number in _UNSUPPORTED:
            advice = _SUPPORT
        elif number in _NO_ADAPTER:
            advice = _adapter_advice()
        elif number is None and isinstance(error, TimeoutError):
            advice = f"no answer within {self._wait_s} s: {_BE_THERE}"
        elif number in _ABSENT:
            advice = f"the device does not answer: {_BE_THERE}"
        elif number in _NOT_PAIRED:
            advice = (
                f"the device wants to be paired: `bluetoothctl pair {self._address}`; if it was, "
                f"`bluetoothctl remove {self._address}` and there too, then pair again"
            )
        elif number in _REFUSED:
            advice = (
                f"the device refuses {what}: start what listens there, check the number (without "
                "one the device is asked for it), or pair first: "
                f"`bluetoothctl pair {self._address}`"
            )
        elif number in _BUSY:
            advice = f"{what} is in use; close the other program or `rfcomm` that has it open"
        else:
            advice = f"cannot connect to {what}: {error.strerror or error}"
        return OpenFailed(f"{self._url.text}: {advice}")

    def _left_s(self) -> float | None:
        if self._wait_s is None:
            return None
        # 0 would mean a socket that does not wait at all.
        return max(0.001, self._deadline - time.monotonic())


_SUPPORT: Final = (
    "this kernel has no Bluetooth: `sudo modprobe rfcomm`; a container needs its host's network"
)
_BE_THERE: Final = (
    "is it switched on, near, and free, and does it not wait for somebody to confirm a pairing?"
)


def _check_support(url: Url) -> None:
    if not sockets.supported():
        raise OpenFailed(
            f"{url.text}: this Python has no Bluetooth sockets (there are some on Linux, and in "
            "Python for Windows from python.org); a serial port of the system works too, such as "
            "serial:COM5 or serial:///dev/cu.NAME"
        )


def _create(kind: int, options: dict[str, Any]) -> socket.socket:
    sock = sockets.create(kind)
    try:
        if "security" in options:
            sockets.set_security(sock, options["security"])
    except OSError:
        sock.close()
        raise
    return sock


def _address_of(url: Url, adapter: str) -> str:
    """Return the address of an adapter given by address or name."""
    there = sockets.adapters()
    for one in there:
        if adapter.upper() in (one.address, one.name.upper()):
            return one.address
    if not there and not adapter.startswith("hci"):
        # This system does not tell; it will say by itself.
        return adapter.upper()
    listed = ", ".join(f"{one.name} {one.address}" for one in there) or "none that is known"
    raise OpenFailed(f"{url.text}: there is no adapter {adapter}; there is: {listed}")


def _first_up(url: Url) -> str:
    """Return the address that others reach this machine at, when it listens at all adapters."""
    if not sockets.LINUX:
        return sockets.ANY
    for adapter in sockets.adapters():
        if adapter.up:
            return adapter.address
    raise OpenFailed(f"{url.text}: {_adapter_advice()}")


def _adapter_advice() -> str:
    there = sockets.adapters()
    if not there:
        return "no Bluetooth adapter is there: plug one in, and see `bluetoothctl list`"
    if any(adapter.up for adapter in there):
        return "the adapter went away or cannot reach it; see `bluetoothctl list`"
    return (
        "the Bluetooth adapter is switched off: `bluetoothctl power on`, before that "
        "`sudo rfkill unblock bluetooth` if it is blocked"
    )


def _reason(error: OSError | None) -> str:
    """Say why an open link ended."""
    number = None if error is None else error.errno
    if error is None or number in _numbers("ECONNRESET", "EPIPE", "ENOTCONN"):
        return "the device closed it"
    if number in _ABSENT:
        return "the device does not answer any more: out of range, or switched off"
    if number in _NO_ADAPTER | _numbers("ECONNABORTED"):
        return "this machine has disconnected: its adapter was switched off, or by `bluetoothctl`"
    return error.strerror or str(error)
