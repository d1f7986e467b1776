"""A view of the wire for people.

What flows in: bytes and frames as they pass. What flows out: the same, to a function of the user.
Rules: a trace never disturbs the link; one that raises is reported once and switched off.
"""

import logging
from collections.abc import Callable
from typing import Literal

from j2a.events import Frame, FrameError

__all__ = ["Direction", "Trace", "Tracer"]

Direction = Literal["tx", "rx"]
"""`tx` is what this side sends, `rx` what it receives."""

Trace = Callable[[Direction, Frame | FrameError | bytes], None]
"""Called with a direction and either raw wire bytes as they were read or written, or a frame or
frame error. Sent frames come before their bytes, received ones after. It runs inside the library's
locks: it must be quick and must not call the library."""

_logger = logging.getLogger("j2a")


class Tracer:
    """Calls a trace function, if there is one.

    Attributes:
        is_on: there is a trace function.
    """

    __slots__ = ("_trace", "is_on")

    def __init__(self, trace: Trace | None) -> None:
        self._trace = trace
        self.is_on = trace is not None

    def note(self, direction: Direction, item: Frame | FrameError | bytes) -> None:
        """Hand over one item."""
        if self._trace is None:
            return
        try:
            self._trace(direction, item)
        except Exception:
            _logger.exception("the trace function raised and is switched off")
            self._trace = None
            self.is_on = False
