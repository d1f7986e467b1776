"""The effect of faults on one byte stream: no clock, no input or output.

In: bytes in chunks.  Out: pieces to deliver, each after its delay.
Rules: which byte suffers, and how, depends on the seed and on the number of bytes before it, and on
nothing else: not on time and not on how the bytes were chunked. Each kind of fault has its own
random numbers, so that changing the rate of one leaves the others where they were.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from random import Random
from typing import Final

__all__ = ["KINDS", "FaultCounters", "FaultInjector", "Piece", "Rates"]

DEFAULT_DELAY_MS: Final = 15.0
BURST_BITS: Final = (9, 16)
"""Shortest and longest burst: it always reaches into a second byte, and at most into a third."""
TRUNCATE_MEAN: Final = 16
"""Mean number of bytes that a truncation takes away; the number is geometrically distributed."""


@dataclass(frozen=True, slots=True)
class Rates:
    """How often each fault happens, as a probability per byte from 0 to 1.

    Args:
        drop: the byte is lost.
        flip: one bit of the byte is inverted.
        burst: 9 to 16 bits in a row are damaged, beginning in the byte: the first and the last of
            them are inverted, each between them by chance.
        dup: the byte comes twice.
        swap: the byte comes after the one that follows it.
        truncate: the byte and what follows it are lost, 16 bytes on average.
        split: the stream is cut into two chunks after the byte.
        delay: the byte and what follows it come `delay_ms` later.
        reset: the link ends before the byte.
        delay_ms: length of a delay in milliseconds; the default is longer than a J2A byte timeout.
    """

    drop: float = 0.0
    flip: float = 0.0
    burst: float = 0.0
    dup: float = 0.0
    swap: float = 0.0
    truncate: float = 0.0
    split: float = 0.0
    delay: float = 0.0
    reset: float = 0.0
    delay_ms: float = DEFAULT_DELAY_MS


@dataclass(slots=True)
class FaultCounters:
    """Counts of the bytes and faults of one direction.

    Attributes:
        bytes: bytes that went in.
        drop: bytes dropped.
        flip: bytes with an inverted bit.
        burst: bursts.
        dup: bytes doubled.
        swap: pairs of bytes that changed places.
        truncate: truncations, each of one byte or more.
        split: cuts.
        delay: delays.
        reset: ends of the link, 0 or 1.
    """

    bytes: int = 0
    drop: int = 0
    flip: int = 0
    burst: int = 0
    dup: int = 0
    swap: int = 0
    truncate: int = 0
    split: int = 0
    delay: int = 0
    reset: int = 0

    @property
    def faults(self) -> int:
        """All faults together."""
        return sum(getattr(self, kind) for kind in KINDS)


KINDS: Final = tuple(field.name for field in fields(FaultCounters) if field.name != "bytes")


@dataclass(frozen=True, slots=True)
class Piece:
    """Bytes that travel together, `delay_s` seconds after those before them."""

    delay_s: float
    data: bytes


class FaultInjector:
    """Injects faults into one byte stream.

    Args:
        rates: how often.
        seed: any text; equal seeds give equal faults.

    Attributes:
        counters: what was injected.
        ended: a reset has come; no byte after it is delivered.
    """

    def __init__(self, rates: Rates, seed: str) -> None:
        self.rates = rates
        self.counters = FaultCounters()
        self.ended = False
        self._random = {kind: Random(f"{seed}/{kind}") for kind in KINDS}
        self._next = {kind: self._gap(kind) for kind in KINDS if getattr(rates, kind) > 0}
        self._first = min(self._next.values(), default=math.inf)
        self._mask = 0  # bits of a burst that bytes to come will suffer, the nearest lowest
        self._losing = 0  # bytes to come that a truncation takes away
        self._held = b""  # what a swap keeps until the next byte has gone
        self._delay_s = 0.0
        self._out = bytearray()
        self._pieces: list[Piece] = []

    def feed(self, data: bytes) -> list[Piece]:
        """Return what becomes of `data`, as pieces to deliver in order; may be none.

        A byte that a swap holds back comes with the next chunk when it is the last of this one.
        """
        begin = self.counters.bytes
        self.counters.bytes += len(data)
        self._pieces = []
        done = 0
        while done < len(data) and not self.ended:
            if not (self._mask or self._losing or self._held):
                unharmed = int(min(self._first - begin, len(data)))
                self._out += data[done:unharmed]
                done = unharmed
            if done < len(data):
                self._suffer(begin + done, data[done])
                done += 1
        self._cut()
        self._delay_s = 0.0
        return self._pieces

    def skip(self, count: int) -> bool:
        """Pass over the next `count` bytes if no fault touches them; return whether it did.

        The same as `feed` with bytes that come out as they went in, without looking at them.
        """
        at_work = self._mask or self._losing or self._held or self.ended
        if at_work or self._first < self.counters.bytes + count:
            return False
        self.counters.bytes += count
        return True

    def _suffer(self, position: int, value: int) -> None:
        """Pass on one byte with whatever happens to it."""
        kinds = self._due(position)
        if "reset" in kinds:
            self.ended = True
            return
        if "delay" in kinds:
            self._cut()
            self._delay_s = self.rates.delay_ms / 1000
        if "flip" in kinds:
            value ^= 1 << self._random["flip"].randrange(8)
        if "burst" in kinds:
            self._mask ^= self._burst()
        value, self._mask = value ^ self._mask & 0xFF, self._mask >> 8
        if "truncate" in kinds:
            self._losing = max(self._losing, 1 + self._geometric("truncate", 1 / TRUNCATE_MEAN))
        lost = "drop" in kinds or self._losing
        self._losing = max(self._losing - 1, 0)
        data = b"" if lost else bytes([value]) * (2 if "dup" in kinds else 1)
        if "swap" in kinds and not self._held:
            self._held = data
        else:
            self._out += data + self._held
            self._held = b""
        if "split" in kinds:
            self._cut()

    def _burst(self) -> int:
        """Draw the inverted bits of a burst, as a number that begins with the byte it begins in."""
        random = self._random["burst"]
        bits = random.randint(*BURST_BITS)
        inside = random.getrandbits(bits - 2) << 1
        return (1 | inside | 1 << bits - 1) << random.randrange(8)

    def _cut(self) -> None:
        """End the piece in work, which takes the delay with it."""
        if self._out:
            self._pieces.append(Piece(self._delay_s, bytes(self._out)))
            self._out.clear()
            self._delay_s = 0.0

    def _due(self, position: int) -> set[str]:
        """Take the faults of the byte at `position`, count them and draw their next places."""
        if position < self._first:
            return set()
        kinds = {kind for kind, at in self._next.items() if at == position}
        for kind in kinds:
            setattr(self.counters, kind, getattr(self.counters, kind) + 1)
            self._next[kind] += 1 + self._gap(kind)
        self._first = min(self._next.values())
        return kinds

    def _gap(self, kind: str) -> int:
        """Draw how many bytes go unharmed before the next fault."""
        rate = getattr(self.rates, kind)
        return self._geometric(kind, rate) if 0 < rate < 1 else 0

    def _geometric(self, kind: str, rate: float) -> int:
        return int(math.log(1.0 - self._random[kind].random()) / math.log1p(-rate))
