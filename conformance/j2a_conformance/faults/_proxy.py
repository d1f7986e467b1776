"""Stands between the faults and the device and notes what really passed.

What flows in and out: the bytes of a transport, unchanged. Rules: each write is noted with its
time, because the expected replies depend on the pauses between writes.
"""

from dataclasses import dataclass

from j2a_spec import constants as c
from j2a_transports import Transport

from ._rules import Stream

__all__ = ["Tap"]


@dataclass(frozen=True, slots=True)
class _Write:
    begin_s: float
    end_s: float
    data: bytes


class Tap(Transport):
    """A transport around another one, which it owns.

    Args:
        inner: the link to the device.

    Attributes:
        is_simulated, clock, sleep: those of the link.
        received: what was read since `clear`.
    """

    def __init__(self, inner: Transport) -> None:
        super().__init__(inner.url, inner.write_timeout_s)
        self.inner = inner
        self.is_simulated = inner.is_simulated
        self.clock = inner.clock  # type: ignore[method-assign]
        self.sleep = inner.sleep  # type: ignore[method-assign]
        self.received = bytearray()
        self._seen = 0
        self._writes: list[_Write] = []

    def read(self, timeout_s: float | None) -> bytes:
        """See `Transport.read`."""
        data = self.inner.read(timeout_s)
        self.received += data
        return data

    def write(self, data: bytes | bytearray | memoryview) -> None:
        """See `Transport.write`."""
        self.inner.write_timeout_s = self.write_timeout_s
        begin_s = self.clock()
        self.inner.write(data)
        self._writes.append(_Write(begin_s, self.clock(), bytes(data)))

    @property
    def closed(self) -> bool:
        """See `Transport.closed`."""
        return self.inner.closed

    def close(self) -> None:
        """See `Transport.close`."""
        self.inner.close()

    def clear(self) -> None:
        """Forget what passed so far."""
        self.received.clear()
        self._seen = 0
        self._writes.clear()

    def unread(self) -> bytes:
        """Return what was received since the last call."""
        new = bytes(self.received[self._seen :])
        self._seen = len(self.received)
        return new

    @property
    def sent(self) -> bytes:
        """The bytes written since `clear`."""
        return b"".join(write.data for write in self._writes)

    def stream(self, byte_s: float) -> Stream | None:
        """Return what was written since `clear`, cut where it paused.

        Args:
            byte_s: time that a byte takes on the link.

        Returns:
            None where a pause was neither short nor long enough to know what a device makes of it.
        """
        segments = [b""]
        before: _Write | None = None
        for write in self._writes:
            if before is not None:
                longest_s = write.end_s - before.begin_s
                shortest_s = write.begin_s - before.end_s - len(before.data) * byte_s
                if shortest_s * 1e3 > c.BYTE_TIMEOUT_MAX_MS:
                    segments.append(b"")
                elif longest_s * 1e3 > c.BYTE_TIMEOUT_MIN_MS:
                    return None
            segments[-1] += write.data
            before = write
        return tuple(segment for segment in segments if segment)
