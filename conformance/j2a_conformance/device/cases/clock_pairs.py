"""Adjustments that come faster than a clock takes them up (J2A-CLOCK-012, J2A-CLOCK-013)."""

from typing import Final

from j2a_spec import constants as c
from j2a_spec.grammar import CLOCK_ADJUST

from j2a_conformance.device._clock import Board, ClockCase

_RATE: Final = 9_000_000
_TAKEN_UP_US: Final = 20_000
_REACHED_US: Final = 2_050_000


class Together(ClockCase):
    """Sends several adjustments in one piece, each with another rate and another target."""

    ID = "clock.together"
    EXPECTATION = "The replies as to each alone; from 5 ms on the time leads to the last target."
    REQUIREMENTS = ("J2A-CLOCK-010", "J2A-CLOCK-012", "J2A-CLOCK-013")

    def _judge(self, board: Board) -> None:
        board.step()
        for count in (2, 3):
            for offs in ((0, 0, 0), (900, -900, 700), (-3000, 3000, -2000)):
                for rate in (_RATE, -_RATE):
                    rates = (rate, -rate, rate // 2)[-count:]
                    if not self._adjust(board, offs[-count:], rates):
                        board.peer.link.note("the device has no room for several adjustments")
                        return
                    board.wait(_TAKEN_UP_US)
        self._adjust(board, (-400, 300), (_RATE, 0))
        board.wait(_REACHED_US + 400_000)

    @staticmethod
    def _adjust(board: Board, offs: tuple[int, ...], rates: tuple[int, ...]) -> bool:
        """Send adjustments to targets that are so many us from the time; tell whether they fit."""
        peer, status = board.peer, board.status()
        usual = {"mode": c.CLOCK_SLEW, "local": status.local, "uncertainty": 0, "wander": 0}
        payloads = [
            CLOCK_ADJUST.build({**usual, "time": status.time + off, "rate": rate})
            for off, rate in zip(offs, rates, strict=True)
        ]
        opcode = peer.opcode(c.CLOCK)
        requests = [peer.request(opcode, payload, c.RET_OK) for payload in payloads]
        stream = b"".join(request.wire for request in requests)
        if len(stream) > peer.room(len(stream)):
            return False
        replies = peer.play(stream, *(request.expected for request in requests))
        for payload, reply in zip(payloads, replies, strict=True):
            status = board.adjusted(status, payload, reply.payload)
        return True
