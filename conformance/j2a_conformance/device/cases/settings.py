"""Settings of transducers: written, read, and what they decide (J2A-TRANS)."""

import struct
from collections.abc import Sequence

from j2a_spec import constants as c
from j2a_spec import transducers as oracle

from j2a_conformance._judge import fail

from ._board import (
    FORMATS,
    SLACK_US,
    STIMULUS,
    Board,
    TransducerCase,
    slots,
    spread,
)
from ._topics import RIGHT_TOPICS


class Settings(TransducerCase):
    """Writes each setting that there is, many times, and reads it."""

    ID = "transducers.settings"
    EXPECTATION = "The reply to a write and to a read is what was written last; no other changes."
    REQUIREMENTS = ("J2A-TRANS-009", "J2A-TRANS-014")

    def _judge(self, board: Board) -> None:
        for one in board.all:
            items = [item for item in range(1, 7) if board.has(one, item)]
            before = {item: board.read(one, item) for item in items}
            now = dict(before)
            for item in items:
                for value in self._values(board, one, item):
                    board.write(one, item, value)
                    now[item] = value
                    if board.read(one, item) != value:
                        fail(f"item {item} of {one.name} is not what was written")
                for other in items:
                    if board.read(one, other) != now[other]:
                        fail(f"item {other} of {one.name} has changed with item {item}")
            for item, value in before.items():
                board.write(one, item, value)
        self._apart(board)

    @staticmethod
    def _apart(board: Board) -> None:
        """Look whether a setting of one sensor is that of another one, too."""
        sensors = board.sensors()
        before = [board.read(one, c.TRANSD_PERIOD) for one in sensors]
        for number, one in enumerate(sensors):
            board.write(one, c.TRANSD_PERIOD, struct.pack("<I", 1000 + number))
        for number, one in enumerate(sensors):
            if board.read(one, c.TRANSD_PERIOD) != struct.pack("<I", 1000 + number):
                fail(f"the period of {one.name} is that of another sensor")
        for one, value in zip(sensors, before, strict=True):
            board.write(one, c.TRANSD_PERIOD, value)

    @staticmethod
    def _values(board: Board, one: oracle.Transducer, item: int) -> Sequence[bytes]:
        if item == c.TRANSD_ENABLED:
            return (b"\0", b"\1", b"\0")
        if item == c.TRANSD_PERIOD:
            numbers = (0, 1, 255, 256, 0x12ED7D, 1 << 31, 0xFFFFFFFF)
            return [struct.pack("<I", number) for number in numbers]
        if item == c.TRANSD_DECIMATION:
            return [bytes((number,)) for number in (1, 2, 0x7D, 128, 255)]
        if item == c.TRANSD_WATCHDOG:
            return [struct.pack("<H", number) for number in (65535, 0x12ED, 60000, 0)]
        if item == c.TRANSD_TOPIC:
            return RIGHT_TOPICS
        size = board.size(one)
        if board.scalar(one) in FORMATS:
            return [board.packed(one, number) for number in (0.0, 0.5, 1e30, 3.0)]
        most = (1 << 8 * size - (board.scalar(one)[0] == "i")) - 1
        return [number.to_bytes(size, "little") for number in (0, 1, most, most // 3)]


class Untouched(TransducerCase):
    """Reads samples of sensors and actuators that have no value yet."""

    ID = "transducers.untouched"
    EXPECTATION = "The time 0 for each channel that was never given a value or set."
    REQUIREMENTS = ("J2A-TRANS-005", "J2A-TRANS-015")

    def _judge(self, board: Board) -> None:
        if not board.peer.claims.fresh or board.peer.has(STIMULUS):
            board.peer.link.note("other cases may have given values")
        # Where other cases have set the clock back, values may be of an epoch that was ahead.
        has_epochs = board.peer.announces(c.CAP_CLOCK)
        for one in board.all:
            if board.has(one, c.TRANSD_SAMPLE):
                now_us = board.time_us()
                for time_us, _ in slots(board, one, board.read(one, c.TRANSD_SAMPLE)):
                    if time_us > now_us + SLACK_US and not has_epochs:
                        fail(f"a value of {one.name} has the time {time_us}, it is {now_us}")


class Enabled(TransducerCase):
    """Gives values to sensors while they are disabled, and enables them."""

    ID = "transducers.enabled"
    EXPECTATION = "No SIF meanwhile or for them later; SAMPLE has them where there is no queue."
    REQUIREMENTS = ("J2A-TRANS-010", "J2A-TRANS-006")
    NEEDS = (*TransducerCase.NEEDS, STIMULUS)

    def _judge(self, board: Board) -> None:
        for one in board.sensors():
            with board.tuned(one, enabled=b"\0"):
                self._sensor(board, one)

    @staticmethod
    def _sensor(board: Board, one: oracle.Transducer) -> None:
        for channel in (0, *reversed(spread(one))):
            since, value = board.seen, board.value(one)
            board.stimulate(one, (channel, value))
            board.no_sif(one, since, "while it was disabled")
            if "queue" not in one.attributes:
                found = slots(board, one, board.read(one, c.TRANSD_SAMPLE))
                if found[channel][1] != value:
                    fail(f"{one.name}, which was disabled, has not taken a value for SAMPLE")
            board.write(one, c.TRANSD_ENABLED, b"\1")
            board.no_sif(one, since, "of a value from when it was disabled")
            other = board.value(one)
            board.stimulate(one, (channel, other))
            payload = board.sif(one, since)[1]
            if other not in payload or (one.channels == 1 and not payload.endswith(other)):
                fail(f"{one.name} sent {payload.hex()} after it was enabled, given {other.hex()}")
            board.write(one, c.TRANSD_ENABLED, b"\1")  # again, which changes nothing
            board.write(one, c.TRANSD_ENABLED, b"\0")
