"""Boards that act together: edges of four simulated AVRs for one SET and one TRIGGER.

In: four boards with crystals that are off, each told the true time by ADJUST, and one time at which
all are to act. Out: the true instants of the edges of their pins, which tell the clocks, the main
loops and the waits of all of them. All times are simulated ones.
"""

import struct
from pathlib import Path

import pytest
from j2a_sim import AvrSim
from j2a_spec import constants as c
from j2a_spec.grammar import CLOCK_ADJUST, CLOCK_STATUS
from j2a_spec.oracle import Frame, decode, encode

pytestmark = pytest.mark.avr

APP = Path(__file__).parent / "clock_edges"
OPCODES = [*c.BUILTINS, c.GET_TRANSDS, c.TRANSD, c.CLOCK]
OPCODES.remove(c.GET_DEBUG)
UNIX = 1_700_000_000_000_000
PPMS = (-90.0, -3.5, 40.0, 100.0)
LIMIT_US = 3.0
START_US = 190
"""From the reset to the start of timer 1, the same on each board."""


class Board:
    """A board whose crystal is off: its cycle n comes at n / (16 * (1 + ppm)) us of true time."""

    def __init__(self, elf: Path, ppm: float) -> None:
        self.sim = AvrSim(elf)
        self.cycles_per_us = 16 * (1 + ppm / 1e6)
        self.ppm = ppm
        self.sim.boot()
        self.sim.pins.watch("PB0", "PB1")

    def run_to(self, true_us: float) -> None:
        self.sim.run(int(true_us * self.cycles_per_us) - self.sim.cycle)

    def ask(self, function: str, payload: bytes) -> Frame:
        self.sim.uart_write(encode(Frame(c.SOF, 1, OPCODES.index(function), payload)))
        got = b""
        for _ in range(100):
            self.sim.run(self.sim.cycles(0.001))
            got += self.sim.uart_read()
            for event in decode(got):
                if isinstance(event, Frame) and event.start == c.SOF:
                    return event
        raise AssertionError(f"{function} is not answered")

    def adjust(self) -> None:
        """Tell the true time, as if the local time began with the reset, not START_US later."""
        local = CLOCK_STATUS.parse(self.ask(c.CLOCK, bytes((c.CLOCK_STATUS,))).payload).local
        line = {
            "mode": c.CLOCK_SLEW,
            "local": local,
            "time": UNIX + round(local * 16 / self.cycles_per_us),
            "rate": round((16 / self.cycles_per_us - 1) * 1e9),
            "uncertainty": 1,
            "wander": 0,
        }
        assert self.ask(c.CLOCK, CLOCK_ADJUST.build(line)).opcode == 0

    def edges(self, pin: str) -> list[float]:
        return [edge.cycle / self.cycles_per_us for edge in self.sim.pins.edges(pin)]


def test_four_boards_act_within_three_microseconds(build):
    elf = build("clock_edges", "avr-serial", APP_DIR=str(APP), OPTIONS="-DJ2A_WITH_SYNC=1")
    boards = [Board(elf, ppm) for ppm in PPMS]
    for board in boards:
        board.adjust()
    spreads = []
    for number in range(8):
        at_us = 400_000.0 + 150_000 * number + 0.377 * number
        due = UNIX + round(at_us)
        level = struct.pack("<BBBQB", 0, c.TRANSD_SET, 0, due, number % 2 == 0)
        trigger = struct.pack("<BBQ", 1, c.TRANSD_TRIGGER, due + 20_000)
        for index, board in enumerate(boards):
            board.run_to(at_us - 100_000 + 7_000 * index)
            assert board.ask(c.TRANSD, level).opcode == 0
            assert board.ask(c.TRANSD, trigger).opcode == 0
        found = {}
        for board in boards:
            board.run_to(at_us + 40_000)
            for pin in ("PB0", "PB1"):
                found.setdefault(pin, []).append(board.edges(pin))
        for pin, begin_us in (("PB0", at_us), ("PB1", at_us + 20_000)):
            assert all(len(edges) == 1 for edges in found[pin]), found
            times = [edges[0] for edges in found[pin]]
            assert all(0 < time - begin_us < 2 * START_US for time in times)
            spreads.append(max(times) - min(times))
    print(f"largest difference of edges: {max(spreads):.2f} us")
    assert max(spreads) < LIMIT_US
    for board in boards:
        board.sim.close()
