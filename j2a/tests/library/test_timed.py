"""Several boards of a fleet that act at one instant."""

import asyncio
import contextlib
import dataclasses
import itertools
import math
import threading
import time

import pytest
from j2a_spec import constants as c

import j2a
from j2a.protocol.clock import Adjust
from j2a.timed import FleetAt
from j2a.types.transds_file import read_transds

from .clocked import ClockedDevice
from .rebooting import Rebooting
from .support import PATIENCE_S, served
from .test_aio import in_event_loop

FILE = """
SENSOR(imu, 2, imu, X, 1, u8, none, (trigger))
SENSOR(quad, 3, quad, X, 1, u8, none)
ACTUATOR(lamp, 11, lamp, X, 1, u8, none, (range, 0, 9))
"""


SET_LAMP = bytes([11, c.TRANSD_SET])
"""What an order for the lamp begins with; the second byte alone may be one of a nonce."""


class Board(j2a.Device):
    """Notes when it acts, on its own clock."""

    def __init__(self, name, text=FILE):
        super().__init__({"serial": name}, transducers=read_transds(text))
        self.acted = []
        self.has_acted = threading.Event()
        if text is FILE:
            self.actuator("lamp")(self._note)
            self.on_trigger("imu")(self._note)

    def now_us(self):
        return self._transducers().now_us()

    def _note(self, *what):
        self.acted.append((self.now_us(), what))
        self.has_acted.set()


@pytest.fixture
def boards():
    with contextlib.ExitStack() as stack:
        made = [stack.enter_context(Board(name)) for name in ("left", "right")]
        made.append(stack.enter_context(Board("other", "SENSOR(t, 1, t, X, 1, u8, none)")))
        urls = [stack.enter_context(served(one)) for one in made]
        yield made, urls


@pytest.fixture
def fleet(boards):
    with j2a.Fleet(*boards[1], timeout=PATIENCE_S, heartbeat=None) as fleet:
        fleet.wait(3, timeout=PATIENCE_S)
        yield fleet


def soon_us(seconds):
    return time.time_ns() // 1000 + int(seconds * 1e6)


def leads():
    """Yield how many seconds ahead a time is, more where this machine was too slow for less."""
    end = time.monotonic() + PATIENCE_S
    for number in itertools.count():
        assert time.monotonic() < end
        yield 0.3 * 2**number


def is_late(error):
    return "is over" in str(error) or "after the time" in str(error)


def in_time(fleet, order):
    """Give an order for a time that is soon; return what boards were told, and the time."""
    for lead in leads():
        time_us = soon_us(lead)
        try:
            return order(fleet.at(time_us, within_us=math.inf)), time_us
        except j2a.J2AError as error:
            if not is_late(error):
                raise
    raise AssertionError


@pytest.mark.parametrize("wrong", ["left", "", 5])
def test_one_name_is_no_list_of_boards(boards, fleet, wrong):
    del boards
    for order in (fleet.at(soon_us(5)).set, fleet.at(soon_us(5)).trigger):
        with pytest.raises(j2a.WrongArgument, match=r"boards is a list .* not"):
            order("lamp", boards=wrong)


@pytest.mark.parametrize("error", [j2a.CallTimeout, j2a.DeviceRestarted, j2a.LinkLost])
def test_a_board_that_does_not_tell_what_it_has_is_left_out(boards, fleet, error, monkeypatch):
    made, urls = boards

    def load(client, **_options):
        if client.url == urls[1]:
            raise error("no reply")

    monkeypatch.setattr(j2a.Client, "_load", load)
    told, _ = in_time(fleet, lambda at: at.set("lamp", 7))
    assert set(told) == {"left"}
    assert made[0].has_acted.wait(PATIENCE_S)
    with pytest.raises(error):
        fleet.at(soon_us(5), within_us=math.inf).set("lamp", 7, boards=["left", "right"])
    with pytest.raises(j2a.UnknownTransducer, match="'none'; what right has is not known: no"):
        fleet.at(soon_us(5), within_us=math.inf).set("none", 7)
    assert not made[1].acted


