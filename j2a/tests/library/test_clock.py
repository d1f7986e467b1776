"""`board.clock` of both clients, with devices that have a clock, transducers, or neither."""

import asyncio
import gc
import math
import os
import re
import subprocess
import sys
import threading
import time
import weakref
from concurrent.futures import ThreadPoolExecutor

import pytest
from j2a_spec import constants as c
from j2a_spec import oracle
from j2a_spec.constants import SOF

import j2a
from j2a.io import clock as clock_module
from j2a.io import host_time
from j2a.io.clock import Clock
from j2a.types.transds_file import read_transds
from j2a.virtual import VirtualBoard

from .clocked import ClockedDevice
from .support import PATIENCE_S, linked, served
from .test_aio import in_event_loop
from .test_simulated_time import SlowDevice

SENSORS = "SENSOR(quad, 0, quad, X, 1, int16_t, none, (period, 5000))"


@pytest.fixture
def device():
    with ClockedDevice(ppm=80) as made:
        yield made


@pytest.fixture
def board(device):
    with linked(device) as client:
        yield client


def until(condition):
    """Wait for something that another thread does."""
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, "it does not happen"
        time.sleep(0.005)


def truth_us(device):
    """The time of the device less that of this computer, now: bounds, in microseconds."""
    before = time.time_ns() / 1000
    told = device.time_us()
    after = time.time_ns() / 1000
    return told - after, told - before


# ---------------------------------------------------------------------------- reading


def test_a_clock_is_measured_when_it_is_looked_at(board, device):
    assert board.clock.state == "free"
    assert board.clock.epoch == 0
    reading = board.clock.measure()
    low, high = truth_us(device)
    slack = reading.uncertainty_us + abs(reading.rate_ppb) / 1000
    assert low - slack <= reading.offset_us <= high + slack
    assert reading.can_be_set
    assert all(one[0] in (c.CLOCK_EXCHANGE, c.CLOCK_STATUS) for one in device.requests)


def test_the_bound_that_is_known_is_told_without_asking(board, device):
    assert board.clock.known_bound_us is None
    assert not device.requests
    board.clock.measure()
    asked = len(device.requests)
    assert 0 < board.clock.known_bound_us <= board.clock.uncertainty_us
    assert len(device.requests) == asked
    device._began_s -= 1.0  # faster than any counter runs
    board.clock.exchange()
    assert board.clock.known_bound_us == math.inf
    board.clock.exchange()  # agrees with the one before
    assert 0 < board.clock.known_bound_us < math.inf


def test_times_are_converted_there_and_back(board, device):
    board.clock.measure()
    bound = board.clock.uncertainty_us
    before, told, after = time.time_ns() // 1000, int(device.time_us()), time.time_ns() // 1000
    assert before - bound - 2 <= board.clock.to_host(told) <= after + bound + 2
    assert abs(board.clock.to_device(board.clock.to_host(told)) - told) <= 2


def test_the_rate_of_a_crystal_is_seen_within_what_is_known_of_it(board):
    board.clock.measure(16)
    estimate = board.clock._discipline.estimator.estimate
    assert abs(board.clock.rate_ppb - 80_000) <= (estimate.rate_error + 500e-6) * 1e9


@pytest.mark.requirement("J2A-CLOCK-022")
@pytest.mark.requirement("J2A-CLOCK-023")
@pytest.mark.requirement("J2A-CLOCK-025")
def test_what_a_device_says_wrong_is_not_used(board, device):
    board.clock.measure(2)
    answers = [
        (0, bytes(14)),  # another nonce
        (0, b"\1"),
        (2, b""),
        (0, b""),
    ]
    for answer in answers:
        device.spoil = lambda payload, answer=answer: answer if payload[0] == 0 else None
        with pytest.raises((j2a.ProtocolError, j2a.RemoteError)):
            board.clock.exchange()
    device.spoil = lambda payload: (0, payload[1:5] + b"\xff" * 10)  # absurd, and saturated
    board.clock.exchange()
    estimator = board.clock._discipline.estimator
    assert estimator.rejected == 1
    assert board.clock.uncertainty_us >= estimator._least_slack() / 2


