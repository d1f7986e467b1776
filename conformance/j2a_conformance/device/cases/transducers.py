"""Transducers: what describes them, as text in pieces (J2A-TRANS)."""

from itertools import permutations
from typing import Final

from j2a_spec import constants as c

from j2a_conformance._judge import fail
from j2a_conformance.device._case import Case
from j2a_conformance.device._contents import (
    check_all_or_none,
    check_end,
    check_offsets,
    check_writes,
)
from j2a_conformance.device._peer import Peer

from ._board import (
    Board,
    TransducerCase,
)

_STEP: Final = 7


class Announced(Case):
    """Compares what the device announces with what it has."""

    ID = "transducers.announced"
    EXPECTATION = "The token `transducers`, a2jGetTransds and a2jTransd, or none of them."
    REQUIREMENTS = ("J2A-TRANS-001",)
    LEVEL = "transducers"
    NEEDS = (c.GET_PROPERTIES,)

    def _run(self, peer: Peer) -> None:
        has = {
            f"the token {c.CAP_TRANSDUCERS}": peer.announces(c.CAP_TRANSDUCERS),
            f"the function {c.GET_TRANSDS}": peer.has(c.GET_TRANSDS),
            f"the function {c.TRANSD}": peer.has(c.TRANSD),
        }
        check_all_or_none(has)
        peer.opcode(c.GET_TRANSDS)


class Language(TransducerCase):
    """Takes the descriptors apart."""

    ID = "transducers.language"
    EXPECTATION = "Definitions, an empty line, then the transducers, by the grammar."
    REQUIREMENTS = ("J2A-TRANS-001", "J2A-TRANS-004")

    def _judge(self, board: Board) -> None:
        lines = board.peer.read_all(c.GET_TRANSDS).decode().split("\n")
        kinds = ("sensor ", "actuator ")
        names = [line.split(" ")[1] for line in lines if line.startswith(kinds)]
        if strange := [name for name in names if name not in board.descriptors.transducers]:
            fail(f"the type of {strange[0]} is not defined")


class Chunks(TransducerCase):
    """Reads the descriptors again from many offsets, with and without data in the request, and
    piece by piece in turn with each other text of the device.
    """

    ID = "transducers.chunks"
    EXPECTATION = "The bytes of the first read from there on, with isLast in the last chunk only."
    REQUIREMENTS = ("J2A-TRANS-001", "J2A-MANY-008", "J2A-MANY-010")

    def _judge(self, board: Board) -> None:
        whole = board.peer.read_all(c.GET_TRANSDS)
        lines = [at + 1 for at, byte in enumerate(whole[:-1]) if byte == ord("\n")]
        around = {at + n for at in (*lines, 249, 256, 498, 512) for n in (-1, 0, 1)}
        around |= {*range(0, len(whole), 249), *range(0, len(whole), 256)}
        # So that a last chunk has each length.
        chosen = {*range(64), *range(0, len(whole), _STEP), *range(len(whole) - 250, len(whole))}
        offsets = sorted(at for at in chosen | around if 0 <= at < len(whole))
        check_offsets(board.peer, c.GET_TRANSDS, whole, offsets)
        others = [name for name in (c.GET_INTERFACE, c.GET_PROPERTIES) if board.peer.has(name)]
        for other in others:
            texts = {c.GET_TRANSDS: whole, other: board.peer.read_all(other)}
            for names in permutations(texts):
                self._in_turn(board.peer, {name: texts[name] for name in names})

    @staticmethod
    def _in_turn(peer: Peer, texts: dict[str, bytes]) -> None:
        """Read texts to the end of the shorter one."""
        ends = dict.fromkeys(texts, 0)
        while all(end < len(texts[name]) for name, end in ends.items()):
            for name, end in ends.items():
                data = peer.ask_many(peer.many(name, offset=end)).data
                if not data or not texts[name].startswith(data, end):
                    fail(f"{name} has other bytes at {end} while {' and '.join(texts)} are read")
                ends[name] += len(data)


class Written(TransducerCase):
    """Writes to a2jGetTransds, with data and without."""

    ID = "transducers.written"
    EXPECTATION = "0xFF inside the reply of a2jMany, and the descriptors as before."
    REQUIREMENTS = ("J2A-TRANS-002",)

    def _judge(self, board: Board) -> None:
        check_writes(board.peer, c.GET_TRANSDS, "descriptors", b"\nsensor evil 9 1 u8\n")


class BehindEnd(TransducerCase):
    """Reads the descriptors at their end and at many offsets behind it, also with data."""

    ID = "transducers.behind-end"
    EXPECTATION = "0x00 and an empty chunk with isLast, at the offset that was asked for."
    REQUIREMENTS = ("J2A-TRANS-001", "J2A-TRANS-003", "J2A-MANY-010")

    def _judge(self, board: Board) -> None:
        check_end(board.peer, c.GET_TRANSDS)
