"""The time of the host, what it tells boards, and the frames of a USB bus."""

import random
import struct
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from j2a_spec import constants as c
from j2a_spec import grammar
from j2a_spec.clock import Clock

from j2a.errors import ProtocolError
from j2a.protocol.clock import (
    Adjust,
    BusClock,
    ClockState,
    Discipline,
    Exchange,
    Frame,
    ReferenceClock,
    Status,
    Verdict,
    pack_exchange,
    unpack_exchange,
    unpack_status,
)
from j2a.tests.library import simulated_clock as sim
from j2a.tests.library.simulated_clock import US, Board

EPOCH_US = 1_700_000_000_000_000


class Host:
    """A host that disciplines one board; its clock runs off its counter as NTP makes it."""

    def __init__(self, board: Board) -> None:
        self.board = board
        self.reference = ReferenceClock()
        self.discipline = Discipline(self.reference)
        self.rate = 0.0
        self._unix = (board.host_us, EPOCH_US)
        self.told: list[Adjust] = []

    def unix_us(self) -> float:
        at, unix = self._unix
        passed = self.board.host_us - at
        return unix + passed * (1 + self.rate)

    def set_clock(self, step_us: float = 0.0, rate: float | None = None) -> None:
        self._unix = self.board.host_us, self.unix_us() + step_us
        self.rate = self.rate if rate is None else rate

    def round(self) -> Verdict:
        """Make an exchange, and tell the board what follows from it."""
        verdict = self.discipline.add(self.board.exchange())
        self.reference.observe(self.board.host_us, round(self.unix_us()))
        if self.discipline.status is None:
            self.discipline.take_status(self.board.status())
        adjust = self.discipline.next_adjust(self.board.host_us)
        if adjust is not None:
            self.told.append(adjust)
            self.discipline.take_status(self.board.adjust(adjust), adjust)
        return verdict

    def run(self, seconds: float) -> list[tuple[float, float]]:
        """Keep the board right for so long; return errors of its clock, and of `to_local`."""
        errors = []
        end = self.board.host_us + seconds * US
        while self.board.host_us < end:
            self.round()
            pause = self.discipline.delay_s(1.0) * US
            for _ in range(10):
                self.board.run(pause / 10)
                self.reference.observe(self.board.host_us, round(self.unix_us()))
                if self.discipline.is_outdated:
                    self.round()
                local = self.discipline.to_local(round(self.board.time_us))
                errors.append((self.board.time_us - self.unix_us(), local - self.board.counter_us))
        return errors


def test_a_board_is_stepped_once_and_then_follows() -> None:
    for seed in range(5):
        board = Board(random.Random(seed), wander_ppm=0.01, ppm=80)
        host = Host(board)
        host.run(30)
        errors = host.run(60)
        assert max(abs(one) for one, _ in errors) < 60
        assert max(abs(one) for _, one in errors) < 10
        assert not any(one.is_step for one in host.told)  # the first one steps by itself
        assert board.state is ClockState.LOCKED
        assert (board.epoch, board.jumps_back, host.discipline.steps) == (1, 0, 1)


@pytest.mark.parametrize("step_s", [-3600, 3600, 1, -1])
def test_a_step_of_the_host_is_told_as_a_step(step_s: float) -> None:
    board = Board(random.Random(1))
    host = Host(board)
    host.run(30)
    host.set_clock(step_s * US)
    host.run(2.5)
    assert host.reference.steps == 1
    assert host.reference.last_step_us == pytest.approx(step_s * US, abs=200)
    assert board.epoch == 2
    assert max(abs(one) for one, _ in host.run(10)) < 60


