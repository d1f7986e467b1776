"""Settings of sensors together: queue, decimation, threshold, period and ENABLED (J2A-TRANS)."""

import struct
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, Final

from j2a_spec import constants as c
from j2a_spec import transducers as oracle

from j2a_conformance._judge import fail

from ._board import (
    Board,
    is_readable,
    is_writable,
    queued,
    slots,
    spread,
)
from .refused import Refused
from .sif import frames, show
from .taken import Taken

_LIMIT: Final = 5
_FILL: Final = (0, 10)
_BEHIND: Final = 60
_HOLD: Final = b"\xff" * 4
_PERIOD_S: Final = 0.12
_ITEMS: Final = range(c.TRANSD_TIME + 1)
_EVERY: Final = 3
_SOME: Final = 12


class Counted(Taken):
    """Gives values to sensors with decimation while they are disabled, up to each place in the
    count, and then to the next one that is due.
    """

    ID = "transducers.counted"
    EXPECTATION = "Every n-th value is taken; those given without ENABLED are counted, too."
    REQUIREMENTS = ("J2A-TRANS-012",)

    def _judge(self, board: Board) -> None:
        for one in board.sensors("decimation"):
            with board.tuned(one):
                for every in (2, 3, 5):
                    for meanwhile in range(1, every + 2):
                        channel = spread(one)[-(meanwhile % 2)]
                        self._count(board, one, channel, every, meanwhile)

    def _count(
        self, board: Board, one: oracle.Transducer, channel: int, every: int, meanwhile: int
    ) -> None:
        board.write(one, c.TRANSD_DECIMATION, bytes((every,)))
        board.write(one, c.TRANSD_ENABLED, b"\0")
        for _ in range(meanwhile):
            board.stimulate(one, (channel, board.value(one)))
        board.write(one, c.TRANSD_ENABLED, b"\1")
        for number in range(meanwhile + 1, meanwhile + every + 1):
            self._give(board, one, channel, board.value(one), number % every == 0)


class EachChannel(Taken):
    """Gives values to each channel of sensors with decimation, in each place in the count, and of
    those with threshold, near to and far from another last value.
    """

    ID = "transducers.each-channel"
    EXPECTATION = "Each channel counts and compares its own values, as the settings say."
    REQUIREMENTS = ("J2A-TRANS-012", "J2A-TRANS-013")

    def _judge(self, board: Board) -> None:
        for one in board.all:
            if one.kind == "sensor" and board.has(one, c.TRANSD_DECIMATION):
                with board.tuned(one):
                    self._count(board, one)
            if one.kind == "sensor" and board.has(one, c.TRANSD_THRESHOLD):
                with board.tuned(one):
                    self._compare(board, one)

    def _count(self, board: Board, one: oracle.Transducer) -> None:
        """Begin the count of each channel elsewhere."""
        board.write(one, c.TRANSD_DECIMATION, bytes((_EVERY,)))
        for number in range(1, 2 * _EVERY):
            for channel in range(one.channels):
                count = number - channel % _EVERY
                if 0 < count <= _EVERY:
                    self._give(board, one, channel, board.value(one), count == _EVERY)

    def _compare(self, board: Board, one: oracle.Transducer) -> None:
        """Have another last value on each channel."""
        last = [20 + channel * 2 * _LIMIT % 60 for channel in range(one.channels)]
        for limit, steps in ((0, (0,)), (_LIMIT, (_LIMIT - 1, 1 - _LIMIT, _LIMIT))):
            board.write(one, c.TRANSD_THRESHOLD, board.packed(one, limit))
            for step in steps:
                for channel, number in enumerate(last):
                    value = board.packed(one, number + step)
                    self._give(board, one, channel, value, due=step in (0, _LIMIT))


def overfilled(
    board: Board,
    one: oracle.Transducer,
    channel: int,
    setting: tuple[int, bytes],
    given: Sequence[bytes],
) -> tuple[list[bytes], int]:
    """Give a sensor more values than its queue holds; return those that it sends, and how many it
    has lost.

    Args:
        board: with the sensor.
        one: the sensor.
        channel: of the values.
        setting: an item that says which of them are due, and its value.
        given: the values; the first one is sent before that is written.
    """
    since = board.seen
    board.stimulate(one, (channel, given[0]))
    index, payload = board.sif(one, since)
    before = int.from_bytes(payload[:2], "little")
    board.write(one, c.TRANSD_PERIOD, _HOLD)
    board.write(one, *setting)
    for value in given[1:]:
        board.stimulate(one, (channel, value))
    board.write(one, c.TRANSD_PERIOD, bytes(4))
    found: list[bytes] = []
    while len(found) < int(one.attributes["queue"]):
        index, payload = board.sif(one, index + 1)
        found += [value for _, _, value in queued(board, one, payload)]
    return found, (int.from_bytes(payload[:2], "little") - before) % 65536


