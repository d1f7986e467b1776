"""What transducers do at one time, and in one silence of the host (J2A-TRANS)."""

import struct
from contextlib import ExitStack, suppress
from itertools import chain, repeat
from typing import Final

from j2a_spec import constants as c
from j2a_spec import transducers as oracle
from j2a_transports import TransportError

from j2a_conformance._judge import Judged, fail

from ._board import (
    SLACK_US,
    STIMULUS,
    US,
    Board,
    TransducerCase,
    fit,
    measured,
    queued,
    safe,
    settable,
    slots,
    unsafe,
)
from .limits import delay
from .sif import frames

_LIMIT_MS: Final = 120
_STEP_MS: Final = 30  # from the watchdog of one actuator to that of the next one
_LATE_MS: Final = 40
_BEFORE_US: Final = 90_000  # shorter than each watchdog, longer than one may be late
_LEAST_US: Final = 30_000
_SPARE: Final = 2


def _set(board: Board, one: oracle.Transducer, due_us: int, values: list[bytes]) -> None:
    board.write(one, c.TRANSD_SET, b"\0" + US.pack(due_us) + b"".join(values))


def _was_set(board: Board, one: oracle.Transducer, due_us: int, values: list[bytes]) -> None:
    """Fail where channels were not set to values soon after their time."""
    found = slots(board, one, board.read(one, c.TRANSD_SAMPLE))
    for channel, value in enumerate(values):
        time_us, raw = found[channel]
        if raw != value or not due_us <= time_us <= due_us + SLACK_US:
            text = f"channel {channel} of {one.name} is {raw.hex()} since {time_us} us; it was to "
            fail(text + f"be {value.hex()} from {due_us} us on", suspect=time_us > due_us)