@pytest.mark.requirement("J2A-CLOCK-027")
@pytest.mark.parametrize("back_s", [0.002, 0.5, 4, 3600])
def test_a_time_that_came_twice_is_doubted_for_a_while(back_s: float) -> None:
    """Time stamps from before a step back may still be on their way."""
    board = Board(random.Random(1))
    host = Host(board)
    host.run(30)
    host.set_clock(-back_s * US)
    host.reference.observe(board.host_us, round(host.unix_us()))
    before_us = board.time_us
    host.round()
    assert board.epoch == 2
    stamps = (before_us - back_s * US / 2, before_us)
    for passed_s in (0, 0.01, 2, 3):
        host.run(passed_s)
        for stamp_us in stamps:
            assert not host.discipline.is_of_epoch(stamp_us, board.counter_us + 20)
        is_new = board.time_us > before_us + 100
        assert host.discipline.is_of_epoch(board.time_us, board.counter_us + 20) is is_new
    host.run(4)
    assert host.discipline.is_of_epoch(board.time_us, board.counter_us + 20)
    assert not host.discipline.is_of_epoch(board.time_us + 90, board.counter_us + 20)


@pytest.mark.requirement("J2A-CLOCK-028")
@pytest.mark.parametrize("step_s", [-3600, 3600, 1, -1, 0.002])
def test_a_step_while_an_adjustment_is_on_its_way_is_told_as_a_step(step_s: float) -> None:
    """What the board answers was calculated from the clock as it was before."""
    board = Board(random.Random(1))
    host = Host(board)
    host.run(30)
    adjust = host.discipline.next_adjust(board.host_us)
    assert adjust is not None
    status = board.adjust(adjust)
    host.set_clock(step_s * US)
    host.reference.observe(board.host_us, round(host.unix_us()))
    host.discipline.take_status(status, adjust)
    assert host.discipline.is_outdated
    host.round()
    assert host.told[-1].is_step
    assert board.epoch == 2
    assert max(abs(one) for one, _ in host.run(10)) < 60
    assert not any(one.is_step for one in host.told[-5:])


@pytest.mark.parametrize("step_s", [-3600, 3600, 1, -1, 0.002])
def test_a_step_that_no_reply_came_to_is_told_again(step_s: float) -> None:
    host = Host(Board(random.Random(1)))
    host.run(60)
    host.set_clock(step_s * US)
    host.discipline.add(host.board.exchange())
    host.reference.observe(host.board.host_us, round(host.unix_us()))
    lost = host.discipline.next_adjust(host.board.host_us)
    assert lost is not None
    assert lost.is_step
    host.round()
    assert host.told[-1].is_step


def test_a_slew_of_500_ppm_is_followed_without_a_step() -> None:
    board = Board(random.Random(2))
    host = Host(board)
    host.run(30)
    for rate in (500e-6, 0.0, -500e-6, 0.0):
        host.set_clock(rate=rate)
        assert max(abs(one) for one, _ in host.run(20)) < 150  # it is seen after 0.1 s
        assert max(abs(one) for one, _ in host.run(20)) < 60
    assert (host.reference.steps, board.epoch, board.jumps_back) == (0, 1, 0)


def test_a_board_that_begins_anew_is_set_anew() -> None:
    board = Board(random.Random(3))
    host = Host(board)
    host.run(30)
    board.reset()
    assert host.round() is Verdict.RESTARTED
    assert host.told[-1].local_us > board.counter_us
    host.run(20)
    assert board.epoch == 1
    assert max(abs(one) for one, _ in host.run(10)) < 60


def test_a_first_error_is_slewed_while_times_are_told_right() -> None:
    """While the board slews, `to_local` knows where its clock is."""
    board = Board(random.Random(4))
    host = Host(board)
    host.run(20)
    board.time_us += 3000  # set by somebody else
    host.round()
    errors = host.run(6)
    assert max(abs(one) for _, one in errors) < 10
    assert abs(errors[-1][0]) < 60
    assert board.epoch == 1


@pytest.mark.requirement("J2A-CLOCK-028")
@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize(("off_s", "steps"), [(0.5, 0), (1.99, 0), (2.01, 1), (3600, 1)])
def test_a_clock_that_another_host_has_set(off_s: float, sign: int, steps: int) -> None:
    """It is slewed, unless it is so wrong that this would take more than half an hour."""
    board = Board(random.Random(7))
    Host(board).run(20)
    host = Host(board)
    host.set_clock(board.time_us - host.unix_us() + sign * off_s * US)
    errors = host.run(10)
    assert [one.is_step for one in host.told].count(True) == steps
    assert (board.epoch, board.jumps_back) == (1 + steps, 0)
    slewed_us = off_s * US * (1 - steps) - 9 * US / 1000
    assert abs(errors[-1][0]) == pytest.approx(max(slewed_us, 0), abs=2000)
    assert host.reference.steps == 0


