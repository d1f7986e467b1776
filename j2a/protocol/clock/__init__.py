"""One time for host and boards, without waiting (SPEC.md, section 23).

What flows in: times of the host as numbers, replies of boards. What flows out: estimates with a
bound of their error, and requests.

    messages     the bytes of a2jClock
    estimator    how the counter of a board runs: `Estimator`, `Exchange`, `Estimate`
    strip        the arithmetic of that
    reference    the host's own time: `ReferenceClock`
    discipline   what to tell a board, and when: `Discipline`
    bus          the frames of one USB bus: `BusClock`
"""

from j2a.protocol.clock.bus import BusClock
from j2a.protocol.clock.discipline import Discipline
from j2a.protocol.clock.estimator import Estimate, Estimator, Exchange, Verdict
from j2a.protocol.clock.messages import (
    Adjust,
    ClockState,
    Frame,
    Status,
    pack_exchange,
    pack_status,
    unpack_exchange,
    unpack_status,
)
from j2a.protocol.clock.reference import LOOK_S, ReferenceClock

__all__ = [
    "LOOK_S",
    "Adjust",
    "BusClock",
    "ClockState",
    "Discipline",
    "Estimate",
    "Estimator",
    "Exchange",
    "Frame",
    "ReferenceClock",
    "Status",
    "Verdict",
    "pack_exchange",
    "pack_status",
    "unpack_exchange",
    "unpack_status",
]
