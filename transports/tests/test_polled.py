"""Transports on descriptors where processes fork, signals come, and descriptors run out."""

from __future__ import annotations

import math
import os
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import j2a_transports
import pytest
from j2a_transports import LinkClosed, Transport
from j2a_transports._poll import READY, Readiness, Waker

from .programs import run_program
from .suite import PATIENCE_S, Background, read_exactly
from .test_listeners import accepted, free_descriptors

if sys.platform != "win32":
    import fcntl
    import resource

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="programs of POSIX")

FORKING = """
import os, signal, threading, j2a_transports
near = j2a_transports.open("exec:cat")
reader = threading.Thread(target=lambda: print(near.read(None)))
reader.start()
while near._reading.acquire(blocking=False):
    near._reading.release()
child = os.fork()
if child == 0:
    signal.alarm(30)  # nobody gives the lock of the reader back here
    near.close()
    os._exit(not near.closed)
print(os.waitpid(child, 0)[1])
near.write(b"still the parent's")
reader.join()
near.close()
"""


def test_a_child_process_lets_go_of_what_its_parent_reads() -> None:
    code, said, errors = run_program(FORKING)
    assert (code, said) == (0, '0\nb"still the parent\'s"\n'), errors


@contextmanager
def joined() -> Iterator[tuple[Transport, Transport]]:
    with (
        j2a_transports.listen("tcp://127.0.0.1:0") as listener,
        j2a_transports.open(listener.url) as near,
        accepted(listener) as far,
    ):
        yield near, far


class TestWithoutADescriptorToBeWokenBy:
    def test_a_read_without_a_limit_returns_what_comes(self) -> None:
        with joined() as (near, far), free_descriptors(0):
            reading = Background(lambda: near.read(None))
            far.write(b"x")
            assert reading.result() == b"x"

    def test_a_reader_that_is_woken_returns(self) -> None:
        with joined() as (near, _), free_descriptors(0):
            reading = Background(lambda: near.read(None))
            assert near.wake_reader()
            assert reading.result() == b""

    def test_closing_ends_it(self) -> None:
        with joined() as (near, _), free_descriptors(0):
            reading = Background(lambda: near.read(None))
            near.close()
            with pytest.raises(LinkClosed):
                reading.result()

    def test_a_wait_keeps_its_limit(self) -> None:
        with joined() as (near, far), free_descriptors(0):
            assert not near.wait(0.01)
            far.write(b"x")
            assert near.wait(PATIENCE_S)


@contextmanager
def at_a_signal(handle: Callable[[], object]) -> Iterator[None]:
    """Let a signal come in a moment, amid what the main thread waits for by then."""
    before = signal.signal(signal.SIGUSR1, lambda *_: handle())
    sender = threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGUSR1))
    sender.start()
    try:
        yield
    finally:
        sender.join()
        signal.signal(signal.SIGUSR1, before)


@pytest.mark.parametrize("limit_s", [1e8, math.inf])
def test_a_limit_that_the_system_cannot_count_is_none(limit_s: float) -> None:
    with joined() as (near, far):
        far.write(b"x")
        assert near.wait(limit_s)
        assert near.read(limit_s) == b"x"
        near.write_timeout_s = limit_s
        writing = Background(lambda: near.write(bytes(1 << 24)))
        assert len(read_exactly(far, 1 << 24)) == 1 << 24
        writing.result()


def test_a_signal_handler_closes_a_terminal_amid_a_read() -> None:
    with j2a_transports.listen("pty:") as listener:
        terminal = os.open(listener.url.removeprefix("serial://"), os.O_RDWR | os.O_NOCTTY)
        far = accepted(listener)
        with at_a_signal(far.close), pytest.raises(LinkClosed):
            far.read(PATIENCE_S)
        os.close(terminal)


def test_a_signal_handler_waits_amid_a_wait_for_a_great_descriptor() -> None:
    """Greater than those that `select` can wait for."""
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(before[0], 1100), before[1]))
    found: list[int] = []
    one, other = socket.socketpair()
    with one, other:
        great = fcntl.fcntl(one.fileno(), fcntl.F_DUPFD, 1024)
        waker = Waker()
        readable = Readiness(great, waker, write=False)

        def handle() -> None:
            found.append(readable.wait(0))
            other.send(b"x")
            found.append(readable.wait(PATIENCE_S))

        with at_a_signal(handle):
            assert readable.wait(PATIENCE_S) == READY
        waker.close()
        os.close(great)
    resource.setrlimit(resource.RLIMIT_NOFILE, before)
    assert found == [0, READY]
