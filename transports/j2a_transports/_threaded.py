"""A transport on blocking calls, for what cannot be polled: Windows pipes and pyserial's own URLs.

In: a blocking `source` and `sink`.  Out: `ThreadedTransport`, a loopback end whose other end two
threads move.
Rules: the threads are the only ones that touch source and sink; bytes written before `close()` are
still handed to the sink when it takes them.
"""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Callable
from typing import Final

from ._base import LinkLost, OpenFailed
from ._loopback import Channel, LoopbackTransport
from ._poll import CHUNK

# How long a stuck sink may take to end after it was interrupted, and a source. A source that
# cannot be interrupted is left behind; its thread does not keep the program alive.
SINK_END_S: Final = 5.0
SOURCE_END_S: Final = 1.0


class ThreadedTransport(LoopbackTransport):
    """A transport between a blocking source and a blocking sink.

    Args:
        url: for messages.
        source: returns bytes, b"" when there are none yet; raises at the end.
        sink: takes all bytes; raises when it cannot.
        interrupt: makes blocked calls of source and sink return or raise; called once, by `close`,
            with whether the sink is stuck.
        finish: called by the writing thread when nothing more will be written.
        release: frees what source and sink use; called once, after both threads have ended.
        reason: says why the link is lost, from the exception that ended a thread.
        write_timeout_s: see `Transport`.
    """

    def __init__(
        self,
        url: str,
        *,
        source: Callable[[], bytes],
        sink: Callable[[bytes], None],
        interrupt: Callable[[bool], None],
        finish: Callable[[], None],
        release: Callable[[], None],
        reason: Callable[[Exception], str],
        write_timeout_s: float | None,
    ) -> None:
        super().__init__(url, Channel(), Channel(), write_timeout_s)
        self._source = source
        self._sink = sink
        self._interrupt = interrupt
        self._finish = finish
        self._release = release
        self._reason = reason
        self._failure: Exception = EOFError()
        # Re-entrant, so that a signal handler may close what its own thread is closing.
        self._ending = threading.RLock()
        self._ended = False
        self._threads = [
            threading.Thread(target=target, name=f"{url} {name}", daemon=True)
            for target, name in ((self._pump_out, "writer"), (self._pump_in, "reader"))
        ]
        try:
            for thread in self._threads:
                thread.start()
        except RuntimeError as refused:  # the system has no thread to give
            self._threads = [thread for thread in self._threads if thread.is_alive()]
            if not self._threads:
                finish()
            self.close()
            raise OpenFailed(f"{url}: {refused}") from refused

    def _pump_in(self) -> None:
        try:
            while not self._incoming.reader_closed:
                rest = memoryview(self._source())
                while rest and not self._incoming.reader_closed:
                    rest = rest[self._incoming.put(rest, None) :]
        except Exception as error:
            # A foreign driver may raise anything; whatever it is, this direction has ended.
            self._failure = error
        self._incoming.close_writer()

    def _pump_out(self) -> None:
        try:
            while data := self._outgoing.get(None):
                self._sink(data)
        except Exception as error:
            # A foreign driver may raise anything; whatever it is, this direction has ended.
            self._failure = error
        self._outgoing.close_reader()
        self._finish()

    def wake_reader(self) -> bool:
        """See `Transport.wake_reader`; the source may have bytes that its thread has not."""
        return False

    def close(self) -> None:
        """See `Transport.close`."""
        with self._ending:
            if self._ended:  # or it is being closed, and this is a signal handler amid that
                return
            self._ended = True
            super().close()
            # A sink that may take for ever gets a moment now.
            limit_s = SINK_END_S if self.write_timeout_s is None else self.write_timeout_s
            for writer in self._threads[:1]:
                writer.join(limit_s)
            with contextlib.suppress(Exception):
                # A device that is gone refuses this, in many ways.
                self._interrupt(any(writer.is_alive() for writer in self._threads[:1]))
            for thread, end_s in zip(self._threads, (SINK_END_S, SOURCE_END_S), strict=False):
                thread.join(end_s)
            self._release()

    def _lost(self) -> LinkLost:
        return LinkLost(f"{self.url} is lost: {self._reason(self._failure)}")


def source_of(descriptor: int) -> Callable[[], bytes]:
    """Return a source that reads from a descriptor in blocking mode."""

    def source() -> bytes:
        data = os.read(descriptor, CHUNK)
        if not data:
            raise EOFError
        return data

    return source


def sink_of(descriptor: int) -> Callable[[bytes], None]:
    """Return a sink that writes to a descriptor in blocking mode."""

    def sink(data: bytes) -> None:
        rest = memoryview(data)
        while rest:
            rest = rest[os.write(descriptor, rest) :]

    return sink
