"""Transports on file descriptors and sockets, with waits that `close()` can end.

In: descriptors that never block.  Out: `PolledTransport`, on which TCP, processes, pseudo terminals
and POSIX serial ports are built, and `Waker` and `Readiness` for listeners.
Rules: a descriptor is released only after the reader and the writer have left it, because its
number could be given to another file meanwhile. Windows can wait for sockets only.
"""

from __future__ import annotations

import contextlib
import math
import os
import select
import socket
import threading
import time
from typing import Final

from ._base import LinkClosed, LinkLost, Transport, WriteTimeout
from .options import LONGEST_S

CHUNK: Final = 65536
LOOK_S: Final = 0.1
"""So often a read that nothing can wake looks whether it was to be."""

READY: Final = 1
BROKEN: Final = 2
WOKEN: Final = 4
_INPUT: Final = READY | BROKEN


class Waker:
    """A switch that ends all present and future waits."""

    def __init__(self) -> None:
        self._process = os.getpid()
        self._receiver, self._sender = socket.socketpair()
        self._receiver.setblocking(False)
        self._sender.setblocking(False)

    def fileno(self) -> int:
        """Return the descriptor that becomes readable, and stays so, once `wake` was called."""
        return self._receiver.fileno()

    def wake(self) -> None:
        """End the waits; in a forked process, which has none but shares the switch, nothing."""
        if os.getpid() != self._process:
            return
        try:
            self._sender.send(b"\0")
        except OSError:
            # Full or closed: the waiting thread is already awake.
            return

    def reset(self) -> None:
        """Let waits wait again."""
        with contextlib.suppress(BlockingIOError):
            self._receiver.recv(CHUNK)

    def close(self) -> None:
        """Free the descriptors."""
        self._sender.close()
        self._receiver.close()


class Readiness:
    """Waits for one direction of one descriptor, or for a waker. For one thread at a time."""

    def __init__(self, fd: int, waker: Waker, *, write: bool) -> None:
        self._fd = fd
        self._wakers: list[Waker] = []
        self._write = write
        self._is_polling = False
        self._poll = None
        self._just_ready: list[tuple[int, int]] | None = None
        if hasattr(select, "poll"):
            self._poll = self._new_poll()
            self._just_ready = [(fd, self._mask)]
        self.add(waker)

    @property
    def _mask(self) -> int:
        return select.POLLOUT if self._write else select.POLLIN

    def _new_poll(self) -> select.poll:
        """Return what polls all of this; it cannot be used twice at a time."""
        poll = select.poll()
        poll.register(self._fd, self._mask)
        for waker in self._wakers:
            poll.register(waker.fileno(), select.POLLIN)
        return poll

    def add(self, waker: Waker) -> None:
        """Let one more waker end the waits."""
        self._wakers.append(waker)
        if self._poll is not None:
            self._poll.register(waker.fileno(), select.POLLIN)

    def wait(self, timeout_s: float | None) -> int:
        """Return a set of READY, BROKEN (the peer hung up) and WOKEN; 0 when the time ran out."""
        if timeout_s is not None and timeout_s >= LONGEST_S:
            timeout_s = None
        poll = self._poll
        if poll is None:
            return self._select(timeout_s)
        was_polling = self._is_polling  # then this is a signal handler amid a wait
        if was_polling:
            poll = self._new_poll()
        self._is_polling = True
        try:
            limit_ms = None if timeout_s is None else timeout_s * 1000 if timeout_s > 0 else 0
            found = poll.poll(limit_ms)
        finally:
            self._is_polling = was_polling
        if found == self._just_ready:
            return READY
        result = 0
        for fd, mask in found:
            if fd != self._fd:
                result |= WOKEN
                continue
            if mask & (select.POLLIN | select.POLLOUT):
                result |= READY
            if mask & ~(select.POLLIN | select.POLLOUT):
                result |= BROKEN
        return result

    def hung_up(self) -> bool:
        """Whether the peer has hung up; bytes of it may still be there."""
        return self._poll is not None and any(
            fd == self._fd and mask & select.POLLHUP for fd, mask in self._new_poll().poll(0)
        )

    def _select(self, timeout_s: float | None) -> int:
        wait = None if timeout_s is None else max(timeout_s, 0)
        wakers = [waker.fileno() for waker in self._wakers]
        readers = wakers + ([] if self._write else [self._fd])
        writers = [self._fd] if self._write else []
        readable, writable, _ = select.select(readers, writers, [], wait)
        result = 0
        if set(wakers) & set(readable):
            result |= WOKEN
        if self._fd in readable or writable:
            result |= READY
        return result


