"""`j2a sync verify` with two Python devices and a wire between them that has a delay.

The wire carries an edge at the time of its order, by the true clocks of both devices, not at the
moment at which a thread of this computer runs: so the figures are those of the clocks.
"""

import json
import math
import struct
import threading
import time
from types import SimpleNamespace

import pytest
from j2a_spec import constants as c

import j2a
from j2a.cli._exit import UsageError
from j2a.cli._sync_verify import _announced_us
from j2a.protocol.clock import Adjust
from j2a.syncd.singleton import Server
from j2a.types.transds_file import read_transds

from .conftest import WAIT_S, served

DRIVER = "ACTUATOR(lamp, 1, lamp, X, 1, u8, none)"
REFEREE = "SENSOR(edge, 2, edge, X, 1, u8, none)"
SET = struct.Struct("<BBBQB")
STEADY_US = 50


class Wire(j2a.Device):
    """The driver, whose pin is wired to the referee.

    Attributes:
        delay_us: from the time of an order to the time stamp.
        is_cut: no edge arrives.
    """

    def __init__(self, referee, text=DRIVER, ppm=-70.0):
        super().__init__(clock=ppm, transducers=read_transds(text))
        self.delay_us = 0
        self.is_cut = False
        self._referee = referee
        self._at_us = 0
        self._run_call = self._table.execute
        self._table.execute = self._note
        self.actuator("lamp")(self._edge)

    def _note(self, opcode, payload):
        if len(payload) == SET.size and payload[1] == c.TRANSD_SET:
            self._at_us = SET.unpack(payload)[3]
        return self._run_call(opcode, payload)

    def _edge(self, _channel, value):
        if self.is_cut:
            return
        # Both clocks at one instant: a reading in which this thread had to wait is not one.
        before, there, after = self.clock_us, self._referee.clock_us, self.clock_us
        while after - before > STEADY_US:
            before, there, after = self.clock_us, self._referee.clock_us, self.clock_us
        late_us = (before + after) // 2 - self._at_us if self._at_us else 0
        runner = self._referee._transducers()
        with runner._changed:
            stamp_us = there - late_us + self.delay_us
            runner._server.sensor("edge").sense(0, [value], stamp_us, is_raw=True)
            runner._wake()


@pytest.fixture
def referee():
    return j2a.Device(clock=90.0, transducers=read_transds(REFEREE))


@pytest.fixture
def wire(referee):
    return Wire(referee)


@pytest.fixture
def urls(wire, referee):
    one, other = served(wire), served(referee)
    yield next(one), next(other)
    for board in (one, other):
        next(board, None)


def test_two_clocks_agree_as_well_as_they_say(run, urls):
    result = run("sync", "verify", *urls, "--count", "5", "--json")
    assert (result.code, result.err) == (0, "")
    figures = json.loads(result.out)
    assert (figures["edges"], figures["outside"]) == (5, 0)
    errors, bounds = figures["errors_us"], figures["bounds_us"]
    assert all(abs(one) <= bound for one, bound in zip(errors, bounds, strict=True))
    assert figures["peak_us"] == max(map(abs, errors))
    assert figures["median_us"] == sorted(errors)[2]
    assert 0 < figures["bound_us"] < 1e6


def test_nobody_asks_the_clock_of_a_board_that_waits_for_its_time(run, wire, urls):
    """Its main loop would be busy then, and the pin be set late."""
    execute, edge, asked = wire._table.execute, wire._edge, []

    def note(opcode, payload):
        if len(payload) == SET.size and payload[1] == c.TRANSD_SET:
            asked.append([])
        elif asked and payload[:1] in {bytes((c.CLOCK_EXCHANGE,)), bytes((c.CLOCK_ADJUST,))}:
            asked[-1].append(payload)
        return execute(opcode, payload)

    def move(channel, value):
        if value:
            found.append(len(asked[-1]))
        edge(channel, value)

    found = []
    wire._table.execute = note
    wire.actuator("lamp")(move)
    assert run("sync", "verify", *urls, "--count", "8").code == 0
    assert found == [0] * 8