def check(boards, told, fleet, time_us):
    """The two boards acted when they were to, on their clocks."""
    assert set(told) == {"left", "right"}
    deadline = time.monotonic() + PATIENCE_S
    for name, board in zip(("left", "right"), boards, strict=False):
        while not board.acted or board.acted[-1][0] < told[name]:
            assert time.monotonic() < deadline, board.acted
            time.sleep(0.01)
        clock = fleet[name].clock
        assert abs(clock.to_host(told[name]) - time_us) <= clock.uncertainty_us + 5000


def test_actuators_of_several_boards_are_set_at_one_time(boards, fleet):
    told, time_us = in_time(fleet, lambda at: at.set("lamp", 7))
    check(boards[0], told, fleet, time_us)


def test_sensors_of_several_boards_measure_at_one_time(boards, fleet):
    told, time_us = in_time(fleet, lambda at: at.trigger("imu"))
    check(boards[0], told, fleet, time_us)


def test_boards_may_be_named(boards, fleet):
    told, _ = in_time(fleet, lambda at: at.set("lamp", 1, boards=["right"]))
    assert set(told) == {"right"}
    with pytest.raises(j2a.UnknownBoard):
        fleet.at(soon_us(5)).set("lamp", 1, boards=["nobody"])
    with pytest.raises(j2a.UnknownTransducer):
        fleet.at(soon_us(5)).set("lamp", 1, boards=["other"])


def test_what_is_wrong_is_refused_before_anything_is_sent(boards, fleet):
    in_time(fleet, lambda at: at.trigger("imu"))  # their clocks are known
    sent = {name: client.counters.frames_sent for name, client in fleet.items()}
    for order, error, text in [
        (lambda at: at.set("lamp", 99), j2a.WrongArgument, "lamp is"),
        (lambda at: at.set("lamp"), j2a.WrongArgument, "missing"),
        (lambda at: at.set("lamp", 1, channel=3), j2a.WrongArgument, "channels"),
        (lambda at: at.set("imu", 1), j2a.WrongArgument, "a sensor"),
        (lambda at: at.trigger("lamp"), j2a.WrongArgument, "an actuator"),
        (lambda at: at.trigger("quad"), j2a.WrongArgument, "no trigger"),
        (lambda at: at.trigger("nothing"), j2a.UnknownTransducer, "no board"),
    ]:
        with pytest.raises(error, match=text):
            order(fleet.at(soon_us(60), within_us=math.inf))
    with pytest.raises(j2a.LocalError, match="is over"):
        fleet.at(soon_us(-1), within_us=math.inf).set("lamp", 1)
    with pytest.raises(j2a.WrongArgument):
        fleet.at(1.5)
    assert {name: client.counters.frames_sent for name, client in fleet.items()} == sent


def test_an_order_that_comes_too_late_is_an_error(boards, fleet):
    in_time(fleet, lambda at: at.trigger("imu"))
    slow = boards[0][1]
    answer = slow._table.execute

    def execute(opcode, payload):
        if payload[:2] == SET_LAMP:
            while soon_us(0) <= time_us + 1000:
                time.sleep(0.01)
        return answer(opcode, payload)

    slow._table.execute = execute
    for lead in leads():
        time_us = soon_us(lead)
        with pytest.raises((j2a.CallTimeout, j2a.LocalError)) as error:
            fleet.at(time_us, within_us=math.inf).set("lamp", 1)
        if "is over" not in str(error.value):  # before it was sent
            break
    assert "after the time" in str(error.value)


def test_a_board_that_refuses_does_not_keep_the_others_from_acting(boards, fleet):
    in_time(fleet, lambda at: at.trigger("imu"))
    left, right = boards[0][:2]
    left._table.execute = lambda _opcode, _payload: (c.TRANSD_BAD_VALUE, b"")
    right.has_acted.wait(PATIENCE_S)
    right.has_acted.clear()
    with pytest.raises(j2a.FunctionFailed):
        in_time(fleet, lambda at: at.set("lamp", 1))
    assert right.has_acted.wait(PATIENCE_S)


