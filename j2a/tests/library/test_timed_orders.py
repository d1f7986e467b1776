"""What orders of a fleet for an instant have in common, in both kinds of fleets."""

import asyncio
import contextlib
import dataclasses
import inspect
import itertools
import time

import j2a_transports
import pytest
from j2a_spec import constants as c

import j2a
from j2a.io.clock_base import ClockBase
from j2a.timed import _At
from j2a.types.transds_file import read_transds
from j2a.types.transducers import TIME_BYTES

from .support import PATIENCE_S, served

FILE = """
SENSOR(imu, 2, imu, X, 1, u8, none, (trigger))
ACTUATOR(servo, 7, servo, X, 3, i16, none, (scale, 0.5), (offset, -3))
"""
ORDERS = (bytes([7, c.TRANSD_SET]), bytes([2, c.TRANSD_TRIGGER]))
NAMES = ("left", "right")


class Both:
    """A fleet of two boards, whose calls are made as its kind wants it.

    Attributes:
        told: by board, the requests that order something.
    """

    def __init__(self, stack, kind):
        self._runner = stack.enter_context(asyncio.Runner()) if kind == "async" else None
        self.told = {name: [] for name in NAMES}
        urls = []
        for name in NAMES:
            device = j2a.Device({"serial": name}, clock=0, transducers=read_transds(FILE))
            device.actuator("servo")(lambda *_what: None)
            device.on_trigger("imu")(lambda *_what: None)
            device._table.execute = self._noted(device._table.execute, self.told[name])
            urls.append(stack.enter_context(served(stack.enter_context(device))))
        options = {"timeout": PATIENCE_S, "heartbeat": None}
        if self._runner is None:
            self.fleet = stack.enter_context(j2a.Fleet(*urls, **options))
        else:
            self._runner.run(self._open(urls, options))
            stack.callback(lambda: self.do(self.fleet.close))
        self.do(self.fleet.wait, len(NAMES), timeout=PATIENCE_S)
        for name in NAMES:
            self.do(self.fleet[name].clock.measure, 1)

    async def _open(self, urls, options):
        self.fleet = await j2a.AsyncFleet(*urls, **options).__aenter__()

    @staticmethod
    def _noted(execute, told):
        def answer(opcode, payload):
            # Those of a clock, which have random bytes, are shorter than a time.
            if payload[:2] in ORDERS and len(payload) > TIME_BYTES:
                told.append(payload)
            return execute(opcode, payload)

        return answer

    def do(self, call, *args, **options):
        """Make a call; return its result."""
        found = call(*args, **options)
        return self._runner.run(awaited(found)) if inspect.isawaitable(found) else found


async def awaited(one):
    return await one


@pytest.fixture(params=["blocking", "async"])
def both(request):
    with contextlib.ExitStack() as stack:
        yield Both(stack, request.param)


def soon_us(seconds):
    return time.time_ns() // 1000 + int(seconds * 1e6)


@pytest.mark.parametrize(
    ("values", "options"),
    [
        ((4.5,), {}),
        ((4.5, -6.0, 0.0), {}),
        ((9,), {"channel": 2}),
        ((9, -9), {"channel": 1}),
        ((9,), {"raw": True}),
        ((-9, 300, 0), {"raw": True}),
        ((9, -9), {"raw": True, "channel": 1}),
    ],
)
def test_an_order_says_what_an_order_to_one_board_says(both, values, options):
    """All but the time, which is that of each board."""
    when = both.do(both.fleet.at(soon_us(60), within_us=1e9).set, "servo", *values, **options)
    assert when.keys() == set(NAMES)
    for name, at_us in when.items():
        servo = both.fleet[name].transducers["servo"]
        both.do(servo.set, *values, at_us=at_us, **options)
        first, second = both.told[name]
        assert first == second


@pytest.mark.parametrize("made", [list, tuple, set, dict, iter], ids=lambda one: one.__name__)
@pytest.mark.parametrize("chosen", [(), ("left",), ("right",), NAMES], ids=len)
@pytest.mark.parametrize("order", ["set", "trigger"])
def test_only_boards_that_are_named_have_an_order(both, made, chosen, order):
    """No board is named by an empty list, which is not the same as no list."""
    boards = made(dict.fromkeys(chosen) if made is dict else list(chosen))
    what = ("servo", 1) if order == "set" else ("imu",)
    call = getattr(both.fleet.at(soon_us(60), within_us=1e9), order)
    if chosen:
        assert both.do(call, *what, boards=boards).keys() == set(chosen)
    else:
        with pytest.raises(j2a.UnknownTransducer, match="no board"):
            both.do(call, *what, boards=boards)
    assert {name for name, told in both.told.items() if told} == set(chosen)


