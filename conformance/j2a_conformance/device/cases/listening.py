"""What keeps the watchdog of an actuator quiet: requests of each kind, however long their functions
run (J2A-TRANS-017).
"""

import struct
from collections.abc import Callable
from typing import Final

from j2a_spec import constants as c
from j2a_spec import transducers as oracle

from j2a_conformance._judge import fail
from j2a_conformance.device._peer import MANY_ONLY, Peer, Request

from ._board import Board, TransducerCase, safe, slots, unsafe
from .actuators import watchdog_kept
from .limits import delay

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
            with watchdog_kept(board, one):
                board.peer.attempts(
                    lambda one=one, name=name, make=make: self._keep(board, one, name, make)  # type: ignore[misc]
                )

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


class Busy(TransducerCase):
    """Keeps the device busy by `delay`, for less and more than the watchdog of an actuator waits;
    is silent then.
    """

    ID = "transducers.heard-busy"
    EXPECTATION = "It stays as it was set until the function has returned for so long."
    REQUIREMENTS = ("J2A-TRANS-017",)
    NEEDS = (*TransducerCase.NEEDS, "delay")
    _PARTS: Final = ((0.5, 0.7), (2.0, 0.2))  # of the watchdog: `delay`, and the silence

    def _judge(self, board: Board) -> None:
        for one in board.actuators("watchdog"):
            with watchdog_kept(board, one):
                for busy, silent in self._PARTS:
                    board.peer.attempts(
                        lambda one=one, busy=busy, silent=silent: (  # type: ignore[misc]
                            self._keep(board, one, busy, silent)
                        )
                    )

    @staticmethod
    def _keep(board: Board, one: oracle.Transducer, busy: float, silent: float) -> None:
        value, peer = unsafe(board, one), board.peer
        if value == safe(board, one):  # it has one value only
            return
        exchanged_us = -board.time_us() + board.time_us()
        limit_ms = _LIMIT_MS + 4 * exchanged_us // 1000  # of a slow link, too
        board.write(one, c.TRANSD_SET, bytes(9) + value)
        board.write(one, c.TRANSD_WATCHDOG, struct.pack("<H", limit_ms))
        peer.ask(*delay(peer, round(busy * limit_ms)))
        peer.silence(silent * limit_ms / 1e3, "while nothing was asked")
        raw = slots(board, one, board.read(one, c.TRANSD_SAMPLE))[0][1]
        if raw != value:
            what = f"{one.name}, busy for {busy:.1f} times its watchdog of {limit_ms} ms,"
            fail(f"{what} is {raw.hex()} after {silent:.1f} times that in silence", suspect=True)
