"""What the clocks of both clients do alike."""

import asyncio
import contextlib
import inspect
import itertools
import threading
from types import SimpleNamespace

import pytest
from j2a_spec import constants as c

import j2a
from j2a.types.transds_file import read_transds

from .clocked import ClockedDevice
from .support import PATIENCE_S, served

KEEPING = ("discipline", "follow")


async def awaited(one):
    return await one


class Both:
    """A client of one kind or the other, whose calls are made as it wants them."""

    def __init__(self, stack, device, kind):
        url = stack.enter_context(served(stack.enter_context(device)))
        if kind == "async":
            self._runner = stack.enter_context(asyncio.Runner())
            self.board = self.do(j2a.aconnect, url, timeout=PATIENCE_S)
            stack.callback(lambda: self.do(self.board.close))
        else:
            self.board = stack.enter_context(j2a.connect(url, timeout=PATIENCE_S))
        self.clock = self.board.clock

    def do(self, call, *args, **options):
        """Make a call; return its result."""
        found = call(*args, **options)
        return self._runner.run(awaited(found)) if inspect.isawaitable(found) else found


@pytest.fixture(params=["blocking", "async"])
def made(request):
    with contextlib.ExitStack() as stack:
        yield lambda device: Both(stack, device, request.param)


@pytest.mark.parametrize("kinds", list(itertools.product(KEEPING, repeat=3)))
def test_a_clock_is_kept_by_one_at_a_time_and_by_another_one_behind_it(made, kinds):
    both = made(ClockedDevice(ppm=80))
    for kind in kinds:
        keeper = both.do(getattr(both.clock, kind), 0.02)
        for other in KEEPING:
            with pytest.raises(j2a.LocalError, match="disciplined or followed already"):
                both.do(getattr(both.clock, other), 0.02)
        assert keeper.is_running
        both.do(keeper.stop)
        assert not keeper.is_running


@pytest.mark.parametrize("rounds", [1, 2, 7, 8, 9])
def test_any_number_of_rounds_sets_a_clock(made, rounds):
    device = ClockedDevice(ppm=80)
    both = made(device)
    assert both.do(both.clock.sync, rounds).epoch == 1
    adjusts = [one for one in device.requests if one[0] == c.CLOCK_ADJUST]
    assert len(adjusts) == max(rounds - 7, 1)


@pytest.mark.parametrize("first", [0, 1, 7, 100])
def test_any_transducer_tells_the_time_of_a_board_without_a_clock(made, first):
    text = f"""
    SENSOR(one, {first}, one, X, 1, u8, none)
    ACTUATOR(other, {first + 5}, other, X, 1, u8, none)
    """
    both = made(j2a.Device({}, transducers=read_transds(text)))
    reading = both.do(both.clock.measure, 3)
    assert (reading.state, reading.epoch, reading.can_be_set) == ("free", 0, False)


@pytest.mark.parametrize("ppm", [-300, -20, 0, 20, 300])
def test_a_clock_of_this_computer_that_is_fast_makes_the_board_slow(made, ppm, monkeypatch):
    both = made(ClockedDevice(ppm=80))
    both.do(both.clock.measure, 8)
    estimate, host = both.clock._estimate(), both.clock._host
    reference = SimpleNamespace(rate=ppm * 1e-6, to_unix=host.reference.to_unix)
    slewed = SimpleNamespace(observe=host.observe, counter_us=host.counter_us, reference=reference)
    monkeypatch.setattr(both.clock, "_host", slewed)
    # A second of this computer has so much less of the counter, and so of the board.
    rate = 1 / (1 + estimate.rate) - ppm * 1e-6 - 1
    assert both.clock._reading().rate_ppb == pytest.approx(rate * 1e9, abs=50_000)


def test_a_clock_that_stands_still_is_none(made):
    both = made(ClockedDevice(now_s=lambda: 5.0))
    with pytest.raises(j2a.NoClock, match="do not fit those before: its clock stands still"):
        both.do(both.clock.measure, 3)
    assert both.clock.known_bound_us == float("inf")


class Held:
    """A device whose clock does not answer until it is let go."""

    def __init__(self):
        self.device = ClockedDevice()
        self.came, self.go_on = threading.Event(), threading.Event()

    def hold(self):
        def spoil(_payload):
            self.came.set()
            assert self.go_on.wait(PATIENCE_S)

        self.device.spoil = spoil


class Noted:
    """A lock that notes for how long it is waited for."""

    def __init__(self, lock):
        self.lock, self.waits_s = lock, []

    def acquire(self, timeout):
        self.waits_s.append(timeout)
        return self.lock.acquire(timeout=timeout)

    def __getattr__(self, name):
        return getattr(self.lock, name)


@pytest.mark.requirement("J2A-CLOCK-029", "J2A-TIME-008")
def test_a_limit_covers_the_wait_for_another_thread():
    held = Held()
    with served(held.device) as url, j2a.connect(url, timeout=PATIENCE_S) as board:
        board.clock.measure(1)
        held.hold()
        first = threading.Thread(target=board.clock.exchange)
        first.start()
        assert held.came.wait(PATIENCE_S)
        board.clock._busy = noted = Noted(board.clock._busy)
        try:
            for call in (board.clock.exchange, board.clock.status):
                with pytest.raises(j2a.CallTimeout, match="another thread asks it") as caught:
                    call(timeout=0.05)
                assert caught.value.outcome is j2a.errors.Outcome.NOT_SENT
        finally:
            held.go_on.set()
        first.join(PATIENCE_S)
        assert max(noted.waits_s) <= 0.05
        board.clock.exchange()


@pytest.mark.requirement("J2A-CLOCK-029", "J2A-TIME-008")
def test_a_limit_covers_the_wait_for_another_task():
    async def main(url, held):
        async with await j2a.aconnect(url, timeout=PATIENCE_S) as board:
            await board.clock.measure(1)
            held.hold()
            first = asyncio.create_task(board.clock.exchange())
            await asyncio.to_thread(held.came.wait, PATIENCE_S)
            cancelled = asyncio.create_task(board.clock.exchange())
            behind = asyncio.create_task(board.clock.exchange())
            try:
                for call in (board.clock.exchange, board.clock.status):
                    with pytest.raises(j2a.CallTimeout, match="another task asks it") as caught:
                        await call(timeout=0.05)
                    assert caught.value.outcome is j2a.errors.Outcome.NOT_SENT
                    cancelled.cancel()
                assert not first.done()
            finally:
                held.go_on.set()
            await first
            await behind
            assert cancelled.cancelled()

    held = Held()
    with served(held.device) as url:
        asyncio.run(main(url, held))
