"""How the clock of a device follows its targets (J2A-CLOCK-011 to 020); see `clock`."""

import struct
from itertools import pairwise
from typing import Any, Final

from j2a_spec import constants as c
from j2a_spec import transducers as types

from j2a_conformance._judge import fail
from j2a_conformance.device._clock import UNIX, Board, ClockCase, S, frame_request

from . import _board as transducers
from .clock import Values
from .clock_waits import transducers_of
from .sif import frames

_HOUR: Final = 3600 * S
_REACHED_US: Final = 2_050_000
_SHORT_US: Final = 400_000
_HELD_US: Final = 10_900_000  # behind an adjustment it is in HOLDOVER


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

    # One of them is near the time, however long a request is under way.
    _NEAR_US: Final = (2000, 4000, 7000, 10_000, 14_000)

    def _judge(self, board: Board) -> None:
        board.step()
        for by in (1, -1, 1000, -1000, *self._NEAR_US, S, -S, _HOUR, -_HOUR):
            before = board.status()
            status = board.step(before.time + by, rate=by % 40_001 - 20_000)
            if status.local - before.local > 60 * S:
                fail("the local time was stepped, too")
            board.wait(20_000)
        board.step(0)
        board.step(2**63 - 1)
        board.step(UNIX)


class Epochs(ClockCase):
    """Steps the clock until each epoch has come, by much, by little and by nothing, also while it
    is led to a target.
    """

    ID = "clock.epochs"
    EXPECTATION = "One more each time; 255 is followed by 1."
    REQUIREMENTS = ("J2A-CLOCK-011",)

    def _judge(self, board: Board) -> None:
        board.step()
        for number in range(257):
            board.adjust(base=UNIX + number, mode=c.CLOCK_STEP)
        for size in (0, 1, 5, 11, 99, 250, 999, 1001, 30_000, 2 * S):
            for off in (size, -size):
                board.adjust(off, mode=c.CLOCK_STEP)
                board.adjust(off)  # changes no epoch, however far it is
                board.adjust(-off, mode=c.CLOCK_STEP)


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
        for off, rate in (
            *((900, 0), (-900, 0), (900, -20_000), (-900, 20_000), (900, 70_000)),
            *((3000, 0), (-3000, 5_000)),  # at 1000 ppm
            # With the correction beyond the largest rate, and below it.
            *((3000, c.CLOCK_MAX_RATE), (-3000, -c.CLOCK_MAX_RATE)),
            *((900, 9_500_000), (900, -c.CLOCK_MAX_RATE)),
        ):
            board.step(rate=rate)
            self._check_told(board, board.adjust(off, rate=rate), rate)
            self._check_rates(list(board.watch(300_000 if rate else 600_000)))
            self._check_told(board, board.adjust_back(off, rate=rate), rate)
            self._check_told(board, board.status(), rate)
        board.step()
        for off in (400, -400, 7, -7, 18, -18, 4, -3, 2600, -6000):
            board.adjust(
                off,
                uncertainty=c.CLOCK_UNKNOWN if off in (-400, 7) else 3,
                wander=10_000 if off in (-7, 4) else 0,
                rate={-3: -9_000, 4: 9_000}.get(off, 0),
            )
            board.wait(_REACHED_US + 1000 * abs(off), 0.02 if abs(off) < 1000 else 0.1)
            board.again()
        board.adjust(300)
        board.wait(200_000)
        board.adjust(-300)
        board.wait(_REACHED_US + 1_000_000)

    @staticmethod
    def _check_told(board: Board, told: Any, rate: int) -> None:
        """What a reply tells of the rate must show in the time after it, as the correction may
        change a little; `rate` is that of the target.
        """
        later = board.wait(100_000)
        passed = later.local - told.local
        if passed > _SHORT_US:
            board.peer.link.note("the link is too slow to compare the rate of a reply")
            return
        moved, said = later.time - told.time - passed, passed * told.rate / 1e9
        if abs(moved - said) > 10 + abs(moved - passed * rate / 1e9) / 4:
            fail(f"a reply tells {told.rate} ppb, but the time moved by {moved} us in {passed} us")

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
    EXPECTATION = "Towards it at 1000 ppm at most; the same epoch, SETTLING, the uncertainty."
    REQUIREMENTS = (
        "J2A-CLOCK-011",
        "J2A-CLOCK-012",
        "J2A-CLOCK-013",
        "J2A-CLOCK-014",
        "J2A-CLOCK-015",
        "J2A-CLOCK-017",
    )
    _MIDDLE_US: Final = 1 << 62
    _BITS: Final = range(31, 62)  # of distances, up to all that there are

    def _judge(self, board: Board) -> None:
        board.step()
        for off in (10_000, -10_000, 2 * _HOUR, -2 * _HOUR):
            board.adjust(off)
            board.wait(600_000)
        # From the target, and at once from another one.
        for fields in (
            {},
            {"uncertainty": c.CLOCK_UNKNOWN},
            {"rate": -70_000, "wander": 900},
            {"rate": 70_000},
            {"rate": c.CLOCK_MAX_RATE},
            {"rate": -c.CLOCK_MAX_RATE},
        ):
            for off in (20, -20, 2000, -2000, 5000, -5000, 3 * S, -3 * S):
                board.adjust(0, **fields)
                board.adjust(off, **fields)
                board.wait(20_000)
        board.adjust(base=2**63 - 1)
        board.wait(100_000)
        board.step(self._MIDDLE_US)
        for bit in self._BITS:
            for off in (1 << bit, -(1 << bit)):
                board.adjust(off)
                board.wait(20_000)
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


