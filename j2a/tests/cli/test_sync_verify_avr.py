"""`j2a sync verify` with two simulated AVRs whose crystals are off, and a wire from pin to pin.

Both have one time, which is simulated: it passes while a link is read, for both boards together,
and an edge of the one comes to the other at its very instant. Beside the figures that the command
prints the truth is known: the cycles of the edges.
"""

import json
import threading
from pathlib import Path

import j2a_transports
import pytest
from j2a_sim import AvrSim

import j2a
import j2a.cli._sync_verify

pytestmark = pytest.mark.avr

APP = Path(__file__).parents[3] / "firmware/tests/clock_wire"
PPMS = {"driver": -70.0, "referee": 90.0}
SLICE_US = 200.0
WALL_S = 0.0004
"""A slice takes so long at least, lest time flies while the program thinks."""
DELAY_US = 150_000.0


class Wire:
    """Two boards at one time, and a wire from the pin PB0 of the driver to PD2 of the referee.

    Attributes:
        edges_us: true times of the edges to 1, taken at the driver.
        delay_us: of the wire.
        is_cut: no edge arrives.
    """

    def __init__(self, elf):
        self.sims = {name: AvrSim(elf) for name in PPMS}
        self.lock = threading.Lock()
        self.edges_us = []
        self.delay_us = 0.0
        self.is_cut = False
        self._ticking = threading.Event()
        for sim in self.sims.values():
            sim.boot()
            sim.pins.drive("PD2", 0)
        self.sims["driver"].pins.watch("PB0")
        self.now_us = max(sim.time_s for sim in self.sims.values()) * 1e6 * 1.001

    def tick(self):
        """Let a slice of time pass: first for the driver, whose edges are then known."""
        self._ticking.wait(WALL_S)
        with self.lock:
            self.now_us += SLICE_US
            driver, referee = self.sims.values()
            self._run("driver")
            for edge in driver.pins.edges("PB0"):
                at_us = edge.cycle / self._cycles_per_us("driver")
                if edge.level:
                    self.edges_us.append(at_us)
                if self.is_cut:
                    continue
                cycle = int((at_us + self.delay_us) * self._cycles_per_us("referee"))
                referee.pins.drive("PD2", edge.level, max(cycle, referee.cycle))
            self._run("referee")

    def _run(self, name):
        sim = self.sims[name]
        sim.run(max(0, int(self.now_us * self._cycles_per_us(name)) - sim.cycle))

    @staticmethod
    def _cycles_per_us(name):
        return 16 * (1 + PPMS[name] / 1e6)

    def close(self):
        for sim in self.sims.values():
            sim.close()


class WiredLink(j2a_transports.Transport):
    """The UART of one of both boards."""

    is_simulated = True

    def __init__(self, wire, name):
        super().__init__(f"wired:{name}", None)
        self._wire, self._sim, self._closed = wire, wire.sims[name], False
        self.byte_time_s = self._sim.char_cycles / self._sim.frequency_hz

    def clock(self):
        return self._wire.now_us / 1e6

    def read(self, timeout_s):
        end_s = self.clock() + (0.01 if timeout_s is None else max(timeout_s, SLICE_US / 1e6))
        while True:
            if self._closed:
                raise j2a_transports.LinkClosed(f"{self.url} is closed")
            with self._wire.lock:
                if self._sim.readable:
                    return bytes(self._sim.uart_read())
            if self.clock() >= end_s:
                return b""
            self._wire.tick()

    def sleep(self, seconds):
        end_s = self.clock() + seconds
        while self.clock() < end_s:
            self._wire.tick()

    def write(self, data):
        with self._wire.lock:
            self._sim.uart_write(bytes(data))

    @property
    def closed(self):
        return self._closed

    def close(self):
        self._closed = True


@pytest.fixture
def wire(build_firmware, monkeypatch):
    elf = build_firmware("clock_wire", "avr-serial", APP_DIR=str(APP), OPTIONS="-DJ2A_WITH_SYNC=1")
    wire = Wire(elf)
    monkeypatch.setattr(
        j2a.cli._sync_verify,
        "connect",
        lambda _args, name: j2a.Client(WiredLink(wire, name), timeout=5),
    )
    yield wire
    wire.close()


def test_two_boards_agree_as_well_as_they_say(run, wire):
    result = run("sync", "verify", "driver", "referee", "--count", "8", "--json")
    print(result.out, result.err)
    assert (result.code, result.err) == (0, "")
    figures = json.loads(result.out)
    assert (figures["edges"], figures["outside"]) == (8, 0)
    assert len(wire.edges_us) >= 8  # one more for each order that came late


def test_a_wire_that_is_longer_than_it_may_be_is_measured(run, wire):
    """As a clock that is off by as much would be."""
    wire.delay_us = DELAY_US
    words = ("sync", "verify", "driver", "referee", "--count", "2", "--json")
    result = run(*words)
    print(result.out, result.err)
    assert result.code == 1
    assert "2 of 2 edges are outside what is announced" in result.err
    figures = json.loads(result.out)
    pairs = zip(figures["errors_us"], figures["bounds_us"], strict=True)
    assert all(abs(error - DELAY_US) <= bound for error, bound in pairs)
    assert run(*words, "--delay", str(DELAY_US)).code == 0


def test_a_wire_that_is_not_there(run, wire):
    wire.is_cut = True
    result = run("sync", "verify", "driver", "referee")
    assert result.code == 4
    assert "edge 1 of 20: no sample of edge came" in result.err
    assert wire.edges_us