@pytest.mark.parametrize("slow", range(6))
def test_a_clock_is_asked_until_it_is_known_and_four_times_at_most(both, monkeypatch, slow):
    asked = []
    clock = both.fleet["left"].clock
    measure = clock.measure

    def count(rounds):
        asked.append(rounds)
        return measure(rounds)

    monkeypatch.setattr(clock, "measure", count)
    monkeypatch.setattr(clock, "_to_act", lambda us: (us, 1 if len(asked) >= slow else 100))
    order = both.fleet.at(soon_us(60), within_us=10).set
    if slow <= 4:
        assert both.do(order, "servo", 1, boards=["left"]).keys() == {"left"}
    else:
        with pytest.raises(j2a.LocalError, match="may be off by 100 us"):
            both.do(order, "servo", 1, boards=["left"])
    assert asked == [1] * min(slow, 4)
    assert len(both.told["left"]) == (slow <= 4)


@pytest.mark.parametrize(("error_us", "within_us", "is_allowed"), [
    (9.5, 10, True),
    (10, 10, True),
    (10.5, 10, False),
    (0, 0, True),
    (0.1, 0, False),
    (1e9, float("inf"), True),
    (float("inf"), float("inf"), True),
    (float("inf"), 1e9, False),
    (0, float("nan"), False),
    (float("nan"), 10, False),
    (0, -1, False),
])  # fmt: skip
def test_an_order_is_given_where_the_clock_is_off_by_no_more_than_allowed(
    both, monkeypatch, error_us, within_us, is_allowed
):
    for name in NAMES:
        off = error_us if name == "right" else 0  # one of them is enough
        monkeypatch.setattr(both.fleet[name].clock, "_to_act", lambda us, off=off: (us, off))
    order = both.fleet.at(soon_us(60), within_us=within_us).trigger
    if is_allowed:
        assert both.do(order, "imu").keys() == set(NAMES)
    else:
        with pytest.raises(j2a.LocalError, match="nothing was sent"):
            both.do(order, "imu")
    assert {len(told) for told in both.told.values()} == {int(is_allowed)}


@pytest.mark.parametrize(("before_us", "behind_us", "error"), [
    (-1, -1, None),
    (-1, 0, None),
    (-1, 1, j2a.CallTimeout),
    (-1, 10**7, j2a.CallTimeout),
    (0, 0, j2a.LocalError),
    (1, 1, j2a.LocalError),
])  # fmt: skip
def test_a_time_that_is_over_by_the_least_is_an_error(
    both, monkeypatch, before_us, behind_us, error
):
    """Before the orders are sent, and again when all boards have answered."""
    monkeypatch.setattr(
        _At, "_late_us", lambda *_what: behind_us if all(both.told.values()) else before_us
    )
    order = both.fleet.at(soon_us(60), within_us=1e9).trigger
    with pytest.raises(error) if error else contextlib.nullcontext():
        both.do(order, "imu")
    is_sent = error is not j2a.LocalError
    assert {len(told) for told in both.told.values()} == {int(is_sent)}


@pytest.mark.parametrize("state", ["free", "settling", "locked", "holdover"])
@pytest.mark.parametrize("offset_us", [-51, -50, -30, 0, 30, 50, 51])
def test_a_board_is_told_our_time_where_it_follows_us_with_all_that_may_be_off(
    both, monkeypatch, state, offset_us
):
    clock = both.fleet["left"].clock
    now = dataclasses.replace(
        clock._reading(), state=state, offset_us=offset_us, uncertainty_us=50.0
    )
    monkeypatch.setattr(clock, "_reading", lambda: now)
    time_us = soon_us(60)
    told_us, error_us = clock._to_act(time_us)
    if state == "locked" and abs(offset_us) <= 50:
        assert (told_us, error_us) == (time_us, abs(offset_us) + 50)
    else:  # its own clock was never set
        assert abs(told_us - time_us) > 1e12
        assert error_us > 50


@pytest.mark.parametrize("planned", list(itertools.product([0, 1, 7], [0, 1, 2, 255])))
@pytest.mark.parametrize("now", list(itertools.product([0, 1, 7], [0, 1, 2, 255])))
def test_a_time_holds_for_the_clock_that_it_was_planned_for(monkeypatch, planned, now):
    """Restarts and epochs may have any order: an epoch is one of 255."""
    monkeypatch.setattr(ClockBase, "_course", now)
    clock = ClockBase(lambda: None, j2a_transports.pair()[0])
    if now[0] != planned[0]:
        with pytest.raises(j2a.DeviceRestarted, match="restarted"):
            clock._check_course(planned)
    elif now[1] != planned[1]:
        with pytest.raises(j2a.LocalError, match="was set"):
            clock._check_course(planned)
    else:
        clock._check_course(planned)
