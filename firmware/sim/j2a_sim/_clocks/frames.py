"""Starts of frames (SOF) on a USB, as each board sees them.

In: a random generator, the controller's crystal. Out: for each board the true times at which a
start of frame reaches it, the frame numbers, and which ones it loses.
Rules: what the controller does is common to all boards of a bus; hubs and losses are each board's.
Source: USB 2.0, 7.1.12 (frame interval 1.000 ms +- 500 ns), 7.1.14 and 7.1.19 (70 ns for a hub and
its cable), 8.4.3 (frame numbers have 11 bits).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from j2a_sim._clocks.truth import Floats, Oscillator

__all__ = ["FRAME_S", "NUMBERS", "BoardFrames", "Bus", "hub_delay_s"]

FRAME_S: Final = 0.001
NUMBERS: Final = 2048
TIERS: Final = 5
HUB_S: Final = (30e-9, 70e-9)
CABLE_S: Final = 26e-9


@dataclass(frozen=True, slots=True)
class BoardFrames:
    """What reaches one board.

    Attributes:
        starts_s: true times, increasing.
        numbers: of the frames, 0..2047.
        lost: whether the board does not see it.
    """

    starts_s: Floats
    numbers: NDArray[np.uint16]
    lost: NDArray[np.bool_]


class Bus:
    """The frames of one host controller.

    Args:
        rng: the source of all that is random.
        seconds: how long the run is.
        oscillator: the controller's crystal.
        jitter_s: each start is early or late by up to this, each value as likely and none depending
            on another. With 500 ns two starts may be 1 us closer or farther apart than they should,
            which is twice what the standard allows.
        sleeps: intervals of true time, (from, to), without frames; the numbers go on behind them.

    Attributes:
        starts_s: of all frames, in true seconds.
        numbers: theirs, the first one at random.
    """

    def __init__(
        self,
        rng: Generator,
        seconds: float,
        oscillator: Oscillator,
        jitter_s: float = 500e-9,
        sleeps: tuple[tuple[float, float], ...] = (),
    ) -> None:
        first, phase = int(rng.integers(NUMBERS)), rng.uniform(0, FRAME_S)
        count = int(seconds / FRAME_S) + 2
        counted = phase + FRAME_S * np.arange(count, dtype=np.float64)
        exact = oscillator.true_s(counted)
        starts = exact + rng.uniform(-jitter_s, jitter_s, count)
        numbers = (first + np.arange(count)) % NUMBERS
        awake = np.ones(count, dtype=np.bool_)
        for begin, end in sleeps:
            awake &= (starts < begin) | (starts >= end)
        self.starts_s = starts[awake]
        self.numbers = numbers[awake].astype(np.uint16)

    def at_board(self, rng: Generator, delay_s: float, lost_share: float) -> BoardFrames:
        """What a board sees.

        Args:
            rng: the source of all that is random.
            delay_s: of its hubs and cables.
            lost_share: share of the starts that are damaged on their way to it, 0..1.
        """
        lost = rng.random(len(self.starts_s)) < lost_share
        return BoardFrames(self.starts_s + delay_s, self.numbers, lost)


def hub_delay_s(rng: Generator) -> float:
    """The delay of the way to a board: none to five hubs, and a cable of up to 5 m."""
    tiers = int(rng.integers(TIERS + 1))
    return float(rng.uniform(*HUB_S, tiers).sum() + rng.uniform(0, CABLE_S))
