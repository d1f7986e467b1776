"""What boards say of their frames becomes one line, however many they are and whatever one says."""

import math
import random

import pytest

from j2a.io.host_time import HostTime
from j2a.syncd import usb_bus
from j2a.syncd.history import History, rounds_of
from j2a.syncd.plot import panels_of
from j2a.syncd.usb_bus import Bus

UNIX_US = 1_700_000_000_000_000
EXCHANGES = 4


class Frames:
    """A bus whose frames are 1 ms of a controller that is fast, and the daemon's line of them.

    Attributes:
        now_us: the host's counter.
        ahead: frames that were left out, as by a controller that began anew.
        set_us: by how much the clock of the host was set.
        packets: that were told, as (true time of the frame less the one told, age of the frame).
    """

    def __init__(self, ppm=60.0, seed=1, interval_s=1.0, clock_ppm=0):
        self.now_us = 5e6
        self.ahead = 0
        self.packets = []
        self.random = random.Random(seed)
        self.interval_us = interval_s * 1e6
        self._rate = 1 + ppm * 1e-6
        self.set_us = 0
        rate = 1 + clock_ppm * 1e-6
        host = HostTime(
            lambda: self.now_us, lambda: UNIX_US + round(self.now_us * rate) + self.set_us
        )
        self.bus = Bus("usb bus 1", interval_s, History(), host)

    def frames(self, host_us):
        """Frames since the start, with their part."""
        return host_us * self._rate / 1000 + self.ahead

    def ask(self, board, frames_off=0, slow_us=0.0, age_us=None, modulo=2048):
        sent_us = self.now_us
        there, back = (20 + self.random.expovariate(1 / 60) + slow_us for _ in range(2))
        at = self.frames(sent_us + there)
        self.now_us = came_us = sent_us + there + back
        age = int(at % 1 * 1000 / self._rate) if age_us is None else age_us
        self.bus.add(board, sent_us, came_us, (int(at) + frames_off) % modulo, age)

    def round(self, boards, odd=(), frames_off=0, short=()):
        """Do what the threads do in a round; return what is told, None for nothing."""
        self.now_us += self.bus.until_next_round_s() * 1e6
        _, told = self.bus.packet()
        if told is not None:
            age = (int(self.frames(self.now_us)) - told.frame + 1024) % 2048 - 1024
            number = int(self.frames(self.now_us)) - age
            began_us = (number - self.ahead) * 1000 / self._rate
            self.packets.append((told.time_us - UNIX_US - self.set_us - began_us, age))
        for board in boards:
            for _ in range(EXCHANGES):
                off, modulo = frames_off if board in odd else 0, 1024 if board in short else 2048
                self.ask(board, off, modulo=modulo)
        return told


@pytest.mark.parametrize("boards", [1, 2, 8, 64])
def test_many_boards_are_known_as_well_as_one(boards):
    frames = Frames()
    for _ in range(30):
        frames.round(range(boards))
    errors_us = [abs(error) for error, _ in frames.packets[10:]]
    assert max(errors_us) < 100
    assert frames.bus.facts()["uncertainty_us"] < 100


@pytest.mark.parametrize("ppm", [-150, 60])
@pytest.mark.parametrize("clock_ppm", [-200, 0, 100])
def test_the_rate_is_that_of_frames_to_the_clock(ppm, clock_ppm):
    """As that of a board by a URL is that of its counter to the clock, which NTP may slew."""
    frames = Frames(ppm, clock_ppm=clock_ppm)
    for _ in range(60):
        frames.round([1])
    expected = 1e9 * ((1 + ppm * 1e-6) / (1 + clock_ppm * 1e-6) - 1)
    assert abs(frames.bus.facts()["rate_ppb"] - expected) < 10_000
    told = rounds_of(frames.bus._history.facts(frames.bus.name))[-1]
    assert abs(told.rate_ppb - expected) < 10_000


@pytest.mark.parametrize("boards", [1, 2, 8, 64])
@pytest.mark.parametrize("ppm", [-2000, -100, 0, 100, 2000])
@pytest.mark.requirement("SYNC-004", "SYNC-005")
def test_what_is_told_is_of_a_frame_that_has_begun_from_the_first_packet_on(boards, ppm):
    """A board would take a number that is ahead for that of a frame a second before."""
    for seed in range(20):
        frames = Frames(ppm, seed)
        for _ in range(6):
            frames.round(range(boards))
        ages = [age for _, age in frames.packets]
        assert len(ages) >= 3
        assert all(0 <= age < 500 for age in ages), (seed, ages)


