"""Bools that a host sends as another byte than 0 and 1 (J2A-TYPE-002)."""

from typing import Final

from j2a_spec import constants as c
from j2a_spec import transducers as oracle

from j2a_conformance._judge import fail

from ._board import Board, TransducerCase, fit, slots, spread

_AT_ONCE: Final = bytes(8)
_BYTES: Final = (0x02, 0x00, 0x80, 0xFF, 0x00, 0xFE, 0x01)


class SetBools(TransducerCase):
    """Sets actuators whose values are bools to bytes of all kinds, one channel and several."""

    ID = "transducers.set-bools"
    EXPECTATION = "Each byte but 0 is taken as true, and told as 1."
    REQUIREMENTS = ("J2A-TYPE-001", "J2A-TYPE-002", "J2A-TRANS-015", "J2A-TRANS-016")

    def _judge(self, board: Board) -> None:
        for one in board.actuators():
            if board.scalar(one) != "bool":
                continue
            for first in spread(one):
                for count in range(1, min(fit(board, one), one.channels - first) + 1):
                    for turn in range(len(_BYTES)):
                        values = bytes((_BYTES * 2)[turn:] + _BYTES * count)[:count]
                        self._set(board, one, first, values)

    @staticmethod
    def _set(board: Board, one: oracle.Transducer, first: int, values: bytes) -> None:
        board.write(one, c.TRANSD_SET, bytes((first,)) + _AT_ONCE + values)
        found = slots(board, one, board.read(one, c.TRANSD_SAMPLE))[first:][: len(values)]
        raw = b"".join(value for _, value in found)
        if raw != bytes(byte != 0 for byte in values):
            fail(f"{one.name} was set to {values.hex()} from {first} on, and tells {raw.hex()}")
