"""Keeps the log readable whatever comes from the network.

What flows in: records of the log. What flows out: of each kind a few, with the number of those that
were left out.
Rules: a kind is the text before its values are put in, so there are as many as the code has.
"""

import logging
import time
from collections.abc import Callable
from typing import Final

from j2a_spec.plural import counted

__all__ = ["LogLimit"]

MOST: Final = 10
"""So many records of a kind are let through ..."""
WITHIN_S: Final = 10.0
"""... in so many seconds."""


class LogLimit(logging.Filter):
    """Lets a few records of each kind through.

    Args:
        now: the time in seconds.
    """

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._now = now
        # Of each kind: since when it is counted, and how many came since then.
        self._kinds: dict[object, tuple[float, int]] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Tell whether a record is let through; one that follows many says how many there were."""
        kind, now = record.msg, self._now()
        since, count = self._kinds.get(kind, (now, 0))
        if now - since < WITHIN_S:
            self._kinds[kind] = since, count + 1
            return count < MOST
        self._kinds[kind] = now, 1
        if count > MOST:
            more = counted(count - MOST, "more like it was", "more like it were")
            record.msg = f"{kind} ({more} left out)"
        return True