@pytest.mark.parametrize("do", [lambda at: at.set("lamp", 1), lambda at: at.trigger("imu")])
def test_clocks_that_are_not_known_well_are_refused_before_anything_is_sent(boards, fleet, do):
    """The rate of a board may be off by 1 %: by 36 s in an hour."""
    with pytest.raises(j2a.LocalError, match=r"may be off by \d{8} us in 3\d{3}\.\d s.*discipline"):
        do(fleet.at(soon_us(3600)))
    with pytest.raises(j2a.LocalError, match=r"more than 0\.5 us"):
        do(fleet.at(soon_us(30), within_us=0.5))
    assert do(fleet.at(soon_us(3600), within_us=1e9)).keys() == {"left", "right"}
    assert not boards[0][0].acted


@pytest.mark.parametrize("within_us", ["1", None, True])
def test_what_boards_may_be_off_is_a_number(fleet, within_us):
    with pytest.raises(j2a.WrongArgument, match="within_us"):
        fleet.at(soon_us(1), within_us=within_us)


def test_a_clock_that_was_asked_for_long_may_act_late(boards, fleet):
    """Here exchanges of an hour are made up; rates are known by them."""
    fleet.at(soon_us(60), within_us=1e9).set("lamp", 1, boards=["left"])
    clock = fleet["left"].clock
    estimator = clock._discipline.estimator
    newest = estimator.newest
    for ago_us in range(3600_000_000, 0, -60_000_000):
        estimator.add(
            dataclasses.replace(
                newest,
                sent_us=newest.sent_us - ago_us,
                came_us=newest.came_us - ago_us,
                received_us=newest.received_us - ago_us,
            )
        )
    # By 600 ms where the rate is not known; the newest exchange may have been slow.
    assert fleet.at(soon_us(60), within_us=300_000).set("lamp", 1, boards=["left"])


def set_clock(device, off_us, ago_us=0):
    """Be told twice by something else: first the clock steps, then it is locked."""
    device._ask_clock(b"\1")  # knows when it was received
    local, time_us = device._local_us(), time.time_ns() // 1000 + off_us
    for is_step in (True, False):
        told = Adjust(is_step, local, time_us, 0, 50, 0)
        code, _, _ = device._clock.request(told.pack(), local, local)
        assert code == 0
    device._clock._last = device._clock._last._replace(at=local - ago_us)


def bound_us(clock, time_us):
    """What may be wrong of a time to come, with what `set_clock` adds."""
    estimate = clock._estimate()
    return (
        estimate.uncertainty_us(estimate.to_counter(clock._host.reference.to_counter(time_us)))
        + 5000
    )


@pytest.mark.parametrize(
    ("off_us", "ago_us", "state"),
    [(0, 0, "locked"), (80_000, 0, "locked"), (-3_600_000_000, 0, "locked"), (0, 10**7, "holdover"),
     (-80_000, 10**7, "holdover")],
)  # fmt: skip
def test_a_board_that_follows_another_clock_acts_at_our_time(off_us, ago_us, state):
    with (
        j2a.Device({"serial": "one"}, transducers=read_transds(FILE), clock=0) as device,
        served(device) as url,
    ):
        device.actuator("lamp")(lambda *_what: None)
        set_clock(device, off_us, ago_us)
        with j2a.Fleet(url, timeout=PATIENCE_S, heartbeat=None) as fleet:
            fleet.wait(1, timeout=PATIENCE_S)
            told, time_us = in_time(fleet, lambda at: at.set("lamp", 1)["one"])
            clock = fleet["one"].clock
            assert clock._state == state
            assert abs(told - time_us - off_us) <= bound_us(clock, time_us)
            set_clock(device, 700_000)
            clock._discipline.estimator._exchanges.append(  # long ago
                dataclasses.replace(clock._discipline.estimator._exchanges.pop(), came_us=-1e12)
            )
            told, time_us = in_time(fleet, lambda at: at.set("lamp", 1)["one"])
            assert abs(told - time_us - 700_000) <= bound_us(clock, time_us)


