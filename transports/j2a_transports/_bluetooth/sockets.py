"""Bluetooth sockets of the operating system, and the adapters that are there.

In: addresses as text (`AA:BB:CC:DD:EE:FF`), an RFCOMM channel or an L2CAP PSM.  Out: sockets,
adapters.
Rules: errors are OSError, as for any socket; Python's socket module is used where it knows
Bluetooth. Many Pythons are built without, because that takes a header of BlueZ (often those of
pyenv, uv and conda). On Linux their sockets work all the same, only the calls that take or give an
address have to go to the C library.
"""

from __future__ import annotations

import ctypes
import errno
import functools
import os
import select
import socket
import struct
import sys
from typing import Any, Final, NamedTuple

# Where SDP can be asked (it goes over L2CAP sockets), and the adapters be listed.
LINUX: Final = sys.platform == "linux"
ANY: Final = "00:00:00:00:00:00"

_NATIVE: Final = hasattr(socket, "AF_BLUETOOTH")
# The numbers of Linux, for a Python that has no names for them.
_FAMILY: Final = int(getattr(socket, "AF_BLUETOOTH", 31))
_HCI: Final = 1
_PROTOCOLS: Final = {
    socket.SOCK_SEQPACKET: int(getattr(socket, "BTPROTO_L2CAP", 0)),
    socket.SOCK_STREAM: int(getattr(socket, "BTPROTO_RFCOMM", 3)),
}
_SOL_BLUETOOTH: Final = 274
_BT_SECURITY: Final = 4

_HCIGETDEVLIST: Final = 0x800448D2
_HCIGETDEVINFO: Final = 0x800448D3
_MAX_ADAPTERS: Final = 16
_UP: Final = 1


class Adapter(NamedTuple):
    """A Bluetooth controller of this machine.

    Attributes:
        name: such as `hci0`.
        address: such as `AA:BB:CC:DD:EE:FF`.
        up: whether it is switched on.
    """

    name: str
    address: str
    up: bool


def supported() -> bool:
    """Whether this Python can make Bluetooth sockets; the kernel may still know none."""
    return _NATIVE or LINUX


def create(kind: int) -> socket.socket:
    """Make a socket: SOCK_STREAM for RFCOMM, SOCK_SEQPACKET for L2CAP."""
    return socket.socket(_FAMILY, kind, _PROTOCOLS[socket.SocketKind(kind)])


def set_security(sock: socket.socket, level: int) -> None:
    """Demand a security level (Linux): 1 low, 2 medium (paired, encrypted), 3 high (MITM safe)."""
    sock.setsockopt(_SOL_BLUETOOTH, _BT_SECURITY, bytes([level, 0]))


def bind(sock: socket.socket, address: str, port: int) -> None:
    """Bind to a local adapter (`ANY`: to all) and a channel or PSM (0: any)."""
    if _NATIVE:
        sock.bind((address, port))
    else:
        _call("bind", sock.fileno(), *_sockaddr(sock, address, port))


def connect(sock: socket.socket, address: str, port: int, timeout_s: float | None) -> None:
    """Connect to a channel or PSM.

    Args:
        sock: from `create`; it has this timeout afterwards.
        address: of the device.
        port: channel or PSM.
        timeout_s: how long to try, None for as long as the kernel does.

    Raises:
        TimeoutError: no answer in that time, without an errno.
        OSError: it failed.
    """
    if _NATIVE:
        sock.settimeout(timeout_s)
        sock.connect((address, port))
        return
    # Not to be repeated after a signal, so it is the waiting that a signal interrupts.
    sock.setblocking(False)
    try:
        _call("connect", sock.fileno(), *_sockaddr(sock, address, port))
    except BlockingIOError:
        poll = select.poll()
        poll.register(sock, select.POLLOUT)
        if not poll.poll(None if timeout_s is None else timeout_s * 1000):
            raise TimeoutError("timed out") from None
        if error := sock.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
            raise OSError(error, os.strerror(error)) from None
    sock.settimeout(timeout_s)


def accept(sock: socket.socket) -> tuple[socket.socket, str]:
    """Return the next connection of an RFCOMM listener, and the address of the peer."""
    if _NATIVE:
        peer, (address, _) = sock.accept()
        return peer, address
    buffer, size = _room()
    fd = _call("accept4", sock.fileno(), buffer, size, socket.SOCK_CLOEXEC)
    return socket.socket(_FAMILY, socket.SOCK_STREAM, sock.proto, fd), _rfcomm(buffer.raw)[0]


def local(sock: socket.socket) -> tuple[str, int]:
    """Return the local address and channel of an RFCOMM socket."""
    if _NATIVE:
        address, channel = sock.getsockname()
        return address, channel
    buffer, size = _room()
    _call("getsockname", sock.fileno(), buffer, size)
    return _rfcomm(buffer.raw)


def adapters() -> list[Adapter]:
    """Return the controllers of this machine; none where the system does not tell (not Linux)."""
    if not LINUX:
        return []
    import fcntl  # noqa: PLC0415 - not on every system

    try:
        with socket.socket(_FAMILY, socket.SOCK_RAW, _HCI) as sock:
            # u16 number, then for each u16 id, u32 flags, aligned as in C.
            table = bytearray(struct.pack("=Hxx", _MAX_ADAPTERS) + bytes(8 * _MAX_ADAPTERS))
            fcntl.ioctl(sock, _HCIGETDEVLIST, table)
            found = []
            for index in range(struct.unpack_from("=H", table)[0]):
                # u16 id, 8 characters, 6 bytes of address, u32 flags, and counters.
                info = bytearray(struct.pack("=H", *struct.unpack_from("=H", table, 4 + 8 * index)))
                info += bytes(254)
                fcntl.ioctl(sock, _HCIGETDEVINFO, info)
                name, address, flags = struct.unpack_from("=8s6sI", info, 2)
                found.append(
                    Adapter(name.rstrip(b"\0").decode(), _text(address), bool(flags & _UP))
                )
            return sorted(found)
    except OSError:
        # No Bluetooth in this kernel, or an adapter went away meanwhile: what fails next says why.
        return []


@functools.cache
def _libc() -> Any:
    return ctypes.CDLL(None, use_errno=True)


def _call(name: str, *arguments: Any) -> int:
    while True:
        result = int(getattr(_libc(), name)(*arguments))
        if result >= 0:
            return result
        error = ctypes.get_errno()
        if error != errno.EINTR:
            raise OSError(error, os.strerror(error))


def _room() -> tuple[Any, Any]:
    return ctypes.create_string_buffer(32), ctypes.byref(ctypes.c_uint32(32))


def _sockaddr(sock: socket.socket, address: str, port: int) -> tuple[bytes, int]:
    """Return the C structure of an address and its size."""
    raw = bytes.fromhex(address.replace(":", ""))[::-1]
    if sock.type == socket.SOCK_STREAM:
        place = struct.pack("=H6sBx", _FAMILY, raw, port)
    else:
        place = struct.pack("=H", _FAMILY) + struct.pack("<H6sHBx", port, raw, 0, 0)
    return place, len(place)


def _rfcomm(place: bytes) -> tuple[str, int]:
    raw, channel = struct.unpack_from("=2x6sB", place)
    return _text(raw), channel


def _text(raw: bytes) -> str:
    return ":".join(f"{byte:02X}" for byte in reversed(raw))
