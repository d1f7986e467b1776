"""The clocks of boards, from `Client.clock` and `AsyncClient.clock`.

What flows in: nothing. What flows out: the public names of `j2a.io.clock` and
`j2a.protocol.clock`.
"""

from j2a.io.async_clock import AsyncClock, AsyncClockKeeper
from j2a.io.clock import Clock, ClockKeeper
from j2a.io.clock_base import ClockReading
from j2a.protocol.clock import (
    BusClock,
    ClockState,
    Estimate,
    Estimator,
    Exchange,
    ReferenceClock,
    Status,
)

__all__ = [
    "AsyncClock",
    "AsyncClockKeeper",
    "BusClock",
    "Clock",
    "ClockKeeper",
    "ClockReading",
    "ClockState",
    "Estimate",
    "Estimator",
    "Exchange",
    "ReferenceClock",
    "Status",
]
