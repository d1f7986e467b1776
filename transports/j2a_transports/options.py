"""Converters of option values, for the declarations of transports.

In: the text of a value.  Out: the value, or ValueError or KeyError.
Rules: the docstring of a converter says what it takes, as messages and tables print it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, Final

__all__ = ["Converter", "boolean", "choice", "integer", "number", "text", "timeout"]

Converter = Callable[[str], Any]
LONGEST_S: Final = 2e6
"""So many seconds and more are for ever: systems count milliseconds in 31 bits."""


def number(low: float, high: float = math.inf) -> Converter:
    """Make a converter for a real number in [low, high]."""

    def convert(text: str) -> float:
        value = float(text)
        if not low <= value <= high:
            raise ValueError
        return value

    limit = f"from {low:g} up" if high == math.inf else f"from {low:g} to {high:g}"
    convert.__doc__ = f"a number {limit}"
    return convert


def integer(low: int, high: int) -> Converter:
    """Make a converter for a whole number in [low, high]."""

    def convert(text: str) -> int:
        value = int(text)
        if not low <= value <= high:
            raise ValueError
        return value

    convert.__doc__ = f"a whole number from {low} to {high}"
    return convert


def choice(table: Mapping[str, Any]) -> Converter:
    """Make a converter that looks the upper-case text up in `table`."""

    def convert(text: str) -> Any:
        return table[text.upper()]

    convert.__doc__ = "one of " + ", ".join(table)
    return convert


def text(value: str) -> str:
    """any text."""
    return value


boolean = choice({"0": False, "1": True, "FALSE": False, "TRUE": True, "OFF": False, "ON": True})


def timeout(value: str) -> float | None:
    """a number of seconds above 0, or none to wait for ever."""
    if value.lower() == "none":
        return None
    seconds = float(value)
    if not seconds > 0:
        raise ValueError
    return seconds if seconds < LONGEST_S else None
