"""Which values a sensor takes: decimation and threshold (J2A-TRANS)."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

from j2a_spec import constants as c
from j2a_spec import transducers as oracle

from j2a_conformance._judge import fail

from ._board import (
    FORMATS,
    STIMULUS,
    Board,
    TransducerCase,
    byte_off,
    slots,
    spread,
)

_DECIMATIONS: Final = (6, 7, 8, 9, 15, 16, 17, 31, 32, 33, 50, 63, 64, 65, 100, 127, 128, 129, 200)
_DIGITS: Final = {"f32": (24, 128), "f64": (53, 1024)}
"""Binary digits with the hidden one, and the power of two below which the numbers are."""


class Taken(TransducerCase):
    """Gives values one by one; whether each is taken is known before."""

    NEEDS = (*TransducerCase.NEEDS, STIMULUS)

    @staticmethod
    @contextmanager
    def _alone(board: Board, one: oracle.Transducer) -> Iterator[None]:
        """Tune a sensor; in the end nothing may come that was not asked for."""
        with board.tuned(one):
            yield
            board.no_sif(one, board.seen, "without a new value")

    @staticmethod
    def _give(board: Board, one: oracle.Transducer, channel: int, value: bytes, due: bool) -> None:
        since = board.seen
        is_read = not due and "queue" not in one.attributes
        before = board.read(one, c.TRANSD_SAMPLE) if is_read else b""
        board.stimulate(one, (channel, value))
        if due:
            _, payload = board.sif(one, since)
            if value not in payload:
                fail(f"{one.name} was given {value.hex()}, and sent {payload.hex()}")
            return
        if before and board.read(one, c.TRANSD_SAMPLE) != before:
            fail(f"{one.name} has taken {value.hex()} on channel {channel}, which was not due")
        if not before:
            board.no_sif_yet(one, since, f"for {value.hex()}, which was not to be taken")


class Decimation(Taken):
    """Gives values to each channel of sensors with decimation, in turn and one after the other."""

    ID = "transducers.decimation"
    EXPECTATION = "Every n-th value of each channel is taken, counted from the write of n."
    REQUIREMENTS = ("J2A-TRANS-012",)

    def _judge(self, board: Board) -> None:
        for one in board.sensors("decimation"):
            with self._alone(board, one):
                self._sensor(board, one)

    def _sensor(self, board: Board, one: oracle.Transducer) -> None:
        channels = spread(one)
        for every in (1, 2, 3, 5):
            for begun in (0, 1, every - 1):
                board.write(one, c.TRANSD_DECIMATION, bytes((every,)))
                for number in range(begun):  # the count begins anew with each write
                    for channel in channels:
                        is_due = (number + 1) % every == 0
                        self._give(board, one, channel, board.value(one), is_due)
                board.write(one, c.TRANSD_DECIMATION, bytes((every,)))
                for number in range(2 * every + 1):
                    for channel in channels:
                        is_due = (number + 1) % every == 0
                        self._give(board, one, channel, board.value(one), is_due)
        self._disabled(board, one)
        having = board.sensors("decimation")
        for number, every in enumerate((*_DECIMATIONS, 255)):
            if every == 255 or having[number % len(having)] is one:
                for channel in {0, channels[-1] if every == 255 else number % one.channels}:
                    self._many(board, one, channel, every)

    def _many(self, board: Board, one: oracle.Transducer, channel: int, every: int) -> None:
        """Give all values of which none is to be taken in few requests, and then two more."""
        board.write(one, c.TRANSD_DECIMATION, bytes((every,)))
        fit = (board.peer.longest - 1) // (1 + board.size(one))
        has_queue = "queue" in one.attributes
        since = board.seen
        before = b"" if has_queue else board.read(one, c.TRANSD_SAMPLE)
        for given in range(0, every - 2, fit):
            count = min(fit, every - 2 - given)
            board.stimulate(one, *((channel, board.value(one)) for _ in range(count)))
        if not has_queue and board.read(one, c.TRANSD_SAMPLE) != before:
            fail(f"{one.name} has taken one of {every - 2} values, where one in {every} is due")
        board.no_sif_yet(one, since, f"for {every - 2} values, where one in {every} is due")
        for is_due in (False, True):
            self._give(board, one, channel, board.value(one), is_due)

    def _disabled(self, board: Board, one: oracle.Transducer) -> None:
        """Count on over times without ENABLED, and with values in them where there is no queue."""
        board.write(one, c.TRANSD_DECIMATION, b"\3")
        for number in range(9):
            for channel in spread(one):
                is_meanwhile = "queue" not in one.attributes and number % 4 == 1
                board.write(one, c.TRANSD_ENABLED, b"\0")
                if not is_meanwhile:
                    board.write(one, c.TRANSD_ENABLED, b"\1")
                    self._give(board, one, channel, board.value(one), number % 3 == 2)
                    continue
                before, value = board.read(one, c.TRANSD_SAMPLE), board.value(one)
                board.stimulate(one, (channel, value))
                if (board.read(one, c.TRANSD_SAMPLE) != before) != (number % 3 == 2):
                    fail(f"value {number} of {one.name}, which was disabled, was counted wrongly")
                board.write(one, c.TRANSD_ENABLED, b"\1")


class Threshold(Taken):
    """Gives values to sensors with threshold that differ from the last one by less, as much and
    more, up and down, across the whole range, in one byte only, over times without ENABLED, the
    value na, infinities, and floating-point values whose difference is rounded.
    """

    ID = "transducers.threshold"
    EXPECTATION = "The first, those that differ by as much, and from and to na are taken."
    REQUIREMENTS = ("J2A-TRANS-013",)

    def _judge(self, board: Board) -> None:
        for one in board.sensors("threshold"):
            with self._alone(board, one):
                for channel in spread(one):
                    if "queue" not in one.attributes:
                        self._first(board, one, channel)
                    self._sensor(board, one, channel)
                    self._disabled(board, one, channel)
                    if board.scalar(one) in FORMATS:
                        self._infinite(board, one, channel)
                        self._rounded(board, one, channel)
                self._of_one_byte(board, one, channel)
                self._limit_of_one_byte(board, one, channel)
                self._near_na(board, one, channel)
                for channel in spread(one) if "decimation" in one.attributes else ():
                    self._decimated(board, one, channel)

    def _sensor(self, board: Board, one: oracle.Transducer, channel: int) -> None:
        is_float = board.scalar(one) in FORMATS
        na = one.attributes.get("na", "none")
        definitions = board.descriptors.definitions
        na_number = None if na == "none" else oracle.raw(one, na, definitions)
        most = 1 << 8 * board.size(one)
        low = 0 if board.scalar(one)[0] == "u" else -(1 << 20) if is_float else -(most // 2)
        high = 1 << 20 if is_float else low + most - 1
        top = high if high != na_number else high - 1
        limits: tuple[Any, ...] = (0.5, 3.0, 100.0, 262144.0)
        if not is_float:
            limits = (1, 2, min(100, high), high // 2 + 1, *sorted({top, high}))
        start = (low + high) // 2
        start += start == na_number
        for limit in limits:
            board.write(one, c.TRANSD_THRESHOLD, bytes(board.size(one)))
            self._give(board, one, channel, board.packed(one, start), due=True)
            board.write(one, c.TRANSD_THRESHOLD, board.packed(one, limit))
            last: Any = start
            step = 0.25 if is_float else 1
            walk = [last, last + limit - step, last - limit + step, last + limit]
            walk += [last, low, high, high - limit + step, low, low + limit, high, low]
            for number in walk:
                if (not is_float and not low <= number <= high) or number == na_number:
                    continue
                is_due = abs(number - last) >= limit
                self._give(board, one, channel, board.packed(one, number), is_due)
                last = number if is_due else last
            # From the ends and the middle to where it is just far, and near.
            for origin, way in ((low, 1), (top, -1), (start, 1), (start, -1)):
                for distance in (limit, limit - step):
                    number = origin + way * distance
                    if na_number not in (origin, number) and low <= number <= top:
                        board.write(one, c.TRANSD_THRESHOLD, bytes(board.size(one)))
                        self._give(board, one, channel, board.packed(one, origin), due=True)
                        board.write(one, c.TRANSD_THRESHOLD, board.packed(one, limit))
                        is_due = distance == limit
                        self._give(board, one, channel, board.packed(one, number), is_due)
                        last = number if is_due else origin
            if na_number is None:
                continue
            near = na_number if is_float else na_number - 1 if na_number > low else na_number + 1
            numbers = (na_number, na_number, last, last, na_number, near, near, na_number, start)
            for number in numbers:
                is_now, was = _is_na(number, na_number), _is_na(last, na_number)
                is_due = is_now != was or (not is_now and abs(number - last) >= limit)
                self._give(board, one, channel, board.packed(one, number), is_due)
                last = number if is_due else last

    def _first(self, board: Board, one: oracle.Transducer, channel: int) -> None:
        """Give a channel without a value one that is no different from nothing."""
        if slots(board, one, board.read(one, c.TRANSD_SAMPLE))[channel][0]:
            return
        size = board.size(one)
        most = board.packed(one, 1e30 if board.scalar(one) in FORMATS else (1 << 8 * size - 1) - 1)
        board.write(one, c.TRANSD_THRESHOLD, most)
        self._give(board, one, channel, bytes(size), due=True)

    def _disabled(self, board: Board, one: oracle.Transducer, channel: int) -> None:
        """Compare with what was taken last: before ENABLED was 0, and meanwhile without queue.
        Settings that are written meanwhile change nothing of it.
        """
        has_queue = "queue" in one.attributes
        last = 40
        limits = [bytes(board.size(one)), board.packed(one, 8)]
        board.write(one, c.TRANSD_THRESHOLD, limits[0])
        self._give(board, one, channel, board.packed(one, last), due=True)
        board.write(one, c.TRANSD_THRESHOLD, limits[1])
        for round_, meanwhile in enumerate((None, 60, 64, None, 20)):
            board.write(one, c.TRANSD_ENABLED, b"\0")
            if round_ % 2:
                board.rewrite(one)
                for limit in limits:
                    board.write(one, c.TRANSD_THRESHOLD, limit)
            if meanwhile is not None:
                board.stimulate(one, (channel, board.packed(one, meanwhile)))
                last = last if has_queue or abs(meanwhile - last) < 8 else meanwhile
            board.write(one, c.TRANSD_ENABLED, b"\1")
            for number in (last + 7, last - 7, last + 8):
                is_due = number == last + 8
                self._give(board, one, channel, board.packed(one, number), is_due)
            last += 8

    def _of_one_byte(self, board: Board, one: oracle.Transducer, channel: int) -> None:
        """Give values that differ from the one before in one byte, by THRESHOLD and by less."""
        size, definitions = board.size(one), board.descriptors.definitions
        na = _na(board, one)
        bases = [bytes((byte,)) * size for byte in (0x55, 0xAA)]
        if board.scalar(one) in FORMATS:
            bases = [board.packed(one, number) for number in (3.1, -3.1)]
        most = (1 << 8 * size - (board.scalar(one)[0] != "u")) - 1
        for last in bases:
            for value in byte_off(board, one, last):
                if na in (last, value):
                    continue
                numbers = (board.number(one, value), board.number(one, last))
                least = board.packed(one, oracle.difference(one, *numbers, definitions))
                above = int.from_bytes(least, "little") + 1
                for limit, is_due in ((above, False), (above - 1, True)):
                    if limit <= most:
                        board.write(one, c.TRANSD_THRESHOLD, bytes(size))
                        self._give(board, one, channel, last, due=True)
                        board.write(one, c.TRANSD_THRESHOLD, limit.to_bytes(size, "little"))
                        self._give(board, one, channel, value, is_due)

    def _limit_of_one_byte(self, board: Board, one: oracle.Transducer, channel: int) -> None:
        """Give values whose difference is THRESHOLD in all bytes but one."""
        size, na = board.size(one), _na(board, one)
        pair = [bytes((byte,)) * size for byte in (0x15, 0x2B)]
        if board.scalar(one) in FORMATS:
            pair = [board.packed(one, number) for number in (-3.1, 3.1)]
        if na in pair:
            return
        low, high = (board.number(one, value) for value in pair)
        difference = oracle.difference(one, low, high, board.descriptors.definitions)
        for limit in byte_off(board, one, board.packed(one, difference)):
            if (least := board.number(one, limit)) >= 0:
                for last, value in (pair, pair[::-1]):
                    board.write(one, c.TRANSD_THRESHOLD, bytes(size))
                    self._give(board, one, channel, last, due=True)
                    board.write(one, c.TRANSD_THRESHOLD, limit)
                    self._give(board, one, channel, value, due=difference >= least)

    def _near_na(self, board: Board, one: oracle.Transducer, channel: int) -> None:
        """Give na, and values that differ from it in one byte."""
        na, size = _na(board, one), board.size(one)
        if na is None or board.scalar(one) in FORMATS:
            return
        most = (1 << 8 * size - (board.scalar(one)[0] != "u")) - 1
        board.write(one, c.TRANSD_THRESHOLD, bytes(size))
        self._give(board, one, channel, na, due=True)
        board.write(one, c.TRANSD_THRESHOLD, most.to_bytes(size, "little"))
        for value in byte_off(board, one, na):
            self._give(board, one, channel, value, due=True)
            self._give(board, one, channel, na, due=True)

    def _infinite(self, board: Board, one: oracle.Transducer, channel: int) -> None:
        inf = math.inf
        for limit in (1.0, 1e30, inf):
            board.write(one, c.TRANSD_THRESHOLD, bytes(board.size(one)))
            self._give(board, one, channel, board.packed(one, 3.0), due=True)
            board.write(one, c.TRANSD_THRESHOLD, board.packed(one, limit))
            last = 3.0
            for number in (inf, inf, -inf, -inf, 5.0, -inf, inf, inf, 0.0, 0.0):
                self._give(board, one, channel, board.packed(one, number), number != last)
                last = number
        board.write(one, c.TRANSD_THRESHOLD, bytes(board.size(one)))
        for number in (inf, inf, -inf, -inf):
            self._give(board, one, channel, board.packed(one, number), due=True)

    def _rounded(self, board: Board, one: oracle.Transducer, channel: int) -> None:
        """Give values whose difference lies between two numbers, or beyond the largest one."""
        digits, power = _DIGITS[board.scalar(one)]
        step = 2.0**-digits
        largest = math.ldexp(1 - step, power)
        pairs = [(1 - step, -part * step) for part in (0.25, 0.5, 0.75)]
        pairs += [(1.0, -part * step) for part in (0.75, 1, 1.25, 3)]
        pairs += [(largest, -largest), (largest, -step), (largest, -largest * step)]
        for number, last in (*pairs, *((-number, -last) for number, last in pairs)):
            least = oracle.difference(one, number, last, board.descriptors.definitions)
            limits = [(board.packed(one, least), True)]
            if least != math.inf:
                above = int.from_bytes(limits[0][0], "little") + 1
                limits.append((above.to_bytes(board.size(one), "little"), False))
            for limit, is_due in limits:
                board.write(one, c.TRANSD_THRESHOLD, bytes(board.size(one)))
                self._give(board, one, channel, board.packed(one, last), due=True)
                board.write(one, c.TRANSD_THRESHOLD, limit)
                self._give(board, one, channel, board.packed(one, number), is_due)

    def _decimated(self, board: Board, one: oracle.Transducer, channel: int) -> None:
        """Leave the values that decimation leaves to the threshold."""
        board.write(one, c.TRANSD_THRESHOLD, bytes(board.size(one)))
        board.write(one, c.TRANSD_DECIMATION, b"\1")
        self._give(board, one, channel, board.packed(one, 10), due=True)
        board.write(one, c.TRANSD_THRESHOLD, board.packed(one, 5))
        board.write(one, c.TRANSD_DECIMATION, b"\2")
        numbers = ((12, False), (30, True), (31, False), (32, False), (50, False), (60, True))
        for number, is_due in numbers:
            self._give(board, one, channel, board.packed(one, number), is_due)


def _na(board: Board, one: oracle.Transducer) -> bytes | None:
    """Return the value of a sensor that says that there is none."""
    text = one.attributes.get("na", "none")
    if text == "none":
        return None
    return board.packed(one, oracle.raw(one, text, board.descriptors.definitions))


def _is_na(number: Any, na: Any) -> bool:
    return bool(number == na) or (math.isnan(number) and math.isnan(na))
