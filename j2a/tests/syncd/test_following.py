"""How far boards are behind what they are told: the firmware itself is measured by the bench."""

import random

import pytest

from j2a.protocol.clock import Frame
from j2a.syncd.following import Following

UNIX_US = 1_700_000_000_000_000


class Told:
    """Boards that are told a time of a host whose clock the test slews and sets."""

    def __init__(self):
        self.following = Following()
        self.now_us = self.unix_us = 0.0

    def after(self, seconds, rate=0.0, set_us=0):
        self.now_us += seconds * 1e6
        self.unix_us += seconds * 1e6 * (1 + rate) + set_us
        frame = int(self.now_us // 1000)
        began_us = self.unix_us - (self.now_us - 1000 * frame) * (1 + rate)
        packet = Frame(UNIX_US + round(began_us), frame % 2048, 50)
        self.following.tell(packet, self.now_us)
        return self.following.lag_us


@pytest.mark.parametrize("rate", [0.0, 40e-6, -80e-6])
@pytest.mark.parametrize("gap_s", [0.05, 0.3, 1.0, 5.0, 61.0])
def test_boards_that_are_told_one_line_are_on_it(rate, gap_s):
    told = Told()
    lags_us = [told.after(gap_s, rate) for _ in range(30)]
    assert max(lags_us[-10:]) < 2


@pytest.mark.parametrize("rate", [500e-6, -500e-6])
def test_a_slew_is_followed_late_and_then_forgotten(rate):
    told = Told()
    for _ in range(20):
        told.after(1.0)
    lags_us = [told.after(1.0, rate) for _ in range(20)]
    assert lags_us[0] == pytest.approx(500, abs=5)
    assert max(lags_us) < 1000
    assert lags_us[-1] < 15


@pytest.mark.parametrize("set_us", [250_000, -250_000])
def test_what_is_too_little_for_a_step_is_made_up_for_at_1000_ppm(set_us):
    told = Told()
    for _ in range(20):
        told.after(1.0)
    first_us = told.after(1.0, set_us=set_us)
    assert first_us == pytest.approx(250_000, abs=10)
    for _ in range(100):
        told.after(1.0)
    # At 1 ms a second; a board takes it for a rate at first, which is to be made up for, too.
    assert told.following.lag_us > 120_000
    for _ in range(400):
        told.after(1.0)
    assert told.following.lag_us < 5


@pytest.mark.parametrize("set_us", [3_600_000_000, -3_600_000_000, 2_000_000])
def test_a_step_leaves_nothing_to_make_up_for(set_us):
    told = Told()
    for _ in range(20):
        told.after(1.0)
    assert told.after(1.0, set_us=set_us) == 0
    assert max(told.after(1.0) for _ in range(5)) < 2


def test_one_packet_twice_changes_nothing():
    told = Told()
    for _ in range(20):
        told.after(1.0)
    before_us = told.after(1.0, set_us=300)
    assert told.after(0.0) == before_us


@pytest.mark.parametrize("set_us", [250_000, -250_000])
@pytest.mark.parametrize("numbers", [0.25, 0.5, 1, 2, 3, 29])
@pytest.mark.parametrize("off_ms", [-1.4, -0.4, -0.1, 0, 0.1, 0.4, 1.4])
def test_a_gap_of_any_length_is_told_by_the_numbers_of_frames(set_us, numbers, off_ms):
    """A frame number begins anew each 2.048 s, a little before or behind what the counter says."""
    gap_s = 2.048 * numbers + off_ms / 1000
    for phase in range(10):
        told = Told()
        told.after(1 + phase / 10_000)
        for _ in range(12):
            told.after(gap_s)
        assert told.following.lag_us < 2
        assert told.after(gap_s, set_us=set_us) == pytest.approx(250_000, abs=10)
        # No step, behind which there would be nothing to make up for.
        assert 249_000 - 2000 * gap_s < told.after(gap_s) < 500_000


@pytest.mark.parametrize("seed", range(20))
def test_boards_are_as_far_behind_in_either_direction(seed):
    there, back = Told(), Told()
    drawn = random.Random(seed)
    for _ in range(100):
        gap_s = drawn.choice([0.05, 0.3, 1.0, 2.0, 5.0])
        rate, set_us = drawn.uniform(-1e-3, 1e-3), drawn.choice([0, 0, 0, 70, 3000, -90_000])
        one_us, other_us = there.after(gap_s, rate, set_us), back.after(gap_s, -rate, -set_us)
        assert one_us == pytest.approx(other_us, abs=20)
