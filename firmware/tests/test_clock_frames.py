"""The clock of the core led by USB frames, natively: boards on one bus, and what frames may do."""

import itertools
import random
from pathlib import Path

import pytest
from j2a_spec import constants as c
from j2a_spec.grammar import (
    CLOCK_EXCHANGE,
    CLOCK_FRAME,
    CLOCK_SEEN_FRAME,
    CLOCK_STATUS,
)

from firmware.tests.native_clock import NativeClock, build, run_with_clock

S = 1_000_000
UNIX = 1_700_000_000 * S
STATUS = bytes((c.CLOCK_STATUS,))


# Every period that the first loop may have, by what takes no division and by the division.
EVERY_PERIOD = r"""
#include <stdio.h>
#include "ext/j2a_clock_frames.c"

int main(void) {
    const int32_t most = (int32_t)MAX_OFF;
    int32_t off = -most;
    for (; off <= most; off++) {
        if (as_rate(off) != (int32_t)(((int64_t)off * 1024 + 500) / 1000)) {
            printf("%ld\n", (long)off);
            return 1;
        }
    }
    return 0;
}
"""


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("frames"), frames=True)


def frame_request(time: int, frame: int, uncertainty: int = 7) -> bytes:
    return bytes(CLOCK_FRAME.build({"time": time, "frame": frame, "uncertainty": uncertainty}))


class Bus:
    """A host and its boards: frame n begins at `n * 1000 * (1 + host)` us of true time."""

    def __init__(self, library: Path, ppms: list[float], seed: int, host_ppm: float = 30) -> None:
        self.random = random.Random(seed)  # noqa: S311: a simulation
        self.boards = [NativeClock(library) for _ in ppms]
        self.factors = [1 + ppm * 1e-6 for ppm in ppms]
        self.length = 1000 * (1 + host_ppm * 1e-6)
        self.frame = self.random.randrange(2048)
        self.lost = 0.0

    @property
    def truth(self) -> float:
        return self.frame * self.length

    def next(self, count: int = 1, starts: bool = True) -> None:
        """Let frames pass; each board sees a start with jitter of the bus and of its own."""
        for _ in range(count):
            self.frame += 1
            common = self.truth + self.random.uniform(-0.5, 0.5)
            for board, factor in zip(self.boards, self.factors, strict=True):
                late = self.random.choice((0, 0, 0, 0, 0, 0, 3, 8)) * self.random.random()
                seen = (common + self.random.uniform(0, 0.35) + late) * factor
                board.local = int((self.truth + 300) * factor)
                if starts and self.random.random() >= self.lost:
                    board.see_frame(self.frame, round(seen * 2) / 2)
                board.turn()

    def tell(self, modulo: int = 2048) -> None:
        for board in self.boards:
            code, _ = board.call(frame_request(UNIX + round(self.truth), self.frame % modulo))
            assert code == 0

    def errors(self) -> list[float]:
        """Return the time less the truth of each board at one instant."""
        now = self.truth + 500
        found = []
        for board, factor in zip(self.boards, self.factors, strict=True):
            board.local = int(now * factor)
            found.append(board.time - UNIX - board.local / factor)
        return found


def test_the_rate_of_each_period_is_that_of_a_division(tmp_path: Path) -> None:
    assert run_with_clock(EVERY_PERIOD, tmp_path) == (0, "")


@pytest.mark.requirement("SYNC-004")
@pytest.mark.requirement("SYNC-007")
@pytest.mark.parametrize("modulo", [2048, 1024])
def test_boards_on_a_bus_agree(library: Path, modulo: int) -> None:
    bus = Bus(library, [-100, 40, 100], seed=modulo)
    bus.lost = 0.001
    bus.next(20)
    squares: list[float] = []
    for second in range(25):
        bus.tell(modulo)
        for _ in range(10):
            bus.next(100)
            errors = bus.errors()
            if second >= 10:
                squares.append((max(errors) - min(errors)) ** 2)
                assert max(map(abs, errors)) < 4
    assert (sum(squares) / len(squares)) ** 0.5 < 1.5
    for board in bus.boards:
        status = CLOCK_STATUS.parse(board.call(STATUS)[1])
        assert (status.state, status.epoch) == (c.CLOCK_LOCKED, 1)
        assert status.uncertainty <= 15  # 5 us a second, since the last packet


