"""The clock of the core led by USB frames against an exact model of them, over wraps and gaps.

Frame n begins at n * 1000 us of true time, by the crystals of the host and of the board alike, and
is seen without a delay. So a board that takes each packet for the frame that it is about is never
off by more than the rounding, whatever happens on the bus; one that takes it for another is off by
1 ms or more.
"""

import itertools
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from j2a_spec import constants as c
from j2a_spec.grammar import CLOCK_FRAME, CLOCK_STATUS

from firmware.tests.native_clock import NativeClock, build

S = 1_000_000
UNIX = 1_700_000_000 * S
FRAME_US = 1000
SHORT = c.CLOCK_FRAME_NUMBERS // 2
STATUS = bytes((c.CLOCK_STATUS,))
# A host sends a packet so long after its frame (SYNC-005).
LATEST = 499
# The local time counts in a register of 28, 31 and 32 bits on its way.
WRAPS_US = (2**28, 2**31, 2**32, 2**33)
# The main loop takes a turn each 30 minutes at least (j2a_clock.h).
MAX_BLOCKED = 1800 * S // FRAME_US


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("model"), frames=True)


class Board:
    """A board, the frames that it sees, and what its clock has to show.

    Args:
        library: of the clock.
        first: number of the first frame.
        local_us: when that begins, of the board's local time.
    """

    def __init__(self, library: Path, first: int = 0, local_us: int = 5 * S) -> None:
        self.clock = NativeClock(library)
        self.first, self.first_us = first, local_us
        self.number = first  # without end, and after a bus reset another one
        self.began_us = local_us
        self.read_us = 0
        self._see()

    def _see(self) -> None:
        self.clock.local = self.began_us + 300
        self.clock.see_frame(self.number, self.began_us)
        self.clock.turn()

    def frames(self, count: int, each: int = 1) -> None:
        """Let frames pass; only the last one of each `each` is seen."""
        self.clock.see_frame(self.number, self.began_us)
        self.clock.pass_frames(count, each)
        self._begun(count * each)

    def lost(self, count: int) -> None:
        """Let frames pass whose starts are lost."""
        self.clock.run(self.began_us + count * FRAME_US + 300)
        self._begun(count)

    def _begun(self, count: int) -> None:
        self.number += count
        self.began_us += count * FRAME_US

    def suspended(self, count: int, renumbered: int) -> None:
        """Let the bus sleep."""
        self.clock.lose_frames()
        self.began_us += count * FRAME_US
        self.clock.run(self.began_us, every=50_000)
        self.number += renumbered
        self._see()

    def told(self, age: int, modulo: int, off_us: int = 0) -> None:
        """Tell the board of a frame that began `age` frames ago."""
        time_us = UNIX + self.began_us - age * FRAME_US + off_us
        frame = (self.number - age) % modulo
        request = CLOCK_FRAME.build({"time": time_us, "frame": frame, "uncertainty": 7})
        assert self.clock.call(request)[0] == 0
        # It waits where it was told of the frame before just now.
        self._begun((self.clock.local - self.began_us) // FRAME_US)

    @property
    def error_us(self) -> int:
        """Time less truth."""
        return self.clock.time - UNIX - self.clock.local

    @property
    def epoch(self) -> int:
        return int(CLOCK_STATUS.parse(self.clock.call(STATUS)[1]).epoch)

    def check(self) -> None:
        assert self.epoch == 1
        assert abs(self.error_us) <= 1
        assert self.clock.time >= self.read_us
        self.read_us = self.clock.time


def near(*values: int) -> st.SearchStrategy[int]:
    """Return numbers near these."""
    return st.builds(int.__add__, st.sampled_from(values), st.integers(-3, 3))


ages = st.integers(0, LATEST) | st.just(0)
packets = st.tuples(st.just(Board.told), ages, st.sampled_from((SHORT, 2 * SHORT)))
passing = st.tuples(st.just(Board.frames), st.integers(1, 3000))
losing = st.tuples(st.just(Board.lost), st.integers(1, 99))
blocks = st.tuples(
    st.just(Board.frames),
    st.just(1),
    near(100, 1000, 2 * SHORT, 4 * SHORT, 268_435, 268_435 - 147, MAX_BLOCKED - 3)
    | st.integers(1, MAX_BLOCKED),
)
idle = st.tuples(st.just(Board.frames), st.integers(1, 6000), st.integers(900, 999))
sleeps = st.tuples(
    st.just(Board.suspended), st.integers(100, 10_000_000), st.integers(0, 2 * SHORT)
)
events = packets | passing | losing | blocks | idle | sleeps
starts_us = near(5 * S, *(wrap - 2 * S for wrap in WRAPS_US), *(wrap - 400 for wrap in WRAPS_US))


@pytest.mark.requirement("SYNC-004")
@pytest.mark.requirement("SYNC-007")
@pytest.mark.requirement("SYNC-009")
@given(
    first=st.integers(0, 2 * SHORT - 1),
    local_us=starts_us,
    packet=packets,
    happens=st.lists(events, max_size=12),
)
def test_each_packet_is_taken_for_its_frame(library, first, local_us, packet, happens) -> None:
    board = Board(library, first, local_us)
    board.frames(LATEST)  # a host tells of frames that it knows
    for what, *how in (packet, *happens):
        what(board, *how)
        board.check()


@pytest.mark.requirement("SYNC-007")
@pytest.mark.parametrize("period_s", [1, 10, 100, 200, 300, 1000, 1800])
@pytest.mark.parametrize("ppm", [-100, 90])
def test_a_board_keeps_the_rate_of_a_host_between_its_packets(library, period_s, ppm) -> None:
    """The clock of the host runs faster than the frames by `ppm`."""
    board = Board(library)
    for told in range(10):
        board.told(0, 2 * SHORT, ppm * period_s * told)
        board.frames(10 * period_s, 99)
        board.frames(10 * period_s)  # without a gap: what is left goes within two seconds
    error_us = board.error_us - ppm * period_s * 10
    assert abs(error_us) <= 2 + period_s / 10  # 0.1 ppm
    assert board.epoch == 1


@pytest.mark.requirement("SYNC-006")
@pytest.mark.parametrize("days", [1, 20, 24, 25, 26, 48, 50])
def test_a_host_that_was_silent_for_weeks_is_followed_again(library, days) -> None:
    """It is off by then, but by less than would be a step."""
    board = Board(library)
    for off_us in (0, 1000):
        for _ in range(10):
            board.told(0, 2 * SHORT, off_us)
            board.frames(10, 100)
        assert abs(board.error_us - off_us) <= 10
        if off_us == 0:
            board.frames(days * 86_400_000 // 960, 960)
    assert board.epoch == 1


def settled(library: Path) -> Board:
    """Return a board that was told ten frames, a second apart."""
    board = Board(library)
    board.frames(3000)
    for _ in range(10):
        board.told(0, 2 * SHORT)
        board.frames(1000)
    return board


@pytest.mark.requirement("SYNC-004")
@pytest.mark.requirement("J2A-CLOCK-012")
@given(age=st.integers(SHORT, 1999))
@example(SHORT)
@example(1999)
def test_one_packet_that_comes_too_late_is_led_away(library, age) -> None:
    """The board takes it for one of a frame that began 1024 ms later."""
    board = settled(library)
    board.told(age, 2 * SHORT)
    errors_us = [0]
    for _ in range(40):
        for _ in range(10):
            board.frames(100)
            errors_us.append(board.error_us)
        board.told(0, 2 * SHORT)
    assert board.epoch == 1
    # 1000 ppm by which the line runs slower then, and as much of correction.
    assert all(abs(b - a) <= 201 for a, b in itertools.pairwise(errors_us))
    assert min(errors_us) < -1000, "it is no frame of before"
    assert abs(errors_us[-1]) <= 10


@pytest.mark.requirement("SYNC-007")
@given(age=st.integers(0, LATEST), newest=st.integers(0, LATEST), off_us=st.integers(-S, S))
@example(0, 0, S)
def test_a_packet_about_a_frame_before_the_last_one_changes_nothing(
    library, age, newest, off_us
) -> None:
    """Neither does the same one twice."""
    board = settled(library)
    board.told(newest, 2 * SHORT)
    board.told(max(age, newest), 2 * SHORT, off_us)
    board.frames(2000)
    board.check()
