"""Samples: what a sensor tells of its values, and keeps while it cannot (J2A-TRANS)."""

import struct
from typing import Final

from j2a_spec import constants as c
from j2a_spec import transducers as oracle

from j2a_conformance._judge import fail

from ._board import (
    MANY,
    STIMULUS,
    WRAP,
    WRAP_US,
    Board,
    TransducerCase,
    check_time,
    queued,
    slots,
    spread,
)
from .sif import check_counter, frames, show

_PERIODS_S: Final = (0.12, 0.06)
_LONG_PERIODS: Final = (1 << 24, 1 << 31, (1 << 32) - 1)  # also for who takes fewer bits
_TURNS: Final = 90  # of three values: more than counters of one byte hold


class Samples(TransducerCase):
    """Gives values to some and to all channels of sensors without a queue."""

    ID = "transducers.samples"
    EXPECTATION = (
        "One SIF with time and newest value of each channel, the same as SAMPLE; the time is that "
        "at which the value was given."
    )
    REQUIREMENTS = ("J2A-TRANS-005", "J2A-TRANS-007", "J2A-TRANS-009", "J2A-TRANS-011")
    NEEDS = (*TransducerCase.NEEDS, STIMULUS)

    def _judge(self, board: Board) -> None:
        for one in board.sensors(queue=False):
            with board.tuned(one):
                self._sensor(board, one)

    @staticmethod
    def _sensor(board: Board, one: oracle.Transducer) -> None:
        now = slots(board, one, board.read(one, c.TRANSD_SAMPLE))
        fit = max(1, (board.peer.longest - 1) // (1 + board.size(one)))
        groups = [[channel] for channel in range(one.channels)]
        groups += [[*range(one.channels)][:fit], [one.channels - 1, 0][:fit], [0, 0][:fit]]
        plain = [[(channel, board.value(one)) for channel in group] for group in groups]
        special = [[(number % one.channels, v)] for number, v in enumerate(board.special(one))]
        for given in (*plain, *special):
            group = [channel for channel, _ in given]
            since, begin_us = board.seen, board.time_us()
            board.stimulate(one, *given)
            end_us = board.time_us()
            index, payload = board.sif(one, since)
            found = slots(board, one, payload)
            for channel, value in dict(given).items():
                time_us, raw = found[channel]
                if raw != value:
                    show(board.peer, board.peer.link.sifs[index])
                    fail(f"channel {channel} of {one.name} is {raw.hex()}, given {value.hex()}")
                check_time(one, time_us, begin_us, end_us)
            for channel in set(range(one.channels)) - set(group):
                if found[channel] != now[channel]:
                    fail(f"channel {channel} of {one.name} has changed, and got no value")
            if board.read(one, c.TRANSD_SAMPLE) != payload:
                fail(f"SAMPLE of {one.name} is not what its SIF was")
            if len(group) == 1:
                board.at_most_one_sif(one, since)
            now = found
        board.no_sif(one, board.seen, "without a new value")
        board.stimulate(one, (one.channels, board.value(one)), (255, board.value(one)))
        if one.channels < 255 and board.read(one, c.TRANSD_SAMPLE) != payload:
            fail(f"a value of a channel that {one.name} does not have has changed its sample")


class Queue(TransducerCase):
    """Gives sensors with a queue one value, as many as fit, and more."""

    ID = "transducers.queue"
    EXPECTATION = (
        "SIFs with the values in their order, and their seqs, too; what did not fit is counted."
    )
    REQUIREMENTS = ("J2A-TRANS-006", "J2A-TRANS-007", "J2A-SIF-001")
    NEEDS = (*TransducerCase.NEEDS, STIMULUS)

    def _judge(self, board: Board) -> None:
        sensors = board.sensors(queue=True)
        lost = [self._fit(board, one) - self._depth(one) for one in sensors]
        begin = board.seen
        for one, size in zip(sensors, lost, strict=True):
            with board.tuned(one):
                self._sensor(board, one)
                # That it wraps is the same for all: shown where a request loses the most values.
                self._wrap(board, one, WRAP if size == max(lost) else MANY)
        check_counter(board.peer, begin)  # these have all lengths up to the longest

    @staticmethod
    def _depth(one: oracle.Transducer) -> int:
        return int(one.attributes["queue"])

    @staticmethod
    def _fit(board: Board, one: oracle.Transducer) -> int:
        """Return how many values one request of the stimulus holds."""
        return (board.peer.longest - 1) // (1 + board.size(one))

    def _sensor(self, board: Board, one: oracle.Transducer) -> None:
        depth, fit = self._depth(one), self._fit(board, one)
        lost = None
        counts = (1, 2, depth - 1, depth, depth + 1, depth + 3, 1, depth + 7, 2)
        for count in (*counts, *counts, *reversed(counts)):
            if not 1 <= count <= fit:
                continue
            channels = [board.rng.randrange(one.channels) for _ in range(count)]
            given = [(channel, board.value(one)) for channel in channels]
            since, begin_us = board.seen, board.time_us()
            board.stimulate(one, *given)
            end_us = board.time_us()
            kept = given[: min(count, depth)]
            found: list[tuple[int, int, bytes]] = []
            index = since
            while len(found) < len(kept):
                index, payload = board.sif(one, index)
                found += queued(board, one, payload)
                index += 1
            if [(channel, value) for channel, _, value in found] != kept:
                show(board.peer, board.peer.link.sifs[index - 1])
                fail(f"{one.name} was given {kept}, and sent {found}")
            for _, time_us, _ in found:
                check_time(one, time_us, begin_us, end_us)
            if sorted(time_us for _, time_us, _ in found) != [t for _, t, _ in found]:
                fail(f"the times of {one.name} go back")
            now = int.from_bytes(payload[:2], "little")
            if lost is not None and (now - lost) % 65536 != count - len(kept):
                fail(f"{one.name} says that {now - lost} values were lost, not {count - len(kept)}")
            if lost is None and count > depth:
                fail(f"{one.name}: no room for one value before")
            lost = now
            board.no_sif(one, board.seen, "without a new value")

    def _wrap(self, board: Board, one: oracle.Transducer, most: int) -> None:
        """Keep values until counters of one byte have wrapped with values waiting, and lose some
        until the number of them is beyond one byte, and where it is quick, beyond `most`.
        """
        depth, fit, lost = self._depth(one), self._fit(board, one), 0
        found: list[tuple[int, int, bytes]]
        for _ in range(_TURNS):
            entries = [(0, board.value(one)) for _ in range(min(depth, 3))]
            since, found, begin_us = board.seen, [], board.time_us()
            board.stimulate(one, *entries)
            while len(found) < len(entries):
                since, payload = board.sif(one, since)
                found += queued(board, one, payload)
                since += 1
            if [(channel, value) for channel, _, value in found] != entries:
                fail(f"{one.name} was given {entries}, and sent {found}")
            for _, time_us, _ in found:
                check_time(one, time_us, begin_us, board.time_us())
        given, begin_us = 0, board.time_us()
        while given <= most:
            since = board.seen
            board.stimulate(one, *((0, board.value(one)) for _ in range(fit)))
            index = since
            kept = 0
            while kept < min(fit, depth):
                index, payload = board.sif(one, index)
                kept += len(queued(board, one, payload))
                index += 1
            now = int.from_bytes(payload[:2], "little")
            if given and (now - lost) % 65536 != fit - kept:
                fail(f"{one.name} says {now} behind {lost}, where {fit - kept} values were lost")
            lost, given = now, given + fit - kept
            rest = (most - given) / max(given, 1)
            if given > MANY and (board.time_us() - begin_us) * rest > WRAP_US:
                return


class Waiting(TransducerCase):
    """Disables sensors whose values wait for the end of the period, and enables those that are."""

    ID = "transducers.waiting"
    EXPECTATION = "What waits is dropped and counts as lost; where ENABLED stays 1, it is sent."
    REQUIREMENTS = ("J2A-TRANS-006", "J2A-TRANS-010")
    NEEDS = (*TransducerCase.NEEDS, STIMULUS)

    def _judge(self, board: Board) -> None:
        queues = board.sensors(queue=True)
        deepest = max((int(one.attributes["queue"]) for one in queues), default=0)
        for one in queues:
            depth = int(one.attributes["queue"])
            with board.tuned(one):
                for count in range(1, min(depth, 5) + 1):
                    self._drop(board, one, count)
                    self._keep(board, one, count)
                self._drop_many(board, one, WRAP if depth == deepest else MANY)
        for one in board.sensors(queue=False):
            with board.tuned(one):
                for channel in spread(one):
                    self._keep_newest(board, one, channel)

    @staticmethod
    def _hold(board: Board, one: oracle.Transducer, *given: tuple[int, bytes]) -> int:
        """Have values wait for the end of a period; return how many SIFs had come before."""
        since = board.seen
        board.stimulate(one, (0, board.value(one)))
        board.sif(one, since)
        board.write(one, c.TRANSD_PERIOD, struct.pack("<I", 0xFFFFFFFF))
        since = board.seen
        for each in given:
            board.stimulate(one, each)
        board.no_sif(one, since, "before the period was over")
        return since

    def _keep(self, board: Board, one: oracle.Transducer, count: int) -> None:
        given = [(number % one.channels, board.value(one)) for number in range(count)]
        since = self._hold(board, one, *given)
        board.write(one, c.TRANSD_ENABLED, b"\1")  # it is
        board.write(one, c.TRANSD_PERIOD, bytes(4))
        found: list[tuple[int, bytes]] = []
        while len(found) < count:
            since, payload = board.sif(one, since)
            found += [(channel, value) for channel, _, value in queued(board, one, payload)]
            since += 1
        if found != given:
            fail(f"{one.name} sent {found} after it was enabled, which it was; {given} waited")

    def _keep_newest(self, board: Board, one: oracle.Transducer, channel: int) -> None:
        value = board.value(one)
        since = self._hold(board, one, (channel, value))
        board.write(one, c.TRANSD_ENABLED, b"\1")  # it is
        board.write(one, c.TRANSD_PERIOD, bytes(4))
        if slots(board, one, board.sif(one, since)[1])[channel][1] != value:
            fail(f"{one.name} has not sent the value that waited when it was enabled, which it was")
        since = self._hold(board, one, (channel, board.value(one)))
        board.write(one, c.TRANSD_ENABLED, b"\0")
        board.write(one, c.TRANSD_ENABLED, b"\1")
        board.write(one, c.TRANSD_PERIOD, bytes(4))
        board.no_sif(one, since, "for a value that waited when it was disabled")

    @staticmethod
    def _drop(board: Board, one: oracle.Transducer, count: int) -> None:
        since = board.seen
        board.stimulate(one, (0, board.value(one)))
        _, payload = board.sif(one, since)
        before = int.from_bytes(payload[:2], "little")
        board.write(one, c.TRANSD_PERIOD, struct.pack("<I", 0xFFFFFFFF))
        since = board.seen
        for number in range(count):
            board.stimulate(one, (number % one.channels, board.value(one)))
        board.no_sif(one, since, "before the period was over")
        board.write(one, c.TRANSD_ENABLED, b"\0")
        board.write(one, c.TRANSD_PERIOD, bytes(4))
        board.write(one, c.TRANSD_ENABLED, b"\1")
        board.no_sif(one, since, "of values that were dropped")
        value = board.value(one)
        board.stimulate(one, (0, value))
        _, payload = board.sif(one, since)
        if [entry[2] for entry in queued(board, one, payload)] != [value]:
            fail(f"{one.name} sent {payload.hex()}, which is not the one value that it has")
        lost = (int.from_bytes(payload[:2], "little") - before) % 65536
        if lost != count:
            fail(f"{one.name} says that {lost} values were lost; {count} were dropped")

    @staticmethod
    def _drop_many(board: Board, one: oracle.Transducer, most: int) -> None:
        """Drop values, as many as fit and sometimes more, until their number is beyond one byte,
        and where it is quick, beyond `most`.
        """
        depth = int(one.attributes["queue"])
        fit = (board.peer.longest - 1) // (1 + board.size(one))
        since = board.seen
        board.stimulate(one, (0, board.value(one)))
        index, payload = board.sif(one, since)
        before = int.from_bytes(payload[:2], "little")
        board.write(one, c.TRANSD_PERIOD, struct.pack("<I", 0xFFFFFFFF))
        number, dropped, due, begin_us = 0, 0, 0, board.time_us()
        while dropped <= most:
            values = [(0, board.value(one))] * (fit if number % 8 == 7 else min(depth, fit))
            board.stimulate(one, *values)
            board.write(one, c.TRANSD_ENABLED, b"\0")
            board.write(one, c.TRANSD_ENABLED, b"\1")
            number, dropped, due = number + 1, dropped + min(depth, fit), due + len(values)
            rest = (most - dropped) / dropped
            if dropped > MANY and (board.time_us() - begin_us) * rest > WRAP_US:
                break
        board.write(one, c.TRANSD_PERIOD, bytes(4))
        board.stimulate(one, (0, board.value(one)))
        _, payload = board.sif(one, index + 1)
        lost = (int.from_bytes(payload[:2], "little") - before) % WRAP
        if lost != due % WRAP:
            fail(f"{one.name} says that {lost} values were lost, but {due} were")


class Period(TransducerCase):
    """Gives sensors a second value directly behind a first one, with a period and without."""

    ID = "transducers.period"
    EXPECTATION = "The second SIF comes when the period is over, with the newest value."
    REQUIREMENTS = ("J2A-TRANS-011",)
    NEEDS = (*TransducerCase.NEEDS, STIMULUS)

    def _judge(self, board: Board) -> None:
        for one in board.sensors():
            with board.tuned(one):
                for number, period_s in enumerate(_PERIODS_S):
                    channel = spread(one)[-number]
                    board.peer.attempts(
                        lambda one=one, period_s=period_s, channel=channel: self._sensor(  # type: ignore[misc]
                            board, one, channel, period_s
                        )
                    )
                for period_us in _LONG_PERIODS:
                    self._long(board, one, period_us)

    @staticmethod
    def _long(board: Board, one: oracle.Transducer, period_us: int) -> None:
        """Give a second value within a period that no case can wait for."""
        for period in (0, period_us):
            board.write(one, c.TRANSD_PERIOD, struct.pack("<I", period))
            since = board.seen
            board.stimulate(one, (0, board.value(one)))
            if not period:
                board.sif(one, since)
        board.no_sif(one, since, f"within a period of {period_us} us")
        board.write(one, c.TRANSD_PERIOD, bytes(4))
        board.sif(one, since)

    @staticmethod
    def _sensor(board: Board, one: oracle.Transducer, channel: int, period_s: float) -> None:
        link = board.peer.link
        board.write(one, c.TRANSD_PERIOD, bytes(4))
        board.peer.settle()  # a value of the attempt before may have waited
        since = board.seen
        board.stimulate(one, (channel, board.value(one)))
        first, _ = board.sif(one, since)
        board.at_most_one_sif(one, since)
        board.write(one, c.TRANSD_PERIOD, struct.pack("<I", round(period_s * 1e6)))
        since, value = board.seen, board.value(one)
        board.stimulate(one, (channel, board.value(one)))
        board.peer.silence(period_s * 0.6, "within the period of a sensor")
        is_late = any(frame.opcode == one.id for frame in frames(link.sifs[since:]))
        board.stimulate(one, (channel, value))
        second, payload = board.sif(one, since)
        passed_s = link.sifs[second].at_s - link.sifs[first].at_s
        if passed_s < period_s * 0.9 - 0.004:
            show(board.peer, link.sifs[second])
            fail(
                f"two sample SIFs of {one.name} came within {passed_s * 1e3:.1f} ms, the "
                f"period is {period_s * 1e3:.0f} ms",
                suspect=True,
            )
        if value not in payload:
            if is_late:  # the suite was, not the device
                second, payload = board.sif(one, second + 1)
            if value not in payload:
                why = f"a sample of {one.name} lacks the newest value {value.hex()}"
                fail(why, suspect=True)