class FullThreshold(Taken):
    """Gives sensors with queue and threshold one value more than fits, and then values that differ
    from that one, or from the last one in the queue, by less.
    """

    ID = "transducers.threshold-full"
    EXPECTATION = "The one that did not fit was taken and is counted; others differ from it."
    REQUIREMENTS = ("J2A-TRANS-006", "J2A-TRANS-013")

    def _judge(self, board: Board) -> None:
        for one in board.sensors("threshold", queue=True):
            for channel in spread(one):
                with board.tuned(one):
                    self._full(board, one, channel)

    def _full(self, board: Board, one: oracle.Transducer, channel: int) -> None:
        depth = int(one.attributes["queue"])
        values = [board.packed(one, _FILL[number % 2]) for number in range(depth)]
        behind = board.packed(one, _BEHIND)
        near = board.packed(one, _BEHIND + _LIMIT - 1)  # not taken, so not lost
        setting = c.TRANSD_THRESHOLD, board.packed(one, _LIMIT)
        given = (behind, *values, behind, near)
        found, lost = overfilled(board, one, channel, setting, given)
        if found != values:
            fail(f"{one.name} was given {values}, and sent {found}")
        if lost != 1:
            fail(f"{one.name} says that {lost} values were lost, where one did not fit")
        last = _FILL[(depth - 1) % 2]
        for number in (_BEHIND - _LIMIT + 1, _BEHIND + _LIMIT - 1, _BEHIND):
            self._give(board, one, channel, board.packed(one, number), due=False)
        self._give(board, one, channel, board.packed(one, last), due=True)


class FullDecimation(Taken):
    """Gives sensors with queue and decimation more values than fit, of which every n-th is due."""

    ID = "transducers.decimation-full"
    EXPECTATION = "The due ones that did not fit are lost, and no others."
    REQUIREMENTS = ("J2A-TRANS-006", "J2A-TRANS-012")

    def _judge(self, board: Board) -> None:
        for one in board.sensors("decimation", queue=True):
            for channel in spread(one):
                with board.tuned(one):
                    self._full(board, one, channel)

    @staticmethod
    def _full(board: Board, one: oracle.Transducer, channel: int) -> None:
        depth = int(one.attributes["queue"])
        values = [board.value(one) for _ in range((depth + 2) * _EVERY - 1)]
        due = values[_EVERY - 1 :: _EVERY]
        setting = c.TRANSD_DECIMATION, bytes((_EVERY,))
        found, lost = overfilled(board, one, channel, setting, (board.value(one), *values))
        if found != due[:depth]:
            fail(f"{one.name} sent {found} of every {_EVERY} of {values}")
        if lost != len(due) - depth:
            fail(f"{one.name} says that {lost} values were lost, where {len(due) - depth} were")