@pytest.mark.parametrize("off_us", [20_000, -20_000])
def test_a_time_stamp_from_before_the_last_adjustment(off_us: int) -> None:
    """It was made while the board slewed otherwise; the lines of that time are kept."""
    board = Board(random.Random(8))
    host = Host(board)
    host.run(20)
    board.time_us += off_us  # by somebody else; 20 s of slewing
    host.round()
    stamps = []
    for _ in range(40):
        host.run(1)
        stamps.append((round(board.time_us), board.counter_us))
    assert len({one.rate_ppb for one in host.told[-30:]}) > 1
    for time_us, counter_us in stamps:
        assert abs(host.discipline.to_local(time_us) - counter_us) < 10
    host.set_clock(3600 * US)
    host.run(3)
    assert board.epoch == 2
    assert len(host.discipline._lines) < 10


@pytest.mark.parametrize("rate", [20_000_001, -20_000_001, -(10**9), 2**31 - 1, -(2**31)])
def test_a_rate_that_no_clock_has_is_no_status(rate: int) -> None:
    with pytest.raises(ProtocolError, match="no clock runs"):
        unpack_status(status_of_rate(rate))
    for right in (20_000_000, -20_000_000, 0):
        assert unpack_status(status_of_rate(right)).rate_ppb == right


def status_of_rate(rate: int) -> bytes:
    return struct.pack("<QQBBiI", 5, 6, c.CLOCK_LOCKED, 1, rate, 7)


def test_waiting_grows_from_a_burst_to_the_period() -> None:
    board = Board(random.Random(5))
    discipline = Discipline(ReferenceClock())
    assert discipline.delay_s(2.0) == 0.05
    delays = []
    for _ in range(16):
        discipline.add(board.exchange())
        delays.append(discipline.delay_s(2.0))
        board.run(50_000)
    assert delays[:8] == [0.05] * 8
    assert delays[8:] == [0.1, 0.2, 0.4, 0.8, 1.6, 2.0, 2.0, 2.0]
    discipline.reset()
    assert discipline.delay_s(2.0) == 0.05


# ---------------------------------------------------------------------------- the host's clock


def test_the_host_is_followed_through_noise_and_slews() -> None:
    draw = random.Random(6)
    reference, unix = ReferenceClock(), float(EPOCH_US)
    for second in range(400):
        rate = 500e-6 if 100 <= second < 200 else -20e-6
        unix += 0.25 * US * (1 + rate)
        at = (second + 1) * 0.25 * US
        assert not reference.observe(at, round(unix + draw.gauss(0, 0.5)))
        if second % 100 > 10:
            assert reference.rate == pytest.approx(rate, abs=5e-6)
            assert reference.to_unix(at + US) == pytest.approx(unix + US * (1 + rate), abs=6)
        assert reference.to_counter(reference.to_unix(at)) == pytest.approx(at, abs=1)
    assert reference.steps == 0


@pytest.mark.parametrize(("step_us", "steps"), [(900, 0), (-900, 0), (1200, 1), (-1200, 1)])
def test_1_ms_is_a_step(step_us: int, steps: int) -> None:
    reference = ReferenceClock()
    for second in range(20):
        reference.observe(second * 0.1 * US, round(EPOCH_US + second * 0.1 * US))
    assert reference.observe(2 * US, round(EPOCH_US + 2 * US + step_us)) is bool(steps)
    assert reference.steps == steps
    assert reference.to_unix(2 * US) == EPOCH_US + 2 * US + step_us