class Ages(ClockCase):
    """Adjusts by targets of earlier local times, as a host does that has thought for a while."""

    ID = "clock.ages"
    EXPECTATION = "The target holds since then, uncertainty and state count from the request on."
    REQUIREMENTS = (
        "J2A-CLOCK-009",
        "J2A-CLOCK-011",
        "J2A-CLOCK-012",
        "J2A-CLOCK-013",
        "J2A-CLOCK-015",
        "J2A-CLOCK-017",
    )
    _AGES_US = (1, 1000, 1_500_000, 12 * S, 25 * S, c.CLOCK_MAX_BEHIND - 2 * S)
    _LED_US: Final = (1_500_000, 12 * S)  # until it is there

    def _judge(self, board: Board) -> None:
        if (now := board.status().local) < 2 * S:
            board.wait(2 * S - now)
        for age_us in self._AGES_US:
            if age_us > board.status().local:
                board.peer.link.note(f"the device has not run for {age_us} us")
                return
            for rate in (0, 9_345_678, -c.CLOCK_MAX_RATE):
                for given, wander in ((0, 0), (300, c.CLOCK_MAX_RATE), (c.CLOCK_UNKNOWN, 1)):
                    fields = {"rate": rate, "uncertainty": given, "wander": wander}
                    board.step(age_us=age_us, **fields)
                    for off in (0, 3000, -3000):
                        board.adjust(off, age_us=age_us, **fields)
                        board.status()
            if age_us in self._LED_US:
                board.step(rate=9_000)
                board.adjust(-300, age_us=age_us, rate=9_000)
                board.wait(_REACHED_US + 300_000)


