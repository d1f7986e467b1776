"""How far boards are behind what they are told: the firmware itself is measured by the bench."""

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


def test_a_slew_is_followed_late_and_then_forgotten():
    told = Told()
    for _ in range(20):
        told.after(1.0)
    lags_us = [told.after(1.0, 500e-6) for _ in range(20)]
    assert lags_us[0] == pytest.approx(500, abs=5)
    assert max(lags_us) < 1000
    assert lags_us[-1] < 15


def test_what_is_too_little_for_a_step_is_made_up_for_at_1000_ppm():
    told = Told()
    for _ in range(20):
        told.after(1.0)
    first_us = told.after(1.0, set_us=250_000)
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
