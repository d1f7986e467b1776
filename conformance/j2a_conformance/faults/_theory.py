"""How many damaged frames the checksum lets through, by the oracle alone.

What flows in: the frames, the rates and the seed of an experiment. What flows out: counts, and the
interval around a share. Rules: no device takes part; the same frames go through the same faults as
in the experiment, with another seed, and the oracle says what is still taken for a frame.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import cycle, islice
from statistics import NormalDist
from typing import Final

from j2a_spec import constants as c
from j2a_spec.oracle import Frame, decode
from j2a_transports.faults import FaultInjector, Rates

__all__ = ["AGREEMENT", "CONFIDENCE", "Share", "damage", "damages", "missed", "wilson"]

CONFIDENCE: Final = 0.95
"""Of the intervals in a report."""
AGREEMENT: Final = 0.999
"""Of the intervals that must meet: a right device is found wrong less than once in 1000 rows."""
_MOST_FRAMES: Final = 1_000_000
_POOL: Final = 4093


@dataclass(frozen=True, slots=True)
class Share:
    """How many of something, out of how many.

    Attributes:
        of: damaged frames.
        missed: those of them that are taken for a good frame, though not for the one that was sent.
    """

    of: int = 0
    missed: int = 0

    @property
    def value(self) -> float:
        """The share, 0 to 1."""
        return self.missed / self.of if self.of else 0.0

    def interval(self, confidence: float = CONFIDENCE) -> tuple[float, float]:
        """Return the Wilson interval of the share."""
        return wilson(self.missed, self.of, confidence)

    def agrees(self, other: "Share") -> bool:
        """Tell whether both can be samples of the same share."""
        low, high = self.interval(AGREEMENT)
        other_low, other_high = other.interval(AGREEMENT)
        return low <= other_high and other_low <= high

    def __add__(self, other: "Share") -> "Share":
        return Share(self.of + other.of, self.missed + other.missed)


def wilson(hits: int, of: int, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Return the Wilson score interval of a share.

    Args:
        hits: how many.
        of: out of how many; 0 gives the interval that excludes nothing.
        confidence: how often the interval holds the true share, 0 to 1.
    """
    if not of:
        return 0.0, 1.0
    z = NormalDist().inv_cdf((1 + confidence) / 2)
    share, square = hits / of, z * z / of
    middle = (share + square / 2) / (1 + square)
    half = z / (1 + square) * math.sqrt(share * (1 - share) / of + square / (4 * of))
    return max(0.0, middle - half), min(1.0, middle + half)


def damage(injector: FaultInjector, data: bytes) -> bytes:
    """Return what becomes of `data`, delays aside."""
    return b"".join(piece.data for piece in injector.feed(data))


def damages(rates: Rates) -> bool:
    """Tell whether any fault changes bytes, and does not only delay them or end the link."""
    return replace(rates, split=0, delay=0, reset=0, delay_ms=0) != Rates(delay_ms=0)


def missed(
    frames: Iterator[tuple[Frame, bytes]], rates: Rates, seed: str, damaged: int, sif: bool
) -> Share:
    """Damage frames until `damaged` of them are, and return how many the checksum lets through.

    Args:
        frames: endless, each with its bytes on the wire.
        rates: of the faults; a reset ends nothing here.
        seed: of the faults.
        damaged: how many damaged frames to look at; where faults are rare it may be fewer.
        sif: a frame that has become a SIF counts: a host takes it, a device does not.
    """
    injector = FaultInjector(replace(rates, reset=0), seed)
    pool = list(islice(frames, _POOL))
    starts = c.MARKERS if sif else {c.SOF}
    found = Share()
    for frame, wire in islice(cycle(pool), _MOST_FRAMES):
        if injector.skip(len(wire)):  # with a low rate nearly all frames
            continue
        received = damage(injector, wire)
        if received == wire:
            continue
        wrong = any(
            isinstance(event, Frame) and event != frame and event.start in starts
            for event in decode(received)
        )
        found += Share(1, int(wrong))
        if found.of == damaged:
            break
    return found
