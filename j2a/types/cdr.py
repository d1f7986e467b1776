"""Samples as messages of ROS 2, in the encoding CDR, and back, bit for bit.

What flows in: payloads of sample SIFs, or messages. What flows out: the other one.
Rules: numbers keep their bytes, so even what is no number comes back as it was; a message that is
not what the descriptor says is a ValueError, however it is damaged.
"""

import struct
from collections.abc import Iterator
from typing import Any, Final

from j2a_spec.constants import MAX_PAYLOAD
from j2a_spec.plural import counted

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
        # Of an array the elements are elements of the message, which has no array in an array.
        self._elements = sensor.type.count or 1
        self._entry = self._has_queue + TIME_BYTES + sensor.type.size
        self._layouts: dict[int, tuple[int, struct.Struct, struct.Struct]] = {}

    def pack(self, payload: bytes) -> bytes:
        """Return the message of a sample.

        Raises:
            ValueError: a time is behind the year 2106, or the payload is no sample.
        """
        layout = self._layouts.get(len(payload))
        if layout is None:
            layout = self._layouts[len(payload)] = self._layout(len(payload))
        count, from_payload, to_message = layout
        lost, *parts = from_payload.unpack(payload)
        width = len(parts) // count
        time_at = int(self._has_queue)
        numbers: list[Any] = [_HEADER, count]
        for time_us in parts[time_at::width]:
            seconds, us = divmod(time_us, _US)
            if seconds >= _SECONDS:
                raise ValueError(f"a message has no time of {time_us} us")
            numbers += seconds, us * _NS_PER_US
        numbers.append(count * self._elements)
        for at in range(time_at + 1, len(parts), width):
            numbers += parts[at : at + width - time_at - 1]
        if self._has_queue:
            numbers += count, b"".join(parts[::width]), lost
        return to_message.pack(*numbers)

    def _layout(self, length: int) -> tuple[int, struct.Struct, struct.Struct]:
        """Return how many values a payload of a length has, its layout, and that of its message."""
        start = LOST_BYTES if self._has_queue else 0
        count, rest = divmod(length - start, self._entry)
        if rest or count < 1 or length > MAX_PAYLOAD:
            raise ValueError(f"{counted(length, 'byte is', 'bytes are')} no sample")
        values = "".join(f"{size}s" for size in self._sizes)
        payload = f"<{start}s" + f"{'s' * self._has_queue}Q{values}" * count
        # How many times, their seconds and ns, how many values; each with its alignment.
        parts = [("I", _COUNT.size)] * (2 + 2 * count)
        parts += [(f"{size}s", size) for size in self._sizes * count]
        if self._has_queue:
            parts += ("I", _COUNT.size), (f"{count}s", 1), (f"{LOST_BYTES}s", LOST_BYTES)
        message, at = f"<{len(_HEADER)}s", 0
        for code, align in parts:
            skipped = -at % align
            message += f"{skipped}x{code}"
            at += skipped + struct.calcsize(f"<{code}")
        return count, struct.Struct(payload), struct.Struct(message)

    def unpack(self, message: bytes) -> bytes:
        """Return the payload of the sample that a message is.

        Raises:
            ValueError: it is none of this sensor.
        """
        source = _Reader(message)
        times = []
        count = source.count(_TIME.size)
        if not (1 <= count <= MAX_PAYLOAD if self._has_queue else count == self._channels):
            raise ValueError(f"a message has {counted(count, 'time')}, which no sample has")
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


class _Reader:
    """A message, read: each number is at a multiple of its size."""

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
