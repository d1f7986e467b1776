"""Pauses at every time of a counter of 16 bits that wraps (J2A-TIME-001, J2A-TIME-002).

Devices measure pauses by such counters, and one that compares two times of it in the wrong way is
right but for the pauses in which it wraps. The fastest one of ours does so after 6.6 s.
"""

from typing import Final

from j2a_conformance.device._case import Case
from j2a_conformance.device._peer import Peer

from .timing import GivesUp, accepts, awkward

_WRAPS_S: Final = 6.7
_PAUSE_S: Final = 0.005
_CUT: Final = 5


class Wraps(Case):
    """Stops within one frame after the other for 13.4 s, and pauses in each of others for 6.7 s, so
    that hardly a wrap comes between two of them.
    """

    ID = "timing.wraps"
    EXPECTATION = "Error 0xF2 for each frame that stops, and the echoes of the others."
    REQUIREMENTS = ("J2A-TIME-001", "J2A-TIME-002")
    LEVEL = "timing"

    def _run(self, peer: Peer) -> None:
        wire, due = awkward(peer)
        end_s = peer.link.now_s() + 2 * _WRAPS_S
        while peer.link.now_s() < end_s:
            peer.attempts(lambda: GivesUp.cut(peer, wire[:_CUT], due.seq))
        end_s += _WRAPS_S
        while peer.link.now_s() < end_s:
            accepts(peer, [wire[:_CUT], wire[_CUT:]], _PAUSE_S, due, enough=1)
        peer.barrier()