class States(ClockCase):
    """Adjusts within and beyond the bounds of LOCKED, also just so, with uncertainties of each
    size.
    """

    ID = "clock.states"
    EXPECTATION = "SETTLING after a step and far from the target, else LOCKED."
    REQUIREMENTS = ("J2A-CLOCK-015", "J2A-CLOCK-017")
    _SIZES: Final = (
        *(0, 1, c.CLOCK_SETTLED_US - 1, c.CLOCK_SETTLED_US, c.CLOCK_SETTLED_US + 1),
        *(1 << bit for bit in range(4, 32)),
        *(100, 500, 70_000, c.CLOCK_UNKNOWN - 1, c.CLOCK_UNKNOWN),
    )
    _NEAR_US: Final = (3, 8, 25)  # from the bound: the links differ in what they let see

    def _judge(self, board: Board) -> None:
        for given in (0, 1, 500, c.CLOCK_UNKNOWN):
            board.step(uncertainty=given)
            board.adjust(uncertainty=given)
            board.wait(_REACHED_US)
            for off in (4, -4, 200, -200, 3000, -3000):
                board.adjust(off, uncertainty=given)
                board.adjust(0, uncertainty=given)
        for number, given in enumerate(self._SIZES):
            board.adjust((200, -3000, -200, 3000)[number % 4], uncertainty=given)
            board.adjust(0, uncertainty=given)
            known = 0 if given == c.CLOCK_UNKNOWN else given
            limit = max(c.CLOCK_SETTLED_US, known)
            near = self._NEAR_US[number % len(self._NEAR_US)]
            for off in (limit - near, limit + near):
                # Behind a step the time is at the target, so the distance is known well.
                board.step(uncertainty=0 if number % 2 else c.CLOCK_UNKNOWN - 1)
                board.adjust(off if number // 2 % 2 else -off, uncertainty=given)


class Uncertainties(ClockCase):
    """Adjusts with several uncertainties and wanders."""

    ID = "clock.uncertainties"
    EXPECTATION = "What was given, and what wander and the distance from the target add."
    REQUIREMENTS = ("J2A-CLOCK-017",)

    def _judge(self, board: Board) -> None:
        for given in (0, 1, 300, 2**31, c.CLOCK_UNKNOWN - 500, c.CLOCK_UNKNOWN):
            for wander in (0, 1000, c.CLOCK_MAX_RATE):
                board.step(uncertainty=given, wander=wander)
                board.wait(50_000)
                board.exchange(wander)  # is no adjustment
                board.wait(50_000)
        for off in (800, -800):
            board.step(uncertainty=50)
            board.adjust(off, uncertainty=50, wander=100_000)
            board.wait(_REACHED_US)
        board.step(uncertainty=c.CLOCK_UNKNOWN - 100)
        board.adjust(5000, uncertainty=c.CLOCK_UNKNOWN - 100)


class Holdover(ClockCase):
    """Does not adjust the clock for more than 10 s of its local time, in which there are exchanges
    and requests that are refused, and in which it is at its target, or gets there only when they
    are over; then adjusts it again.
    """

    ID = "clock.holdover"
    EXPECTATION = "HOLDOVER after 10 s, the rate goes on, the uncertainty grows; then as before."
    REQUIREMENTS = (
        "J2A-CLOCK-003",
        "J2A-CLOCK-011",
        "J2A-CLOCK-012",
        "J2A-CLOCK-013",
        "J2A-CLOCK-015",
        "J2A-CLOCK-016",
        "J2A-CLOCK-017",
    )
    _LONGEST_US: Final = 20 * S  # a target that is reached later is not waited for
    # How it is stepped, how it is led from there, and what ends HOLDOVER.
    _ROUNDS: tuple[tuple[dict[str, int], dict[str, int] | None, dict[str, int]], ...] = (
        (
            {"uncertainty": 10, "wander": 40_000},
            {"off_us": 12_000, "rate": -50_000, "uncertainty": 10, "wander": 40_000},
            {"off_us": -2500, "rate": -50_000},
        ),
        (
            {"rate": c.CLOCK_MAX_RATE, "uncertainty": c.CLOCK_UNKNOWN},
            None,
            {"off_us": 3 * S, "uncertainty": 7, "age_us": 10 * S},
        ),
        ({}, {"off_us": 40_000, "wander": 1_000_000}, {"off_us": 0, "rate": 1000}),
        (
            {"rate": -c.CLOCK_MAX_RATE, "wander": c.CLOCK_MAX_RATE},
            {"off_us": -300, "rate": 9, "uncertainty": c.CLOCK_UNKNOWN},
            {"off_us": 2500, "mode": c.CLOCK_STEP},
        ),
        ({"uncertainty": 2**31}, {"off_us": -13_500}, {"off_us": -3600 * S}),
    )

    def _judge(self, board: Board) -> None:
        if not board.is_quick():
            return
        is_simulated = board.peer.link.transport.is_simulated
        rounds = self._ROUNDS[:2] if is_simulated else self._ROUNDS
        for stepped, led, again in rounds:
            board.step(**stepped)
            if led is not None:
                board.adjust(**led)
            board.wait(_HELD_US - 1_200_000, 0.1)
            self._disturb(board)
            board.wait(1_200_000, 0.1)
            if board.status().state != c.CLOCK_HOLDOVER:
                fail("the state is not HOLDOVER after 10 s")
            reached_us = _REACHED_US + 1000 * abs((led or {}).get("off_us", 0))
            if reached_us < self._LONGEST_US:
                board.wait(reached_us - _HELD_US, 0.1)
            board.adjust(**again)
            board.wait(100_000)

    @staticmethod
    def _disturb(board: Board) -> None:
        """Ask for what is no adjustment."""
        for nonce in range(3):
            board.exchange(nonce)
        for mode in (c.CLOCK_SLEW, c.CLOCK_STEP):
            Values.refuse(board, mode)
        board.refuse(b"", c.CLOCK_BAD_LENGTH)
        for item in (c.CLOCK_EXCHANGE, c.CLOCK_STATUS, c.CLOCK_ADJUST):
            board.refuse(bytes((item,)) + bytes(9), c.CLOCK_BAD_LENGTH)
        board.refuse(b"\xff", c.CLOCK_NO_ITEM)
        if board.has_frames:
            board.refuse(frame_request(UNIX, c.CLOCK_FRAME_NUMBERS), c.CLOCK_BAD_VALUE)
        board.status()


class TransducerTime(ClockCase):
    """Reads the time of transducers, and lets sensors and actuators tell theirs, also such as are
    before the local time, and such as fill all of its bytes.
    """

    ID = "clock.transducers"
    EXPECTATION = "TIME, samples, SET and TRIGGER are by the time, also after steps."
    REQUIREMENTS = ("J2A-CLOCK-019", "J2A-TRANS-007", "J2A-TRANS-016", "J2A-TRANS-018")
    _FULL_US: Final = 0x7A69584736251403
    _AHEAD_US: Final = 30_000

    def _judge(self, board: Board) -> None:
        devices = transducers_of(board)
        if devices is None:
            return
        firsts = [one for queue in (False, True) for one in devices.sensors(queue=queue)[:1]]
        if not board.peer.has(transducers.STIMULUS):
            firsts = []
        if (now := board.status().local) < S:
            board.wait(S - now)
        earlier = board.status().local // 2
        for base, rate in (
            (UNIX, -70_000),
            (UNIX - _HOUR, -c.CLOCK_MAX_RATE),  # what is ahead takes longer than in local time
            (UNIX + 5 * _HOUR, c.CLOCK_MAX_RATE),
            (earlier, -c.CLOCK_MAX_RATE),
            (self._FULL_US, -70_000),
        ):
            board.step(base, rate=rate)
            self._read(board, devices)
            for one in devices.actuators():
                self._set(board, devices, one)
            for one in devices.sensors("trigger"):
                with devices.tuned(one):
                    self._trigger(board, devices, one)
            for one in firsts:
                with devices.tuned(one):
                    self._give(board, devices, one)
        board.step()

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
        due = after + TransducerTime._AHEAD_US
        devices.write(one, c.TRANSD_SET, struct.pack("<BQ", 0, due) + value)
        for _ in board.watch(TransducerTime._AHEAD_US + 5 * S):
            last, time = time, int.from_bytes(devices.read(one, c.TRANSD_SAMPLE)[:8], "little")
            if time != last:
                break
        if time < due:
            fail(f"{one.name} was set at {time} us, and not at {due} us")

    @staticmethod
    def _trigger(board: Board, devices: transducers.Board, one: types.Transducer) -> None:
        since, due = devices.seen, board.status().time + TransducerTime._AHEAD_US
        devices.write(one, c.TRANSD_TRIGGER, struct.pack("<Q", due))
        board.wait(TransducerTime._AHEAD_US)
        _, payload = devices.sif(one, since)
        after = board.status().time
        for time in transducers.times_us(devices, one, payload):
            if not due <= time <= after:
                text = f"{one.name} was triggered at {time} us, and not between {due}"
                fail(f"{text} and {after} us")

    @staticmethod
    def _give(board: Board, devices: transducers.Board, one: types.Transducer) -> None:
        before, since = board.status().time, devices.seen
        devices.stimulate(one, (0, devices.value(one)))
        after = board.status().time
        _, payload = devices.sif(one, since)
        times = transducers.times_us(devices, one, payload)[:1]
        if devices.has(one, c.TRANSD_SAMPLE):
            sample = devices.read(one, c.TRANSD_SAMPLE)
            times += transducers.times_us(devices, one, sample)[:1]
        for time in times:
            if not before <= time <= after:
                text = f"a value of {one.name} has the time {time} us, and was given between"
                fail(f"{text} {before} and {after} us")


class Intervals(ClockCase):
    """Steps the clock within the period of each sensor, also to the largest rates, with a longer
    period for a sensor of each kind, and within the watchdogs of actuators; has a longer watchdog
    expire at the largest rate.
    """

    ID = "clock.intervals"
    EXPECTATION = "The sample SIF comes when the period is over, and what is safe is so in time."
    REQUIREMENTS = ("J2A-CLOCK-019",)
    _PERIOD_US: Final = 200_000
    _LIMIT_MS: Final = 200
    _PAUSE_S: Final = 0.02
    _LONGER_US: Final = S  # at the largest rate it would be over 10 ms early

    def _judge(self, board: Board) -> None:
        devices = transducers_of(board)
        if devices is None:
            return
        firsts = [one for queue in (False, True) for one in devices.sensors(queue=queue)[:1]]
        for by, rate in ((_HOUR, 0), (-_HOUR, -c.CLOCK_MAX_RATE)):
            board.step()
            if board.peer.has(transducers.STIMULUS):
                for one in devices.sensors():
                    with devices.tuned(one):
                        self._period(board, devices, one, by, rate)
                        if one in firsts and by > 0:
                            self._period(board, devices, one, by, c.CLOCK_MAX_RATE)
            for one in devices.actuators("watchdog"):
                before = devices.read(one, c.TRANSD_WATCHDOG)
                devices.write(one, c.TRANSD_WATCHDOG, struct.pack("<H", self._LIMIT_MS))
                self._watchdog(board, devices, one, by)
                devices.write(one, c.TRANSD_WATCHDOG, before)
        for one in devices.actuators("watchdog")[:1]:
            before = devices.read(one, c.TRANSD_WATCHDOG)
            self._expire(board, devices, one)
            devices.write(one, c.TRANSD_WATCHDOG, before)
        board.step()

    def _period(
        self,
        board: Board,
        devices: transducers.Board,
        one: types.Transducer,
        by: int,
        rate: int,
    ) -> None:
        is_longer = rate > 0
        period_us = self._LONGER_US if is_longer else self._PERIOD_US
        devices.write(one, c.TRANSD_PERIOD, bytes(4))
        since, begin = devices.seen, board.status().local
        devices.stimulate(one, (0, devices.value(one)))
        first, _ = devices.sif(one, since)  # at once, and not late
        devices.write(one, c.TRANSD_PERIOD, struct.pack("<I", period_us))
        devices.stimulate(one, (0, devices.value(one)))
        status = board.step(board.status().time + by, rate=rate)
        if is_longer:  # then it is asked without pauses, so that little is early enough to be seen
            board.wait(begin + period_us * 9 // 10 - status.local)
        for _ in board.watch(period_us + 5 * S, 0.0 if is_longer else self._PAUSE_S):
            if one.id in [frame.opcode for frame in frames(board.peer.link.sifs[first + 1 :])]:
                break
        else:
            fail(f"no sample SIF of {one.name} came behind a step by {by} us")
        passed = board.status().local - begin
        if passed < period_us:
            fail(f"two SIFs of {one.name} came in {passed} us, its period is {period_us} us")

    def _watchdog(
        self, board: Board, devices: transducers.Board, one: types.Transducer, by: int
    ) -> None:
        safe = transducers.safe(devices, one)
        values = (transducers.settable(devices, one) for _ in range(100))
        value = next((value for value in values if value != safe), safe)
        begun = board.status()  # before it is heard, as it may stand still behind that
        devices.write(one, c.TRANSD_SET, bytes(9) + value)
        board.step(board.status().time + by)
        is_safe = self._newest(devices, one) == safe
        passed_ms = (board.status().local - begun.local) / 1000
        if is_safe and passed_ms < self._LIMIT_MS and value != safe:
            fail(f"{one.name} is safe after {passed_ms} ms, its watchdog is {self._LIMIT_MS} ms")
        board.peer.silence(2.6 * self._LIMIT_MS / 1000, "while nothing was asked")
        if self._newest(devices, one) != safe:
            fail(f"{one.name} was not made safe behind a step by {by} us", suspect=True)

    def _expire(self, board: Board, devices: transducers.Board, one: types.Transducer) -> None:
        """Be silent for longer than a watchdog that is early by 1 % if it is by the time."""
        rate = c.CLOCK_MAX_RATE
        limit_us = 2 * self._LONGER_US
        devices.write(one, c.TRANSD_WATCHDOG, struct.pack("<H", limit_us // 1000))
        board.step(rate=rate)
        for times in (1, 2, 4):  # an emulator may be slower than we are
            begun = board.status()  # before it is heard
            value = transducers.unsafe(devices, one)
            devices.write(one, c.TRANSD_SET, bytes(9) + value)
            board.peer.silence(times * (limit_us / S + 0.1), "while nothing was asked")
            sample = devices.read(one, c.TRANSD_SAMPLE)
            time, raw = transducers.slots(devices, one, sample)[0]
            if raw != value:
                break
        else:
            fail(f"{one.name} was not made safe by its watchdog", suspect=True)
        passed_us = (time - begun.time) * 10**9 // (10**9 + rate)
        if passed_us < limit_us - 1000:
            fail(f"{one.name} is safe after {passed_us} us, its watchdog is of {limit_us} us")

    @staticmethod
    def _newest(devices: transducers.Board, one: types.Transducer) -> bytes:
        return transducers.slots(devices, one, devices.read(one, c.TRANSD_SAMPLE))[0][1]