@pytest.mark.requirement("J2A-CLOCK-028")
@pytest.mark.parametrize("idle_s", [0.1, 60, 300, 86_400])
@pytest.mark.parametrize("off_us", [1000, -1000, 200_000, -200_000])
def test_a_step_after_any_idle_time_is_one_where_the_system_tells_it(
    idle_s: float, off_us: int
) -> None:
    """A clock that is slewed, but never set, tells a step from a slew."""
    for is_set in (True, False):
        reference, at = ReferenceClock(), 0.0
        for _ in range(20):
            reference.observe(at, EPOCH_US + round(at), round(at))
            at += 0.1 * US
        at += idle_s * US
        unix_us = EPOCH_US + round(at) + off_us
        told = reference.observe(at, unix_us, round(at) + (0 if is_set else off_us))
        assert told is is_set
        assert reference.steps == is_set
        if is_set:
            assert reference.last_step_us == off_us
        assert reference.to_unix(at) == unix_us


@pytest.mark.parametrize("idle_s", [10, 300])
@pytest.mark.parametrize("tells", [True, False])
def test_what_happened_in_an_idle_time_tells_nothing_of_the_rate(idle_s: int, tells: bool) -> None:
    reference, at = ReferenceClock(), 0.0
    gained = -20e-6
    for _ in range(40):
        slewed = round(at * (1 + gained))
        reference.observe(at, EPOCH_US + slewed, slewed if tells else None)
        at += 0.1 * US
    assert reference.rate == pytest.approx(gained, abs=5e-6)
    at += idle_s * US
    later_us = round(at * (1 + gained)) + idle_s * 500
    for number in range(40):
        passed = number * 0.01 * US
        slewed = later_us + round(passed * (1 + gained))
        reference.observe(at + passed, EPOCH_US + slewed, slewed if tells else None)
        assert reference.rate == pytest.approx(gained, abs=25e-6)
    assert reference.steps == 0


# ---------------------------------------------------------------------------- one USB bus


def usb_exchange(board: Board, first_us: float, period_us: float, number: int = 0) -> Exchange:
    """Make an exchange whose request arrives in a frame of a bus."""
    there, back = board.delays(board.draw)
    sent = board.host_us
    board.run(there)
    since = (board.host_us - first_us) / period_us
    frame, age = int(since), (since - int(since)) * period_us
    received = int(board.counter_us)
    board.run(back)
    return Exchange(
        sent, board.host_us, received, 0, frame=(frame + number) % 2048, age_us=int(age)
    )


@pytest.mark.parametrize("ppm", [-500, 0, 500])
@pytest.mark.parametrize("seed", range(3))
def test_the_frames_of_a_bus_are_one_line_for_all_boards(ppm: float, seed: int) -> None:
    draw = random.Random(seed)
    reference = ReferenceClock()
    bus, period, begin = BusClock(reference), 1000 * (1 + ppm * 1e-6), draw.uniform(0, 1e6)
    board = Board(draw, sim.serial, host_us=5e6)
    inside = count = 0
    for _ in range(240):
        reference.observe(board.host_us, EPOCH_US + round(board.host_us))
        bus.add(usb_exchange(board, begin, period, 77))
        board.run(draw.uniform(1e3, 5e5))
        told = bus.frame_at(board.host_us)
        assert told is not None
        passed = int((board.host_us - begin) / period)
        late = (passed + 77 - told.frame + 1024) % 2048 - 1024
        truth = EPOCH_US + begin + (passed - late) * period
        assert abs(late) <= (1 if count > 3 else 2)
        assert told.uncertainty_us is not None
        inside += abs(told.time_us - truth) <= told.uncertainty_us
        count += 1
    assert inside / count >= 0.997
    assert bus.estimator.restarts == 0


def test_a_bus_that_was_reset_begins_anew() -> None:
    board = Board(random.Random(8), sim.serial)
    reference = ReferenceClock()
    reference.observe(0.0, EPOCH_US)
    bus = BusClock(reference)
    for _ in range(30):
        bus.add(usb_exchange(board, 0.0, 1000.0))
        board.run(3e5)
    verdicts = []
    for _ in range(10):
        verdicts.append(bus.add(usb_exchange(board, 437_250.0, 1000.0, 5)))
        board.run(3e5)
    assert verdicts[:2] == [Verdict.DOUBTED, Verdict.RESTARTED]
    assert set(verdicts[2:]) == {Verdict.TAKEN}
    told = bus.frame_at(board.host_us)
    assert told is not None
    number = int((board.host_us - 437_250.0) / 1000)
    assert told.frame in ((number + 5) % 2048, (number + 4) % 2048)


