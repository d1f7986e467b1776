"""When sample SIFs are due: lateness, silence and writes of PERIOD (J2A-TRANS-011).

All times are those of the device's clock. TIME is read when a sample SIF has come, so the SIF began
before: if the time is too early, so was the SIF; if it is late, only the reading may be. A SIF that
must not be late is therefore tried several times, with longer periods, until it is in time. A
device may break the rule only where a period takes 16 bits, or more, so a period of 16 bits stays
one unless the link is too slow for it.
"""

import struct
from collections.abc import Callable, Sequence
from functools import partial
from typing import Final

from j2a_spec import constants as c
from j2a_spec import transducers as oracle

from j2a_conformance._judge import fail, inform
from j2a_conformance.device._paused import send_paused

from ._board import (
    STIMULUS,
    Board,
    TransducerCase,
    is_readable,
    is_writable,
    queued,
    spread,
)
from .timing import awkward

_SHORT_US: Final = 25_000
_SHORTER_US: Final = (1000, 2000, 5000, 10_000, 16_000, 20_000)
_LONG_US: Final = 70_000  # more than 16 bits
_LONGEST_SHORT_US: Final = 65_000  # 16 bits
_LONGEST_US: Final = 400_000
_LATER_US: Final = 600_000
_TRIES: Final = 6
_SLOW: Final = 12
"""A link is, where giving a value takes more than one part of so many of a period: a value that is
late by 0.8 of one needs that time twice before the next one.
"""
_NEVER_US: Final = 0xFFFFFFFF
_AHEAD_US: Final = 1 << 62
_LATE: Final = ((2, 4), (6, 2), (8, 1))  # tenths of a period, and how many SIFs in a row
_LATE_ONCE: Final = (5, 1)
_RATE: Final = 0.95  # the clock may run slower than the local time
_IN_TIME: Final = 0.94
_PIECE_S: Final = 0.006  # a pause within a request, and more than a TIME takes
_PIECE_BYTE_S: Final = 0.0005


