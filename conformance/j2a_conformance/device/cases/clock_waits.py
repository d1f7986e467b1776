"""What waits for a time of the clock while adjustments step it (J2A-CLOCK-019, J2A-CLOCK-020)."""

import struct
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from typing import Any, Final

from j2a_spec import constants as c
from j2a_spec import transducers as types

from j2a_conformance._judge import fail
from j2a_conformance.device._clock import UNIX, Board, ClockCase, S

from . import _board as transducers

_HOUR: Final = 3600 * S
_FAR_US: Final = 1 << 40


def transducers_of(board: Board) -> transducers.Board | None:
    """Return the transducers of the device, if it has any."""
    if board.peer.announces(c.CAP_TRANSDUCERS) and board.peer.has(c.TRANSD):
        return transducers.Board(board.peer)
    board.peer.link.note("the device has no transducers")
    return None


class Waits(ClockCase):
    """Has SET of each channel and TRIGGER wait for their time, and the clock stepped meanwhile."""

    _AHEAD_US: Final = 300_000
    _LATE_US: Final = 5 * S  # a busy device

    @staticmethod
    def _set(devices: transducers.Board, due: int) -> list[tuple[types.Transducer, int, bytes]]:
        """Set all channels that fit into a request, of each actuator.

        Returns: the actuator, how many channels these are, and its sample before.
        """
        before = []
        for one in devices.actuators():
            count = transducers.fit(devices, one)
            values = b"".join(transducers.settable(devices, one) for _ in range(count))
            before.append((one, count, devices.read(one, c.TRANSD_SAMPLE)))
            devices.write(one, c.TRANSD_SET, struct.pack("<BQ", 0, due) + values)
        return before

    def _ahead_us(self, board: Board, devices: transducers.Board) -> int:
        """Return how far ahead their time has to be, so that the step comes before it."""
        first = board.status()
        exchange_us = int(board.status().local - first.local)
        exchanges = 2 * len(devices.actuators()) + len(devices.sensors("trigger")) + 4
        return max(self._AHEAD_US, 3 * exchanges * exchange_us)

    def wait(
        self,
        board: Board,
        devices: transducers.Board,
        step: Callable[[], Any],
        left_us: int | None = None,
    ) -> bool:
        """Judge when they happen; return False where their time came before the step.

        Args:
            board, devices: the clock and the transducers of the device.
            step: steps the clock, or leads it elsewhere.
            left_us: so long before their time it does, None: at once.
        """
        ahead_us = self._ahead_us(board, devices)
        first, since = board.status(), devices.seen
        due = first.time + ahead_us
        left = self._set(devices, due)
        triggered = devices.sensors("trigger")
        for sensor in triggered:
            devices.write(sensor, c.TRANSD_TRIGGER, struct.pack("<Q", due))
        before = board.status()
        if left_us is not None:
            board.wait(max(0, int(first.local - before.local) + ahead_us - left_us))
            before = board.status()
        after = step()
        if after.local - first.local >= ahead_us:
            return False
        moved = 0
        if after.epoch != before.epoch:
            moved = after.time - before.time - (after.local - before.local)
        found: list[tuple[str, int]] = []
        for _ in board.watch(ahead_us + self._LATE_US):
            for one, count, unset in [*left]:
                if (sample := devices.read(one, c.TRANSD_SAMPLE)) != unset:
                    newest = transducers.slots(devices, one, sample)[:count]
                    found += ((f"SET of {one.name}", time) for time, _ in newest)
                    left.remove((one, count, unset))
            if not left:
                break
        for one, _, _ in left:
            fail(f"SET of {one.name} for {due + moved} us did not happen")
        for sensor in triggered:
            _, payload = devices.sif(sensor, since)
            times = transducers.times_us(devices, sensor, payload)
            found += ((f"TRIGGER of {sensor.name}", time) for time in times)
        for name, time in found:
            if not due + moved - 2 <= time <= due + moved + self._LATE_US:
                fail(f"{name} for {due + moved} us happened at {time} us")
        return True


class Waiting(Waits):
    """Steps the clock twice while SET of each channel and TRIGGER wait for their time, and once
    shortly before it; leads it to targets that are near and far.
    """

    ID = "clock.waiting"
    EXPECTATION = (
        "They happen at the same instant as without the steps, by the time where there is no step, "
        "and the last time never."
    )
    REQUIREMENTS = ("J2A-CLOCK-019", "J2A-CLOCK-020")
    # Both ways, by little, by more than 32 bits hold, and so that they do not make up for another.
    _STEPS: Final = (
        (_FAR_US, -2 * _HOUR),
        (-_FAR_US, 2 * _HOUR),
        (_HOUR, 100_000),
        (-_HOUR, -100_000),
    )
    _TARGETS_US: Final = (-100_000, -_HOUR, _HOUR)
    _LEFT_US: Final = 60_000
    _TRIES: Final = 4  # a link may be too slow for it, and a machine too busy
    _NEVER: Final = 2**64 - 1

    def _judge(self, board: Board) -> None:
        devices = transducers_of(board)
        if devices is None:
            return
        with ExitStack() as stack:
            for one in devices.sensors("trigger"):
                stack.enter_context(devices.tuned(one))
            steps = [partial(self._step, board, steps) for steps in self._STEPS]
            slews = [partial(board.adjust, off_us) for off_us in self._TARGETS_US]
            for adjust in (*steps, *slews):
                board.step(UNIX)
                if not self.wait(board, devices, adjust):
                    fail("the time came before the adjustment", suspect=True)
            for by in (_HOUR, -_HOUR):
                for _ in range(self._TRIES):
                    board.step(UNIX)
                    if self.wait(board, devices, partial(self._step, board, (by,)), self._LEFT_US):
                        break
                else:
                    board.peer.link.note("each time its time came before the step")
            board.step(UNIX)
            self._never(board, devices)

    @staticmethod
    def _step(board: Board, steps: tuple[int, ...]) -> Any:
        for by in steps:
            status = board.step(board.status().time + by)
        return status

    def _never(self, board: Board, devices: transducers.Board) -> None:
        """Step the clock while what waits is so far ahead that its time cannot be moved."""
        waiting = self._set(devices, self._NEVER)
        since = devices.seen
        for sensor in devices.sensors("trigger"):
            devices.write(sensor, c.TRANSD_TRIGGER, struct.pack("<Q", self._NEVER))
        board.step(UNIX + _HOUR)
        board.wait(50_000)
        for one, _, sample in waiting:
            if devices.read(one, c.TRANSD_SAMPLE) != sample:
                fail(f"SET of {one.name} for {self._NEVER} us happened behind a step")
        for sensor in devices.sensors("trigger"):
            devices.no_sif(sensor, since, "though its trigger was far ahead")
            devices.write(sensor, c.TRANSD_TRIGGER, bytes(8))
        self._set(devices, 0)