@pytest.mark.requirement("SYNC-009")
@pytest.mark.parametrize("renumbered", [False, True])
def test_the_time_goes_on_without_frames(library: Path, renumbered: bool) -> None:
    bus = Bus(library, [-80], seed=3)
    (board,) = bus.boards
    bus.next(20)
    for _ in range(15):
        bus.tell()
        bus.next(1000)
    board.lose_frames()
    readings = []
    for _ in range(30):
        bus.next(100, starts=False)
        readings.append((board.local, board.time))
    assert board.call(frame_request(UNIX, 5))[0] == c.CLOCK_BAD_VALUE
    if renumbered:
        bus.frame += 2048 * 3 + 77
        bus.length *= (bus.frame - 2048 * 3 - 77) / bus.frame
    for _ in range(4):
        bus.next(1000)
        readings.append((board.local, board.time))
        bus.tell()
    bus.next(3000)
    assert abs(bus.errors()[0]) < 30
    passed = [(b[0] - a[0], b[1] - a[1]) for a, b in itertools.pairwise(readings)]
    assert all(abs(time - local) <= local * 0.0015 + 2 for local, time in passed)
    assert CLOCK_STATUS.parse(board.call(STATUS)[1]).epoch == 1


@pytest.mark.parametrize(
    ("off", "epoch"), [(1_900_000, 1), (-1_900_000, 1), (2_100_000, 2), (-3600 * S, 2)]
)
def test_frame_steps_only_far_away(library: Path, off: int, epoch: int) -> None:
    bus = Bus(library, [0], seed=4)
    (board,) = bus.boards
    bus.next(5)
    bus.tell()
    bus.next(100)
    request = frame_request(UNIX + round(bus.truth) + off, bus.frame % 2048)
    status = CLOCK_STATUS.parse(board.call(request)[1])
    assert status.epoch == epoch
    assert (abs(status.time - UNIX - bus.truth - off) < 400) == (epoch == 2)


def test_what_frame_refuses(library: Path) -> None:
    bus = Bus(library, [0], seed=5)
    (board,) = bus.boards
    board.local = 5 * S
    assert board.call(frame_request(UNIX, 5))[0] == c.CLOCK_BAD_VALUE
    bus.next(3)
    for time, number in ((UNIX, 2048), (UNIX, 65535), (2**63, 5), (2**64 - 1, 5)):
        assert board.call(frame_request(time, number)) == (c.CLOCK_BAD_VALUE, b"")
    assert CLOCK_STATUS.parse(board.call(STATUS)[1]).state == c.CLOCK_FREE
    assert board.call(frame_request(2**63 - 1, 2047))[0] == 0
    for length in (1, 14, 16):
        assert board.call(frame_request(UNIX, 5)[:length].ljust(length, b"\0"))[0] == 2


def test_exchange_names_the_frame_before_the_request(library: Path) -> None:
    bus = Bus(library, [0], seed=6)
    (board,) = bus.boards
    request = CLOCK_EXCHANGE.build({"nonce": 9})
    board.local = S
    _, payload = board.call(request)
    none = CLOCK_SEEN_FRAME.parse(payload[14:])
    assert (none.frame, none.age) == (c.CLOCK_NO_FRAME, 0)
    for number, age in ((0, 0), (2047, 999), (1024, 65_000)):
        board.local = 50 * S
        board.see_frame(number, board.local - age)
        seen = CLOCK_SEEN_FRAME.parse(board.call(request)[1][14:])
        assert (seen.frame, seen.age) == (number, age)
    board.see_frame(0, board.local + 1500)
    board.interrupt(None, step_us=1600)
    seen = CLOCK_SEEN_FRAME.parse(board.call(request)[1][14:])
    assert (seen.frame, seen.age) == (2046, 500)


def test_a_frame_may_begin_after_the_time_was_read(library: Path) -> None:
    bus = Bus(library, [0], seed=7)
    (board,) = bus.boards
    bus.next(5)
    bus.tell()
    for _ in range(40):
        bus.next(100)
        board.see_frame(bus.frame, board.local + 2)  # an interrupt came in between
        before = board.time
        bus.tell()
        assert abs(board.time - before) < 3
    assert CLOCK_STATUS.parse(board.call(STATUS)[1]).epoch == 1