@pytest.mark.parametrize("idle_s", [0.3, 1.5, 5.0])
def test_a_bus_knows_its_frames_behind_an_exchange_that_was_doubted(idle_s: float) -> None:
    board = Board(random.Random(8), sim.serial)
    bus = BusClock(ReferenceClock())
    for _ in range(30):
        bus.add(usb_exchange(board, 0.0, 1000.0))
        board.run(3e5)
    assert bus.add(usb_exchange(board, 0.0, 1000.0, 500)) is Verdict.DOUBTED
    board.run(idle_s * US)
    assert bus.add(usb_exchange(board, 0.0, 1000.0)) is Verdict.TAKEN
    told = bus.frame_at(board.host_us)
    assert told is not None
    assert (int(board.host_us / 1000) - told.frame) % 2048 <= 1


def test_an_exchange_without_a_frame_tells_nothing_of_the_bus() -> None:
    bus = BusClock(ReferenceClock())
    assert bus.add(Exchange(0.0, 100.0, 5)) is Verdict.ABSURD
    assert bus.frame_at(1e6) is None


# ---------------------------------------------------------------------------- bytes


def test_an_exchange_is_told_by_its_nonce() -> None:
    assert pack_exchange(0x01020304) == bytes.fromhex("00 04030201")
    reply = bytes.fromhex("04030201 0807060504030201 2200")
    assert unpack_exchange(reply, 0x01020304, 1.0, 2.0, (12, 25)) == Exchange(
        1.0, 2.0, 0x0102030405060708, 0x22, 12, 25
    )
    with pytest.raises(ProtocolError, match="nonce"):
        unpack_exchange(reply, 0x01020305, 1.0, 2.0)
    with pytest.raises(ProtocolError, match="exchange"):
        unpack_exchange(reply[:-1], 0x01020304, 1.0, 2.0)


@pytest.mark.parametrize(
    ("tail", "frame", "age_us"),
    [("ff07 0300", 2047, 3), ("ffff 0000", None, 0), ("0008 0100", None, 0), ("0100", None, 0)],
)
def test_an_exchange_may_tell_its_usb_frame(tail: str, frame: int | None, age_us: int) -> None:
    reply = bytes.fromhex("01000000 0200000000000000 0300" + tail)
    found = unpack_exchange(reply, 1, 0.0, 9.0)
    assert (found.frame, found.age_us) == (frame, age_us)


def test_a_status_is_read() -> None:
    reply = bytes.fromhex("0100000000000000 0200000000000000 02 07 ffffffff ffffffff")
    assert unpack_status(reply) == Status(1, 2, ClockState.LOCKED, 7, -1, None)
    with pytest.raises(ProtocolError, match="state 9"):
        unpack_status(reply[:16] + b"\x09" + reply[17:])
    with pytest.raises(ProtocolError):
        unpack_status(reply[:-1])


def test_what_is_told_is_packed_and_cut_to_its_fields() -> None:
    assert Adjust(True, 1, 2, -3, 4, 5).pack() == bytes.fromhex(
        "02 01 0100000000000000 0200000000000000 fdffffff 04000000 05000000"
    )
    huge = Adjust(False, -1, 1 << 64, 10**12, None, 10**12).pack()
    assert huge == bytes.fromhex(
        "02 00 ffffffffffffffff 0000000000000000 80969800" + "ffffffff 80969800"
    )
    frame = Frame(0x0102030405060708, 0x0201, 9)
    assert frame.pack() == bytes.fromhex("03 0807060504030201 0102 09000000")
    assert frame.packet() == bytes.fromhex("0807060504030201 0102")


