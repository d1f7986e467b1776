"""Delays as distributions: of the host's scheduler, of links, of a board's interrupts and main
loop.

In: quantiles, from the data files beside this module or by a formula. Out: random delays in
seconds.
Rules: a distribution is a list of pairs (share, microseconds), linear between them, so the extremes
that were recorded are the extremes that are drawn; what one delay is does not depend on the last.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.random import Generator

from j2a_sim._clocks.truth import Floats

__all__ = [
    "BAUD",
    "BOARD_BYTE_S",
    "HOST_BYTE_S",
    "SHARES",
    "Delay",
    "board_delay",
    "host_delay",
    "quantiles",
    "rfcomm",
    "tcp",
]

# Dense at the upper end, for rare long delays are what disturbs a clock.
SHARES: Final = (
    *(round(i / 20, 2) for i in range(20)),
    *(0.96, 0.97, 0.98, 0.985, 0.99, 0.995, 0.998, 0.999, 0.9995, 0.9999, 1.0),
)
BAUD: Final = 115_200
_BITS: Final = 10
HOST_BYTE_S: Final = _BITS / BAUD
# An ATmega328P at 16 MHz makes its 115200 bit/s of 16 MHz / 8 / 17, as the port avr-serial does.
BOARD_BYTE_S: Final = _BITS * 8 * 17 / 16e6
_FOLDER: Final = Path(__file__).parent


class Delay:
    """A distribution of delays.

    Args:
        shares: of the delays that are at most the value beside it: rising, from 0 to 1.
        values_us: in microseconds, rising.
    """

    def __init__(self, shares: Sequence[float], values_us: Sequence[float]) -> None:
        self.shares = np.array(shares, dtype=np.float64)
        self.values_us = np.array(values_us, dtype=np.float64)
        rises = np.all(np.diff(self.shares) > 0) and np.all(np.diff(self.values_us) >= 0)
        if len(shares) != len(values_us) or not rises or (self.shares[[0, -1]] != (0, 1)).any():
            raise ValueError("quantiles have to rise from share 0 to share 1")

    def draw_s(self, rng: Generator, count: int) -> Floats:
        """So many delays in seconds."""
        return np.interp(rng.random(count), self.shares, self.values_us) * 1e-6

    def one_s(self, rng: Generator) -> float:
        """One delay in seconds."""
        return float(self.draw_s(rng, 1)[0])

    @property
    def mean_us(self) -> float:
        """Their mean."""
        middles = (self.values_us[1:] + self.values_us[:-1]) / 2
        return float(np.sum(np.diff(self.shares) * middles))


def quantiles(samples_us: Floats | Sequence[float]) -> list[float]:
    """The values of samples at SHARES, for a data file."""
    return [round(float(value), 3) for value in np.quantile(np.asarray(samples_us), SHARES)]


@functools.cache
def _file(name: str) -> dict[str, Any]:
    data: dict[str, Any] = json.loads((_FOLDER / name).read_text("utf-8"))
    return data


def host_delay(load: str, kind: str) -> Delay:
    """A delay of the host that record.py has recorded.

    Args:
        load: "light" or "heavy", as record.py made it.
        kind: "wake": from an event to the time stamp of a program that waited for it; "write": from
            a time stamp to the end of the system call that sends.
    """
    data = _file("host_delays.json")
    return Delay(data["shares"], data[load][kind])


def board_delay(kind: str) -> Delay:
    """A delay of a board that the AVR engine has measured; see board_delays.json.

    Args:
        kind: such as "sof": from the start of a frame to the reading of the counter.
    """
    data = _file("board_delays.json")
    return Delay(data["shares"], data[kind])


def tcp() -> Delay:
    """One way over a local network: 80 us, and a queue of 30 us on average and rarely 2 ms."""
    shares = np.linspace(0, 0.9995, 200)
    return Delay([*shares, 1.0], [*(80 - 30 * np.log1p(-shares)), 2000.0])


def rfcomm() -> Delay:
    """One way over Bluetooth: a slot of 1.25 ms to be waited for, some packets sent again.

    Bluetooth 5, volume 2, part B, 2.2: a slave may send in every second slot of 625 us; in one of
    twenty polls the packet is damaged or another device has its turn, which costs 2.5 ms more.
    """
    return Delay((0.0, 0.95, 0.9975, 1.0), (1500.0, 2750.0, 5250.0, 20000.0))