def test_longer_replies_are_read_as_far_as_they_are_known(board, device):
    normal = device._answer

    def longer(payload):
        device.spoil = lambda _payload: None
        device._lock.release()
        try:
            code, reply = normal(payload)
        finally:
            device._lock.acquire()
            device.spoil = longer
        return code, reply + b"\x05\x00\x09\x00later"

    device.spoil = longer
    exchange = board.clock.exchange()
    assert (exchange.frame, exchange.age_us) == (5, 9)
    assert board.clock.status().epoch == 0


# ---------------------------------------------------------------------------- setting


@pytest.mark.requirement("J2A-CLOCK-024")
def test_only_sync_and_discipline_set_a_clock(board, device):
    board.clock.measure(12)
    with board.clock.follow(0.01) as keeper:
        until(lambda: keeper.rounds > 10)
    assert not any(one[0] == c.CLOCK_ADJUST for one in device.requests)
    reading = board.clock.sync()
    assert reading.epoch == 1
    assert reading.state in ("settling", "locked")
    assert any(one[0] == c.CLOCK_ADJUST for one in device.requests)
    low, high = truth_us(device)
    assert low - 50_000 <= 0 <= high + 50_000


@pytest.mark.parametrize("rounds", [1, 2, 7, 8, 9])
def test_any_number_of_rounds_sets_a_clock(board, device, rounds):
    reading = board.clock.sync(rounds)
    assert reading.epoch == 1
    adjusts = [one for one in device.requests if one[0] == c.CLOCK_ADJUST]
    assert len(adjusts) == max(rounds - 7, 1)
    assert abs(reading.offset_us) <= reading.uncertainty_us + 1000
    low, high = truth_us(device)
    assert low - 50_000 <= 0 <= high + 50_000


@pytest.mark.requirement("J2A-CLOCK-029")
def test_a_disciplined_clock_follows_until_it_is_stopped(board, device):
    with board.clock.discipline(0.02) as keeper:
        assert keeper.is_running
        with pytest.raises(j2a.LocalError, match="already"):
            board.clock.follow()
        until(lambda: keeper.rounds > 20)
    assert not keeper.is_running
    assert (keeper.failures, keeper.error) == (0, None)
    count = len(device.requests)
    reading = board.clock.read()
    low, high = truth_us(device)
    slack = reading.uncertainty_us + 1000
    assert low - slack <= reading.offset_us <= high + slack
    assert len(device.requests) == count
    keeper.stop()
    with board.clock.discipline(0.02) as keeper:  # again
        until(lambda: keeper.rounds > 0)
    assert {one[1] for one in device.requests if one[0] == c.CLOCK_ADJUST} == {c.CLOCK_SLEW}


@pytest.mark.requirement("J2A-CLOCK-024", "J2A-CLOCK-029")
def test_a_keeper_that_was_stopped_sets_nothing_although_its_exchange_ends_later(
    board, device, monkeypatch
):
    """A board may answer later than `stop` waits."""
    monkeypatch.setattr(clock_module, "JOIN_S", 0.01)
    is_held, may_go = threading.Event(), threading.Event()

    def hold(payload):
        if payload[0] == c.CLOCK_EXCHANGE:
            is_held.set()
            may_go.wait(PATIENCE_S)

    board.clock.sync()
    keeper = board.clock.discipline(0.02)
    until(lambda: keeper.rounds > 0)
    device.spoil = hold
    assert is_held.wait(PATIENCE_S)
    keeper.stop()
    asked = len(device.requests)
    may_go.set()
    until(lambda: not keeper._thread.is_alive())
    assert not any(one[0] == c.CLOCK_ADJUST for one in device.requests[asked:])