class PolledTransport(Transport):
    """A transport on one or two descriptors; a subclass says how to receive, send and release.

    Args:
        url: for messages.
        read_fd: descriptor to read from, not blocking.
        write_fd: descriptor to write to, not blocking; may be the same.
        write_timeout_s: see `Transport`.

    Attributes:
        says_empty: receiving fails where nothing has come, so that b"" is the end and nothing else;
            a terminal may be set up otherwise. Then `read(0)` need not ask before it receives.
    """

    says_empty = False

    def __init__(
        self, url: str, read_fd: int, write_fd: int, write_timeout_s: float | None
    ) -> None:
        super().__init__(url, write_timeout_s)
        self._read_fd = read_fd
        self._write_fd = write_fd
        self._process = os.getpid()
        self._waker = Waker()
        self._readable = Readiness(read_fd, self._waker, write=False)
        self._writable = Readiness(write_fd, self._waker, write=True)
        # Made by the first read without a time limit or `wait`, as only these have to be woken.
        self._reader_waker: Waker | None = None
        self._reader_woken = False
        # Re-entrant, so that a signal handler may close what its own thread is reading.
        self._reading = threading.RLock()
        self._writing = threading.RLock()
        # Held by a `try_write` for one call of the system. It is no `acquire` that may fail: what a
        # signal handler raises behind that would leave the lock taken.
        self._sending = threading.RLock()
        self._is_writing = False
        self._closed = False
        self._released = False
        # Set once reading has met the end: the link stays lost, in both directions.
        self._end: str | None = None

    def read(self, timeout_s: float | None) -> bytes:
        """See `Transport.read`."""
        deadline = None if not timeout_s else time.monotonic() + timeout_s
        with self._reading:
            while True:
                if self._closed or self._end is not None:
                    self._check()
                if timeout_s != 0 or not self.says_empty:
                    state = self._await_input(timeout_s)
                    if self._closed:
                        raise LinkClosed(f"{self.url} was closed during a read")
                    if not state & _INPUT:
                        return b""
                try:
                    data = self._receive()
                except (BlockingIOError, InterruptedError):
                    if timeout_s == 0:
                        return b""
                    # Ready and yet nothing there: wait for what is left of the time.
                    timeout_s = _left(deadline, timeout_s)
                    continue
                except OSError as error:
                    if not self._knows_end(_left(deadline, timeout_s)):
                        return b""
                    lost = self._lost(error)
                    self._end = str(lost)
                    raise lost from error
                if data:
                    return data
                if not self._knows_end(_left(deadline, timeout_s)):
                    return b""
                self._end = str(self._lost(None))

    def fileno(self) -> int:
        """See `Transport.fileno`."""
        return self._read_fd

    def wait(self, timeout_s: float) -> bool:
        """See `Transport.wait`."""
        with self._reading:
            if self._closed or self._end is not None:
                return True
            state = self._await_input(timeout_s, may_be_woken=True)
            return bool(state & _INPUT) or self._closed

    def _await_input(self, timeout_s: float | None, *, may_be_woken: bool = False) -> int:
        """Wait until there is something to read, or until woken; return what `Readiness` says."""
        # A read with a time limit need not be woken, so a device saves the descriptors.
        if (timeout_s is None or may_be_woken) and self._reader_waker is None:
            try:
                self._add_reader_waker()
            except OSError:  # there are too many open files
                return self._look_for_input(timeout_s)
        state = self._readable.wait(0 if self._reader_woken else timeout_s)
        if (state != READY or self._reader_woken) and not self._closed:
            self._reader_woken = False
            if state & WOKEN and self._reader_waker is not None:
                self._reader_waker.reset()
        return state

    def _look_for_input(self, timeout_s: float | None) -> int:
        """Do the same where nothing ends a wait, by looking again and again."""
        end = math.inf if timeout_s is None else time.monotonic() + timeout_s
        while True:
            left_s = 0 if self._reader_woken else end - time.monotonic()
            state = self._readable.wait(min(left_s, LOOK_S))
            if state or left_s <= 0:
                self._reader_woken = False
                return state

    def _add_reader_waker(self) -> None:
        self._reader_waker = Waker()
        self._readable.add(self._reader_waker)

    def write(self, data: bytes | bytearray | memoryview) -> None:
        """See `Transport.write`."""
        with self._writing:
            was_writing = self._is_writing  # of a signal handler's caller
            try:
                with self._sending:
                    self._is_writing = True
                self._write_all(memoryview(data).cast("B"))
            finally:
                self._is_writing = was_writing

    def try_write(self, data: bytes) -> int:
        """See `Transport.try_write`."""
        with self._sending:
            if self._is_writing or self._closed or self._end is not None:
                return 0
            try:
                return self._send(data)
            except OSError:
                return 0  # there is no room, or `write` meets the same error

    def wake_reader(self) -> bool:
        """See `Transport.wake_reader`."""
        self._reader_woken = True
        if self._reader_waker is not None:
            self._reader_waker.wake()
        return True

    def _write_all(self, data: memoryview) -> None:
        rest = data
        self._check()
        while rest:
            try:
                sent = self._send(rest)
            except (BlockingIOError, InterruptedError):
                sent = 0
            except OSError as error:
                raise self._lost(error) from error
            rest = rest[sent:]
            if rest and not sent:
                self._await_room(len(rest), len(data))

    def _check(self) -> None:
        if self._closed:
            raise LinkClosed(f"{self.url} is closed")
        if self._end is not None:
            raise LinkLost(self._end)

    def _await_room(self, missing: int, total: int) -> None:
        state = self._writable.wait(self.write_timeout_s)
        if self._closed:
            raise LinkClosed(f"{self.url} was closed during a write")
        if not state:
            raise WriteTimeout(
                f"{self.url} took no byte for {self.write_timeout_s} s "
                f"({missing} of {total} bytes not sent): the peer does not read"
            )
        if state & BROKEN and not state & READY:
            raise self._lost(None)

    @property
    def closed(self) -> bool:
        """See `Transport.closed`."""
        return self._closed

    def close(self) -> None:
        """See `Transport.close`."""
        self._closed = True
        if self._is_fork:
            self._let_go()  # nobody who may hold the locks is in this process
            return
        self._waker.wake()
        with self._reading, self._writing, self._sending:
            self._let_go()

    @property
    def _is_fork(self) -> bool:
        """Whether this is a forked process: it has descriptors, but the link is its parent's."""
        return os.getpid() != self._process

    def _let_go(self) -> None:
        if self._released:
            return
        self._released = True
        try:
            self._release()
        finally:
            self._waker.close()
            if self._reader_waker is not None:
                self._reader_waker.close()

    def _receive(self) -> bytes:
        """Return what is there, b"" at the end; BlockingIOError when there is nothing."""
        return os.read(self._read_fd, CHUNK)

    def _send(self, data: bytes | memoryview) -> int:
        """Return how many bytes were taken; BlockingIOError when none can be."""
        return os.write(self._write_fd, data)

    def _knows_end(self, limit_s: float | None) -> bool:
        """Whether it is known how the link has ended; waits for that, but no longer than this."""
        return True

    def _lost(self, error: OSError | None) -> LinkLost:
        """Say how the link was lost; `error` is None at the end of the stream."""
        reason = "the peer closed it" if error is None else error.strerror or str(error)
        return LinkLost(f"{self.url} is lost: {reason}")

    def _release(self) -> None:
        """Free the descriptors; called once, when they are no longer in use.

        In a forked process that is all that it may do: the parent goes on.
        """
        for fd in {self._read_fd, self._write_fd}:
            os.close(fd)


def _left(deadline: float | None, timeout_s: float | None) -> float | None:
    """Return what is left of a time limit, which is 0 or None where there is no deadline."""
    return timeout_s if deadline is None else max(0.0, deadline - time.monotonic())