def test_an_error_is_found(run, wire, urls):
    wire.delay_us = 450_000
    result = run("sync", "verify", *urls, "--count", "3")
    assert result.code == 1
    assert "3 of 3 edges are outside what is announced" in result.err
    *lines, last = result.out.splitlines()
    assert [line.split()[0] for line in lines] == ["1", "2", "3"]
    median_us = float(last.split("median ")[1].split()[0])
    assert abs(median_us - wire.delay_us) < 200_000


def test_a_delay_that_is_known_is_subtracted(run, wire, urls):
    wire.delay_us = 450_000
    words = ("--count", "2", "--delay", "450000", "--json")
    assert json.loads(run("sync", "verify", *urls, *words).out)["outside"] == 0
    wire.delay_us = 0
    assert json.loads(run("sync", "verify", *urls, *words).out)["outside"] == 2


def test_a_bound_of_the_user(run, wire, urls):
    wire.delay_us = 450_000
    result = run("sync", "verify", *urls, "--count", "2", "--bound", "900000", "--json")
    assert (result.code, json.loads(result.out)["bound_us"]) == (0, 900_000)


def test_clocks_that_another_program_keeps_are_left_alone(run, urls, monkeypatch):
    monkeypatch.setattr("j2a.cli._sync_verify._LOCKED_S", 0.2)
    result = run("sync", "verify", *urls, "--no-discipline")
    assert result.code == 4
    assert "is free after 0.2 s, not locked" in result.err
    monkeypatch.setattr("j2a.cli._sync_verify._LOCKED_S", WAIT_S)
    with (
        j2a.connect(urls[0]) as one,
        j2a.connect(urls[1]) as other,
        one.clock.discipline(),
        other.clock.discipline(),
    ):
        assert run("sync", "verify", *urls, "--no-discipline", "--count", "2").code == 0


@pytest.fixture
def told_by_syncusb(wire, referee):
    """Both clocks are right and locked, but know not how well, as behind SyncUSB packets."""
    for device in (wire, referee):
        device._ask_clock(bytes([c.CLOCK_STATUS]))
        for is_step in (True, False):
            local, time_us = device._local_us(), time.time_ns() // 1000
            told = Adjust(is_step, local, time_us, 0, c.CLOCK_UNKNOWN, 0)
            assert device._clock.request(told.pack(), local, local)[0] == 0


@pytest.mark.parametrize("uncertainty_us", [200_000.0, None])
def test_a_daemon_announces_what_boards_with_syncusb_do_not(
    run, urls, told_by_syncusb, uncertainty_us, monkeypatch, tmp_path
):
    monkeypatch.setenv("J2A_RUNTIME_DIR", str(tmp_path))
    words = ("sync", "verify", *urls, "--no-discipline", "--count", "1")
    result = run(*words)
    assert result.code == 2
    assert "SyncUSB only, and no j2a syncd says so: --bound US" in result.err
    row = {"uncertainty_us": uncertainty_us}
    rows = [{"board": f"board {url}", "place": url, **row} for url in urls]
    daemon = Server(tmp_path, lambda _request, _is_trusted: {"boards": rows})
    daemon.start()
    try:
        result = run(*words, "--json")
    finally:
        daemon.close()
    if uncertainty_us is None:
        assert result.code == 2
    else:
        assert json.loads(result.out)["bound_us"] == 2 * uncertainty_us


@pytest.mark.parametrize("url", ["usb://left", "usb:left", "usb://6666:cafe/left", "usb://1-2.3"])
def test_boards_on_a_usb_are_known_to_the_daemon_by_serial_or_place(monkeypatch, url):
    rows = [
        {"board": "left", "place": "usb 1-2.3", "uncertainty_us": 80},
        {"board": "usb 1-2.4", "place": "usb 1-2.4", "uncertainty_us": 90},
    ]
    monkeypatch.setattr("j2a.cli._sync_verify.ask", lambda *_what: {"boards": rows})
    board, status = SimpleNamespace(url=url), SimpleNamespace(uncertainty_us=None)
    assert _announced_us(board, status) == 80


LEFT = {"board": "left", "place": "left"}


@pytest.mark.parametrize(
    "rows",
    [
        None,
        "x",
        [1],
        [{}],
        [{"board": "left", "place": 1}],
        [{"board": "left", "place": ""}],
        *([LEFT | {"uncertainty_us": bad}] for bad in (10**400, math.inf, math.nan, -1, "9", True)),
    ],
)
def test_a_daemon_that_tells_something_else_announces_nothing(monkeypatch, rows):
    monkeypatch.setattr("j2a.cli._sync_verify.ask", lambda *_what: {"boards": rows})
    board, status = SimpleNamespace(url="usb://left"), SimpleNamespace(uncertainty_us=None)
    with pytest.raises(UsageError, match="no j2a syncd says so: --bound US"):
        _announced_us(board, status)


