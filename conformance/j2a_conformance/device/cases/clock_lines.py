"""How the clock of a device follows its targets (J2A-CLOCK-011 to 020); see `clock`."""

import struct
from itertools import pairwise
from typing import Any, Final

from j2a_spec import constants as c
from j2a_spec import transducers as types

from j2a_conformance._judge import fail

from . import transducers
from .clock import UNIX, Board, ClockCase, S

_HOUR: Final = 3600 * S
_REACHED_US: Final = 2_050_000
_FAST: Final = 2.0


class Steps(ClockCase):
    """Steps the clock forth and back by little and by much, and watches it."""

    ID = "clock.steps"
    EXPECTATION = "The target at once, another epoch, SETTLING; the local time goes on."
    REQUIREMENTS = (
        "J2A-CLOCK-002",
        "J2A-CLOCK-007",
        "J2A-CLOCK-010",
        "J2A-CLOCK-011",
        "J2A-CLOCK-014",
        "J2A-CLOCK-015",
        "J2A-CLOCK-018",
    )

    def _judge(self, board: Board) -> None:
        board.step()
        for by in (1, -1, 1000, -1000, S, -S, _HOUR, -_HOUR):
            before = board.status()
            status = board.step(before.time + by, rate=by % 40_001 - 20_000)
            if status.local - before.local > 60 * S:
                fail("the local time was stepped, too")
            board.wait(20_000)
        board.step(0)
        board.step(2**63 - 1)
        board.step(UNIX)


class Epochs(ClockCase):
    """Steps the clock until each epoch has come."""

    ID = "clock.epochs"
    EXPECTATION = "One more each time; 255 is followed by 1."
    REQUIREMENTS = ("J2A-CLOCK-011",)

    def _judge(self, board: Board) -> None:
        board.step()
        for number in range(257):
            board.adjust(base=UNIX + number, mode=c.CLOCK_STEP)


class Slews(ClockCase):
    """Adjusts the clock by the mode SLEW to targets ahead and behind, and watches it get there."""

    ID = "clock.slews"
    EXPECTATION = "Towards the target at 1000 ppm at most, and there in time; the same epoch."
    REQUIREMENTS = (
        "J2A-CLOCK-007",
        "J2A-CLOCK-010",
        "J2A-CLOCK-011",
        "J2A-CLOCK-012",
        "J2A-CLOCK-013",
        "J2A-CLOCK-014",
        "J2A-CLOCK-015",
        "J2A-CLOCK-018",
    )

    def _judge(self, board: Board) -> None:
        board.step()
        for off in (900, -900):
            board.adjust(off)
            board.wait(20_000)
            self._check_rates(list(board.watch(600_000)))
        for off in (400, -400, 7, -7, 4, -3):
            board.adjust(off, uncertainty=3)
            board.wait(_REACHED_US + 1000 * abs(off))
        board.adjust(300)
        board.wait(200_000)
        board.adjust(-300)
        board.wait(_REACHED_US + 1_000_000)

    @staticmethod
    def _check_rates(readings: list[Any]) -> None:
        """Most readings that tell the same rate in a row must show it."""
        wrong = [
            abs(after.time - before.time - (after.local - before.local) * (1 + after.rate / 1e9))
            > 2 + (after.local - before.local) / 1e6
            for before, after in pairwise(readings)
            if before.rate == after.rate
        ]
        if 2 * sum(wrong) > len(wrong):
            fail(
                f"{sum(wrong)} of {len(wrong)} times the time ran at another rate than the one told"
            )


class Far(ClockCase):
    """Adjusts by the mode SLEW to targets that are far away."""

    ID = "clock.far"
    EXPECTATION = "Towards the target at 1000 ppm at most; the same epoch, SETTLING."
    REQUIREMENTS = ("J2A-CLOCK-012", "J2A-CLOCK-013", "J2A-CLOCK-014", "J2A-CLOCK-015")

    def _judge(self, board: Board) -> None:
        board.step()
        for off in (10_000, -10_000, _HOUR, -_HOUR):
            board.adjust(off)
            board.wait(600_000)
        board.adjust(base=2**63 - 1)
        board.wait(100_000)
        board.step()


class Rates(ClockCase):
    """Gives the clock other rates, at which the target is where it is."""

    ID = "clock.rates"
    EXPECTATION = "The rate of the target, to 1 ppb in the status."
    REQUIREMENTS = ("J2A-CLOCK-012", "J2A-CLOCK-013", "J2A-CLOCK-014", "J2A-CLOCK-018")

    def _judge(self, board: Board) -> None:
        for rate in (1, -1, 100_000, -100_000, c.CLOCK_MAX_RATE, -c.CLOCK_MAX_RATE):
            board.step(rate=rate)
            board.wait(50_000)
        board.step()
        for rate in (-7, 33_333, -c.CLOCK_MAX_RATE):
            board.adjust(rate=rate)
            board.wait(_REACHED_US + 200_000)


class States(ClockCase):
    """Adjusts within and beyond the bounds of LOCKED."""

    ID = "clock.states"
    EXPECTATION = "SETTLING after a step and far from the target, else LOCKED."
    REQUIREMENTS = ("J2A-CLOCK-015", "J2A-CLOCK-017")

    def _judge(self, board: Board) -> None:
        for given in (0, 500, c.CLOCK_UNKNOWN):
            board.step(uncertainty=given)
            board.adjust(uncertainty=given)
            board.wait(_REACHED_US)
            for off in (4, -4, 200, -200, 3000, -3000):
                board.adjust(off, uncertainty=given)
                board.adjust(0, uncertainty=given)


