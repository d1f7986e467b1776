"""The first values of a sensor since the start of the device (J2A-TRANS-011, J2A-TRANS-013)."""

import struct
from typing import Final

from j2a_spec import constants as c
from j2a_spec import transducers as oracle

from ._board import STIMULUS, Board, TransducerCase, slots, spread
from .sif import frames

# Each far longer than the device has run, also for who takes fewer bits or a sign.
_PERIODS_US: Final = (0xFFFFFFFF, 1 << 31, (1 << 31) - 1, 1 << 30)
_LIMIT: Final = 5


class FirstSample(TransducerCase):
    """Sets PERIOD of sensors that have sent nothing to long times, and gives each two values; then
    gives those with threshold the value 0 on each other channel.
    """

    ID = "transducers.first-sample"
    EXPECTATION = (
        "A sample SIF for the first value, at once, and none for the second one; the first value "
        "of a channel is taken whatever the threshold is."
    )
    REQUIREMENTS = ("J2A-TRANS-011", "J2A-TRANS-013")
    NEEDS = (*TransducerCase.NEEDS, STIMULUS)
    NEEDS_START = True

    def _judge(self, board: Board) -> None:
        for number, one in enumerate(board.sensors()):
            if not self._is_untouched(board, one):
                board.peer.link.note(f"{one.name} may have sent a sample SIF before")
                continue
            period = struct.pack("<I", _PERIODS_US[number % len(_PERIODS_US)])
            with board.tuned(one, period=period):
                since = board.seen
                board.stimulate(one, (0, board.value(one)))
                index, _ = board.sif(one, since)
                board.stimulate(one, (0, board.value(one)))
                board.no_sif_yet(one, index + 1, "within the period of the first one")
                if board.has(one, c.TRANSD_THRESHOLD):
                    self._each_first(board, one)

    @staticmethod
    def _each_first(board: Board, one: oracle.Transducer) -> None:
        board.write(one, c.TRANSD_PERIOD, bytes(4))
        board.write(one, c.TRANSD_THRESHOLD, board.packed(one, _LIMIT))
        for channel in spread(one):
            if channel:
                since = board.seen
                board.stimulate(one, (channel, board.packed(one, 0)))
                board.sif(one, since)

    @staticmethod
    def _is_untouched(board: Board, one: oracle.Transducer) -> bool:
        """Whether a sensor has sent no sample SIF, as far as that can be known."""
        if board.has(one, c.TRANSD_SAMPLE):
            sample = board.read(one, c.TRANSD_SAMPLE)
            return not any(time_us for time_us, _ in slots(board, one, sample))
        sifs = frames(board.peer.link.sifs)
        return board.peer.claims.fresh and all(sif.opcode != one.id for sif in sifs)