def test_without_a_wire(run, wire, urls, monkeypatch):
    monkeypatch.setattr("j2a.cli._sync_verify._EDGE_S", 0.6)
    wire.is_cut = True
    result = run("sync", "verify", *urls, "--json")
    assert result.code == 4
    assert "edge 1 of 20: no sample of edge came" in json.loads(result.out)["error"]["message"]


def test_an_order_that_comes_late_is_given_again(run, wire, urls):
    """It says nothing of the clocks."""
    execute, late = wire._table.execute, []

    def dawdle(opcode, payload):
        is_set = len(payload) == SET.size and payload[1] == c.TRANSD_SET
        if is_set and (at_us := SET.unpack(payload)[3]):
            # The pin is set when the order comes.
            wire.delay_us = 0 if late else 450_000
            if late:
                return execute(opcode, payload)
            late.append(at_us)
            while wire.clock_us < at_us + 20_000:
                time.sleep(0.01)
        return execute(opcode, payload)

    wire._table.execute = dawdle
    result = run("sync", "verify", *urls, "--count", "2", "--json")
    assert (result.code, result.err) == (0, "")
    assert late
    assert json.loads(result.out)["outside"] == 0


def test_orders_that_all_come_late(run, urls, monkeypatch):
    monkeypatch.setattr("j2a.cli._sync_verify._LEADS_US", (0, 0))
    result = run("sync", "verify", *urls, "--count", "1")
    assert result.code == 4
    assert "edge 1 of 1: each order reached its board after its time" in result.err


def test_a_sensor_that_never_is_quiet(run, referee, urls):
    ended = threading.Event()

    def chatter():
        while not ended.wait(0.01):
            referee.sense("edge", 0, 0)

    thread = threading.Thread(target=chatter)
    thread.start()
    try:
        result = run("sync", "verify", *urls)
    finally:
        ended.set()
        thread.join()
    assert result.code == 1
    assert "edge sends samples all the time" in result.err


def test_a_sensor_that_was_off_is_off_again(run, wire, referee, urls):
    with j2a.connect(urls[1]) as board:
        board.transducers["edge"].enabled = False
        assert run("sync", "verify", *urls, "--count", "1").code == 0
        assert board.transducers["edge"].enabled is False


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--actuator", "arm"], "has no actuator 'arm'; it has: lamp"),
        (["--sensor", "eye"], "has no sensor 'eye'; it has: edge"),
        (["--count", "0"], "not from 1 up"),
        (["--bound", "0"], "must be greater than 0, not 0"),
        (["--delay", "nan"], "is not finite"),
        (["-o", "x.svg"], "only plot does"),
    ],
)
def test_what_cannot_be_done_is_told(run, urls, words, text):
    try:
        result = run("sync", "verify", *urls, *words)
    except SystemExit:
        raise AssertionError("argparse must not end the program") from None
    assert result.code == 2
    assert text in result.err


def test_boards_that_cannot_take_part(run, urls):
    plain = served(j2a.Device(transducers=read_transds(REFEREE)))
    url = next(plain)
    try:
        result = run("sync", "verify", urls[0], url)
        assert result.code == 2
        assert "capability clock" in result.err
        assert "--actuator NAME says which one: none" in run("sync", "verify", url, url).err
        assert "two URLs" in run("sync", "verify", url).err
        assert "status takes no URL" in run("sync", "status", url).err
    finally:
        next(plain, None)


def test_a_clock_that_is_set_in_between_is_told(run, wire, urls):
    execute = wire._table.execute

    def step(opcode, payload):
        if len(payload) == SET.size and payload[1] == c.TRANSD_SET and SET.unpack(payload)[3]:
            wire._clock._epoch = wire._clock._epoch % 255 + 1
        return execute(opcode, payload)

    wire._table.execute = step
    result = run("sync", "verify", *urls, "--count", "1")
    assert result.code == 1
    assert "was set between order and edge" in result.err