class NoThreshold(Taken):
    """Gives each value twice to sensors with the threshold 0: ends of the range, na and others."""

    ID = "transducers.threshold-0"
    EXPECTATION = "Each of them is taken: it differs from the last one by 0."
    REQUIREMENTS = ("J2A-TRANS-013",)

    def _judge(self, board: Board) -> None:
        for one in board.sensors("threshold"):
            with board.tuned(one):
                for channel in spread(one):
                    for value in self._values(board, one):
                        for _ in range(2):
                            self._give(board, one, channel, value, due=True)

    @staticmethod
    def _values(board: Board, one: oracle.Transducer) -> Iterator[bytes]:
        numbers: tuple[Any, ...] = (0.0, 1.5, -1e30, float("inf"))
        if board.scalar(one)[0] in "ui":
            most = 1 << 8 * board.size(one)
            numbers = (0, 1, most // 2 - 1, most // 2, most - 1)
        yield from (board.packed(one, number) for number in numbers)
        if (na := one.attributes.get("na", "none")) != "none":
            yield board.packed(one, oracle.raw(one, na, board.descriptors.definitions))


class KeptPeriod(Taken):
    """Writes settings of sensors within their period, and gives them a value then."""

    ID = "transducers.period-kept"
    EXPECTATION = "The next SIF comes when the period since the last one is over, with the value."
    REQUIREMENTS = ("J2A-TRANS-011",)

    def _judge(self, board: Board) -> None:
        period = struct.pack("<I", round(_PERIOD_S * 1e6))
        disturbed: tuple[tuple[tuple[int, bytes], ...], ...] = (
            ((c.TRANSD_ENABLED, b"\0"), (c.TRANSD_ENABLED, b"\1")),
            ((c.TRANSD_PERIOD, _HOLD), (c.TRANSD_PERIOD, period)),
            ((c.TRANSD_DECIMATION, b"\1"),),
            ((c.TRANSD_TOPIC, b"other"),),
        )
        for one in board.sensors():
            topic = board.read(one, c.TRANSD_TOPIC) if board.has(one, c.TRANSD_TOPIC) else b""
            for writes in disturbed:
                if all(board.has(one, item) for item, _ in writes):
                    with board.tuned(one):
                        board.peer.attempts(
                            lambda one=one, writes=((c.TRANSD_PERIOD, period), *writes): (  # type: ignore[misc]
                                self._sensor(board, one, writes)
                            )
                        )
            if topic:
                board.write(one, c.TRANSD_TOPIC, topic)

    @staticmethod
    def _sensor(
        board: Board, one: oracle.Transducer, writes: tuple[tuple[int, bytes], ...]
    ) -> None:
        link, channel = board.peer.link, one.channels - 1
        board.write(one, c.TRANSD_ENABLED, b"\1")  # the attempt before may have ended at 0
        board.write(one, c.TRANSD_PERIOD, bytes(4))  # so that the first SIF is not late
        since = board.seen
        board.stimulate(one, (channel, board.value(one)))
        first, _ = board.sif(one, since)
        for item, value in writes:
            board.write(one, item, value)
        value = board.value(one)
        board.stimulate(one, (channel, value))
        second, payload = board.sif(one, first + 1)
        passed_s = link.sifs[second].at_s - link.sifs[first].at_s
        if passed_s < _PERIOD_S * 0.9 - 0.004:
            show(board.peer, link.sifs[second])
            fail(
                f"two sample SIFs of {one.name} came within {passed_s * 1e3:.1f} ms, the period "
                f"is {_PERIOD_S * 1e3:.0f} ms",
                suspect=True,
            )
        if "queue" in one.attributes:
            found = queued(board, one, payload)[-1][2]
        else:
            found = slots(board, one, payload)[channel][1]
        if found != value:
            fail(f"{one.name} sent {found.hex()}, given {value.hex()}", suspect=True)
        board.time_us()
        ids = [frame.opcode for frame in frames(link.sifs[since:])]
        if ids.count(one.id) != 2:
            fail(f"{one.name} has sent {ids.count(one.id)} samples for two values", suspect=True)


def refused(board: Board, one: oracle.Transducer) -> Iterator[list[tuple[bytes, int]]]:
    """Yield requests about a transducer that it refuses, with their codes, an item at a time."""
    known = {other.id for other in board.all}
    strange = next(number for number in range(255, -1, -1) if number not in known)
    yield [
        (b"", c.TRANSD_BAD_LENGTH),
        (bytes((one.id,)), c.TRANSD_BAD_LENGTH),
        (bytes((strange, c.TRANSD_ENABLED, 0)), c.TRANSD_NO_ID),
        (bytes((one.id, 255, 0)), c.TRANSD_NO_ITEM),
    ]
    for item in _ITEMS:
        if item == c.TRANSD_SAVE:
            continue
        begin = bytes((one.id, item))
        if not is_writable(board, one, item):
            yield [(begin + bytes(length), c.TRANSD_NO_ITEM) for length in (1, 8)]
            continue
        lengths = range(1, board.peer.longest - 1)
        wrong = [length for length in lengths if not Refused.fits(board, one, item, length)]
        values = [*Refused.wrong(board, one, item)]
        chosen = [*values[: _SOME // 2], *values[_SOME // 2 :: max(1, len(values) // _SOME)]]
        yield [
            *((begin + bytes(length), c.TRANSD_BAD_LENGTH) for length in (*wrong[:2], *wrong[-1:])),
            *((begin + value, c.TRANSD_BAD_VALUE) for value in chosen),
            *([] if is_readable(board, one, item) else [(begin, c.TRANSD_NO_ITEM)]),
        ]


class _Meanwhile(Taken):
    """Has values wait for the end of the period, and asks for something meanwhile."""

    def _wait(
        self, board: Board, one: oracle.Transducer, what: str, ask: Callable[[], None]
    ) -> None:
        has_queue = "queue" in one.attributes
        since = board.seen
        board.stimulate(one, (0, board.value(one)))
        index, payload = board.sif(one, since)
        lost = payload[:2]
        board.write(one, c.TRANSD_PERIOD, _HOLD)
        fit = (board.peer.longest - 1) // (1 + board.size(one))
        count = min(fit, int(one.attributes["queue"]) if has_queue else one.channels)
        given = [(number % one.channels, board.value(one)) for number in range(count)]
        board.stimulate(one, *given)
        ask()
        board.write(one, c.TRANSD_PERIOD, bytes(4))
        found: list[tuple[int, bytes]] = []
        while len(found) < count:
            index, payload = board.sif(one, index + 1)
            if not has_queue:
                entries = enumerate(slots(board, one, payload))
                found = [(channel, value) for channel, (_, value) in entries][:count]
                continue
            found += [(channel, value) for channel, _, value in queued(board, one, payload)]
            if payload[:2] != lost:
                fail(f"{one.name} says that values were lost, where {what} while they waited")
        if found != given:
            show(board.peer, board.peer.link.sifs[index])
            fail(f"{one.name} sent {found} instead of {given}, where {what} while they waited")


class RefusedMeanwhile(_Meanwhile):
    """Asks sensors for what they refuse, while values wait for the end of the period, and between
    values of which decimation and threshold leave some out.
    """

    ID = "transducers.refused-meanwhile"
    EXPECTATION = "What waits is sent, none is lost; counts and the value taken last stay."
    REQUIREMENTS = ("J2A-TRANS-008",)

    def _judge(self, board: Board) -> None:
        for one in board.sensors():
            with board.tuned(one):
                groups = list(refused(board, one))
                every = [request for some in groups for request in some]
                for some in groups:
                    text = f"a2jTransd refused {some[-1][0].hex()}"
                    self._wait(board, one, text, partial(self._refuse, board, some))
                if board.has(one, c.TRANSD_DECIMATION):
                    self._count(board, one, every)
                if board.has(one, c.TRANSD_THRESHOLD):
                    self._compare(board, one, every)

    @staticmethod
    def _refuse(board: Board, requests: list[tuple[bytes, int]]) -> None:
        for payload, code in requests:
            board.exchange(payload, code)

    def _count(
        self, board: Board, one: oracle.Transducer, requests: list[tuple[bytes, int]]
    ) -> None:
        board.write(one, c.TRANSD_DECIMATION, bytes((_EVERY,)))
        for number in range(1, 2 * _EVERY + 1):
            for channel in spread(one):
                self._give(board, one, channel, board.value(one), number % _EVERY == 0)
            self._refuse(board, requests)
        board.write(one, c.TRANSD_DECIMATION, b"\1")

    def _compare(
        self, board: Board, one: oracle.Transducer, requests: list[tuple[bytes, int]]
    ) -> None:
        for channel in spread(one):
            board.write(one, c.TRANSD_THRESHOLD, bytes(board.size(one)))
            self._give(board, one, channel, board.packed(one, _BEHIND), due=True)
            board.write(one, c.TRANSD_THRESHOLD, board.packed(one, _LIMIT))
            self._refuse(board, requests)
            for number, is_due in ((_LIMIT - 1, False), (1 - _LIMIT, False), (_LIMIT, True)):
                value = board.packed(one, _BEHIND + number)
                self._give(board, one, channel, value, due=is_due)


class ReadMeanwhile(_Meanwhile):
    """Reads each item of sensors while values wait for the end of the period."""

    ID = "transducers.read-meanwhile"
    EXPECTATION = "Once the period is over the values are sent, and none is lost."
    REQUIREMENTS = ("J2A-TRANS-011",)

    def _judge(self, board: Board) -> None:
        for one in board.sensors():
            with board.tuned(one):
                for item in _ITEMS:
                    if is_readable(board, one, item):
                        text = f"item {item} was read"
                        self._wait(board, one, text, partial(self._read, board, one, item))

    @staticmethod
    def _read(board: Board, one: oracle.Transducer, item: int) -> None:
        for _ in range(2):
            board.read(one, item)
