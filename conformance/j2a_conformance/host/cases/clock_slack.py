"""Exchanges that are slow in one direction only (J2A-CLOCK-025)."""

from dataclasses import dataclass
from typing import Final

from j2a_spec import constants as c

from j2a_conformance.host._device import DEMO
from j2a_conformance.host._host import Host
from j2a_conformance.host._outcomes import Request

from .clock import BOARD, _ClockCase, _Scripted

_SLOW_S: Final = (0.01, 0.04)


@dataclass
class _Lopsided(_Scripted):
    """A device that keeps the requests before it reads its local time, and the replies behind.

    Attributes:
        slow_s: so long it keeps one of them, in turn.
    """

    slow_s: float = 0.0

    def answer(self, request: Request) -> None:
        if request.payload[:1] == bytes((c.CLOCK_EXCHANGE,)):
            is_before = len(self.nonces) % 2 == 0
            self.delay_s = 0.0 if is_before else self.slow_s
            if is_before:
                self.host.link.wait_until(self.host.link.now_s() + self.slow_s)
        super().answer(request)


class Lopsided(_ClockCase):
    """Keeps the request of one exchange and the reply of the next one, which together show where in
    either the local time was read.
    """

    ID = "host.clock.lopsided"
    EXPECTATION = "An uncertainty of at least half of the slack of each, as for slow ones."
    REQUIREMENTS = ("J2A-CLOCK-025",)

    def _run(self, host: Host) -> None:
        for slow_s in _SLOW_S:
            host.become(DEMO)
            host.become(BOARD)
            self._uncertain(_Lopsided(host, slow_s=slow_s), slow_s)
