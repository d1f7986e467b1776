"""A caller that reads for itself, over a transport that raises what no transport may raise."""

import threading

import pytest
from j2a_transports._tcp import TcpTransport

import j2a

from .sockets import tcp_pair
from .support import PATIENCE_S
from .test_leading import calls
from .wire import Background


class Broken(TcpTransport):
    """Raises in one of its methods, from a moment on or in one thread only."""

    error = None
    where = ""
    thread = None
    leads = None
    last = None

    def _hit(self, where):
        thread = self.thread or threading.current_thread()
        if self.error is not None and where == self.where and thread is threading.current_thread():
            raise self.error

    def read(self, timeout_s):
        data = super().read(timeout_s)
        self._hit("read")
        return data

    def wait(self, timeout_s):
        self.last = threading.current_thread()
        if self.leads is not None:
            self.leads.set()
        is_there = super().wait(timeout_s)
        self._hit("wait")
        return is_there

    def write(self, data):
        self._hit("write")
        super().write(data)

    def try_write(self, data):
        if self.where == "write":
            return 0
        return super().try_write(data)


@pytest.fixture
def link(monkeypatch):
    monkeypatch.setattr("j2a.io.blocking.LEAD_S", PATIENCE_S)
    monkeypatch.setattr("j2a.io.threads._LINGER_S", 1.0)  # no other thread reads between two calls
    near, far = tcp_pair(Broken)
    with far, j2a.Client(near, timeout=PATIENCE_S) as client:
        while near.last is not threading.current_thread():  # the reading thread lets go in its time
            calls(client, far, 1)
        yield client, near, far


ERRORS = [OSError("gone"), ValueError("a bug"), KeyboardInterrupt()]


@pytest.mark.parametrize("error", ERRORS, ids=lambda error: type(error).__name__)
@pytest.mark.parametrize("where", ["read", "wait"])
def test_who_follows_does_not_hang(link, where, error):
    """Nobody can tell it from the exception of a signal handler: it is the caller's."""
    client, near, far = link
    near.where, near.thread, near.leads = where, threading.Thread(), threading.Event()
    leader = Background(client.call, 1)
    near.thread = leader
    assert near.leads.wait(PATIENCE_S)
    follower = Background(client.call, 2)
    while client._session.waiting < 2:
        assert leader.is_alive()
    near.error = error
    far.read(PATIENCE_S)
    far.write(b"\0")
    with pytest.raises(type(error)):
        leader.result()
    far.close()  # the reading thread goes on, and finds what becomes of the link
    with pytest.raises(j2a.LinkLost):
        follower.result()
    assert not client._engine._link.is_leading
    assert not client._engine._turn._is_owned()


@pytest.mark.parametrize("where", ["read", "write"])
def test_a_transport_that_ends_its_thread_has_lost_the_link(where):
    """Nobody else reads or writes; calls do not wait for their time limit."""
    near, far = tcp_pair(Broken)
    with far, j2a.Client(near, timeout=5) as client:
        near.where, near.error = where, SystemExit("a driver")
        if where == "read":
            far.write(b"\0")
        with pytest.raises(j2a.LinkLost, match="SystemExit: a driver"):
            client.call(1)
        assert not client.is_open
