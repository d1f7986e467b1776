"""Samples as messages of ROS 2, in the encoding CDR, and back, bit for bit.

What flows in: payloads of sample SIFs, or messages. What flows out: the other one.
Rules: numbers keep their bytes, so even what is no number comes back as it was; a message that is
not what the descriptor says is a ValueError, however it is damaged.
"""

import struct
from collections.abc import Iterator
from typing import Final

from j2a_spec.constants import MAX_PAYLOAD

from j2a.types.model import Structure, Type, element_size
from j2a.types.transducers import LOST_BYTES, TIME_BYTES, Transducer

__all__ = ["SampleMessage"]

_HEADER: Final = b"\x00\x01\x00\x00"  # little-endian, plain
_US: Final = 1_000_000
_NS_PER_US: Final = 1000
_SECONDS: Final = 1 << 32
_COUNT: Final = struct.Struct("<I")
_TIME: Final = struct.Struct("<II")


class SampleMessage:
    """Turns the samples of one sensor into messages and back; the type is that of `ros2_messages`.

    Args:
        sensor: what its descriptor says.
    """

    def __init__(self, sensor: Transducer) -> None:
        self._has_queue = sensor.queue > 0
        self._channels = sensor.channels
        self._sizes = tuple(_sizes(sensor.type))
        self._bytes = sensor.type.size
        # Of an array the elements are elements of the message, which has no array in an array.
        self._elements = 1 if isinstance(sensor.type.element, Structure) else len(self._sizes)
        self._entry = self._has_queue + TIME_BYTES + self._bytes

    def pack(self, payload: bytes) -> bytes:
        """Return the message of a sample.

        Raises:
            ValueError: a time is behind the year 2106, or the payload is no sample.
        """
        start = LOST_BYTES if self._has_queue else 0
        count, rest = divmod(len(payload) - start, self._entry)
        if rest or count < 1:
            raise ValueError(f"{len(payload)} bytes are no sample")
        entries = [payload[at : at + self._entry] for at in range(start, len(payload), self._entry)]
        out = _Writer()
        out.count(count)
        skipped = int(self._has_queue)
        for entry in entries:
            time_us = int.from_bytes(entry[skipped : skipped + TIME_BYTES], "little")
            seconds, us = divmod(time_us, _US)
            if seconds >= _SECONDS:
                raise ValueError(f"a message has no time of {time_us} us")
            out.add(_TIME.pack(seconds, us * _NS_PER_US), 4)
        out.count(count * self._elements)
        for entry in entries:
            at = skipped + TIME_BYTES
            for size in self._sizes:
                out.add(entry[at : at + size], size)
                at += size
        if self._has_queue:
            out.count(count)
            out.add(bytes(entry[0] for entry in entries), 1)
            out.add(payload[:LOST_BYTES], LOST_BYTES)
        return bytes(out.data)

    def unpack(self, message: bytes) -> bytes:
        """Return the payload of the sample that a message is.

        Raises:
            ValueError: it is none of this sensor.
        """
        source = _Reader(message)
        times = []
        count = source.count(_TIME.size)
        if not (1 <= count <= MAX_PAYLOAD if self._has_queue else count == self._channels):
            raise ValueError(f"a message has {count} times, which no sample has")
        for _ in range(count):
            seconds, ns = _TIME.unpack(source.take(_TIME.size, 4))
            times.append((seconds * _US + ns // _NS_PER_US).to_bytes(TIME_BYTES, "little"))
        if source.count(1) != len(times) * self._elements:
            raise ValueError("a message has more times than values, or fewer")
        values = [b"".join(source.take(size, size) for size in self._sizes) for _ in times]
        if not self._has_queue:
            return b"".join(map(bytes.__add__, times, values))
        if source.count(1) != len(times):
            raise ValueError("a message has more times than channels, or fewer")
        channels = [source.take(1, 1) for _ in times]
        if max(channels)[0] >= self._channels:
            raise ValueError(f"a message has channel {max(channels)[0]}, which is not there")
        lost = source.take(LOST_BYTES, LOST_BYTES)
        entries = zip(channels, times, values, strict=True)
        payload = lost + b"".join(map(b"".join, entries))
        if len(payload) > MAX_PAYLOAD:
            raise ValueError(f"a message is a sample of {len(payload)} bytes")
        return payload


def _sizes(kind: Type) -> Iterator[int]:
    """Yield the bytes of each number of a value."""
    for _ in range(kind.count or 1):
        if isinstance(kind.element, Structure):
            for field in kind.element.fields:
                yield from _sizes(field.type)
        else:
            yield element_size(kind.element)


class _Writer:
    """Numbers, each at a multiple of its size."""

    def __init__(self) -> None:
        self.data = bytearray(_HEADER)

    def add(self, number: bytes, align: int) -> None:
        self.data += bytes(-(len(self.data) - len(_HEADER)) % align) + number

    def count(self, count: int) -> None:
        self.add(_COUNT.pack(count), _COUNT.size)


class _Reader:
    """The same, read."""

    def __init__(self, data: bytes) -> None:
        if data[: len(_HEADER)] != _HEADER:
            raise ValueError("a message is not in little-endian CDR")
        self._data = data
        self._at = len(_HEADER)

    def take(self, size: int, align: int) -> bytes:
        self._at += -(self._at - len(_HEADER)) % align
        number = self._data[self._at : self._at + size]
        if len(number) != size:
            raise ValueError("a message is too short")
        self._at += size
        return number

    def count(self, size: int) -> int:
        """Return a number of elements, which must fit into what is left."""
        [count] = _COUNT.unpack(self.take(_COUNT.size, _COUNT.size))
        if count * size > len(self._data) - self._at:
            raise ValueError("a message is too short")
        return int(count)
