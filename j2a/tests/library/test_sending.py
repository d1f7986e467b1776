"""The way of requests to the transport: by the caller where the link takes them at once, else by
the writing thread, and in their order either way."""

import signal
import threading
import time

import j2a_transports
import pytest
from j2a_spec import oracle

import j2a
from j2a.demo import DemoDevice
from j2a.io.threads import LinkThreads

from .support import PATIENCE_S, served
from .wire import Background


class Narrow(j2a_transports.Transport):
    """A transport that takes a given number of bytes at once, and more when its gate is open."""

    def __init__(self, at_once):
        super().__init__("narrow:")
        self.room = at_once
        self.gate, self.is_full = threading.Event(), threading.Event()
        self.sent = b""
        self.writers = set()
        self._closed = threading.Event()

    def try_write(self, data):
        taken = data[: self.room]
        self.room -= len(taken)
        self._take(taken)
        return len(taken)

    def write(self, data):
        self.is_full.set()
        assert self.gate.wait(PATIENCE_S)
        self._take(data)

    def _take(self, data):
        self.sent += data
        if data:
            self.writers.add(threading.current_thread())

    def read(self, timeout_s):
        self._closed.wait(timeout_s)
        if self._closed.is_set():
            raise j2a_transports.LinkClosed("narrow: is closed")
        return b""

    @property
    def closed(self):
        return self._closed.is_set()

    def close(self):
        self.gate.set()
        self._closed.set()


@pytest.fixture
def started():
    links = []

    def start(transport):
        link = LinkThreads(transport, lambda _: None, lambda _: None, lambda _: None)
        links.append((link, transport))
        link.start()
        return link

    yield start
    for link, transport in links:
        link.stop()
        transport.close()
        for thread in link.threads:
            thread.join(PATIENCE_S)
            assert not thread.is_alive()


PIECES = [bytes([number]) * 10 for number in range(20)]


@pytest.mark.parametrize("at_once", [*range(0, 201, 7), 10, 199, 200])
def test_pieces_keep_their_order_whoever_writes_them(started, at_once):
    transport = Narrow(at_once)
    link = started(transport)
    for piece in PIECES[:15]:
        link.send(piece)
    transport.gate.set()
    for piece in PIECES[15:]:
        link.send(piece)
    link.stop()
    link.threads[1].join(PATIENCE_S)
    assert transport.sent == b"".join(PIECES)


def test_what_waits_for_the_writing_thread_is_not_overtaken(started):
    transport = Narrow(0)
    link = started(transport)
    link.send(b"first")
    assert transport.is_full.wait(PATIENCE_S)
    transport.room = 1000
    link.send(b"second")
    assert transport.sent == b""
    transport.gate.set()
    link.stop()
    link.threads[1].join(PATIENCE_S)
    assert transport.sent == b"firstsecond"


def test_what_the_link_takes_at_once_needs_no_other_thread(started):
    transport = Narrow(1000)
    link = started(transport)
    for piece in PIECES:
        link.send(piece)
    assert transport.sent == b"".join(PIECES)
    assert transport.writers == {threading.current_thread()}


def test_when_nothing_waits_any_more_the_link_is_tried_again(started):
    transport = Narrow(0)
    link = started(transport)
    link.send(b"first")
    transport.gate.set()
    for _ in range(5000):
        transport.room = 1000
        link.send(b"next")
        if threading.current_thread() in transport.writers:
            break
        time.sleep(0.001)
    assert transport.sent.startswith(b"firstnext")
    assert threading.current_thread() in transport.writers


@pytest.mark.requirement("J2A-TIME-006")
@pytest.mark.parametrize("at_once", range(6))
def test_a_link_that_takes_a_part_of_a_request_does_not_hold_up_its_caller(at_once):
    transport = Narrow(at_once)
    with j2a.Client(transport) as client:
        with pytest.raises(j2a.CallTimeout):
            client.call(0, timeout=0.01)
        transport.gate.set()
        call = Background(lambda: client.call(0, timeout=0.01))
        with pytest.raises(j2a.CallTimeout):
            call.result()
    first = oracle.decode(transport.sent)[0]
    assert (first.opcode, first.payload) == (0, b"")


def test_over_tcp():
    with served(DemoDevice(), "tcp://127.0.0.1:0") as url, j2a.connect(url) as client:
        data = bytes(range(256)) * 40
        assert client.echo_many(data) == data


class TestASignalAmidACall:
    """The trace runs where the locks are held, so a signal that it raises comes at the worst."""

    @pytest.fixture
    def amid(self):
        """A function that connects a client and has a handler called amid its next call."""
        clients = []

        def connect(url, handler):
            def trace(direction, _item):
                if direction == "tx" and len(clients) == 1 and (client := clients.pop()):
                    handlers.append(lambda: handler(client))
                    signal.raise_signal(signal.SIGINT)

            def interrupt(_number, _frame):
                handlers.pop()()

            handlers = []
            befores.append(signal.signal(signal.SIGINT, interrupt))
            client = j2a.connect(url, trace=trace, timeout=PATIENCE_S)
            clients.append(client)
            return client

        befores = []
        yield connect
        signal.signal(signal.SIGINT, befores[0])

    def test_may_close_the_client(self, amid):
        with served(DemoDevice()) as url:
            client = amid(url, lambda client: client.close())
            with pytest.raises(j2a.LinkClosed, match="was closed by this program"):
                client.echo(b"x")
            client.close()
            assert not client.is_open

    def test_may_close_the_client_and_end_the_program(self, amid):
        def end(client):
            client.close()
            raise SystemExit

        with served(DemoDevice()) as url:
            client = amid(url, end)
            with pytest.raises(SystemExit):
                client.echo(b"x")
            client.close()
            assert not client.is_open

    def test_cannot_call(self, amid):
        def call(client):
            with pytest.raises(j2a.LocalError, match="signal handler") as error:
                client.echo(b"y")
            refused.append(error.value.outcome)

        refused = []
        with served(DemoDevice()) as url, amid(url, call) as client:
            assert client.echo(b"x") == b"x"
        assert refused == [j2a.Outcome.NOT_SENT]
