"""Settings of transducers that stay without power: SAVE and its states (J2A-TRANS-028)."""

from collections.abc import Iterator
from itertools import cycle
from typing import Final

from j2a_spec import constants as c
from j2a_spec import transducers as oracle
from j2a_spec.oracle import Frame

from j2a_conformance._judge import fail, skip

from ._board import Board, TransducerCase

_STATES: Final = (c.TRANSD_NOT_SAVED, c.TRANSD_SAVED, c.TRANSD_SAVING)
_LONGEST_US: Final = 10_000_000
_WRONG: Final = (0, 2, 3, 0x81, 0xFF)
_LENGTHS: Final = range(2, 13)
_AGAIN: Final = 3
_SETTINGS: Final = range(c.TRANSD_ENABLED, c.TRANSD_WATCHDOG + 1)


class Saving(TransducerCase):
    """Saves the settings of each transducer, with right values and wrong ones, asks for SAVE until
    it is SAVED, and meanwhile saves it and others.
    """

    ID = "transducers.saving"
    EXPECTATION = "SAVING, BUSY for a write meanwhile, and SAVED; the settings stay as they are."
    REQUIREMENTS = ("J2A-TRANS-008", "J2A-TRANS-009", "J2A-TRANS-028")

    def _judge(self, board: Board) -> None:
        having = [one for one in board.all if self._has(board, one)]
        if not having:
            skip("the device keeps no settings without power")
        if len(having) < len(board.all):
            fail(f"{having[0].name} has SAVE, others do not")
        for one in board.all:
            before = self._settings(board, one)
            self._refused(board, one)
            self._saved(board, one)
            if self._settings(board, one) != before:
                fail(f"settings of {one.name} have changed when they were saved")

    @staticmethod
    def _ask(board: Board, one: oracle.Transducer, value: bytes = b"") -> Frame:
        payload = bytes((one.id, c.TRANSD_SAVE)) + value
        return board.peer.ask(board.peer.request(board.peer.opcode(c.TRANSD), payload))

    def _has(self, board: Board, one: oracle.Transducer) -> bool:
        for value in (b"", b"\0"):
            reply = self._ask(board, one, value)
            if (reply.opcode, reply.payload) == (c.TRANSD_NO_ITEM, b""):
                return False
        return True

    def _state(self, reply: Frame, one: oracle.Transducer, *states: int) -> int:
        if reply.opcode != c.RET_OK or len(reply.payload) != 1 or reply.payload[0] not in states:
            fail(f"SAVE of {one.name} is {reply.payload.hex()}, with the code {reply.opcode}")
        return reply.payload[0]

    def _refused(self, board: Board, one: oracle.Transducer) -> None:
        before = self._state(self._ask(board, one), one, c.TRANSD_NOT_SAVED, c.TRANSD_SAVED)
        board.refuse_all(self._wrong(board, one))
        if self._state(self._ask(board, one), one, *_STATES) != before:
            fail(f"SAVE of {one.name} has changed by what was refused")

    @staticmethod
    def _wrong(board: Board, one: oracle.Transducer) -> Iterator[tuple[bytes, int]]:
        """Yield what SAVE cannot be; most values and long ones go to the transducers in turn."""
        item, longest = bytes((one.id, c.TRANSD_SAVE)), board.peer.longest - 2
        for value in (0, *range(2, 256)):
            if value in _WRONG or board.all[value % len(board.all)] is one:
                yield item + bytes((value,)), c.TRANSD_BAD_VALUE
        for length in range(2, longest + 1):
            if length in (*_LENGTHS, longest) or board.all[length % len(board.all)] is one:
                yield item + bytes((1,)) * length, c.TRANSD_BAD_LENGTH

    def _saved(self, board: Board, one: oracle.Transducer) -> None:
        begin_us = board.time_us()
        states = (c.TRANSD_SAVING, c.TRANSD_SAVED)
        state = self._state(self._ask(board, one, b"\1"), one, *states)
        if state == c.TRANSD_SAVING:
            state = self._itself(board, one)
        others = cycle([other for other in reversed(board.all) if other.id != one.id] or [one])
        while state == c.TRANSD_SAVING:
            other = next(others)
            again = self._ask(board, other, b"\1")
            state = self._state(self._ask(board, one), one, *states)
            is_busy = (again.opcode, again.payload) == (c.TRANSD_BUSY, b"")
            if state == c.TRANSD_SAVING and not is_busy:
                fail(f"{other.name} is saved with the code {again.opcode}, not BUSY")
            if not is_busy:  # the first one was ready by then
                self._wait(board, other, board.time_us())
            if board.time_us() - begin_us > _LONGEST_US:
                fail(f"SAVE of {one.name} is SAVING for more than 10 s", suspect=True)
        self._state(self._ask(board, one), one, c.TRANSD_SAVED)

    def _itself(self, board: Board, one: oracle.Transducer) -> int:
        """Save a transducer that is being saved, also with what is wrong, and write its settings;
        return its state then.

        It may be ready before any of these requests, and a device that then saves anew is SAVING
        again; but if a request finds it so, not each of those before came just when it was ready.
        """
        peer, item = board.peer, bytes((one.id, c.TRANSD_SAVE))
        states = (c.TRANSD_SAVING, c.TRANSD_SAVED)
        payloads = (item, *[item + b"\1"] * _AGAIN, item)
        wrong = ((item + b"\0", c.TRANSD_BAD_VALUE), (item + b"\1\1", c.TRANSD_BAD_LENGTH))
        opcode = peer.opcode(c.TRANSD)
        requests = [peer.request(opcode, payload) for payload in payloads]
        writes = [
            peer.request(opcode, bytes((one.id, setting)) + value, c.RET_OK, value)
            for setting in _SETTINGS
            if board.has(one, setting)
            for value in (board.read(one, setting),)
        ]
        replies = peer.ask_all((requests[0], *writes, *requests[1:]))
        first, *again, last = (replies[0], *replies[1 + len(writes) :])
        board.refuse_all(wrong)
        busy = [reply for reply in again if reply.opcode == c.TRANSD_BUSY]
        for reply in again:
            if reply not in busy:
                self._state(reply, one, *states)
            elif reply.payload:
                fail(f"BUSY has the payload {reply.payload.hex()}")
        found = [self._state(reply, one, *states) for reply in (first, last)]
        if found == [c.TRANSD_SAVING] * 2 and not busy:
            fail(f"{one.name} is saved while it is SAVING, and is not BUSY")
        return found[-1]

    def _wait(self, board: Board, one: oracle.Transducer, begin_us: int) -> None:
        while self._state(self._ask(board, one), one, *_STATES) == c.TRANSD_SAVING:
            if board.time_us() - begin_us > _LONGEST_US:
                fail(f"SAVE of {one.name} is SAVING for more than 10 s", suspect=True)

    @staticmethod
    def _settings(board: Board, one: oracle.Transducer) -> list[bytes]:
        return [board.read(one, item) for item in _SETTINGS if board.has(one, item)]
