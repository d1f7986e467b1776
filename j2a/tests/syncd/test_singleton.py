"""The socket of the daemon: one at a time, and nobody who asks can hold it up."""

import json
import os
import socket
import threading

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


def test_without_a_daemon_it_says_where_it_looked(folder):
    with pytest.raises(NotRunning, match=r"syncd\.sock: No such file.*start one: j2a syncd"):
        ask(folder, {})


@pytest.mark.parametrize("text", [b"", b"\n", b"[]\n", b"nonsense\n", b"\xff\xfe\n", b"[" * 4000])
def test_what_is_no_request_is_answered_by_an_error(folder, server, text):
    with socket.socket(socket.AF_UNIX) as connection:
        connection.connect(os.fspath(server.path))
        connection.sendall(text)
        connection.shutdown(socket.SHUT_WR)
        assert "that is no request" in json.loads(connection.makefile().read())["error"]
    assert ask(folder, {})["trusted"]


def test_who_says_nothing_or_too_much_holds_it_up_for_a_moment(folder, server, monkeypatch):
    monkeypatch.setattr(singleton, "_SERVE_S", 0.05)
    monkeypatch.setattr(singleton, "LIMIT_S", 60)
    idle = [socket.socket(socket.AF_UNIX) for _ in range(8)]
    for one in idle:
        one.connect(os.fspath(server.path))
    idle[1].sendall(b"{")
    idle[2].sendall(b" " * (singleton.MAX_REQUEST + 1))
    assert ask(folder, {})["trusted"]
    for one in idle:
        one.close()


def test_who_hangs_up_disturbs_nobody(folder, server):
    for _ in range(50):
        with socket.socket(socket.AF_UNIX) as connection:
            connection.connect(os.fspath(server.path))
            connection.sendall(b"{}\n")
    assert ask(folder, {})["trusted"]


def test_a_folder_that_others_may_write_into_is_refused(folder):
    folder.mkdir()
    folder.chmod(0o777)
    with pytest.raises(PermissionError, match="others may write"):
        Server(folder, echo)


def test_a_reply_that_is_none_is_told(folder):
    folder.mkdir()
    with socket.socket(socket.AF_UNIX) as other:
        other.bind(os.fspath(folder / "syncd.sock"))
        other.listen()

        def serve():
            connection, _ = other.accept()
            with connection:
                connection.recv(100)
                connection.sendall(b"42\n")

        thread = threading.Thread(target=serve)
        thread.start()
        with pytest.raises(NotRunning, match="is no j2a syncd"):
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
