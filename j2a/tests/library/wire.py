"""A client whose device is the test itself, and calls that wait in the background."""

import struct
import threading

import j2a_transports
from j2a_spec import oracle

import j2a

from .support import PATIENCE_S


def delay(milliseconds: int) -> bytes:
    return struct.pack("<H", milliseconds)


class Wire:
    """A client whose device is the test itself, frame by frame."""

    def __init__(self, **options: object) -> None:
        near, self.far = j2a_transports.pair()
        self._data = b""
        self.client = j2a.Client(near, timeout=PATIENCE_S, **options)

    def __enter__(self) -> "Wire":
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.client.close()
        self.far.close()

    def request(self) -> oracle.Frame:
        while True:
            event, *more = oracle.decode(self._data) or [None]
            if isinstance(event, oracle.Frame):
                self._data = b"".join(map(oracle.encode, more))
                return event
            data = self.far.read(PATIENCE_S)
            assert data, "no request comes"
            self._data += data

    def send(self, *frames: oracle.Frame) -> None:
        self.far.write(b"".join(map(oracle.encode, frames)))


class BrokenDriver(j2a_transports.Transport):
    """A transport that raises what no transport may raise, when told to.

    Args:
        fails: "read" or "write".
    """

    closed = False

    def __init__(self, fails: str) -> None:
        super().__init__("broken:")
        self._fails = fails
        self._told = threading.Event()

    def read(self, timeout_s: float | None) -> bytes:
        self._told.wait(timeout_s)
        if timeout_s is None and self._fails == "read":
            raise ValueError("a bug in the driver")
        return b""

    def write(self, _data: bytes) -> None:
        if self._fails == "write":
            raise ValueError("a bug in the driver")
        self._told.set()

    def close(self) -> None:
        self._fails = "read"
        self._told.set()


class Background(threading.Thread):
    """A call in a thread of its own; `result()` gives its reply or raises its error."""

    def __init__(self, function, *args, **kwargs):
        super().__init__(daemon=True)
        self._work = lambda: function(*args, **kwargs)
        self._reply = self._error = None
        self.start()

    def run(self):
        try:
            self._reply = self._work()
        except BaseException as error:
            self._error = error

    def result(self):
        self.join(PATIENCE_S)
        assert not self.is_alive(), "the call does not end"
        if self._error is not None:
            raise self._error
        return self._reply


class Watched(threading.Condition):
    """A condition that says when somebody waits for it."""

    def __init__(self):
        super().__init__()
        self.is_waited_for = threading.Event()

    def wait(self, timeout=None):
        self.is_waited_for.set()
        return super().wait(timeout)
