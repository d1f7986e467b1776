"""Bools that a host sends as another byte than 0 and 1 (J2A-TYPE-002)."""

from typing import Final

from j2a_spec import constants as c

from j2a_conformance._judge import fail

from ._board import Board, TransducerCase, slots, spread

_AT_ONCE: Final = bytes(8)


class SetBools(TransducerCase):
    """Sets actuators whose values are bools to bytes of all kinds."""

    ID = "transducers.set-bools"
    EXPECTATION = "Each byte but 0 is taken as true, and told as 1."
    REQUIREMENTS = ("J2A-TYPE-001", "J2A-TYPE-002", "J2A-TRANS-015", "J2A-TRANS-016")

    def _judge(self, board: Board) -> None:
        for one in board.actuators():
            if board.scalar(one) != "bool":
                continue
            for channel in spread(one):
                for byte in (0x02, 0x00, 0x80, 0xFF, 0x00, 0xFE, 0x01):
                    value = bytes((byte,))
                    board.write(one, c.TRANSD_SET, bytes((channel,)) + _AT_ONCE + value)
                    found = slots(board, one, board.read(one, c.TRANSD_SAMPLE))[channel][1]
                    if found != bytes((byte != 0,)):
                        fail(f"{one.name} was set to {value.hex()}, and tells {found.hex()}")
