"""What keeps the watchdog of an actuator quiet: requests of each kind (J2A-TRANS-017)."""

import struct
from collections.abc import Callable
from contextlib import suppress
from typing import Final

from j2a_spec import constants as c
from j2a_spec import transducers as oracle
from j2a_transports import TransportError

from j2a_conformance._judge import Judged, fail
from j2a_conformance.device._peer import MANY_ONLY, Peer, Request

from ._board import Board, TransducerCase, safe, slots, unsafe

_LIMIT_MS: Final = 150
_TIMES: Final = 5
_Make = Callable[[], Request]


def kinds(peer: Peer) -> dict[str, _Make]:
    """Return what makes a request of each kind, those that are refused, too."""
    many, transd = peer.opcode(c.MANY), peer.opcode(c.TRANSD)
    made: dict[str, _Make] = {
        "a2jEcho": lambda: peer.echo(b"heard"),
        "a2jEchoMany": lambda: peer.many(c.GET_ECHO_MANY),
        "a2jMany without a header": lambda: peer.request(many, b"", c.RET_FAILED, b""),
        "a2jMany of itself": lambda: peer.many(many, code=c.ERR_OPCODE),
        "a2jTransd of no transducer": lambda: peer.request(transd, b"\xff\0", c.TRANSD_NO_ID, b""),
    }
    for name in sorted(name for name in MANY_ONLY if peer.has(name)):
        made[f"{name} directly"] = lambda name=name: peer.direct(name)  # type: ignore[misc]
    if free := peer.out_of_range():
        made["no function"] = lambda: peer.request(free[-1], b"", c.ERR_OPCODE)
    if peer.longest < c.MAX_PAYLOAD:
        made["a payload that is too long"] = lambda: peer.echo(bytes(peer.longest + 1))
    return made


class Heard(TransducerCase):
    """Sends requests of one kind only, again and again, for longer than the watchdog of an actuator
    waits.
    """

    ID = "transducers.heard"
    EXPECTATION = "It stays as it was set: a request that is refused was received, too."
    REQUIREMENTS = ("J2A-TRANS-017",)

    def _judge(self, board: Board) -> None:
        actuators = board.actuators("watchdog")
        for number, (name, make) in enumerate(kinds(board.peer).items() if actuators else ()):
            one = actuators[number % len(actuators)]
            before = board.read(one, c.TRANSD_WATCHDOG)
            try:
                board.peer.attempts(
                    lambda one=one, name=name, make=make: self._keep(board, one, name, make)  # type: ignore[misc]
                )
            finally:
                with suppress(Judged, TransportError):
                    board.write(one, c.TRANSD_WATCHDOG, before)

    @staticmethod
    def _keep(board: Board, one: oracle.Transducer, name: str, make: _Make) -> None:
        value = unsafe(board, one)
        if value == safe(board, one):  # it has one value only
            return
        board.write(one, c.TRANSD_SET, bytes(9) + value)
        board.write(one, c.TRANSD_WATCHDOG, struct.pack("<H", _LIMIT_MS))
        for _ in range(_TIMES):
            board.peer.silence(_LIMIT_MS * 0.4 / 1e3, "while nothing was asked")
            board.peer.ask(make())
        if slots(board, one, board.read(one, c.TRANSD_SAMPLE))[0][1] != value:
            fail(f"{one.name} was made safe, though requests came: {name}", suspect=True)
