"""Listeners: TCP, loopback names, pseudo terminals for others to open."""

from __future__ import annotations

import errno
import os
import select
import socket
import stat
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import j2a_transports
import pytest
from j2a_transports import BadUrl, LinkClosed, LinkLost, Listener, OpenFailed, Transport

from .suite import PATIENCE_S, Background, read_exactly, read_to_end

if sys.platform != "win32":
    import resource

URLS = ["tcp://127.0.0.1:0", "loopback:listeners"]
if sys.platform != "win32":
    URLS.append("pty:")


def accepted(listener: Listener) -> Transport:
    transport = listener.accept(PATIENCE_S)
    assert transport is not None
    return transport


@pytest.mark.parametrize("url", URLS)
class TestEveryListener:
    def test_nobody_comes(self, url: str) -> None:
        with j2a_transports.listen(url) as listener:
            assert listener.accept(0) is None
            start = time.monotonic()
            assert listener.accept(0.1) is None
            assert time.monotonic() - start >= 0.09

    def test_its_url_leads_to_it(self, url: str) -> None:
        with j2a_transports.listen(url) as listener:
            assert listener.url in repr(listener)
            waiting = Background(lambda: accepted(listener))
            with j2a_transports.open(listener.url) as near, waiting.result() as far:
                near.write(b"hello")
                assert read_exactly(far, 5) == b"hello"

    def test_close_ends_accept(self, url: str) -> None:
        listener = j2a_transports.listen(url)
        waiting = Background(lambda: listener.accept(None))
        time.sleep(0.1)
        listener.close()
        with pytest.raises(LinkClosed):
            waiting.result()
        listener.close()
        with pytest.raises(LinkClosed):
            listener.accept(0)

    def test_a_signal_handler_may_close_it_at_any_line(
        self, url: str, signal_at: Callable[..., Any]
    ) -> None:
        for line in range(60):
            listener = j2a_transports.listen(url)
            with signal_at(line, listener.close) as was_called, pytest.raises(LinkClosed):
                listener.accept(None)
            assert was_called()

    def test_accepted_transports_outlive_it(self, url: str) -> None:
        listener = j2a_transports.listen(url)
        with j2a_transports.open(listener.url) as near, accepted(listener) as far:
            listener.close()
            near.write(b"a")
            assert far.read(PATIENCE_S) == b"a"
            far.write(b"b")
            assert near.read(PATIENCE_S) == b"b"

    def test_one_peer_after_the_other(self, url: str) -> None:
        with j2a_transports.listen(url) as listener:
            for word in (b"first", b"second", b"third"):
                with j2a_transports.open(listener.url) as near:
                    near.write(word)
                    far = accepted(listener)
                    assert read_exactly(far, len(word)) == word
                    far.write(word)
                    assert read_exactly(near, len(word)) == word
                with pytest.raises(LinkLost):
                    far.read(PATIENCE_S)
                far.close()
                assert listener.accept(0) is None


@contextmanager
def free_descriptors(count: int) -> Iterator[None]:
    """Let this process open only so many files more."""
    held = [os.dup(1) for _ in range(count + 1)]
    for fd in held:
        os.close(fd)
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (held[-1], before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, before)


@pytest.mark.skipif(sys.platform == "win32", reason="a program of POSIX")
@pytest.mark.parametrize(
    ("offer", "url"),
    [
        (j2a_transports.open, "exec:sleep 1000"),
        (j2a_transports.open, "pty:sleep 1000"),
        (j2a_transports.listen, "pty:{folder}/link"),
    ],
)
def test_nothing_is_left_where_the_system_has_no_file(
    offer: Callable[[str], Transport | Listener], url: str, tmp_path: Path
) -> None:
    def left() -> tuple[int, list[str], list[Path]]:
        command = ["pgrep", "-P", str(os.getpid()), "-f", "sleep 1000"]
        children = subprocess.run(command, capture_output=True, text=True, check=False).stdout
        # Before Python 3.11.4 Popen itself leaves pipes open where it fails (gh-87474).
        leaks = url.startswith("exec:") and sys.version_info < (3, 11, 4)
        files = 0 if leaks else sum(1 for _ in Path("/dev/fd").iterdir())
        return files, children.split(), [*tmp_path.iterdir()]

    offer(url.format(folder=tmp_path)).close()  # the module of the scheme is loaded now
    before = left()
    for count in range(20):
        try:
            with free_descriptors(count):
                offered = offer(url.format(folder=tmp_path))
        except OpenFailed:
            assert left() == before, count
        else:
            offered.close()
            break
    assert count > 1
    assert left() == before