class Unheard(TransducerCase):
    """Is silent for longer than the watchdogs of all actuators, each with another limit, where
    sensors are to measure and actuators without a watchdog to be set: once before the first of them
    expires, and once behind the last one.
    """

    ID = "transducers.unheard"
    EXPECTATION = "Each is safe in its time; what others do meanwhile is done, and is no request."
    REQUIREMENTS = ("J2A-TRANS-016", "J2A-TRANS-017", "J2A-TRANS-018")

    def _judge(self, board: Board) -> None:
        guarded = board.actuators("watchdog")
        if not guarded:
            return
        before = [board.read(one, c.TRANSD_WATCHDOG) for one in guarded]
        try:
            with ExitStack() as stack:
                for one in board.sensors("trigger"):
                    stack.enter_context(board.tuned(one))
                for is_behind in (False, True):
                    times = chain((1, 2), repeat(4))  # an emulator may be slower than we are
                    board.peer.attempts(
                        lambda is_behind=is_behind, times=times: self._silence(  # type: ignore[misc]
                            board, is_behind, next(times)
                        )
                    )
        finally:
            with suppress(Judged, TransportError):
                for one, value in zip(guarded, before, strict=True):
                    board.write(one, c.TRANSD_WATCHDOG, value)

    def _silence(self, board: Board, is_behind: bool, times: int) -> None:
        guarded, triggered = board.actuators("watchdog"), board.sensors("trigger")
        free = [one for one in board.actuators() if one not in guarded]
        for one in guarded:
            board.write(one, c.TRANSD_WATCHDOG, bytes(2))
        limits_ms = [_LIMIT_MS + _STEP_MS * number for number in range(len(guarded))]
        begin_us = board.time_us()
        exchange_us = board.time_us() - begin_us
        ahead_us = (limits_ms[-1] + _LATE_MS) * 1000 if is_behind else _BEFORE_US
        ahead_us += _SPARE * exchange_us * (3 * len(guarded) + len(free) + len(triggered))
        if not is_behind:  # what takes longer on a slow link is before each watchdog, too
            limits_ms = [limit_ms + (ahead_us - _BEFORE_US) // 1000 for limit_ms in limits_ms]
        since, due_us = board.seen, board.time_us() + ahead_us
        values = {one.id: [settable(board, one) for _ in range(fit(board, one))] for one in free}
        for one in free:
            _set(board, one, due_us, values[one.id])
        for one in triggered:
            board.write(one, c.TRANSD_TRIGGER, US.pack(due_us))
        for one, limit_ms in zip(guarded, limits_ms, strict=True):
            _set(board, one, 0, [unsafe(board, one)] * fit(board, one))
            if is_behind:
                _set(board, one, due_us, [unsafe(board, one)] * fit(board, one))
            board.write(one, c.TRANSD_WATCHDOG, struct.pack("<H", limit_ms))
        asked_us = board.time_us()
        silent_us = board.time_us()
        end_us = max(due_us, silent_us + (limits_ms[-1] + _LATE_MS) * 1000) + _LEAST_US
        board.peer.silence(times * (end_us - silent_us) / 1e6, "while nothing was asked")
        for one, limit_ms in zip(guarded, limits_ms, strict=True):
            self._is_safe(board, one, limit_ms, asked_us, silent_us)
        board.wait_until(due_us)
        for one in free:
            _was_set(board, one, due_us, values[one.id])
        for one in triggered:
            measured(board, one, since, due_us)

    @staticmethod
    def _is_safe(
        board: Board, one: oracle.Transducer, limit_ms: int, asked_us: int, silent_us: int
    ) -> None:
        found = slots(board, one, board.read(one, c.TRANSD_SAMPLE))
        for channel, (time_us, raw) in enumerate(found):
            what = f"channel {channel} of {one.name}, with a watchdog of {limit_ms} ms,"
            late_us = silent_us + (limit_ms + _LATE_MS) * 1000
            if raw != safe(board, one) or time_us > late_us:
                text = f"is {raw.hex()} since {time_us} us, after a silence from {silent_us} us on"
                fail(f"{what} {text}", suspect=True)
            if time_us < asked_us + limit_ms * 900 - 1000:
                fail(f"{what} was made safe at {time_us} us, and heard at {asked_us} us")


class AtOnce(TransducerCase):
    """Lets samples of all sensors, TRIGGER of those that have it and SET of all actuators become
    due while `delay` keeps the device busy.
    """

    ID = "transducers.at-once"
    EXPECTATION = "Each value is sent, once, and each channel set: none is in the way of another."
    REQUIREMENTS = ("J2A-TRANS-006", "J2A-TRANS-011", "J2A-TRANS-016", "J2A-TRANS-018")
    NEEDS = (*TransducerCase.NEEDS, STIMULUS, "delay")

    def _judge(self, board: Board) -> None:
        with ExitStack() as stack:
            for one in board.sensors():
                stack.enter_context(board.tuned(one))
            for is_triggered in (False, True):
                board.peer.attempts(
                    lambda is_triggered=is_triggered: self._busy(board, is_triggered)  # type: ignore[misc]
                )

    def _busy(self, board: Board, is_triggered: bool) -> None:
        """Have all wait, and be busy until all are due."""
        triggered = board.sensors("trigger") if is_triggered else []
        sensors = [one for one in board.sensors() if one not in triggered]
        begin_us = board.time_us()
        for one in board.sensors():
            board.write(one, c.TRANSD_PERIOD, bytes(4))
        for one in sensors:
            since = board.seen
            board.stimulate(one, (0, board.value(one)))
            board.sif(one, since)
        actuators = [one for one in board.actuators() if not self._is_guarded(board, one)]
        spent_us = board.time_us() - begin_us
        period_us = _LEAST_US + 2 * _SPARE * spent_us
        if period_us > SLACK_US:
            board.peer.link.note("the link is too slow for all to be due at once")
            return
        due_us = board.time_us() + period_us
        for one in sensors:
            board.write(one, c.TRANSD_PERIOD, struct.pack("<I", period_us + spent_us))
        since = board.seen
        given = {one.id: self._give(board, one) for one in sensors}
        for one in triggered:
            board.write(one, c.TRANSD_TRIGGER, US.pack(due_us))
        values = {
            one.id: [settable(board, one) for _ in range(fit(board, one))] for one in actuators
        }
        for one in actuators:
            _set(board, one, due_us, values[one.id])
        busy_us = max(0, due_us - board.time_us()) + spent_us + _LEAST_US
        board.peer.ask(*delay(board.peer, busy_us // 1000))
        for one in sensors:
            self._sent(board, one, since, given[one.id])
        for one in triggered:
            measured(board, one, since, due_us)
        for one in actuators:
            _was_set(board, one, due_us, values[one.id])

    @staticmethod
    def _is_guarded(board: Board, one: oracle.Transducer) -> bool:
        return board.has(one, c.TRANSD_WATCHDOG) and any(board.read(one, c.TRANSD_WATCHDOG))

    @staticmethod
    def _give(board: Board, one: oracle.Transducer) -> list[tuple[int, bytes]]:
        """Give a sensor a value for each channel, or as many as its queue has room for."""
        count = int(one.attributes["queue"]) if "queue" in one.attributes else one.channels
        count = min(count, (board.peer.longest - 1) // (1 + board.size(one)))
        given = [(number % one.channels, board.value(one)) for number in range(count)]
        board.stimulate(one, *given)
        return given

    @staticmethod
    def _sent(
        board: Board, one: oracle.Transducer, since: int, given: list[tuple[int, bytes]]
    ) -> None:
        """Fail where a sensor has not sent its values, or sends more."""
        found: list[tuple[int, bytes]] = []
        index = since
        while len(found) < len(given):
            index, payload = board.sif(one, index)
            index += 1
            if "queue" in one.attributes:
                found += [(channel, value) for channel, _, value in queued(board, one, payload)]
            else:
                entries = enumerate(slots(board, one, payload))
                found = [(channel, value) for channel, (_, value) in entries][: len(given)]
        if found != given:
            fail(f"{one.name} sent {found} instead of {given}")
        board.time_us()
        if one.id in [frame.opcode for frame in frames(board.peer.link.sifs[index:])]:
            fail(f"{one.name} has sent one more sample SIF than it has values")