@given(
    st.builds(
        Adjust,
        st.booleans(),
        st.integers(0, 2**64 - 1),
        st.integers(0, 2**63 - 1),
        st.integers(-(10**10), 10**10),
        st.none() | st.integers(0, 2**40),
        st.integers(0, 2**40),
    )
)
def test_an_adjustment_is_one_of_the_grammar(adjust: Adjust) -> None:
    parsed = grammar.CLOCK_ADJUST.parse(adjust.pack())
    assert (parsed.mode, parsed.local, parsed.time) == (
        adjust.is_step,
        adjust.local_us,
        adjust.time_us,
    )
    assert parsed.rate == max(-c.CLOCK_MAX_RATE, min(adjust.rate_ppb, c.CLOCK_MAX_RATE))
    unknown = c.CLOCK_UNKNOWN
    assert parsed.uncertainty == min(
        unknown if adjust.uncertainty_us is None else adjust.uncertainty_us, unknown
    )
    oracle = Clock()
    assert oracle.code(adjust.pack(), adjust.local_us + 5) == 0


@given(st.integers(0, 2**63 - 1), st.integers(0, 2047), st.none() | st.integers(0, 2**40))
def test_a_frame_is_one_of_the_grammar(time_us: int, number: int, bound: int | None) -> None:
    frame = Frame(time_us, number, bound)
    parsed = grammar.CLOCK_FRAME.parse(frame.pack())
    assert (parsed.time, parsed.frame) == (time_us, number)
    assert frame.packet() == frame.pack()[1:11]


def test_what_the_oracle_bounds_is_read_as_it_was_meant() -> None:
    """A device that keeps section 23 is where `to_time` says, while it slews and after that."""
    told = Adjust(False, 10_000_000, EPOCH_US + 5_000_000, 20_000, 10, 100)
    oracle, discipline = Clock(), Discipline(ReferenceClock())
    assert oracle.code(Adjust(True, 5_000_000, EPOCH_US, 0, 10, 100).pack(), 5_000_000) == 0
    assert oracle.code(told.pack(), 10_000_300) == 0
    for local in range(10_005_300, 14_000_000, 97_000):
        bounds = oracle.bounds(local)
        # In the middle of what a device may do: it is at the target, which it has not left far.
        status = Status(local, bounds.time[0], ClockState.LOCKED, 1, bounds.rate[0], None)
        discipline.take_status(status, told)
        assert discipline.to_time(local) == bounds.time[0]
        assert discipline.to_local(bounds.time[0]) == pytest.approx(local, abs=1)
        later = oracle.bounds(local + 500_000)
        assert later.time[0] - 1000 <= discipline.to_time(local + 500_000) <= later.time[1] + 1000


def test_a_board_told_by_frames_is_read_by_its_status_alone() -> None:
    board = Board(random.Random(9), ppm=20)
    host = Host(board)
    host.run(20)
    status = board.status()
    frames = Status(status.local_us, status.time_us - 700, ClockState.LOCKED, 1, 50_000, 30)
    host.discipline.take_status(frames)
    later = status.local_us + 1_000_000
    assert host.discipline.to_time(later) == pytest.approx(frames.time_us + 1_000_050, abs=1)
    assert host.discipline.to_local(frames.time_us + 1_000_050) == pytest.approx(later, abs=1)


@pytest.mark.requirement("J2A-CLOCK-026")
@pytest.mark.parametrize("what", ["doubted", "slow", "contradicts itself", "says that it is over"])
def test_a_received_time_before_one_that_was_not_used_is_a_reset(what: str) -> None:
    board = Board(random.Random(4))
    discipline = Discipline(ReferenceClock())
    for _ in range(12):
        board.run(0.05 * US)
        assert discipline.add(board.exchange()) is Verdict.TAKEN
    ahead = board.exchange()
    changes = {
        "doubted": {"received_us": ahead.received_us + 5_000_000},
        "slow": {"sent_us": ahead.sent_us - 1.1 * US},
        "contradicts itself": {"turnaround_us": 60_000},
        "says that it is over": {"turnaround_us": 65_535},
    }
    discipline.add(replace(ahead, **changes[what]))
    assert len(discipline.estimator) == 12
    before = replace(ahead, received_us=ahead.received_us - 1)
    assert discipline.add(before) is Verdict.RESTARTED
    assert len(discipline.estimator) == 1
    # What came before says nothing of what comes now.
    board.run(0.05 * US)
    assert discipline.add(board.exchange()) is Verdict.TAKEN