class TestTcp:
    def test_only_the_named_address_is_bound(self) -> None:
        with j2a_transports.listen("tcp://127.0.0.1:0") as listener:
            port = int(listener.url.rpartition(":")[2])
            # The same port of another local address is still free.
            with socket.create_server(("127.0.0.2", port)):
                pass

    def test_small_packets_are_not_delayed(self) -> None:
        with (
            j2a_transports.listen("tcp://127.0.0.1:0") as listener,
            j2a_transports.open(listener.url) as near,
            accepted(listener) as far,
        ):
            for end in (near, far):
                sock = socket.socket(fileno=os.dup(end._read_fd))
                with sock:
                    assert sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)

    def test_several_peers_at_once(self) -> None:
        with j2a_transports.listen("tcp://127.0.0.1:0") as listener:
            nears = [j2a_transports.open(listener.url) for _ in range(3)]
            fars = [accepted(listener) for _ in range(3)]
            for index, near in enumerate(nears):
                near.write(bytes([index]))
            assert [far.read(PATIENCE_S) for far in fars] == [b"\0", b"\1", b"\2"]
            for end in nears + fars:
                end.close()

    def test_a_place_that_is_taken(self) -> None:
        with (
            j2a_transports.listen("tcp://127.0.0.1:0") as listener,
            pytest.raises(OpenFailed, match="another program listens there"),
        ):
            j2a_transports.listen(listener.url)

    def test_a_place_that_is_not_here(self) -> None:
        with pytest.raises(OpenFailed, match="cannot listen"):
            j2a_transports.listen("tcp://192.0.2.1:5000")

    def test_nobody_listens(self) -> None:
        with j2a_transports.listen("tcp://127.0.0.1:0") as listener:
            url = listener.url
        with pytest.raises(OpenFailed, match="start the device first, or check the port"):
            j2a_transports.open(url)

    def test_a_server_that_does_not_answer(self) -> None:
        with socket.socket() as full:
            full.bind(("127.0.0.1", 0))
            full.listen(0)
            port = full.getsockname()[1]
            fillers = []
            try:
                with pytest.raises(OpenFailed, match=r"no answer within 0\.2 s"):
                    # The kernel answers for as many as wait to be accepted, and then no more.
                    while len(fillers) < 100:
                        url = f"tcp://127.0.0.1:{port}?connect_timeout=0.2"
                        fillers.append(j2a_transports.open(url))
            finally:
                for filler in fillers:
                    filler.close()

    def test_a_reset_connection_is_a_lost_link(self) -> None:
        with j2a_transports.listen("tcp://127.0.0.1:0") as listener:
            port = int(listener.url.rpartition(":")[2])
            peer = socket.create_connection(("127.0.0.1", port))
            with accepted(listener) as far:
                far.write(b"never read")
                assert peer.recv(1) == b"n"
                peer.close()
                with pytest.raises(LinkLost, match="reset"):
                    far.read(PATIENCE_S)

    @pytest.mark.parametrize(
        ("name", "number"),
        [
            ("accept", errno.ECONNABORTED),
            ("accept", errno.EPROTO),
            ("setsockopt", errno.EINVAL),
            ("setsockopt", errno.ECONNRESET),
        ],
    )
    def test_a_peer_that_is_gone_before_it_is_served_is_passed_over(
        self, monkeypatch: pytest.MonkeyPatch, name: str, number: int
    ) -> None:
        # Linux does not say so of a connection that was reset, so the system's answer is made up.
        real = getattr(socket.socket, name)
        failed = []

        def fails_once(*arguments: object) -> object:
            if not failed:
                failed.append(arguments)
                raise OSError(number, os.strerror(number))
            return real(*arguments)

        with j2a_transports.listen("tcp://127.0.0.1:0") as listener:
            port = int(listener.url.rpartition(":")[2])
            with (
                socket.create_connection(("127.0.0.1", port)) as first,
                socket.create_connection(("127.0.0.1", port)) as second,
            ):
                monkeypatch.setattr(socket.socket, name, fails_once)
                with accepted(listener) as far:
                    assert failed
                    # Where accept fails once, the made-up answer took nobody away.
                    served = first if name == "accept" else second
                    far.write(b"x")
                    assert served.recv(1) == b"x"
                    if name == "setsockopt":
                        assert first.recv(1) == b""

    @pytest.mark.parametrize("free", range(4))
    def test_with_too_many_open_files_it_turns_peers_away_and_goes_on(self, free: int) -> None:
        """However many descriptors are missing: of three that a transport needs."""
        with j2a_transports.listen("tcp://127.0.0.1:0") as listener:
            with j2a_transports.open(listener.url) as near:
                with free_descriptors(free):
                    far = listener.accept(0.3)
                    assert (far is None) == (free < 3)
                if far is None:
                    with pytest.raises(LinkLost, match="may be busy with another host"):
                        near.read(PATIENCE_S)
                else:
                    far.close()
            with j2a_transports.open(listener.url) as near, accepted(listener) as far:
                far.write(b"x")
                assert near.read(PATIENCE_S) == b"x"

    def test_however_many_are_turned_away_accept_keeps_its_limit(self) -> None:
        """The others wait for the next call."""
        with j2a_transports.listen("tcp://127.0.0.1:0") as listener:
            nears = [j2a_transports.open(listener.url) for _ in range(3)]
            with free_descriptors(0):
                assert listener.accept(0) is None
            for near in nears[1:]:
                with accepted(listener) as far:
                    far.write(b"x")
                    assert near.read(PATIENCE_S) == b"x"
            for near in nears:
                near.close()

    def test_all_addresses_of_a_host_share_the_time(self, monkeypatch: pytest.MonkeyPatch) -> None:
        now, limits = [0.0], []

        def silent(sock: socket.socket, _: tuple[str, int]) -> None:
            limits.append(sock.gettimeout() or 0)
            now[0] += limits[-1]
            raise TimeoutError("timed out")

        def three(host: str, port: int, **_: object) -> list[tuple[Any, ...]]:
            return [(socket.AF_INET, socket.SOCK_STREAM, 6, "", ("127.0.0.1", port))] * 3

        monkeypatch.setattr("socket.socket.connect", silent)
        monkeypatch.setattr("socket.getaddrinfo", three)
        monkeypatch.setattr("time.monotonic", lambda: now[0])
        with pytest.raises(OpenFailed, match=r"no answer within 5\.0 s"):
            j2a_transports.open("tcp://board:5000?connect_timeout=5")
        assert limits == pytest.approx([5 / 3] * 3)

    def test_a_server_that_closes_at_once_is_a_lost_link(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """Its address cannot be asked for then, and no socket may be left open."""
        real = socket.socket.connect

        def then_reset(sock: socket.socket, place: tuple[str, int]) -> None:
            real(sock, place)
            server, _ = listening.accept()
            server.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            server.close()
            select.select([sock], [], [], PATIENCE_S)

        with socket.create_server(("127.0.0.1", 0)) as listening:
            monkeypatch.setattr("socket.socket.connect", then_reset)
            port = listening.getsockname()[1]
            with (
                j2a_transports.open(f"tcp://127.0.0.1:{port}") as link,
                pytest.raises(LinkLost),
            ):
                link.read(PATIENCE_S)

    def test_a_client_that_reaches_itself_has_reached_nobody(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """As one may that tries again and again at a port that the system hands out."""
        socks = []

        connect = socket.socket.connect

        def to_itself(sock: socket.socket, place: tuple[str, int]) -> None:
            socks.append(sock)
            sock.bind(place)
            connect(sock, sock.getsockname())

        monkeypatch.setattr("socket.socket.connect", to_itself)
        with pytest.raises(OpenFailed, match="nothing listens there"):
            j2a_transports.open("tcp://127.0.0.1:0")
        assert [sock.fileno() for sock in socks] == [-1]

    def test_a_network_that_fails_is_no_busy_server(self, monkeypatch: pytest.MonkeyPatch) -> None:
        def fails(*_: object) -> bytes:
            raise TimeoutError(errno.ETIMEDOUT, "Connection timed out")

        with (
            j2a_transports.listen("tcp://127.0.0.1:0") as listener,
            j2a_transports.open(listener.url) as near,
        ):
            monkeypatch.setattr(near, "_receive", fails)
            with pytest.raises(LinkLost, match="is lost: Connection timed out"):
                near.read(0)

    def test_closing_ends_the_pause_after_too_many_open_files(self) -> None:
        listener = j2a_transports.listen("tcp://127.0.0.1:0")
        with j2a_transports.open(listener.url), free_descriptors(0):
            closer = threading.Timer(0.3, listener.close)
            closer.start()
            with pytest.raises(LinkClosed):
                listener.accept(None)
            closer.join()

    def test_a_connection_without_enough_descriptors_is_closed(self) -> None:
        """The socket is there, and what the transport needs besides is not."""
        with j2a_transports.listen("tcp://127.0.0.1:0") as listener:
            with free_descriptors(1), pytest.raises(OpenFailed, match="Too many open files"):
                j2a_transports.open(listener.url)
            with accepted(listener) as far, pytest.raises(LinkLost):
                far.read(PATIENCE_S)
        with free_descriptors(1), pytest.raises(OpenFailed, match="Too many open files"):
            j2a_transports.listen("tcp://127.0.0.1:0")

    def test_ipv6(self) -> None:
        try:
            socket.create_server(("::1", 0), family=socket.AF_INET6).close()
        except OSError:
            pytest.skip("this machine has no IPv6")
        with j2a_transports.listen("tcp://[::1]:0") as listener:
            assert listener.url.startswith("tcp://[::1]:")
            with j2a_transports.open(listener.url) as near, accepted(listener) as far:
                near.write(b"six")
                assert read_exactly(far, 3) == b"six"


class TestLoopback:
    def test_a_name_nobody_listens_at(self) -> None:
        with pytest.raises(OpenFailed, match="make it first with listen"):
            j2a_transports.open("loopback:nobody")

    def test_a_name_that_is_taken(self) -> None:
        with (
            j2a_transports.listen("loopback:mine"),
            pytest.raises(OpenFailed, match="this name is taken"),
        ):
            j2a_transports.listen("loopback:mine")
        j2a_transports.listen("loopback:mine").close()

    def test_a_peer_that_was_never_accepted_loses_its_link(self) -> None:
        listener = j2a_transports.listen("loopback:late")
        near = j2a_transports.open("loopback:late")
        listener.close()
        with pytest.raises(LinkLost):
            near.read(None)


@pytest.mark.skipif(sys.platform == "win32", reason="no pseudo terminals")
class TestPty:
    @staticmethod
    def device(listener: Listener) -> str:
        return listener.url.removeprefix("serial://")

    def test_it_is_a_raw_terminal_for_any_program(self) -> None:
        with j2a_transports.listen("pty:") as listener:
            path = self.device(listener)
            assert stat.S_ISCHR(Path(path).stat().st_mode)
            for _ in range(2):
                # No program of ours: nothing sets the terminal up, nothing discards old input.
                other = os.open(path, os.O_RDWR | os.O_NOCTTY)
                far = accepted(listener)
                os.write(other, bytes(range(256)))
                assert read_exactly(far, 256) == bytes(range(256))
                far.write(b"\x03\r\n\x04")
                assert os.read(other, 10) == b"\x03\r\n\x04"
                far.write(b"left unread")
                os.write(other, b"last")
                os.close(other)
                assert read_to_end(far) == b"last"
                far.close()

    def test_what_one_peer_leaves_does_not_reach_the_next(self) -> None:
        with j2a_transports.listen("pty:") as listener:
            other = os.open(self.device(listener), os.O_RDWR | os.O_NOCTTY)
            far = accepted(listener)
            os.write(other, b"left unread by us")
            far.write(b"left unread by them")
            os.close(other)
            far.close()
            assert listener.accept(0.05) is None
            other = os.open(self.device(listener), os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            with accepted(listener) as far:
                assert far.read(0.05) == b""
                with pytest.raises(BlockingIOError):
                    os.read(other, 100)
                os.close(other)

    def test_a_peer_that_comes_and_goes_leaves_its_bytes(self) -> None:
        with j2a_transports.listen("pty:") as listener:
            other = os.open(self.device(listener), os.O_RDWR | os.O_NOCTTY)
            os.write(other, b"quick")
            os.close(other)
            with accepted(listener) as far:
                assert read_to_end(far) == b"quick"

    def test_the_next_peer_waits_until_the_transport_is_closed(self) -> None:
        with (
            j2a_transports.listen("pty:") as listener,
            j2a_transports.open(listener.url) as near,
        ):
            far = accepted(listener)
            assert listener.accept(0.05) is None
            far.close()
            # Still open over there: as with a real line, it is simply the next one.
            with accepted(listener) as again:
                near.write(b"x")
                assert again.read(PATIENCE_S) == b"x"

    def test_a_link_gives_it_a_name(self, tmp_path: Path) -> None:
        link = tmp_path / "board"
        with j2a_transports.listen(f"pty:{link}") as listener:
            assert listener.url == f"serial://{link}"
            with j2a_transports.open(listener.url) as near, accepted(listener) as far:
                near.write(b"x")
                assert far.read(PATIENCE_S) == b"x"
        assert not link.is_symlink()

    @pytest.mark.parametrize("name", ["board?baud=9600", "bo\0ard"])
    def test_a_name_that_no_client_could_open(self, name: str, tmp_path: Path) -> None:
        with pytest.raises(BadUrl, match="no link can have that name"):
            j2a_transports.listen(f"pty:{tmp_path}/{name}")
        assert not [*tmp_path.iterdir()]

    def test_a_link_of_the_next_listener_is_not_removed(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        link = tmp_path / "board"
        first = j2a_transports.listen(f"pty:{link}")
        close, successors = os.close, []

        def close_and_go_on(fd: int) -> None:
            close(fd)
            if fd == first._master:
                # The terminal is gone, and another program takes its place at once.
                successors.append(j2a_transports.listen(f"pty:{link}"))

        with monkeypatch.context() as patched:
            patched.setattr("os.close", close_and_go_on)
            first.close()
        with successors[0]:
            assert link.exists()

    def test_why_there_is_no_terminal(self) -> None:
        with free_descriptors(0), pytest.raises(OpenFailed, match="terminal: Too many open files"):
            j2a_transports.listen("pty:")

    def test_a_stale_link_is_replaced_and_nothing_else(self, tmp_path: Path) -> None:
        link = tmp_path / "board"
        link.symlink_to("/dev/pts/no-such-terminal")
        j2a_transports.listen(f"pty:{link}").close()
        link.write_text("a file of the user")
        with pytest.raises(OpenFailed, match="cannot make the link: File exists"):
            j2a_transports.listen(f"pty:{link}")
        assert link.read_text() == "a file of the user"