def restart(link, client, _device):
    link.reset()
    while not client.counters.restarts:
        time.sleep(0.001)


def be_set(_link, client, device):
    set_clock(device, 0)
    client.clock.measure(1)


@pytest.mark.parametrize(
    ("meanwhile", "error", "text"),
    [
        (restart, j2a.DeviceRestarted, "restarted after a time on its clock was planned"),
        (be_set, j2a.LocalError, "was set after a time on it was planned"),
    ],
)
def test_an_order_for_a_clock_that_is_gone_is_not_sent(meanwhile, error, text):
    """The second board begins anew, or is set, while the first one is told."""
    with contextlib.ExitStack() as stack:
        devices, clients = [], {}
        for name in ("left", "right"):
            device = j2a.Device({}, boot=True, clock=0, transducers=read_transds(FILE))
            device.actuator("lamp")(lambda *_what: None)
            link = stack.enter_context(Rebooting(device))
            clients[name] = stack.enter_context(j2a.Client(link.near, timeout=PATIENCE_S))
            devices.append(device)
        told = []

        def note(execute, number):
            def answer(opcode, payload):
                if payload[:2] == SET_LAMP:
                    told.append(number)
                    meanwhile(link, clients["right"], devices[1])
                return execute(opcode, payload)

            return answer

        for number, device in enumerate(devices):
            device._table.execute = note(device._table.execute, number)
        with pytest.raises(error, match=text):
            FleetAt(clients, soon_us(60), math.inf).set("lamp", 1)
        assert told == [0]
        assert FleetAt(clients, soon_us(60), math.inf).set("lamp", 1, boards=["left"])


def test_boards_that_follow_us_are_told_our_time():
    """They agree by it better with each other than with us."""
    with (
        j2a.Device({"serial": "one"}, transducers=read_transds(FILE), clock=0) as device,
        served(device) as url,
    ):
        device.actuator("lamp")(lambda *_what: None)
        set_clock(device, 0)
        with j2a.Fleet(url, timeout=PATIENCE_S, heartbeat=None) as fleet:
            fleet.wait(1, timeout=PATIENCE_S)
            told, time_us = in_time(fleet, lambda at: at.set("lamp", 1))
            assert told == {"one": time_us}


@in_event_loop
async def test_boards_of_an_asyncio_fleet_act_at_one_time():
    with contextlib.ExitStack() as stack:
        boards = [stack.enter_context(Board(name)) for name in ("left", "right")]
        urls = [stack.enter_context(served(one)) for one in boards]
        async with j2a.AsyncFleet(*urls, timeout=PATIENCE_S, heartbeat=None) as fleet:
            await fleet.wait(2, timeout=PATIENCE_S)
            for order in (lambda at: at.set("lamp", 3), lambda at: at.trigger("imu")):
                for lead in leads():
                    time_us = soon_us(lead)
                    try:
                        told = await order(fleet.at(time_us, within_us=math.inf))
                        break
                    except j2a.J2AError as error:
                        if not is_late(error):
                            raise
                await asyncio.to_thread(check, boards, told, fleet, time_us)
            with pytest.raises(j2a.LocalError, match=r"may be off by .*discipline"):
                await fleet.at(soon_us(3600)).set("lamp", 3)
            with pytest.raises(j2a.LocalError, match="is over"):
                await fleet.at(soon_us(-1)).set("lamp", 3)


def test_each_board_that_comes_is_disciplined(fleet):
    """As the page Time shows it."""
    with ClockedDevice(ppm=70) as device, served(device) as url:

        def keep(change):
            if change.is_here:
                fleet[change.board].clock.discipline(0.02)

        fleet.on_change(keep)
        fleet.add(url)
        fleet.wait(url, timeout=PATIENCE_S)
        deadline = time.monotonic() + PATIENCE_S
        while device._epoch != 1:
            assert time.monotonic() < deadline
            time.sleep(0.01)
        fleet.remove(url)