def test_the_allan_deviation_is_that_of_the_controller():
    """Its rate drifts by D a second, so that the deviation is D * tau / sqrt(2)."""
    drift_ppm = 0.02

    class Drifting(Frames):
        def frames(self, host_us):
            return host_us / 1000 * (1 + drift_ppm * 1e-12 * host_us / 2)

    frames = Drifting()
    for _ in range(1500):
        frames.round(["a", "b"])
    rounds = rounds_of(frames.bus._history.facts(frames.bus.name))
    (panel,) = (one for one in panels_of({"bus": rounds}) if "Allan" in one.title)
    slow = [(tau, deviation) for tau, deviation in panel.series["bus"] if tau > 100]
    assert len(slow) >= 3
    for tau, deviation in slow:
        assert deviation == pytest.approx(drift_ppm * tau / math.sqrt(2), rel=0.02)
    # From one round to the next it is the noise of single exchanges that shows.
    assert 5 < panel.series["bus"][0][1] < 100


def test_an_answer_that_came_late_tells_little_and_does_no_harm():
    frames = Frames()
    for number in range(20):
        frames.round([1])
        if number > 3:
            frames.ask(2, slow_us=200_000)
    assert max(abs(error) for error, _ in frames.packets[10:]) < 100


def test_an_age_that_stands_for_more_counts_for_nothing():
    frames = Frames()
    for _ in range(4):
        for _ in range(EXCHANGES):
            frames.ask(1, age_us=65_535)
        frames.now_us += 1e6
        assert frames.bus.packet()[1] is None


@pytest.mark.parametrize("interval_s", [0.01, 0.1, 0.2, 0.3, 0.5, 1.0, 5.0])
def test_boards_of_one_round_are_told_the_same_and_those_of_the_next_one_something_new(interval_s):
    """But for those that ask so late in a round that the packet would be too old."""
    frames, before = Frames(interval_s=interval_s), None
    fresh_us = min(0.3, 0.9 * interval_s) * 1e6
    for _ in range(20):
        frames.now_us += frames.bus.until_next_round_s() * 1e6
        first, began_us = frames.bus.packet(), frames.now_us
        assert first[0] != before
        for part in (0.1, 0.6, 0.99):
            frames.now_us = began_us + part * fresh_us
            assert frames.bus.packet() == first
        before = first[0]
    frames.now_us = began_us + 1.01 * fresh_us
    assert frames.bus.packet()[0] != before


@pytest.mark.parametrize("boards", [1, 3])
@pytest.mark.parametrize("frames", [70, 200, 900])
def test_an_age_that_stands_for_more_speaks_against_nobody(boards, frames):
    """Neither the line nor the board that told it is the worse for it."""
    bus = Frames(ppm=0)
    for _ in range(10):
        bus.round(range(boards))
        for _ in range(EXCHANGES):
            bus.ask("old", frames_off=-frames, age_us=65_535)
    assert not bus.bus.is_odd("old")
    assert not any(bus.bus.is_odd(board) for board in range(boards))
    assert max(abs(error) for error, _ in bus.packets[3:]) < 200


@pytest.mark.parametrize("frames", [0, 1, 30, 64])
def test_an_age_that_is_told_counts(frames):
    bus = Frames(ppm=0)
    for _ in range(10):
        bus.round([])
        for _ in range(EXCHANGES):
            part_us = int((bus.now_us + 20) % 1000)
            bus.ask("old", frames_off=-frames, age_us=1000 * frames + part_us)
    assert bus.packets


@pytest.mark.parametrize("frames_off", [3, -3, 50, 700, 1024])
@pytest.mark.parametrize("odd", [1, 4])
def test_a_board_that_tells_wrong_frames_disturbs_no_other(frames_off, odd):
    frames = Frames()
    for _ in range(4):
        frames.round(range(2, 5))
    for number in range(20):
        frames.round(range(5), odd={odd} if number else set(), frames_off=frames_off)
    assert len(frames.packets) >= 20
    assert max(abs(error) for error, _ in frames.packets[10:]) < 100


def test_a_board_that_tells_any_frames_disturbs_no_other():
    frames = Frames()
    for _ in range(20):
        frames.round(range(1, 4))
        for _ in range(EXCHANGES):
            frames.ask(0, frames.random.randrange(2048), age_us=frames.random.randrange(65_536))
    assert len(frames.packets) >= 17
    assert max(abs(error) for error, _ in frames.packets[10:]) < 100


