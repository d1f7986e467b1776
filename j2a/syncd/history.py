"""What the daemon remembers of each board, for `j2a sync plot`.

In: a record of each round. Out: the same, the oldest dropped, and its Allan deviation.
Rules: bounded; a board that is gone keeps its records until others need the room. What is told is
of one board at a time, because JSON is made without a pause in which other threads could run.
"""

import math
import threading
from array import array
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Final

__all__ = ["History", "Round", "allan_deviation", "phases_us", "rounds_of"]

MAX_ROUNDS: Final = 7200
"""Of a board: two hours of a round each second."""
MAX_BOARDS: Final = 256
MAX_TOLD: Final = 2000
"""Rounds of a board; more are thinned."""
_MOST: Final = 1e18
"""No number of a round is greater, so that squares and differences of them are finite."""


@dataclass(frozen=True, slots=True)
class Round:
    """One round of a board.

    Attributes:
        time_s: of the host, seconds since 1970.
        offset_us: of the measured time to the line through the measurements before.
        rate_ppb: by which frames, or the counter of the board, run faster than the host's clock.
        uncertainty_us: of what was told to the board.
    """

    time_s: float
    offset_us: float
    rate_ppb: float
    uncertainty_us: float


_FIELDS: Final = 4


class History:
    """The rounds of the boards that were seen last; may be used by several threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        # Of each board the fields of its rounds, one after the other: 32 bytes a round.
        self._boards: OrderedDict[str, array[float]] = OrderedDict()

    def add(self, board: str, one: Round) -> None:
        """Remember a round of a board."""
        with self._lock:
            rounds = self._boards.setdefault(board, array("d"))
            self._boards.move_to_end(board)  # the last one is the one that was heard last
            rounds.extend((one.time_s, one.offset_us, one.rate_ppb, one.uncertainty_us))
            # Many at once: what is behind them has to move.
            if len(rounds) >= _FIELDS * (MAX_ROUNDS + MAX_ROUNDS // 8):
                del rounds[: len(rounds) - _FIELDS * MAX_ROUNDS]
            while len(self._boards) > MAX_BOARDS:
                self._boards.popitem(last=False)

    @property
    def boards(self) -> list[str]:
        """The boards that have rounds, the one that was heard last at the end."""
        with self._lock:
            return list(self._boards)

    def facts(self, board: str) -> list[list[float]]:
        """Return the rounds of a board as JSON has them: time, offset, rate and uncertainty.

        Of more than MAX_TOLD only each second one is told, or each third and so on, the newest
        among them: what is left is as regular as it was, for the Allan deviation.
        """
        with self._lock:
            rounds = self._boards.get(board, array("d"))[-_FIELDS * MAX_ROUNDS :]
        last = len(rounds) - _FIELDS
        step = _FIELDS * max(1, math.ceil(len(rounds) / _FIELDS / MAX_TOLD))
        return [rounds[at : at + _FIELDS].tolist() for at in range(last % step, last + 1, step)]


def rounds_of(facts: object) -> list[Round]:
    """Return what `History.facts` has made.

    Raises:
        ValueError: it is something else.
    """
    try:
        if len(facts) > MAX_TOLD:  # type: ignore[arg-type]
            raise ValueError(f"more than {MAX_TOLD} rounds")
        rows = [[float(value) for value in one] for one in facts]  # type: ignore[attr-defined]
        if not all(abs(value) <= _MOST for row in rows for value in row):  # nor NaN
            raise ValueError("a number is too large")
        return [Round(*row) for row in rows]
    except (OverflowError, TypeError, ValueError) as error:
        raise ValueError(f"no history: {error}") from None


def phases_us(rounds: Sequence[Round], period_s: float) -> list[float]:
    """Return by how much frames, or the counter of the board, are ahead at each round.

    The offset alone tells of a round what the line through those before did not foresee. The line
    follows the crystal, so what a crystal does in minutes is in the rate.

    Args:
        rounds: of one bus or board.
        period_s: between two of them; their times are of a clock that may be set.
    """
    ahead_us = accumulate(one.rate_ppb * 1e-3 * period_s for one in rounds)
    return [ahead - one.offset_us for ahead, one in zip(ahead_us, rounds, strict=True)]


def allan_deviation(offsets_us: Sequence[float], period_s: float) -> list[tuple[float, float]]:
    """Return the overlapping Allan deviation of a clock.

    Args:
        offsets_us: the time error at regular instants, in microseconds.
        period_s: between two of them, in seconds.

    Returns: pairs of the averaging time in seconds and the deviation in parts per million, for
        averaging times that double, as long as there are two second differences to average.
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