class Uncertainties(ClockCase):
    """Adjusts with several uncertainties and wanders."""

    ID = "clock.uncertainties"
    EXPECTATION = "What was given, and what wander and the distance from the target add."
    REQUIREMENTS = ("J2A-CLOCK-017",)

    def _judge(self, board: Board) -> None:
        for given in (0, 1, 300, 2**31, c.CLOCK_UNKNOWN - 5000, c.CLOCK_UNKNOWN):
            for wander in (0, 1000, c.CLOCK_MAX_RATE):
                board.step(uncertainty=given, wander=wander)
                board.wait(100_000)
        for off in (800, -800):
            board.step(uncertainty=50)
            board.adjust(off, uncertainty=50, wander=100_000)
            board.wait(_REACHED_US)
        board.step(uncertainty=c.CLOCK_UNKNOWN - 100)
        board.adjust(5000, uncertainty=c.CLOCK_UNKNOWN - 100)


class Holdover(ClockCase):
    """Leaves the clock alone for more than 10 s of its local time, and adjusts it again."""

    ID = "clock.holdover"
    EXPECTATION = "HOLDOVER after 10 s, the rate goes on, the uncertainty grows; then LOCKED."
    REQUIREMENTS = ("J2A-CLOCK-015", "J2A-CLOCK-016", "J2A-CLOCK-017")

    def _judge(self, board: Board) -> None:
        link = board.peer.link
        first, at_s = board.status(), link.now_s()
        passed = board.wait(200_000).local - first.local
        if not link.transport.is_simulated and passed / S < _FAST * (link.now_s() - at_s):
            link.note("10 s of this device are too long on a real link")
            return
        board.step(uncertainty=10, wander=40_000)
        board.adjust(rate=-50_000, uncertainty=10, wander=40_000)
        board.wait(9_700_000, 0.1)
        board.wait(1_200_000, 0.1)
        if board.status().state != c.CLOCK_HOLDOVER:
            fail("the state is not HOLDOVER after 10 s")
        board.adjust(rate=-50_000)
        board.wait(100_000)


def _transducers(board: Board) -> transducers.Board | None:
    """Return the transducers of the device, if it has any."""
    if board.peer.announces(c.CAP_TRANSDUCERS) and board.peer.has(c.TRANSD):
        return transducers.Board(board.peer)
    board.peer.link.note("the device has no transducers")
    return None


class TransducerTime(ClockCase):
    """Reads the time of transducers, and lets a sensor and an actuator tell theirs."""

    ID = "clock.transducers"
    EXPECTATION = "TIME, samples and SET are by the time, also after steps; intervals are not."
    REQUIREMENTS = ("J2A-CLOCK-019", "J2A-TRANS-007")

    def _judge(self, board: Board) -> None:
        devices = _transducers(board)
        if devices is None:
            return
        for base in (UNIX, UNIX - _HOUR, UNIX + 5 * _HOUR):
            board.step(base, rate=-70_000)
            self._read(board, devices)
            if actuators := devices.actuators():
                self._set(board, devices, actuators[0])

    @staticmethod
    def _read(board: Board, devices: transducers.Board) -> None:
        for one in devices.all:
            before = board.status().time
            time = int.from_bytes(devices.read(one, c.TRANSD_TIME), "little")
            after = board.status().time
            if not before <= time <= after:
                fail(f"TIME is {time} us, which is not between {before} and {after} us")

    @staticmethod
    def _set(board: Board, devices: transducers.Board, one: types.Transducer) -> None:
        before = board.status().time
        value = transducers.settable(devices, one)
        devices.write(one, c.TRANSD_SET, struct.pack("<BQ", 0, before) + value)
        after = board.status().time
        time = int.from_bytes(devices.read(one, c.TRANSD_SAMPLE)[:8], "little")
        if not before <= time <= after:
            fail(f"{one.name} was set at {time} us, not between {before} and {after} us")


class Waiting(ClockCase):
    """Steps the clock while SET waits for its time."""

    ID = "clock.waiting"
    EXPECTATION = "SET happens at the same instant as without the step."
    REQUIREMENTS = ("J2A-CLOCK-019", "J2A-CLOCK-020")
    _AHEAD_US: Final = 300_000
    _LATE_US: Final = 5 * S  # a busy device

    def _judge(self, board: Board) -> None:
        devices = _transducers(board)
        if devices is None or not (actuators := devices.actuators()):
            return
        for by in (_HOUR, -_HOUR, 100_000, -100_000):
            board.step(UNIX)
            self._wait(board, devices, actuators[0], by)

    def _wait(
        self, board: Board, devices: transducers.Board, one: types.Transducer, by: int
    ) -> None:
        first = board.status()
        due = first.time + self._AHEAD_US
        value = transducers.settable(devices, one)
        unset = devices.read(one, c.TRANSD_SAMPLE)
        devices.write(one, c.TRANSD_SET, struct.pack("<BQ", 0, due) + value)
        before = board.status()
        after = board.step(before.time + by)
        if after.local - first.local >= self._AHEAD_US:
            fail("the time came before the step", suspect=True)
        moved = after.time - before.time - (after.local - before.local)
        for _ in board.watch(self._AHEAD_US + self._LATE_US):
            if (sample := devices.read(one, c.TRANSD_SAMPLE)) != unset:
                break
        else:
            fail(f"SET for {due + moved} us did not happen")
        time = int.from_bytes(sample[:8], "little")
        if not due + moved - 2 <= time <= due + moved + self._LATE_US:
            fail(f"SET for {due + moved} us happened at {time} us")
