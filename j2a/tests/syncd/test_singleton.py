"""The socket of the daemon: one at a time, and nobody who asks can hold it up."""

import json
import os
import socket
import struct
import threading
import time
from types import SimpleNamespace

import pytest

from j2a.syncd import singleton
from j2a.syncd.singleton import NotRunning, Server, Taken, ask, folders


def echo(request, is_trusted):
    return {"asked": request, "trusted": is_trusted}


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "run"


@pytest.fixture
def server(folder):
    with_thread = Server(folder, echo)
    with_thread.start()
    yield with_thread
    with_thread.close()


def test_a_request_gets_its_reply(folder, server):
    assert ask(folder, {"command": "x"}) == {"asked": {"command": "x"}, "trusted": True}


def test_there_is_one_at_a_time(folder, server):
    with pytest.raises(Taken):
        Server(folder, echo)
    assert ask(folder, {})["asked"] == {}, "the second one has taken the socket away"


def test_the_next_one_may_begin_when_the_first_has_ended(folder):
    Server(folder, echo).close()
    Server(folder, echo).close()


def test_many_that_begin_at_once_are_one(folder):
    ready = threading.Barrier(16)
    taken, servers = [], []

    def begin():
        ready.wait(60)
        try:
            servers.append(Server(folder, echo))
        except Taken:
            taken.append(1)

    threads = [threading.Thread(target=begin) for _ in range(16)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert (len(servers), len(taken)) == (1, 15)
    servers[0].close()


def test_a_daemon_that_was_killed_leaves_nothing_in_the_way(folder):
    child = os.fork()
    if child == 0:
        Server(folder, echo)
        os._exit(0)
    os.waitpid(child, 0)
    assert (folder / "syncd.sock").exists()
    with pytest.raises(NotRunning, match="refused"):
        ask(folder, {})
    one = Server(folder, echo)
    one.start()
    assert ask(folder, {})["trusted"]
    one.close()
    assert not (folder / "syncd.sock").exists()


root = pytest.mark.skipif(os.geteuid() != 0, reason="only root may become somebody else")
OTHER, ANOTHER = (65534, 65534), (65533, 65533)


def live(folder, owner):
    """Be the daemon, and end as the user that root becomes."""
    child = os.fork()
    if child == 0:
        code = 1
        try:
            server = Server(folder, echo, owner)
            os.setgroups([])
            os.setgid(owner[1])
            os.setuid(owner[0])
            server.close()
            code = 0
        finally:
            os._exit(code)
    assert os.waitpid(child, 0)[1] == 0


@root
def test_who_gives_its_rights_away_removes_its_socket(folder):
    for owner in (OTHER, OTHER, ANOTHER, OTHER):
        live(folder, owner)
        assert not (folder / "syncd.sock").exists()
        assert folder.stat().st_uid == owner[0]


@root
def test_a_socket_of_one_that_was_killed_is_in_nobodys_way(folder):
    folder.mkdir()
    for owner in (OTHER, ANOTHER):
        with socket.socket(socket.AF_UNIX) as stale:
            stale.bind(os.fspath(folder / "syncd.sock"))
        (folder / "syncd.lock").touch()
        live(folder, owner)
        assert not (folder / "syncd.sock").exists()


@root
def test_one_that_begins_leaves_the_folder_to_the_one_that_runs(folder):
    server = Server(folder, echo, OTHER)
    with pytest.raises(Taken):
        Server(folder, echo, ANOTHER)
    assert folder.stat().st_uid == OTHER[0]
    server.close()


@root
def test_a_folder_for_something_else_is_not_given_away(folder):
    folder.mkdir()
    (folder / "treasure").touch()
    with pytest.raises(PermissionError, match="not for syncd alone"):
        Server(folder, echo, OTHER)
    assert folder.stat().st_uid == 0


@root
def test_root_follows_no_link_that_another_user_has_left(folder, tmp_path):
    folder.mkdir()
    (tmp_path / "treasure").touch(mode=0o600)
    (folder / "syncd.lock").symlink_to(tmp_path / "treasure")
    os.chown(folder, *OTHER)
    with pytest.raises(OSError, match="symbolic"):
        Server(folder, echo, OTHER)
    (folder / "syncd.lock").unlink()
    (folder / "syncd.sock").symlink_to(tmp_path / "treasure")
    live(folder, OTHER)
    facts = (tmp_path / "treasure").stat()
    assert (facts.st_uid, facts.st_mode & 0o777) == (0, 0o600)


def test_without_a_daemon_it_says_where_it_looked(folder):
    with pytest.raises(NotRunning, match=r"syncd\.sock: No such file.*start one: j2a syncd"):
        ask(folder, {})


@pytest.mark.parametrize(
    "text", [b"", b"\n", b"[]\n", b"nonsense\n", b"\xff\xfe\n", b"[" * 4000, "{}".encode("utf-16")]
)
def test_what_is_no_request_is_answered_by_an_error(folder, server, text):
    with socket.socket(socket.AF_UNIX) as connection:
        connection.connect(os.fspath(server.path))
        connection.sendall(text)
        connection.shutdown(socket.SHUT_WR)
        assert "that is no request" in json.loads(connection.makefile().read())["error"]
    assert ask(folder, {})["trusted"]


def connected(server, text=b""):
    one = socket.socket(socket.AF_UNIX)
    one.settimeout(60)
    while True:
        try:
            one.connect(os.fspath(server.path))
        except BlockingIOError:
            time.sleep(0.01)
        else:
            break
    one.sendall(text)
    return one


def test_who_says_nothing_or_too_much_holds_nobody_up(folder, server, monkeypatch):
    """Each of them has a limit that is longer than the one of who asks."""
    monkeypatch.setattr(singleton, "_SERVE_S", 600)
    idle = [connected(server, text) for text in [b"", b"{", b" " * (singleton.MAX_REQUEST + 1)] * 8]
    assert ask(folder, {})["trusted"]
    for one in idle:
        one.close()


def test_a_thousand_connections_hold_nobody_up(folder, server, monkeypatch):
    monkeypatch.setattr(singleton, "_SERVE_S", 600)
    idle = []
    for number in range(1000):
        idle.append(connected(server, b"{" if number % 2 else b""))
        if number % 100 == 99:
            assert ask(folder, {})["trusted"]
    # The oldest have made room for those that came.
    assert idle[0].recv(1) == b""
    for one in idle:
        one.close()


def test_who_reads_nothing_of_a_long_reply_holds_nobody_up(folder, monkeypatch):
    monkeypatch.setattr(singleton, "_SERVE_S", 600)
    server = Server(folder, lambda request, _: {"long": "x" * request.get("length", 0)})
    server.start()
    deaf = [connected(server, b'{"length": 3000000}\n') for _ in range(8)]
    assert ask(folder, {}) == {"long": ""}
    assert len(ask(folder, {"length": 3_000_000})["long"]) == 3_000_000
    for one in deaf:
        one.close()
    server.close()


def test_who_takes_too_long_is_hung_up(folder, server, monkeypatch):
    monkeypatch.setattr(singleton, "_SERVE_S", 0.05)
    with connected(server, b"{") as slow:
        assert slow.recv(1) == b""


@pytest.mark.parametrize("reply", [{"x": float("nan")}, {"x": object()}, {}])
def test_an_answer_that_fails_is_told_and_is_not_the_last_one(folder, reply):
    def answer(request, _):
        return {"good": True} if request else reply or reply["missing"]

    server = Server(folder, answer)
    server.start()
    assert "the daemon failed" in ask(folder, {})["error"]
    assert ask(folder, {"a": 1}) == {"good": True}
    server.close()


def test_who_hangs_up_disturbs_nobody(folder, server):
    for _ in range(50):
        with socket.socket(socket.AF_UNIX) as connection:
            connection.connect(os.fspath(server.path))
            connection.sendall(b"{}\n")
    assert ask(folder, {})["trusted"]


@pytest.mark.parametrize("owner", [None, pytest.param(OTHER, marks=root)])
@pytest.mark.parametrize("mode", [0o700, 0o711, 0o755, 0o777, 0o775, 0o757, 0o720, 0o702])
def test_a_folder_that_others_may_write_into_is_refused(folder, mode, owner):
    folder.mkdir()
    folder.chmod(mode)
    if mode & 0o022:
        with pytest.raises(PermissionError, match="others may write"):
            Server(folder, echo, owner)
        assert not list(folder.iterdir())
    else:
        Server(folder, echo, owner).close()


@pytest.mark.skipif(not hasattr(socket, "SO_PEERCRED"), reason="nobody is known here")
@pytest.mark.parametrize("own", [0, 1000])
@pytest.mark.parametrize("other", [0, 999, 1000, 1001, 65534])
def test_the_user_of_the_daemon_and_root_are_trusted(monkeypatch, own, other):
    monkeypatch.setattr(os, "geteuid", lambda: own)
    facts = struct.pack("=iII", 1, other, 0)
    connection = SimpleNamespace(getsockopt=lambda *_what: facts)
    assert singleton._is_trusted(connection) == (other in (0, own))


@pytest.mark.parametrize("over", [-4000, -1, 0, 1])
def test_a_request_may_be_as_long_as_is_allowed(folder, server, over):
    """With its line feed."""
    empty = len(json.dumps({"command": ""})) + 1
    request = {"command": "x" * (singleton.MAX_REQUEST + over - empty)}
    reply = ask(folder, request)
    if over > 0:
        assert "longer than 4096 bytes" in reply["error"]
    else:
        assert "error" not in reply


@pytest.mark.parametrize(
    ("reply", "told"), [(b"42", "is no j2a syncd"), (b"[" * 60_000, "no daemon answers.*recursion")]
)
def test_a_reply_that_is_none_is_told(folder, reply, told):
    folder.mkdir()
    with socket.socket(socket.AF_UNIX) as other:
        other.bind(os.fspath(folder / "syncd.sock"))
        other.listen()

        def serve():
            connection, _ = other.accept()
            with connection:
                connection.recv(100)
                connection.sendall(reply + b"\n")

        thread = threading.Thread(target=serve)
        thread.start()
        with pytest.raises(NotRunning, match=told):
            ask(folder, {})
        thread.join(60)


def test_where_it_is_looked_for(monkeypatch):
    monkeypatch.setenv("J2A_RUNTIME_DIR", "/a")
    monkeypatch.setenv("RUNTIME_DIRECTORY", "/b:/c")
    assert list(map(str, folders())) == ["/a"]
    monkeypatch.delenv("J2A_RUNTIME_DIR")
    assert list(map(str, folders())) == ["/b"]
    monkeypatch.delenv("RUNTIME_DIRECTORY")
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    assert list(map(str, folders())) == ["/run/j2a"]
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    monkeypatch.setenv("XDG_RUNTIME_DIR", "/run/user/7")
    assert list(map(str, folders())) == ["/run/user/7/j2a", "/run/j2a"]
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    assert str(folders()[0]) == "/run/user/1000/j2a"