class PeriodCase(TransducerCase):
    """Measures when sample SIFs of each sensor begin."""

    NEEDS = (*TransducerCase.NEEDS, STIMULUS)

    def _judge(self, board: Board) -> None:
        sensors = board.sensors()
        firsts = [one for queue in (False, True) for one in board.sensors(queue=queue)[:1]]
        for number, one in enumerate(sensors):
            with board.tuned(one):
                for period_us in (_SHORT_US, _LONG_US) if one in firsts else (_SHORT_US,):
                    board.peer.attempts(partial(self._attempt, board, one, period_us, number % 2))

    def _attempt(self, board: Board, one: oracle.Transducer, period_us: int, odd: int) -> None:
        board.write(one, c.TRANSD_ENABLED, b"\1")  # the attempt before may have ended at 0
        self._sensor(board, one, period_us, odd)

    def _sensor(self, board: Board, one: oracle.Transducer, period_us: int, odd: int) -> None:
        raise NotImplementedError

    @staticmethod
    def _in_time(
        board: Board, one: oracle.Transducer, period_us: int, attempt: Callable[[int], bool]
    ) -> None:
        """Fail where all attempts are in vain, each with a longer period as far as it may be."""
        is_short = period_us <= _LONGEST_SHORT_US and not PeriodCase._is_slow(board, one)
        for _ in range(_TRIES):
            if attempt(period_us):
                return
            period_us = min(2 * period_us, _LONGEST_SHORT_US if is_short else _LONGEST_US)
        fail(f"a sample SIF of {one.name} comes long after it was due", suspect=True)

    def _in_middle(
        self,
        board: Board,
        one: oracle.Transducer,
        us: int,
        begun: tuple[int, int],
        since: int,
        *,
        change: Callable[[], None],
        periods: int = 1,
    ) -> bool:
        """Change something within the period; return whether that was in time, and so is the
        sample SIF, so many periods behind the one before.
        """
        low_us, high_us = begun
        board.wait_until(high_us + us // 2)
        written_us = board.time_us()
        change()
        is_early = board.time_us() < low_us + us
        board.sif(one, since)
        begun_us = board.time_us()
        self._not_before(one, begun_us, low_us, (periods if is_early else 1) * us)
        return is_early and begun_us < written_us + periods * us * _IN_TIME

    @staticmethod
    def _is_slow(board: Board, one: oracle.Transducer, period_us: int = _LONGEST_SHORT_US) -> bool:
        """Whether no time is told soon enough for short periods; a stall spoils only some."""
        spans_us = (
            high - low for low, high in (PeriodCase._refer(board, one) for _ in range(_TRIES))
        )
        return all(span_us > period_us // _SLOW for span_us in spans_us)

    @staticmethod
    def _refer(board: Board, one: oracle.Transducer) -> tuple[int, int]:
        """Have a sample SIF sent at once; return times around its start, the next reference."""
        board.write(one, c.TRANSD_PERIOD, bytes(4))
        low_us = board.time_us()
        PeriodCase._send(board, one, 0)
        return low_us, board.time_us()

    @staticmethod
    def _period(board: Board, one: oracle.Transducer, period_us: int) -> None:
        board.write(one, c.TRANSD_PERIOD, struct.pack("<I", period_us))

    @staticmethod
    def _give(board: Board, one: oracle.Transducer, channel: int = 0) -> None:
        board.stimulate(one, (spread(one)[channel], board.value(one)))

    @staticmethod
    def _send(board: Board, one: oracle.Transducer, channel: int) -> int:
        """Give a value; return a time after the start of its sample SIF."""
        since = board.seen
        PeriodCase._give(board, one, channel)
        board.sif(one, since)
        return board.time_us()

    @staticmethod
    def _not_before(one: oracle.Transducer, begun_us: int, from_us: int, wait_us: int) -> None:
        if begun_us < from_us + wait_us * _RATE:
            fail(
                f"a sample SIF of {one.name} began at {begun_us} us or before, and was due at "
                f"{from_us + wait_us} us"
            )


class ShortPeriod(PeriodCase):
    """Gives sensors two values after one, with periods that only quick links can tell from none."""

    ID = "transducers.period-short"
    EXPECTATION = "Each sample SIF comes a period behind the one before, or later."
    REQUIREMENTS = ("J2A-TRANS-011",)

    def _sensor(self, board: Board, one: oracle.Transducer, period_us: int, odd: int) -> None:
        if period_us != _SHORT_US:
            return
        for us in _SHORTER_US:
            low_us, _ = self._refer(board, one)
            self._period(board, one, us)
            for number in (1, 2):
                self._not_before(one, self._send(board, one, -(number % 2)), low_us, number * us)


class LatePeriod(PeriodCase):
    """Gives sensors values late by some of a period, one and several in a row, and others behind
    them, also where the sensor was disabled meanwhile or several values wait.
    """

    ID = "transducers.period-late"
    EXPECTATION = "Those behind it come when they are due, as if it had not been late."
    REQUIREMENTS = ("J2A-TRANS-011",)

    def _judge(self, board: Board) -> None:
        super()._judge(board)
        for one in board.sensors()[:1]:
            with board.tuned(one):
                board.peer.attempts(partial(self._longer, board, one))

    def _longer(self, board: Board, one: oracle.Transducer) -> None:
        """Be late once by some of a period that is longer than the others."""
        board.write(one, c.TRANSD_ENABLED, b"\1")
        if self._is_slow(board, one, _LATER_US):
            board.peer.link.note(f"the link is too slow for periods of {_LATER_US} us")
        elif not self._late(board, one, _LATE_ONCE, False, _LATER_US):
            fail(f"a sample SIF of {one.name} comes long after it was due", suspect=True)

    def _sensor(self, board: Board, one: oracle.Transducer, period_us: int, odd: int) -> None:
        for number, late in enumerate(_LATE):
            is_disabled = (number + odd) % 2 == 1
            attempt = partial(self._late, board, one, late, is_disabled)
            self._in_time(board, one, period_us, attempt)

    def _late(
        self,
        board: Board,
        one: oracle.Transducer,
        late: tuple[int, int],
        is_disabled: bool,
        us: int,
    ) -> bool:
        tenths, count = late
        low_us, high_us = self._refer(board, one)
        self._period(board, one, us)
        if is_disabled:
            for enabled in (b"\0", b"\1"):
                board.write(one, c.TRANSD_ENABLED, enabled)
        for number in range(1, count + 1):
            is_several = number == count and "queue" in one.attributes
            if is_several:  # they wait, and are due with the next write of PERIOD
                self._period(board, one, _NEVER_US)
                since = board.seen
                self._give(board, one, -1)
                self._give(board, one)
            board.wait_until(high_us + number * us + us * tenths // 10)
            given_us = board.time_us()
            if is_several:
                self._period(board, one, us)
                board.sif(one, since)
                late_us = board.time_us()
            else:
                late_us = self._send(board, one, 0)
            if late_us >= low_us + (number + 1) * us:
                return False  # it may have been late by a period, which delays the next one
        second_us = self._send(board, one, -1)
        third_us = self._send(board, one, 0)
        self._not_before(one, second_us, low_us, (count + 1) * us)
        self._not_before(one, third_us, low_us, (count + 2) * us)
        return second_us < given_us + us * _IN_TIME


class SilentPeriod(PeriodCase):
    """Gives sensors two values after some periods without one, or in which they were disabled."""

    ID = "transducers.period-silence"
    EXPECTATION = "The second one comes a period behind the first one: nothing is caught up with."
    REQUIREMENTS = ("J2A-TRANS-011",)

    def _sensor(self, board: Board, one: oracle.Transducer, period_us: int, odd: int) -> None:
        for tenths, is_disabled in ((21, odd == 0), (45, odd == 1), (25, False)):
            _, high_us = self._refer(board, one)
            self._period(board, one, period_us)
            if is_disabled:
                board.write(one, c.TRANSD_ENABLED, b"\0")
                self._give(board, one)
            board.wait_until(high_us + period_us * tenths // 10)
            if is_disabled:
                board.write(one, c.TRANSD_ENABLED, b"\1")
            given_us = board.time_us()
            self._send(board, one, -1)
            self._not_before(one, self._send(board, one, 0), given_us, period_us)


class WrittenPeriod(PeriodCase):
    """Writes PERIOD and ENABLED in the middle of a period: longer, shorter and the same values; or
    reads all items then, and writes them as they are.
    """

    ID = "transducers.period-written"
    EXPECTATION = "A value is sent when PERIOD, as written last, is over since the SIF before."
    REQUIREMENTS = ("J2A-TRANS-011",)
    _BETWEEN: Final = (
        ((c.TRANSD_PERIOD, 0), (c.TRANSD_PERIOD, 1)),
        ((c.TRANSD_ENABLED, 0), (c.TRANSD_ENABLED, 1)),
        ((c.TRANSD_ENABLED, 1),),
        ((c.TRANSD_ENABLED, 0), (c.TRANSD_PERIOD, 1), (c.TRANSD_ENABLED, 1)),
        ((c.TRANSD_ENABLED, 0), (c.TRANSD_PERIOD, 0), (c.TRANSD_PERIOD, 1), (c.TRANSD_ENABLED, 1)),
    )

    def _sensor(self, board: Board, one: oracle.Transducer, period_us: int, odd: int) -> None:
        changes: tuple[Callable[..., bool], ...] = (
            partial(self._waiting, first=1, then=2),
            partial(self._waiting, first=1, then=1),
            partial(self._waiting, first=_NEVER_US, then=1),
            *(partial(self._between, writes=writes) for writes in self._BETWEEN),
            self._touched,
        )
        for change in changes:
            self._in_time(board, one, period_us, partial(change, board, one))
        if board.has(one, c.TRANSD_TRIGGER):
            board.write(one, c.TRANSD_TRIGGER, bytes(8))  # so that nothing waits

    def _waiting(
        self, board: Board, one: oracle.Transducer, us: int, *, first: int, then: int
    ) -> bool:
        """Write PERIOD, and while a value waits again; both as multiples of a period."""
        begun = self._refer(board, one)
        since = board.seen
        self._period(board, one, min(first * us, _NEVER_US))
        self._give(board, one, -1)
        change = partial(self._period, board, one, then * us)
        return self._in_middle(board, one, us, begun, since, change=change, periods=then)

    def _between(
        self, board: Board, one: oracle.Transducer, us: int, *, writes: Sequence[tuple[int, int]]
    ) -> bool:
        """Write items, PERIOD as 0 or as it was, and then give a value."""
        begun = self._refer(board, one)
        self._period(board, one, us)
        since = board.seen

        def change() -> None:
            for item, value in writes:
                if item == c.TRANSD_PERIOD:
                    self._period(board, one, value * us)
                else:
                    board.write(one, item, bytes((value,)))
            self._give(board, one, -1)

        return self._in_middle(board, one, us, begun, since, change=change)

    def _touched(self, board: Board, one: oracle.Transducer, us: int) -> bool:
        """Touch all items, and then give a value; where that takes long the period is longer."""
        begin_us = board.time_us()
        self._touch(board, one)
        us = max(us, 4 * (board.time_us() - begin_us))
        begun = self._refer(board, one)
        self._period(board, one, us)
        since = board.seen

        def change() -> None:
            self._touch(board, one)
            self._give(board, one, -1)

        return self._in_middle(board, one, us, begun, since, change=change)

    @staticmethod
    def _touch(board: Board, one: oracle.Transducer) -> None:
        """Read each item, and write it as it is; have TRIGGER wait."""
        for item in range(c.TRANSD_TIME + 1):
            if is_readable(board, one, item):
                value = board.read(one, item)
                if is_writable(board, one, item):
                    board.write(one, item, value)
        if board.has(one, c.TRANSD_TRIGGER):
            board.write(one, c.TRANSD_TRIGGER, struct.pack("<Q", _AHEAD_US))


class QueuedPeriod(PeriodCase):
    """Gives sensors with queue more values within a period than a sample SIF holds."""

    ID = "transducers.period-queue"
    EXPECTATION = "The sample SIF with the rest comes a period behind the one before."
    REQUIREMENTS = ("J2A-TRANS-011",)

    def _sensor(self, board: Board, one: oracle.Transducer, period_us: int, odd: int) -> None:
        longest, size = board.peer.longest, board.size(one)
        count = min(int(one.attributes.get("queue", 0)), (longest - 1) // (1 + size))
        if count <= (longest - 2) // (9 + size):
            return
        low_us, _ = self._refer(board, one)
        since = board.seen
        self._period(board, one, period_us)
        board.stimulate(one, *((0, board.value(one)) for _ in range(count)))
        index, payload = board.sif(one, since)
        left = count - len(queued(board, one, payload))
        for number in range(2, 2 + count):
            if not left:
                break
            index, payload = board.sif(one, index + 1)
            self._not_before(one, board.time_us(), low_us, number * period_us)
            left -= len(queued(board, one, payload))


class AmidRequest(PeriodCase):
    """Sends a request in three pieces from before a sample SIF of each sensor is due to behind
    that, cut at another byte each time, also inside escapes.
    """

    ID = "transducers.period-amid-request"
    EXPECTATION = "The sample SIF comes, once, within the request or behind it."
    REQUIREMENTS = ("J2A-TRANS-011",)

    def _judge(self, board: Board) -> None:
        if board.peer.link.byte_s > _PIECE_BYTE_S:
            inform("on a link as slow as this no sample SIF is due within a request")
        for number, one in enumerate(board.sensors()):
            with board.tuned(one):
                board.peer.attempts(partial(self._attempt, board, one, _SHORT_US, number))

    def _sensor(self, board: Board, one: oracle.Transducer, period_us: int, odd: int) -> None:
        _, high_us = self._refer(board, one)
        since = board.seen
        self._period(board, one, period_us)
        self._give(board, one)
        board.wait_until(high_us + period_us - round(_PIECE_S * 1.5e6))
        wire, _ = awkward(board.peer)
        first = 1 + odd % (len(wire) - 2)
        send_paused(
            board.peer, [wire[:first], wire[first : first + 1], wire[first + 1 :]], _PIECE_S
        )
        board.peer.resync()  # whatever the reply is: the machine may have stalled in a pause
        index, _ = board.sif(one, since)
        board.no_sif_yet(one, index + 1, "behind the one that was due")
