"""Sequence numbers (J2A-SEQ)."""

import random

from j2a_spec import constants as c

from j2a_conformance._judge import skip
from j2a_conformance.device._case import Case
from j2a_conformance.device._peer import Peer
from j2a_conformance.wire._dimensions import payload_of, spread

from .sif import compare


class Every(Case):
    """Sends a request with each seq from 0 to 255, up, down and shuffled."""

    ID = "seq.every-value"
    EXPECTATION = "Each reply carries the seq of its request."
    REQUIREMENTS = ("J2A-SEQ-001", "J2A-SEQ-008", "J2A-DISP-001", "J2A-STUFF-005")
    LEVEL = "core"

    def _run(self, peer: Peer) -> None:
        shuffled = random.Random(3).sample(range(256), 256)
        for order in (range(256), range(255, -1, -1), shuffled):
            peer.ask_all(peer.echo(payload_of(seq % 9, seq), seq=seq) for seq in order)


class Repeated(Case):
    """Sends requests with one and the same seq, different ones and identical ones; also long ones,
    one behind the other.
    """

    ID = "seq.repeated"
    EXPECTATION = "Each is executed and answered."
    REQUIREMENTS = ("J2A-SEQ-008", "J2A-DISP-001")
    LEVEL = "core"

    def _run(self, peer: Peer) -> None:
        for seq in (0x00, 0x41, 0xFF):
            peer.ask(*(peer.echo(bytes((n,)), seq=seq) for n in range(5)))
            peer.ask(*(peer.echo(b"same", seq=seq) for _ in range(5)))
        peer.ask_all(
            peer.echo(payload_of(length, n), seq=n * 13 % 256)
            for n, length in enumerate(spread(step=31))
            for _ in range(2)
        )


class RepeatedEffect(Case):
    """Sends the same request to `sif` three times, byte by byte identical."""

    ID = "seq.repeated-effect"
    EXPECTATION = "Three SIFs and three replies: a repeated request is executed again."
    REQUIREMENTS = ("J2A-SEQ-008",)
    LEVEL = "core"
    NEEDS = ("sif",)

    def _run(self, peer: Peer) -> None:
        peer.carried(lambda: self._thrice(peer))

    @staticmethod
    def _thrice(peer: Peer) -> None:
        before = len(peer.link.sifs)
        request = peer.request(peer.opcode("sif"), b"\x34again", c.RET_OK)
        peer.ask(request, request, request)
        for _ in range(3):
            before = 1 + compare(peer, before, 0x34, b"again")


class OfErrors(Case):
    """Calls an opcode out of range with every seq."""

    ID = "seq.of-errors"
    EXPECTATION = "Each error reply carries the seq of its request."
    REQUIREMENTS = ("J2A-SEQ-001", "J2A-ERR-001", "J2A-ERR-005")
    LEVEL = "core"

    def _run(self, peer: Peer) -> None:
        if not (free := peer.out_of_range()):
            skip("the device has 256 functions, so no opcode is out of range")
        peer.ask_all(
            peer.request(free[seq % len(free)], b"", c.ERR_OPCODE, seq=seq) for seq in range(256)
        )
