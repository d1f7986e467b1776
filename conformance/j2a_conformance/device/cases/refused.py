"""Requests for transducers that a device must refuse, and topics that it takes (J2A-TRANS)."""

import math
from collections.abc import Iterator
from typing import Final

from j2a_spec import constants as c
from j2a_spec import transducers as oracle

from j2a_conformance._judge import fail

from ._board import (
    ITEMS,
    READ_ONLY,
    STIMULUS,
    WRITE_ONLY,
    Board,
    TransducerCase,
    nans,
    wrong_sets,
)
from ._topics import WRONG_TOPICS

_SHORT: Final = 40  # longer than a topic, and than a value of any type


class Refused(TransducerCase):
    """Asks for transducers that there are not, for items that they do not have, and writes values
    of other lengths and out of range. Items that no transducer has and long values go to the
    transducers in turn.
    """

    ID = "transducers.refused"
    EXPECTATION = "The code of the first thing that is wrong, no payload, and nothing has changed."
    REQUIREMENTS = ("J2A-TRANS-008", "J2A-TRANS-014", "J2A-TRANS-016")

    def _judge(self, board: Board) -> None:
        for payload in (b"", *(bytes((one.id,)) for one in board.all), b"\xff"):
            board.exchange(payload, c.TRANSD_BAD_LENGTH)
        self._ids(board)
        for one in board.all:
            board.refuse_all((item, c.TRANSD_NO_ITEM) for item in self._items(board, one))
            self._values(board, one)

    @staticmethod
    def _ids(board: Board) -> None:
        known = {one.id for one in board.all}
        strange = next(number for number in range(255, -1, -1) if number not in known)
        payloads = (
            *(bytes((number, number % 11)) for number in range(256) if number not in known),
            *(bytes((strange, item)) + bytes(item % 3) for item in (*range(12), 255)),
            *(
                bytes((strange, length % 11)) + bytes(length)
                for length in range(board.peer.longest - 1)
            ),
        )
        board.refuse_all((payload, c.TRANSD_NO_ID) for payload in payloads)

    @staticmethod
    def _items(board: Board, one: oracle.Transducer) -> Iterator[bytes]:
        """Yield requests for items that a transducer does not have."""
        for item in range(256):
            if item == c.TRANSD_SAVE:
                continue
            if ITEMS < item < 255 and board.all[item % len(board.all)] is not one:
                continue
            if item in WRITE_ONLY or not board.has(one, item):
                yield bytes((one.id, item))
            if item in READ_ONLY or not board.has(one, item):
                lengths = (*range(1, ITEMS + 1), board.peer.longest - 2) if item < ITEMS else (1,)
                for length in lengths:
                    yield bytes((one.id, item)) + bytes(length)
        # Longer ones to the transducers in turn, and of each to one item.
        lacking = [item for item in range(ITEMS) if item != c.TRANSD_SAVE]
        lacking = [item for item in lacking if item in READ_ONLY or not board.has(one, item)]
        for length in range(ITEMS + 1, board.peer.longest - 2):
            if board.all[length % len(board.all)] is one:
                yield bytes((one.id, lacking[length % len(lacking)])) + bytes(length)

    def _values(self, board: Board, one: oracle.Transducer) -> None:
        readable = [item for item in range(11) if item not in (*WRITE_ONLY, c.TRANSD_TIME)]
        if one.kind == "sensor" and not board.peer.has(STIMULUS):
            readable.remove(c.TRANSD_SAMPLE)  # its driver measures on its own
        before = {item: board.read(one, item) for item in readable if board.has(one, item)}
        board.refuse_all(self._wrong_values(board, one))
        for item, value in before.items():
            if board.read(one, item) != value:
                fail(f"item {item} of {one.name} has changed by what was refused")

    def _wrong_values(self, board: Board, one: oracle.Transducer) -> Iterator[tuple[bytes, int]]:
        """Yield requests that write what an item cannot be, each with its code."""
        longest = board.peer.longest - 2
        for item in range(11):
            if item in READ_ONLY or not board.has(one, item):
                continue
            having = [other for other in board.all if board.has(other, item)]
            for length in range(1, longest + 1):
                if _SHORT < length < longest and self._in_turn(board, having, item, length) != one:
                    continue
                if not self.fits(board, one, item, length):
                    value = self._of_length(one, length)
                    yield bytes((one.id, item)) + value, c.TRANSD_BAD_LENGTH
            for value in self.wrong(board, one, item):
                yield bytes((one.id, item)) + value, c.TRANSD_BAD_VALUE

    @staticmethod
    def _of_length(one: oracle.Transducer, length: int) -> bytes:
        """Return a value that is in range of most items, or out of range, which is not judged then:
        for SET in its values, in its first channel, or in both.
        """
        first, rest = ((0, 0), (one.channels, 0), (0, 0xFF), (0xFF, 0xFF))[
            (length // 2 + one.id) % 4
        ]
        return bytes((first, *(rest,) * (length - 1)))

    @classmethod
    def _in_turn(
        cls, board: Board, some: list[oracle.Transducer], item: int, length: int
    ) -> oracle.Transducer | None:
        """Return which of some transducers is given a length that is wrong for it."""
        first = length % len(some)
        ordered = (*some[first:], *some[:first])
        return next((one for one in ordered if not cls.fits(board, one, item, length)), None)

    @staticmethod
    def fits(board: Board, one: oracle.Transducer, item: int, length: int) -> bool:
        """Whether an item may be so long."""
        size = board.size(one)
        if item == c.TRANSD_TOPIC:
            return length <= c.TRANSD_MAX_TOPIC
        if item == c.TRANSD_SET:
            return length > 9 and (length - 9) % size == 0
        sizes = {c.TRANSD_PERIOD: 4, c.TRANSD_THRESHOLD: size, c.TRANSD_WATCHDOG: 2}
        return length == {**sizes, c.TRANSD_TRIGGER: 8}.get(item, 1)

    @staticmethod
    def wrong(board: Board, one: oracle.Transducer, item: int) -> Iterator[bytes]:
        """Yield values of the right length that are out of range."""
        if item == c.TRANSD_ENABLED:
            yield from (b"\2", b"\x12", b"\x80", b"\xff")
        if item == c.TRANSD_DECIMATION:
            yield b"\0"
        if item == c.TRANSD_THRESHOLD and board.scalar(one) in ("f32", "f64"):
            yield from (board.packed(one, number) for number in (-0.5, -1e30, -math.inf))
            yield from nans(board, one)
        if item == c.TRANSD_THRESHOLD and board.scalar(one)[0] == "i":
            lowest = -(1 << 8 * board.size(one) - 1)
            yield from (board.packed(one, number) for number in (-1, lowest, lowest // 2))
        if item == c.TRANSD_TOPIC:
            yield from WRONG_TOPICS
        if item == c.TRANSD_SET:
            yield from wrong_sets(board, one)