@pytest.mark.parametrize("boards", [1, 2, 3, 8])
@pytest.mark.parametrize("ahead", [5, 400, 1500])
def test_frames_that_begin_anew_are_found_by_most_boards(boards, ahead):
    frames = Frames()
    for _ in range(10):
        frames.round(range(boards))
    frames.ahead += ahead
    del frames.packets[:]
    for _ in range(12):
        frames.round(range(boards))
    assert max(abs(error) for error, _ in frames.packets[-5:]) < 100


@pytest.mark.parametrize("hours", [1, -1])
def test_after_a_step_the_next_packet_is_right(hours):
    frames = Frames()
    for _ in range(10):
        frames.round(range(3))
    frames.set_us += hours * 3_600_000_000
    del frames.packets[:]
    for _ in range(3):
        frames.round(range(3))
    assert len(frames.packets) == 3
    assert max(abs(error) for error, _ in frames.packets) < 150


@pytest.mark.parametrize("ahead", [0, 3, 900])
def test_after_the_computer_slept_boards_get_its_time_again(ahead):
    """The counter has stood, as the frames have, which may go on with another number."""
    frames = Frames()
    for _ in range(10):
        frames.round(range(3))
    frames.set_us += 8 * 3_600_000_000
    frames.ahead += ahead
    for _ in range(12):
        frames.round(range(3))
    assert max(abs(error) for error, _ in frames.packets[-5:]) < 100


def test_a_board_that_is_gone_has_no_vote():
    frames = Frames()
    for _ in range(5):
        frames.round(range(5))
    for board in range(1, 5):
        frames.bus.forget(board)
    frames.ahead += 300
    for _ in range(12):
        frames.round([0])
    assert max(abs(error) for error, _ in frames.packets[-5:]) < 100


def test_two_boards_that_contradict_each_other_do_not_turn_it_over_and_over():
    frames = Frames()
    for _ in range(5):
        frames.round([0])
    del frames.packets[:]
    for _ in range(20):
        frames.round([0, 1], odd={1}, frames_off=100)
    assert len(frames.packets) == 20
    assert max(abs(error) for error, _ in frames.packets) < 200


def test_the_line_costs_one_fit_a_round_however_many_boards_there_are(monkeypatch):
    frames = Frames()
    for _ in range(5):
        frames.round(range(64))
    taken = frames.bus._clock.estimator.taken
    for _ in range(10):
        frames.round(range(64))
    assert frames.bus._clock.estimator.taken == taken + 10
    assert usb_bus.LEAST <= taken <= usb_bus.LEAST + 5


@pytest.mark.requirement("SYNC-004", "SYNC-005")
@pytest.mark.parametrize("interval_s", [0.3, 1.0, 1.7])
@pytest.mark.parametrize(("boards", "short"), [(1, 1), (2, 2), (8, 8), (2, 1), (3, 1), (8, 3)])
def test_numbers_modulo_1024_are_found_and_serve_as_well(boards, short, interval_s):
    frames = Frames(interval_s=interval_s)
    ids = range(boards)
    for _ in range(40):
        frames.round(ids, short=range(short))
    assert [frames.bus.modulo(one) for one in ids] == [1024] * short + [2048] * (boards - short)
    assert not any(map(frames.bus.is_odd, ids))
    for _ in range(20):
        told = frames.round(ids, short=range(short))
        assert told is not None
        assert told.frame < 1024 or short < boards
        # A board takes it for the latest frame with this number modulo 1024.
        number = int(frames.frames(frames.now_us))
        taken = number - (number - told.frame) % 1024
        began_us = taken * 1000 / frames._rate
        assert abs(told.time_us - UNIX_US - began_us) < 1000


@pytest.mark.parametrize("interval_s", [0.3, 1.0, 1.024, 2.048])
@pytest.mark.parametrize("ahead", [0, 400, 1024])
def test_numbers_modulo_2048_are_never_taken_for_fewer(interval_s, ahead):
    """Also where answers always come in the lower half, and where frames begin anew."""
    for seed in range(10):
        frames = Frames(ppm=0.0, seed=seed, interval_s=interval_s)
        for number in range(60):
            frames.round(range(2))
            if number % 10 == 5:
                frames.ahead += ahead
            assert 1024 not in {frames.bus.modulo(0), frames.bus.modulo(1)}


def test_a_board_that_is_gone_is_forgotten_with_its_numbers():
    frames = Frames()
    for _ in range(10):
        frames.round([1], short=[1])
    assert frames.bus.modulo(1) == 1024
    frames.bus.forget(1)
    assert frames.bus.modulo(1) is None
