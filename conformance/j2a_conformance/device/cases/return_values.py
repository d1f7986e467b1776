"""What functions for a2jMany return, in the payload of its reply (J2A-DISP-004, J2A-MANY-002)."""

from typing import Final

from j2a_spec import constants as c

from j2a_conformance._judge import fail, skip
from j2a_conformance.device._case import Case
from j2a_conformance.device._peer import Peer

_RET_MANY: Final = "retMany"
_OFFSETS: Final = (0, 0x12ED7D00, 0xFFFFFF00)


class InnerValues(Case):
    """Has a function for a2jMany return each value from 0x00 to 0xFF, read and written to."""

    ID = "many.return-values"
    EXPECTATION = "The value inside the reply with 0x00, and 0xFF in place of 0xF0 and more."
    REQUIREMENTS = ("J2A-DISP-004", "J2A-MANY-002", "J2A-MANY-004", "J2A-MANY-008")
    LEVEL = "many"
    NEEDS = (c.MANY,)

    def _run(self, peer: Peer) -> None:
        if not peer.has(_RET_MANY):
            skip(f"the device has no function {_RET_MANY}")
        for value in range(256):
            due = value if value <= c.RET_MAX else c.RET_FAILED
            for flags in (0, c.FLAG_LAST, c.FLAG_WRITE, c.FLAG_WRITE | c.FLAG_LAST):
                offset = _OFFSETS[(value + flags) % len(_OFFSETS)] + value
                reply = peer.ask_many(peer.many(_RET_MANY, flags, offset))
                if (reply.code, reply.offset, reply.data) != (due, offset, b""):
                    fail(
                        f"code 0x{reply.code:02X}, offset {reply.offset} and "
                        f"{len(reply.data)} bytes came, where the function returned "
                        f"0x{value:02X} at the offset {offset}"
                    )
