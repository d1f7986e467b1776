"""The service record of a listener, at BlueZ of this machine.

In: a name and an RFCOMM channel.  Out: a connection to BlueZ that keeps the record alive.
Rules: what BlueZ refuses is an `OpenFailed` that says what to do.
"""

from __future__ import annotations

import socket
from typing import Final

from j2a_transports._base import OpenFailed
from j2a_transports._url import Url

from . import sdp, sockets

# What a listener is called whose name nobody has said.
SERVICE: Final = "J2A"
# BlueZ's way in for programs on this machine, there when bluetoothd runs with --compat.
SDP_SOCKET: Final = "/var/run/sdp"
_TIMEOUT_S: Final = 10.0


def publish(url: Url, name: str, channel: int) -> socket.socket:
    """Register a record at BlueZ; it lives as long as the connection that is returned."""
    if not sockets.LINUX:
        raise OpenFailed(f"{url.text}: services are published on Linux only; leave service out")
    advice = "start bluetoothd with --compat, or leave service out and name the channel to clients"
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        sock.settimeout(_TIMEOUT_S)
        sock.connect(SDP_SOCKET)
        sock.sendall(sdp.registration(name, channel))
        sdp.check_registration(sock.recv(sdp.PACKET))
        return sock
    except (OSError, sdp.SdpError) as error:
        sock.close()
        if isinstance(error, PermissionError):
            advice = "run it with sudo, or leave service out and name the channel to clients"
        why = error.strerror or str(error) if isinstance(error, OSError) else str(error)
        raise OpenFailed(
            f"{url.text}: cannot publish the service at {SDP_SOCKET}: {why}; {advice}"
        ) from error