def settable(board):
    """Give a client a host's clock that can be set; return it and by how much it is, in us."""
    counter_us, shift = board.clock._host.counter_us, [0]
    clock = host_time.HostTime(counter_us, lambda: time.time_ns() // 1000 + shift[0])
    board.clock._host = clock
    board.clock._discipline.reference = clock.reference
    return clock, shift


@pytest.mark.requirement("J2A-CLOCK-028")
def test_a_step_of_this_computer_is_followed_by_a_step(board, device, caplog):
    clock, shift = settable(board)
    with board.clock.discipline(0.02) as keeper:
        until(lambda: keeper.rounds > 12)
        shift[0] = 3_600_000_000
        until(lambda: device._epoch == 2)
        until(lambda: board.clock.epoch == 2)
    assert clock.reference.steps == 1
    assert abs(board.clock.offset_us) < 100_000
    assert re.search(r"was set by \+(3600\.0|3599\.9)", caplog.text)
    modes = [one[1] for one in device.requests if one[0] == c.CLOCK_ADJUST]
    assert modes.count(c.CLOCK_STEP) == 1


@pytest.mark.parametrize("is_known", [False, True])
def test_a_step_from_before_a_keeper_is_not_logged(board, caplog, is_known):
    clock, shift = settable(board)
    clock.observe()
    shift[0] = 3_600_000_000
    if is_known:
        clock.observe()
    with board.clock.discipline(0.02) as keeper:
        until(lambda: keeper.rounds > 1)
    assert clock.reference.steps == 1
    assert "was set by" not in caplog.text


@in_event_loop
async def test_a_step_from_before_a_keeper_is_awaited_is_not_logged(caplog):
    with ClockedDevice() as device, served(device) as url:
        async with await j2a.aconnect(url, timeout=PATIENCE_S) as board:
            clock, shift = settable(board)
            clock.observe()
            keeper = board.clock.discipline(0.02)
            shift[0] = 3_600_000_000
            clock.observe()
            async with keeper:
                while keeper.rounds < 2:
                    await asyncio.sleep(0.01)
            assert clock.reference.steps == 1
    assert "was set by" not in caplog.text


NO_TIMES = ["x", None, b"5", math.nan, 1.5, 5.0, True, -1, 2**64, 2**70]


@pytest.mark.parametrize("what", NO_TIMES, ids=repr)
def test_what_is_no_time_is_not_converted(board, device, what):
    """It is refused before anything is asked."""
    for convert in (board.clock.to_host, board.clock.to_device):
        with pytest.raises(j2a.WrongArgument, match="a whole number of microseconds"):
            convert(what)
    assert device.requests == []


def test_each_time_that_64_bits_hold_is_converted(board, device):
    board.clock.measure(2)
    for convert in (board.clock.to_host, board.clock.to_device):
        first, last = convert(0), convert(2**64 - 1)
        assert abs((last - first) / 2**64 - 1) < 0.1  # so far away errors of the rate are large
        numpy = pytest.importorskip("numpy")
        assert type(convert(numpy.uint64(5))) is int


@in_event_loop
async def test_what_is_no_time_is_not_converted_in_an_event_loop_either():
    with ClockedDevice() as device, served(device) as url:
        async with await j2a.aconnect(url, timeout=PATIENCE_S) as board:
            await board.clock.measure(2)
            for convert in (board.clock.to_host, board.clock.to_device):
                for what in NO_TIMES:
                    with pytest.raises(j2a.WrongArgument, match="a whole number of microseconds"):
                        convert(what)
                assert abs(convert(2**64 - 1) / 2**64 - 1) < 0.1


@pytest.mark.requirement("J2A-CLOCK-027")
def test_a_time_stamp_of_an_earlier_epoch_is_refused(board, device):
    old = int(device.time_us())
    board.clock.measure(4)
    assert board.clock.to_host(old) > 0
    board.clock.sync()
    with pytest.raises(j2a.LocalError, match="before it was set"):
        board.clock.to_host(old)


@pytest.mark.requirement("J2A-CLOCK-027")
def test_a_client_that_comes_later_refuses_time_stamps_of_an_earlier_epoch(board, device):
    """It was not there when the clock was set; but the counter began at 0."""
    old = int(device.time_us())
    board.clock.sync()
    with linked(device) as later:
        later.clock.measure(4)
        assert later.clock.epoch == 1
        with pytest.raises(j2a.LocalError, match="before it was set"):
            later.clock.to_host(old)
        assert later.clock.to_host(int(device.time_us())) > 0


@pytest.mark.requirement("J2A-CLOCK-027")
@pytest.mark.parametrize("back_s", [3600, 1])
def test_a_time_stamp_from_before_a_step_back_is_refused(board, device, back_s):
    """Its time comes again."""
    _, shift = settable(board)
    with board.clock.discipline(0.02) as keeper:
        until(lambda: keeper.rounds > 12)
        assert board.clock.to_host(int(device.time_us())) > 0
        shift[0] = -int(back_s * 1e6)
        old = int(device.time_us())
        until(lambda: board.clock.epoch == 2)
        until(lambda: board.clock.offset_us < 1e5)
        with pytest.raises(j2a.LocalError, match="J2A-CLOCK-027"):
            board.clock.to_host(old)
        assert board.clock.host_time_of_sample(old) is None


@pytest.mark.requirement("J2A-CLOCK-027")
def test_a_client_that_comes_after_a_step_back_refuses_time_stamps_from_before(board, device):
    """No time stamp is of a time to come."""
    board.clock.sync()
    old = int(device.time_us())
    device._target = (device._target[0], device._target[1] - 3_600_000_000, device._target[2])
    device._epoch = 2
    with linked(device) as later:
        later.clock.measure(4)
        assert later.clock.host_time_of_sample(old) is None
        assert later.clock.to_host(old) > time.time_ns() // 1000 + 3_000_000_000  # a plan may be
        assert later.clock.to_host(int(device.time_us())) > 0
        device.begin_anew()
        later.clock.measure(4)
        assert later.clock.state == "free"
        assert later.clock.host_time_of_sample(old) is None


@pytest.mark.requirement("J2A-CLOCK-026")
def test_a_board_that_begins_anew_is_set_anew(board, device):
    with board.clock.discipline(0.02) as keeper:
        until(lambda: keeper.rounds > 12)
        device.begin_anew()
        until(lambda: device._epoch == 1)
        until(lambda: keeper.rounds > 40)
    assert keeper.failures == 0
    low, high = truth_us(device)
    assert low - 50_000 <= 0 <= high + 50_000


@pytest.mark.requirement("J2A-CLOCK-026")
def test_an_adjustment_that_is_refused_begins_anew(board, device):
    board.clock.measure(12)
    device.spoil = lambda payload: (c.CLOCK_BAD_VALUE, b"") if payload[0] == 2 else None
    board.clock._run(board.clock._adjust, None)
    assert len(board.clock._discipline.estimator) == 0
    device.spoil = lambda _payload: None
    assert board.clock.sync().epoch == 1


def test_a_device_in_python_is_disciplined_and_so_are_its_samples():
    device = j2a.Device(clock=-300, transducers=read_transds(SENSORS))
    with device, linked(device) as board, board.clock.discipline(0.02) as keeper:
        until(lambda: keeper.rounds > 20)
        assert keeper.failures == 0
        assert board.clock.epoch == 1
        with board.transducers["quad"].samples() as samples:
            before = time.time_ns() // 1000
            device.sense("quad", 0, 5)
            after = time.time_ns() // 1000
            sample = samples.wait(PATIENCE_S)
        bound = board.clock.uncertainty_us + 1000
        assert before - bound <= sample.host_us <= after + bound
        assert before - 2 * bound <= sample.time_us <= after + 2 * bound


# ---------------------------------------------------------------------------- boards without it


def test_transducers_tell_a_time_that_cannot_be_set():
    with VirtualBoard(read_transds(SENSORS)) as device, linked(device) as board:
        device.measure()
        assert not board.clock.measure(4).can_be_set
        for call in (board.clock.sync, board.clock.discipline, board.clock.status):
            with pytest.raises(j2a.NoClock, match="cannot be set"):
                call()
        with board.clock.follow():
            before = time.time_ns() // 1000
            sample = board.transducers["quad"].wait()
            after = time.time_ns() // 1000
            bound = board.clock.uncertainty_us + 5000
            assert before - 200_000 - bound <= sample.host_us <= after + bound


def test_samples_tell_no_host_time_before_the_clock_was_asked():
    with VirtualBoard(read_transds(SENSORS)) as device, linked(device) as board:
        device.measure()
        assert board.transducers["quad"].wait().host_us is None


def test_a_board_without_a_time_says_so():
    with j2a.Device() as device, linked(device) as board:
        for call in (board.clock.measure, board.clock.follow, board.clock.exchange):
            with pytest.raises(j2a.NoClock, match="tells no time"):
                call()


@pytest.mark.parametrize("rounds", [0, -1, 1.5, "3"])
def test_a_number_of_rounds_is_one(board, rounds):
    with pytest.raises(j2a.LocalError, match="rounds"):
        board.clock.measure(rounds)


@pytest.mark.parametrize("period_s", [0, -1.0, 6.0, math.inf, math.nan, "1", None, True])
def test_a_period_keeps_a_board_from_holdover(board, period_s):
    for keep in (board.clock.discipline, board.clock.follow):
        with pytest.raises(j2a.LocalError, match=r"period_s is a number of .* at most 5, not"):
            keep(period_s)


# ---------------------------------------------------------------------------- ends and losses


def test_a_keeper_ends_with_its_client(device):
    with linked(device) as board:
        keeper = board.clock.discipline(0.02)
        until(lambda: keeper.rounds > 0)
    until(lambda: not keeper._thread.is_alive())
    assert not keeper.is_running
    keeper.stop()


@pytest.mark.filterwarnings("ignore:unclosed:ResourceWarning")  # recorded, it keeps the client
def test_a_keeper_keeps_no_client_alive(device):
    with served(device) as url:
        board = j2a.connect(url, timeout=PATIENCE_S)
        keeper = board.clock.discipline(0.02)
        until(lambda: keeper.rounds > 0)
        gone = weakref.ref(board)
        del board
        deadline = time.monotonic() + PATIENCE_S
        while gone() is not None and time.monotonic() < deadline:
            gc.collect()
            time.sleep(0.01)
        assert gone() is None
        until(lambda: not keeper._thread.is_alive())


def test_failures_are_counted_and_raise_nothing(device):
    with linked(device, timeout=0.05) as board:
        with board.clock.discipline(0.02) as keeper:
            until(lambda: keeper.rounds > 2)
            device.spoil = lambda _payload: (0, b"")
            until(lambda: keeper.failures > 3)
            assert isinstance(keeper.error, j2a.ProtocolError)
            device.spoil = lambda _payload: time.sleep(0.2)
            until(lambda: isinstance(keeper.error, j2a.CallTimeout))
            rounds = keeper.rounds
            device.spoil = lambda _payload: None
            until(lambda: keeper.rounds > rounds + 2)
        assert board.is_open


def test_several_threads_ask_one_after_the_other(board, device):
    errors = []

    def ask():
        try:
            for _ in range(10):
                board.clock.measure(1)
        except Exception as error:
            errors.append(error)

    threads = [threading.Thread(target=ask) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(PATIENCE_S)
    assert errors == []
    assert board.clock._discipline.estimator.rejected == 0


def test_threads_that_ask_for_the_clock_at_once_get_the_same(board, monkeypatch):
    """Each would make exchanges of its own otherwise, several at once (J2A-CLOCK-029)."""
    together = threading.Barrier(4)
    make = Clock.__init__

    def slowly(*arguments):
        together.wait(PATIENCE_S)
        make(*arguments)

    monkeypatch.setattr(Clock, "__init__", slowly)
    with ThreadPoolExecutor(4) as pool:
        clocks = [one.result() for one in [pool.submit(lambda: board.clock) for _ in range(4)]]
    assert {id(one) for one in clocks} == {id(board.clock)}


@pytest.mark.parametrize(
    "off_us",
    [
        lambda clock, now_us: clock.read().offset_us,
        lambda clock, now_us: clock.to_host(now_us) - now_us,
        lambda clock, now_us: clock.to_device(now_us) - now_us,
    ],
    ids=["read", "to_host", "to_device"],
)
def test_what_is_known_does_not_change_amid_an_answer(board, monkeypatch, off_us):
    """Another thread finds that the board has restarted, while this one converts a time."""
    clock = board.clock
    clock.sync(8)
    time.sleep(0.01 + 3e-6 * clock.uncertainty_us)  # now is behind the step on both clocks
    observe = clock._host.observe
    others = []

    def interrupted():
        if not others:
            board._session.note_restart()
            others.append(threading.Thread(target=clock.exchange))
            others[0].start()
            others[0].join(0.3)
        return observe()

    monkeypatch.setattr(clock._host, "observe", interrupted)
    try:
        assert abs(off_us(clock, time.time_ns() // 1000)) < 1e6
    finally:
        others[0].join(PATIENCE_S)
    assert clock._discipline.status is None  # now it has begun anew


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the system has no fork")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_child_process_converts_times_and_leaves_the_link_alone(board, device):
    board.clock.measure()
    with board.clock.follow(0.02) as keeper:
        told = int(device.time_us())
        child = os.fork()
        if child == 0:
            code = 3
            try:
                board.clock.to_host(told)
                try:
                    board.clock.measure(1)
                except j2a.LocalError:
                    code = 0
                keeper.stop()
            finally:
                os._exit(code)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
        rounds = keeper.rounds
        until(lambda: keeper.rounds > rounds)


# ---------------------------------------------------------------------------- asyncio


@in_event_loop
async def test_the_asyncio_client_disciplines_a_clock():
    with ClockedDevice(ppm=-40) as device, served(device) as url:
        async with await j2a.aconnect(url, timeout=PATIENCE_S) as board:
            with pytest.raises(j2a.LocalError, match="nothing is known"):
                board.clock.to_host(5)
            reading = await board.clock.measure(4)
            assert (reading.state, board.clock.state, reading.can_be_set) == ("free", "free", True)
            assert (await board.clock.exchange()).turnaround_us >= 0
            assert (await board.clock.sync(2)).epoch == 1
            async with board.clock.discipline(0.02) as keeper:
                with pytest.raises(j2a.LocalError, match="already"):
                    await board.clock.follow()
                while keeper.rounds < 20:
                    await asyncio.sleep(0.01)
            assert not keeper.is_running
            assert (await board.clock.status()).epoch == board.clock.epoch == 1
            low, high = truth_us(device)
            slack = board.clock.uncertainty_us + 1000
            assert low - slack <= board.clock.offset_us <= high + slack
            now = time.time_ns() // 1000
            assert abs(board.clock.to_host(board.clock.to_device(now)) - now) <= 3
            keeper = await board.clock.discipline(0.02)
    for _ in range(3):
        await asyncio.sleep(0)
    assert not keeper.is_running


@in_event_loop
async def test_a_task_that_is_cancelled_while_it_stops_a_keeper_is_cancelled():
    with ClockedDevice() as device, served(device) as url:
        async with await j2a.aconnect(url, timeout=PATIENCE_S) as board:
            keeper = await board.clock.follow(0.02)
            stops = asyncio.create_task(keeper.stop())
            await asyncio.sleep(0)
            assert stops.cancel()
            await asyncio.wait([stops])
            assert stops.cancelled()


@in_event_loop
async def test_the_asyncio_client_says_that_a_board_tells_no_time():
    with j2a.Device() as device, served(device) as url:
        async with await j2a.aconnect(url, timeout=PATIENCE_S) as board:
            with pytest.raises(j2a.NoClock, match="tells no time"):
                await board.clock.measure()
            with pytest.raises(j2a.NoClock):
                await board.clock.discipline()
            with pytest.raises(j2a.LocalError, match="nothing is known"):
                _ = board.clock.offset_us


@in_event_loop
async def test_a_task_counts_failures_and_goes_on():
    with ClockedDevice() as device, served(device) as url:
        async with await j2a.aconnect(url, timeout=PATIENCE_S) as board:
            async with board.clock.follow(0.02) as keeper:
                device.spoil = lambda _payload: (0, b"")
                while keeper.failures < 3:
                    await asyncio.sleep(0.01)
                device.spoil = lambda _payload: None
                rounds = keeper.rounds
                while keeper.rounds < rounds + 3:
                    await asyncio.sleep(0.01)
            assert isinstance(keeper.error, j2a.ProtocolError)


# ---------------------------------------------------------------------------- this computer


def test_the_time_of_this_computer_is_read_in_one_moment():
    before = time.time_ns() // 1000
    counter = host_time._HOST.observe()
    unix = host_time._HOST.reference.to_unix(counter)
    after = time.time_ns() // 1000
    assert before - 2 <= unix <= after + 2


@pytest.mark.parametrize("took_us", [0.1, 4, 12, 60])
def test_a_slow_counter_is_read_again_and_again(took_us):
    """Whatever time a reading takes on this machine, its clock is followed."""
    now = [0.0]
    shift = [10**15]

    def counter_us():
        now[0] += took_us
        return now[0]

    clock = host_time.HostTime(counter_us, lambda: shift[0] + int(now[0]))
    for _ in range(40):
        clock.observe()
        now[0] += 100_000
    for _ in range(3):
        shift[0] += 3_600_000_000
        steps = clock.reference.steps
        for _ in range(12):
            clock.observe()
            now[0] += 100_000
        assert clock.reference.steps == steps + 1
        assert abs(clock.reference.to_unix(now[0]) - shift[0] - now[0]) <= 2 * took_us + 20


def test_a_reading_that_was_interrupted_is_left_out():
    now = [0.0]
    took_us = [1.0]

    def counter_us():
        now[0] += took_us[0]
        return now[0]

    clock = host_time.HostTime(counter_us, lambda: 10**15 + int(now[0]))
    clock.observe()
    for late_us in (30, 200, 5000):
        took_us[0] = late_us
        now[0] += 300_000
        before = clock.reference._anchor
        clock.observe()
        assert clock.reference._anchor == before
    now[0] += 10_000_000
    clock.observe()  # so late that it would look like a step
    assert clock.reference._anchor == before


def test_a_glance_reads_the_clock_once_a_millisecond():
    """So a step of the clock is known to all that is converted later than that."""
    now, read = [0.0], []

    def unix_us():
        read.append(now[0])
        return 10**15 + int(now[0])

    clock = host_time.HostTime(lambda: now[0], unix_us)
    for _ in range(1000):
        now[0] += 0.125 * 1000
        assert clock.glance() == now[0]
        assert clock.reference._anchor[0] > now[0] - 1000
    assert len(read) == 125
    now[0] -= 5000  # a counter that goes back is no reason not to look
    clock.glance()
    assert read[-1] == now[0]


@pytest.mark.skipif(sys.platform != "linux", reason="the system tells no steps")
def test_this_computer_tells_steps_from_slews():
    slewed_us = host_time._HOST._slewed_us
    first = time.time_ns() / 1000 - slewed_us()
    time.sleep(0.01)
    assert abs(time.time_ns() / 1000 - slewed_us() - first) < 5000  # however busy it is


def test_importing_the_library_loads_no_clock():
    code = "import sys, j2a; print([m for m in sys.modules if m.split('.')[2:3] == ['clock']])"
    found = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60
    )
    assert found.stdout.strip() == "[]"


# ---------------------------------------------------------------------------- simulated time


class SimulatedLink(SlowDevice):
    """Carries requests to a device; its bytes take simulated time."""

    def __init__(self, device, byte_us=10.0):
        super().__init__(0.0)
        self.device = device
        self.byte_time_s = byte_us / 1e6

    def write(self, data):
        with self._lock:
            for request in oracle.decode(bytes(data)):
                arrives_s = self.now_s + len(data) * self.byte_time_s
                code, reply = self.device._table.execute(request.opcode, request.payload)
                wire = oracle.encode(oracle.Frame(SOF, request.seq, code, reply))
                self.due.append((arrives_s + len(wire) * self.byte_time_s, wire))


def test_a_clock_is_disciplined_in_simulated_time():
    now = [0.0]
    with ClockedDevice(ppm=2000, now_s=lambda: now[0]) as device:
        link = SimulatedLink(device)
        now_s = link.clock
        device._now_s = now_s
        device._began_s = now_s() - 3.0
        with j2a.Client(link, timeout=10.0) as board:
            with board.clock.discipline(1.0) as keeper:
                begun_s = now_s()
                until(lambda: keeper.rounds > 30)
                assert now_s() - begun_s > 15  # periods are those of the link
            assert keeper.failures == 0
            reading = board.clock.read()
            assert reading.epoch == 1
            estimate = board.clock._discipline.estimator.estimate
            counter = device.local_us
            error_us = estimate.to_host(counter) - now_s() * 1e6
            assert abs(error_us) <= estimate.uncertainty_us(counter) + 20_000  # it went on
            assert abs(board.clock.to_host(int(device.time_us())) - now_s() * 1e6) < 100_000


@pytest.mark.parametrize("ends", ["is closed", "is lost"])
def test_a_measurement_ends_with_the_link_also_where_its_time_stands_still_then(ends):
    """Between two exchanges nobody reads or writes who would notice."""
    with ClockedDevice() as device:
        link = SimulatedLink(device)
        with j2a.Client(link, timeout=10.0) as board:
            board.clock.measure(1)
            end = threading.Thread(target=board.close if ends == "is closed" else link.close)

            def stand_still(_limit_s=None):
                if not end.ident:
                    end.start()
                    end.join(PATIENCE_S)
                return frozen_s

            frozen_s = link.clock()
            board.clock._now = stand_still
            with pytest.raises(j2a.LinkError):
                board.clock.measure(3)


@in_event_loop
async def test_a_measurement_in_an_event_loop_ends_with_the_link():
    with ClockedDevice() as device:
        link = SimulatedLink(device)
        async with j2a.AsyncClient(link, timeout=10.0) as board:
            await board.clock.measure(1)
            frozen_s = link.clock()
            board.clock._now = lambda: frozen_s
            measuring = asyncio.create_task(board.clock.measure(3))
            await asyncio.sleep(0.05)
            await board.close()
            with pytest.raises(j2a.LinkError):
                await asyncio.wait_for(measuring, PATIENCE_S)
