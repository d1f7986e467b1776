"""Boards that hang while their link stays open, as `j2a record` and `j2a watch` see them."""

import contextlib
import re
import signal
import socket
import threading
import time

import pytest

from j2a.cli import _watch
from j2a.virtual import VirtualBoard

from .conftest import served
from .test_record import board_file, payloads, wait_for


@pytest.fixture
def board():
    device = VirtualBoard(board_file())
    device.measure()
    yield from served(device)


class Hanging:
    """A board behind a link that stays open, whatever hangs.

    Attributes:
        url: of the link.
        hangs: while it is set, no byte passes from the board to hosts.
        hosts: so many links were made.
    """

    def __init__(self, url):
        self._board = url
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"tcp://127.0.0.1:{self._listener.getsockname()[1]}"
        self.hangs = threading.Event()
        self.hosts = 0
        self._sockets = []
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self):
        with contextlib.suppress(OSError):
            while True:
                self._serve(self._listener.accept()[0])

    def _serve(self, host):
        self.hosts += 1
        board = socket.create_connection(self._board)
        self._sockets += host, board
        for one, other in ((host, board), (board, host)):
            threading.Thread(target=self._pass, args=(one, other), daemon=True).start()

    def _pass(self, one, other):
        with contextlib.suppress(OSError):
            while piece := one.recv(4096):
                if not self.hangs.is_set():
                    other.sendall(piece)
            other.shutdown(socket.SHUT_RDWR)

    def close(self):
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        for one in self._sockets:
            one.close()


@pytest.fixture
def hanging(board):
    link = Hanging(("127.0.0.1", int(board.rsplit(":", 1)[1])))
    yield link
    link.close()


def test_a_board_that_hangs_is_a_gap_and_taken_in_again(hanging, start, tmp_path):
    path = tmp_path / "a.mcap"
    begun = start("record", hanging.url, "-o", path, "--boot-time", "1", "--timeout", "0.5")
    wait_for(path, 10, begun.process)
    hanging.hangs.set()
    asked = time.monotonic()
    assert f"{hanging.url} does not answer" in begun.line_with("j2a:", "err")
    assert time.monotonic() - asked < 30
    hanging.hangs.clear()
    assert "is here again, after" in begun.line_with("j2a:", "err")
    wait_for(path, len(payloads(path)) + 50, begun.process)
    begun.process.send_signal(signal.SIGINT)
    result = begun.end()
    assert result.code == 130
    [gap_s] = re.findall(r"a board was away 1 time, ([0-9.]+) s", result.out)
    assert float(gap_s) > 3
    assert hanging.hosts >= 2


def test_a_board_that_hangs_until_the_end_is_a_gap(hanging, start, tmp_path):
    path = tmp_path / "a.mcap"
    options = ("--boot-time", "0.1", "--timeout", "0.5", "--wait", "1")
    begun = start("record", hanging.url, "-o", path, *options)
    wait_for(path, 10, begun.process)
    hanging.hangs.set()
    result = begun.end()
    assert result.code == 3
    assert "does not answer" in result.err
    [gap_s] = re.findall(r"a board was away 1 time, ([0-9.]+) s", result.out)
    assert float(gap_s) > 3


@pytest.mark.parametrize("words", [("record", "-o", "FILE", "--seconds", "6"), ("watch",)])
def test_a_board_whose_sensors_are_quiet_does_not_hang(run, tmp_path, words):
    device = VirtualBoard(board_file())
    serving = served(device)
    try:
        link = Hanging(("127.0.0.1", int(next(serving).rsplit(":", 1)[1])))
        path = tmp_path / "a.mcap"
        words = [path if word == "FILE" else word for word in words]
        if words[0] == "watch":
            words += ["0xEF", "--duration", "6"]
        result = run(words[0], link.url, *words[1:])
        link.close()
    finally:
        next(serving, None)
    told = f"{_watch._HINT}\n" if words[0] == "watch" else ""
    assert (result.code, result.err) == (0, told)
    assert "away" not in result.out


@pytest.mark.parametrize("words", [(), ("--rates",), ("0xEF",)])
def test_watching_a_board_that_hangs_ends(hanging, start, words):
    begun = start("watch", hanging.url, "--timeout", "0.5", *words)
    while hanging.hosts < 1:
        time.sleep(0.01)
    time.sleep(1.0)
    hanging.hangs.set()
    result = begun.end()
    assert result.code == 4
    assert "a2jEcho" in result.err


def test_a_name_that_could_not_be_learnt(run, monkeypatch):
    device = VirtualBoard(board_file())
    monkeypatch.setattr(device._runner._server, "content", b"")
    serving = served(device)
    try:
        result = run("watch", next(serving), "plain")
    finally:
        next(serving, None)
    assert result.code == 2
    assert "no SIF or sensor 'plain'; it has: none, as the descriptors break the" in result.err
