"""Settings of transducers that stay without power: SAVE and its states (J2A-TRANS-028)."""

from collections.abc import Iterator
from functools import partial
from itertools import cycle
from typing import Final

from j2a_spec import constants as c
from j2a_spec import transducers as oracle
from j2a_spec.oracle import Frame

from j2a_conformance._judge import fail, skip

from ._board import Board, TransducerCase
from .periods import PeriodCase

_STATES: Final = (c.TRANSD_NOT_SAVED, c.TRANSD_SAVED, c.TRANSD_SAVING)
_LONGEST_US: Final = 10_000_000
_WRONG: Final = (0, 2, 3, 0x81, 0xFF)
_LENGTHS: Final = range(2, 13)
_AGAIN: Final = 3
_SETTINGS: Final = range(c.TRANSD_ENABLED, c.TRANSD_WATCHDOG + 1)


def ask_save(board: Board, one: oracle.Transducer, value: bytes = b"") -> Frame:
    """Write SAVE of a transducer, or read it without a value; return whatever it replies."""
    payload = bytes((one.id, c.TRANSD_SAVE)) + value
    return board.peer.ask(board.peer.request(board.peer.opcode(c.TRANSD), payload))


def has_save(board: Board, one: oracle.Transducer) -> bool:
    """Whether a transducer has SAVE, to read and to write."""
    for value in (b"", b"\0"):
        reply = ask_save(board, one, value)
        if (reply.opcode, reply.payload) == (c.TRANSD_NO_ITEM, b""):
            return False
    return True


class Saving(TransducerCase):
    """Saves the settings of each transducer, with right values and wrong ones, asks for SAVE until
    it is SAVED, and meanwhile saves it and others; then saves each once more.
    """

    ID = "transducers.saving"
    EXPECTATION = "SAVING, BUSY for a write meanwhile, and SAVED, all of them; no setting changes."
    REQUIREMENTS = ("J2A-TRANS-008", "J2A-TRANS-009", "J2A-TRANS-028")

    def _judge(self, board: Board) -> None:
        having = [one for one in board.all if has_save(board, one)]
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
        for is_again in (False, True):
            if is_again:
                for one in board.all:
                    self._saved(board, one)
                    self._changed(board, one)
            for one in board.all:
                self._state(ask_save(board, one), one, c.TRANSD_SAVED)

    def _state(self, reply: Frame, one: oracle.Transducer, *states: int) -> int:
        if reply.opcode != c.RET_OK or len(reply.payload) != 1 or reply.payload[0] not in states:
            fail(f"SAVE of {one.name} is {reply.payload.hex()}, with the code {reply.opcode}")
        return reply.payload[0]

    def _refused(self, board: Board, one: oracle.Transducer) -> None:
        before = self._state(ask_save(board, one), one, c.TRANSD_NOT_SAVED, c.TRANSD_SAVED)
        board.refuse_all(self._wrong(board, one))
        if self._state(ask_save(board, one), one, *_STATES) != before:
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
        state = self._state(ask_save(board, one, b"\1"), one, *states)
        if state == c.TRANSD_SAVING:
            state = self._itself(board, one)
        others = cycle([other for other in reversed(board.all) if other.id != one.id] or [one])
        while state == c.TRANSD_SAVING:
            other = next(others)
            again = ask_save(board, other, b"\1")
            state = self._state(ask_save(board, one), one, *states)
            is_busy = (again.opcode, again.payload) == (c.TRANSD_BUSY, b"")
            if state == c.TRANSD_SAVING and not is_busy:
                fail(f"{other.name} is saved with the code {again.opcode}, not BUSY")
            if not is_busy:  # the first one was ready by then
                self._wait(board, other, board.time_us())
            if board.time_us() - begin_us > _LONGEST_US:
                fail(f"SAVE of {one.name} is SAVING for more than 10 s", suspect=True)
        self._state(ask_save(board, one), one, c.TRANSD_SAVED)

    def _changed(self, board: Board, one: oracle.Transducer) -> None:
        """Save a transducer that was saved before, with another setting and with the first one."""
        items = [item for item in (c.TRANSD_ENABLED, c.TRANSD_WATCHDOG) if board.has(one, item)]
        for item in items[:1]:
            before = board.read(one, item)
            for value in (before[:-1] + bytes((before[-1] ^ 1,)), before):
                board.write(one, item, value)
                self._told(board, one)

    def _told(self, board: Board, one: oracle.Transducer) -> None:
        """Save a transducer; where it is SAVED, no other is BUSY."""
        states = (c.TRANSD_SAVING, c.TRANSD_SAVED)
        self._state(ask_save(board, one, b"\1"), one, *states)
        state = self._state(ask_save(board, one), one, *states)
        other = board.all[board.all.index(one) - 1]
        again = ask_save(board, other, b"\1")
        if state == c.TRANSD_SAVED and again.opcode == c.TRANSD_BUSY:
            fail(f"SAVE of {one.name} is SAVED, and that of {other.name} is BUSY")
        for saved in (one, other):
            self._wait(board, saved, board.time_us())

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
        while self._state(ask_save(board, one), one, *_STATES) == c.TRANSD_SAVING:
            if board.time_us() - begin_us > _LONGEST_US:
                fail(f"SAVE of {one.name} is SAVING for more than 10 s", suspect=True)

    @staticmethod
    def _settings(board: Board, one: oracle.Transducer) -> list[bytes]:
        return [board.read(one, item) for item in _SETTINGS if board.has(one, item)]


class SavedPeriod(PeriodCase):
    """Saves the settings of a sensor of each kind in the middle of a period; they are what they
    were before the case then.
    """

    ID = "transducers.period-saved"
    EXPECTATION = "A value is sent when PERIOD is over since the SIF before, as without a save."
    REQUIREMENTS = ("J2A-TRANS-011", "J2A-TRANS-028")
    _TUNED: Final = range(c.TRANSD_ENABLED, c.TRANSD_THRESHOLD + 1)
    _PERIOD_US: Final = 65_000

    def _judge(self, board: Board) -> None:
        for queue in (False, True):
            for one in board.sensors(queue=queue)[:1]:
                if not has_save(board, one):
                    skip("the device keeps no settings without power")
                usual = self._settings(board, one)
                with board.tuned(one):
                    attempt = partial(self._saved, board, one, usual)
                    board.peer.attempts(
                        partial(self._in_time, board, one, self._PERIOD_US, attempt)
                    )

    @classmethod
    def _settings(cls, board: Board, one: oracle.Transducer) -> dict[int, bytes]:
        return {item: board.read(one, item) for item in cls._TUNED if board.has(one, item)}

    def _saved(
        self, board: Board, one: oracle.Transducer, usual: dict[int, bytes], us: int
    ) -> bool:
        board.write(one, c.TRANSD_ENABLED, b"\1")  # the attempt before may have ended at 0
        for _ in board.until(board.time_us() + _LONGEST_US):
            if ask_save(board, one).payload != bytes((c.TRANSD_SAVING,)):
                break
        begun = self._refer(board, one)
        self._period(board, one, us)
        since = board.seen

        def change() -> None:
            tuned = self._settings(board, one)
            for item, value in usual.items():  # only these may stay without power
                board.write(one, item, value)
            reply = ask_save(board, one, b"\1")
            if reply.opcode != c.RET_OK:
                fail(f"{one.name} is not saved, with the code {reply.opcode}")
            for item, value in tuned.items():
                board.write(one, item, value)
            self._give(board, one, -1)

        return self._in_middle(board, one, us, begun, since, change=change)
