"""Both ends of a TCP connection on this machine, as transports with a descriptor."""

import socket

from j2a_transports._tcp import TcpTransport


def tcp_pair(
    kind: type[TcpTransport] = TcpTransport, *, small: bool = False
) -> tuple[TcpTransport, TcpTransport]:
    """Return the near end, of that kind, and the far one; `small`: few bytes are under way."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        if small:
            server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)  # the system's smallest
        near = socket.socket()
        if small:
            near.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1)
        near.connect(server.getsockname())
        far, _ = server.accept()
    return kind("tcp:near", near, 5.0), TcpTransport("tcp:far", far, 5.0)
