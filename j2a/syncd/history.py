"""What the daemon remembers of each board, for `j2a sync plot`.

In: a record of each round. Out: the same, the oldest dropped, and its Allan deviation.
Rules: bounded; a board that is gone keeps its records until others need the room.
"""

from __future__ import annotations

import math
from collections import OrderedDict, deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

__all__ = ["History", "Round", "allan_deviation"]

MAX_ROUNDS: Final = 7200
"""Of a board: two hours of a round each second."""
MAX_BOARDS: Final = 256


@dataclass(frozen=True, slots=True)
class Round:
    """One round of a board.

    Attributes:
        time_s: of the host, seconds since 1970.
        offset_us: of the measured time to the line through the measurements before.
        rate_ppb: of the host's time to that of the bus or the board.
        uncertainty_us: of what was told to the board.
    """

    time_s: float
    offset_us: float
    rate_ppb: float
    uncertainty_us: float


class History:
    """The rounds of the boards that were seen last."""

    def __init__(self) -> None:
        self._boards: OrderedDict[str, deque[Round]] = OrderedDict()

    def add(self, board: str, one: Round) -> None:
        """Remember a round of a board."""
        rounds = self._boards.pop(board, None)
        if rounds is None:
            rounds = deque(maxlen=MAX_ROUNDS)
        rounds.append(one)
        self._boards[board] = rounds  # the last one is the one that was heard last
        while len(self._boards) > MAX_BOARDS:
            self._boards.popitem(last=False)

    def facts(self) -> dict[str, list[list[float]]]:
        """Return all rounds as JSON has them: time, offset, rate and uncertainty of each."""
        return {
            board: [[r.time_s, r.offset_us, r.rate_ppb, r.uncertainty_us] for r in tuple(rounds)]
            for board, rounds in tuple(self._boards.items())
        }


def rounds_of(facts: Any) -> dict[str, list[Round]]:
    """Return what `History.facts` has made.

    Raises:
        ValueError: it is something else.
    """
    try:
        return {
            str(board): [Round(*(float(value) for value in one)) for one in rounds]
            for board, rounds in facts.items()
        }
    except (AttributeError, TypeError) as error:
        raise ValueError(f"no history: {error}") from None


def allan_deviation(offsets_us: Sequence[float], period_s: float) -> list[tuple[float, float]]:
    """Return the overlapping Allan deviation of a clock.

    Args:
        offsets_us: the time error at regular instants, in microseconds.
        period_s: between two of them, in seconds.

    Returns: pairs of the averaging time in seconds and the deviation in parts per million, for
        averaging times that double, as long as there are three intervals of it.
    """
    found = []
    n = 1
    while len(offsets_us) > 2 * n + 1:
        squares = [
            (offsets_us[k + 2 * n] - 2 * offsets_us[k + n] + offsets_us[k]) ** 2
            for k in range(len(offsets_us) - 2 * n)
        ]
        tau_s = n * period_s
        found.append((tau_s, math.sqrt(sum(squares) / (2 * len(squares))) / tau_s))
        n *= 2
    return found
