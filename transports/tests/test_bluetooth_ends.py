"""bt:// without Bluetooth: listening, how a link ends, and the calls to the kernel."""

from __future__ import annotations

import ctypes
import errno
import os
import socket
import struct
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import j2a_transports
import pytest
from j2a_transports import LinkLost, OpenFailed
from j2a_transports._bluetooth import record, sockets
from j2a_transports._bluetooth.link import BluetoothTransport

from .suite import PATIENCE_S, Background
from .test_bluetooth import HERE

ADDRESS = HERE[0].address
# The structure sockaddr_rc of 00:1A:7D:DA:71:13, channel 7.
PLACE = b"\x1f\x00\x13\x71\xda\x7d\x1a\x00\x07\x00"


class Place:
    """Stands for the kernel of a listener: TCP sockets that are told to be Bluetooth's."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.bound: tuple[str, int] = ("", 0)
        self.error = 0
        self.free = 4
        self.security: list[int] = []
        self.adapters = list(HERE)
        self.sockets: list[socket.socket] = []
        for name in ("create", "bind", "local", "accept"):
            monkeypatch.setattr(sockets, name, getattr(self, name))
        monkeypatch.setattr(sockets, "adapters", lambda: self.adapters)
        monkeypatch.setattr(sockets, "set_security", lambda _, level: self.security.append(level))

    def create(self, kind: int) -> socket.socket:
        assert kind == socket.SOCK_STREAM
        self.sockets.append(socket.socket())
        return self.sockets[-1]

    def bind(self, sock: socket.socket, address: str, port: int) -> None:
        if self.error:
            raise OSError(self.error, os.strerror(self.error))
        self.bound = (address, port)
        sock.bind(("127.0.0.1", 0))

    def local(self, sock: socket.socket) -> tuple[str, int]:
        return self.bound[0], self.bound[1] or self.free

    def accept(self, sock: socket.socket) -> tuple[socket.socket, str]:
        return sock.accept()[0], HERE[1].address

    def connect(self) -> socket.socket:
        return socket.create_connection(self.sockets[-1].getsockname())


@pytest.fixture
def place(monkeypatch: pytest.MonkeyPatch) -> Place:
    return Place(monkeypatch)


class TestListening:
    @pytest.mark.parametrize(
        ("url", "bound", "where"),
        [
            ("bt:", (sockets.ANY, 0), f"bt://{ADDRESS}/4"),
            ("bt://", (sockets.ANY, 0), f"bt://{ADDRESS}/4"),
            ("bt:///0", (sockets.ANY, 0), f"bt://{ADDRESS}/4"),
            ("bt:///9", (sockets.ANY, 9), f"bt://{ADDRESS}/9"),
            ("bt://hci1", (HERE[1].address, 0), f"bt://{HERE[1].address}/4"),
            (f"bt://{HERE[1].address}/30", (HERE[1].address, 30), f"bt://{HERE[1].address}/30"),
        ],
    )
    def test_where(self, place: Place, url: str, bound: tuple[str, int], where: str) -> None:
        with j2a_transports.listen(url) as listener:
            assert place.bound == bound
            assert listener.url == where
            with place.connect() as near:
                far = listener.accept(PATIENCE_S)
                assert far is not None
                with far:
                    assert far.url == f"bt://{HERE[1].address}/{where.rpartition('/')[2]}"
                    near.sendall(b"x")
                    assert far.read(PATIENCE_S) == b"x"
        assert place.sockets[-1].fileno() < 0

    def test_security(self, place: Place) -> None:
        j2a_transports.listen("bt:?security=medium").close()
        assert place.security == [2]

    @pytest.mark.parametrize(
        ("number", "says"),
        [
            (errno.EADDRINUSE, "another program listens there; take another channel, or none"),
            (errno.EACCES, "cannot listen: Permission denied"),
        ],
    )
    def test_failures(self, place: Place, number: int, says: str) -> None:
        place.error = number
        with pytest.raises(OpenFailed, match=says):
            j2a_transports.listen("bt:///4")
        assert place.sockets[-1].fileno() < 0

    def test_no_adapter_that_is_on(self, place: Place) -> None:
        place.adapters = [HERE[1]]
        with pytest.raises(OpenFailed, match="switched off"):
            j2a_transports.listen("bt:")
        with pytest.raises(OpenFailed, match="there is no adapter hci0; there is: hci1 02:"):
            j2a_transports.listen("bt://hci0")

    @pytest.mark.requirement("SPP-001")
    def test_a_service_is_registered_as_long_as_the_listener_is_open(
        self, place: Place, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
    ) -> None:
        path = str(tmp_path / "sdp")
        monkeypatch.setattr(record, "SDP_SOCKET", path)
        with socket.socket(socket.AF_UNIX) as server:
            server.bind(path)
            server.listen()

            def serve(answer: str) -> tuple[socket.socket, bytes]:
                peer = server.accept()[0]
                packet = peer.recv(1000)
                peer.sendall(bytes.fromhex(answer))
                return peer, packet

            for option, name in (("?service=Arm", b"\x25\x03Arm"), ("", b"\x25\x03J2A")):
                serving = Background(lambda: serve("76 0000 0004 00010005"))
                listener = j2a_transports.listen(f"bt:///9{option}")
                peer, packet = serving.result()
                assert name in packet
                assert b"\x08\x09" in packet
                listener.close()
                peer.settimeout(PATIENCE_S)
                assert peer.recv(1) == b""
                peer.close()

            serving = Background(lambda: serve("01 0000 0002 0003"))
            with pytest.raises(OpenFailed, match="refuses the request with error 0003; start"):
                j2a_transports.listen("bt:///9?service=J2A")
            serving.result()[0].close()
        assert place.sockets[-1].fileno() < 0

    def test_no_way_to_register(
        self, place: Place, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
    ) -> None:
        monkeypatch.setattr(record, "SDP_SOCKET", str(tmp_path / "sdp"))
        says = "No such file or directory; start bluetoothd with --compat, or leave service out"
        with pytest.raises(OpenFailed, match=says):
            j2a_transports.listen("bt:?service=J2A")
        assert place.sockets[-1].fileno() < 0
        # Nobody has asked for a record: clients name the channel, which the URL has.
        with j2a_transports.listen("bt:") as listener:
            assert listener.url == f"bt://{ADDRESS}/4"

    def test_registering_takes_root(self, place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
        def refuse(*arguments: Any) -> Any:
            raise PermissionError(errno.EACCES, "Permission denied")

        monkeypatch.setattr(socket.socket, "connect", refuse)
        with pytest.raises(OpenFailed, match="Permission denied; run it with sudo, or leave"):
            j2a_transports.listen("bt:?service=J2A")

    def test_other_systems_publish_nothing(
        self, place: Place, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(sockets, "_NATIVE", True)
        monkeypatch.setattr(sockets, "LINUX", False)
        j2a_transports.listen("bt:///9").close()
        with pytest.raises(OpenFailed, match="on Linux only; leave service out"):
            j2a_transports.listen("bt:///9?service=J2A")


class Scripted:
    """A socket that answers reading with errors or bytes.

    For polling it is a real one: the other end has closed, or has sent a byte that is gone when it
    is to be read.
    """

    def __init__(self, *outcomes: int | bytes, hung_up: bool = True) -> None:
        self.near, self.far = socket.socketpair()
        if hung_up:
            self.far.close()
        else:
            self.far.send(b"x")
        self.outcomes = list(outcomes)
        self.setblocking = self.near.setblocking
        self.fileno = self.near.fileno

    def close(self) -> None:
        self.near.close()
        self.far.close()

    def recv(self, size: int) -> bytes:
        self.near.recv(1)
        outcome = self.outcomes.pop(0) if self.outcomes else errno.EAGAIN
        if isinstance(outcome, int):
            raise OSError(outcome, os.strerror(outcome))
        return outcome

    def send(self, data: memoryview) -> int:
        return len(self.recv(0))


class TestEnds:
    @pytest.mark.parametrize(
        ("number", "says"),
        [
            (errno.ECONNRESET, "lost: the device closed it"),
            (errno.ETIMEDOUT, "lost: the device does not answer any more: out of range"),
            (errno.EHOSTDOWN, "lost: the device does not answer any more: out of range"),
            (
                errno.ECONNABORTED,
                "lost: this machine has disconnected: its adapter",
            ),
            (errno.ENETDOWN, "lost: this machine has disconnected: its adapter"),
            (errno.EIO, "lost: Input/output error"),
        ],
    )
    def test_reasons(self, number: int, says: str) -> None:
        sock: Any = Scripted(b"last", number)
        with BluetoothTransport("bt://x", sock, 1.0) as near:
            assert near.read(PATIENCE_S) == b"last"
            for _ in range(2):
                with pytest.raises(LinkLost, match=says):
                    near.read(PATIENCE_S)
                with pytest.raises(LinkLost, match=says):
                    near.write(b"x")

    def test_the_end_that_a_writer_was_told_reaches_the_reader(self) -> None:
        """The kernel tells it once; then reading finds nothing, and waiting never ends."""
        sock: Any = Scripted(errno.ETIMEDOUT, errno.EAGAIN, b"last", errno.EAGAIN, errno.EAGAIN)
        with BluetoothTransport("bt://x", sock, 1.0) as near:
            with pytest.raises(LinkLost, match="out of range"):
                near.write(b"x")
            assert near.read(None) == b"last"
            with pytest.raises(LinkLost, match="out of range"):
                near.read(None)

    def test_ready_without_a_byte_and_without_an_end_waits(self) -> None:
        sock: Any = Scripted(hung_up=False)
        with BluetoothTransport("bt://x", sock, 1.0) as near:
            assert near.read(0.05) == b""


@pytest.mark.skipif(sys.platform != "linux", reason="the calls are those of Linux")
class TestCalls:
    """What Pythons without Bluetooth ask of the C library."""

    @pytest.fixture(autouse=True)
    def library(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.calls: list[tuple[Any, ...]] = []
        self.result, self.error = 0, 0
        monkeypatch.setattr(sockets, "_NATIVE", False)
        monkeypatch.setattr(sockets, "_libc", lambda: self)

    def answer(self, *arguments: Any) -> int:
        self.calls.append(arguments)
        ctypes.set_errno(self.error)
        return -1 if self.error else self.result

    bind = connect = answer

    def filled(self, fd: int, buffer: Any, *rest: Any) -> int:
        buffer.raw = PLACE.ljust(32, b"\0")
        return self.answer(fd)

    getsockname = accept4 = filled

    @pytest.fixture
    def sock(self) -> Iterator[socket.socket]:
        near, far = socket.socketpair()
        with near, far:
            yield near

    def test_addresses(self, sock: socket.socket) -> None:
        sockets.bind(sock, "00:1A:7D:DA:71:13", 7)
        sockets.connect(sock, "00:1A:7D:DA:71:13", 7, 1.0)
        assert self.calls == [(sock.fileno(), PLACE, 10)] * 2
        assert sock.gettimeout() == 1.0
        assert sockets.local(sock) == ("00:1A:7D:DA:71:13", 7)

    def test_addresses_of_l2cap(self) -> None:
        with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as sock:
            sockets.connect(sock, "00:1A:7D:DA:71:13", 1, None)
            place = b"\x1f\x00\x01\x00\x13\x71\xda\x7d\x1a\x00" + bytes(4)
            assert self.calls == [(sock.fileno(), place, 14)]

    def test_accept(self, sock: socket.socket) -> None:
        self.result = os.dup(sock.fileno())
        peer, address = sockets.accept(sock)
        with peer:
            assert (peer.fileno(), address) == (self.result, "00:1A:7D:DA:71:13")

    def test_errors(self, sock: socket.socket) -> None:
        self.error = errno.ECONNREFUSED
        with pytest.raises(ConnectionRefusedError):
            sockets.connect(sock, ADDRESS, 1, 1.0)

    def test_connecting_goes_on_in_the_background(self) -> None:
        self.error = errno.EINPROGRESS
        with socket.create_server(("127.0.0.1", 0)) as server:
            place = server.getsockname()
            with socket.create_connection(place) as sock:
                sockets.connect(sock, ADDRESS, 1, PATIENCE_S)
                # Full, so that it does not become writable.
                sock.setblocking(False)
                with suppress(BlockingIOError):
                    while True:
                        sock.send(bytes(65536))
                with pytest.raises(TimeoutError) as caught:
                    sockets.connect(sock, ADDRESS, 1, 0.05)
                assert caught.value.errno is None
        with socket.socket() as sock:
            sock.setblocking(False)
            with suppress(BlockingIOError):
                sock.connect(place)
            with pytest.raises(ConnectionRefusedError):
                sockets.connect(sock, ADDRESS, 1, PATIENCE_S)

    def test_connecting_without_a_limit_only_waits(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """The call itself comes back at once, so no signal makes it be repeated."""
        blocking: list[bool] = []

        def connect(fd: int, *arguments: Any) -> int:
            blocking.append(os.get_blocking(fd))
            self.error = errno.EINPROGRESS
            return self.answer(fd, *arguments)

        monkeypatch.setattr(self, "connect", connect, raising=False)
        with (
            socket.create_server(("127.0.0.1", 0)) as server,
            socket.create_connection(server.getsockname()) as sock,
        ):
            sockets.connect(sock, ADDRESS, 1, None)
            assert sock.gettimeout() is None
        assert blocking == [False]
        assert len(self.calls) == 1

    def test_an_interrupted_call_is_repeated(
        self, sock: socket.socket, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        errors = [errno.EINTR, errno.EINTR, 0]

        def bind(*arguments: Any) -> int:
            self.error = errors.pop(0)
            return self.answer(*arguments)

        monkeypatch.setattr(self, "bind", bind, raising=False)
        sockets.bind(sock, ADDRESS, 1)
        assert len(self.calls) == 3


class TestAdapters:
    @staticmethod
    def ioctl(_: object, request: int, buffer: bytearray) -> int:
        if request == 0x800448D2:
            assert struct.unpack_from("=H", buffer) == (16,)
            struct.pack_into("=HxxHxxIHxxI", buffer, 0, 2, 1, 0, 0, 1)
        else:
            (index,) = struct.unpack_from("=H", buffer)
            address = bytes([index, 0, 0, 0, 0, 2])
            name = f"hci{index}".encode()
            struct.pack_into("=8s6sI", buffer, 2, name, address, 0x0C | (index == 0))
        return 0

    def test_what_the_kernel_tells(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr("fcntl.ioctl", self.ioctl)
        monkeypatch.setattr(sockets, "_FAMILY", socket.AF_UNIX)
        monkeypatch.setattr(sockets, "_HCI", 0)
        assert sockets.adapters() == [
            ("hci0", "02:00:00:00:00:00", True),
            ("hci1", "02:00:00:00:00:01", False),
        ]

    def test_none(self, monkeypatch: pytest.MonkeyPatch) -> None:
        # A family that no kernel has.
        monkeypatch.setattr(sockets, "_FAMILY", 255)
        assert sockets.adapters() == []
        monkeypatch.setattr(sockets, "LINUX", False)
        assert sockets.adapters() == []
