"""What the simulator's options take, the same in a `sim:` URL and on the command line.

In: the text of an option. Out: its value.
Rule: a wrong text is a ValueError, and the docstring says what the option takes, for the message.
"""

from __future__ import annotations

from typing import Final

FREQUENCY_MAX_HZ: Final = 100_000_000


def frequency(text: str) -> int:
    """a clock in Hz from 1 to 100000000."""
    value = float(text)
    if not 1 <= value <= FREQUENCY_MAX_HZ:
        raise ValueError
    return int(value)


def rate(text: str) -> float:
    """a number above 0."""
    value = float(text)
    if not 0 < value < float("inf"):
        raise ValueError
    return value


def speed(text: str) -> float:
    """0 for as fast as possible, or a number of simulated seconds per second."""
    value = float(text)
    return value if value == 0 else rate(text)
