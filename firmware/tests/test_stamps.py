"""Times of samples on an AVR, whose interrupts note the timer: exact at each cycle, and cheap.

Edges come from here and have their cycle; what a sample says is compared with it.
"""

import re
from pathlib import Path

import pytest
from j2a_spec import constants as c

from firmware.verify.budget.sensor_load import CHIPS, FORWARD, QUAD, Board

pytestmark = pytest.mark.avr

PAGE = Path(__file__).parents[2] / "docs/transducers.md"
CHIP = CHIPS["atmega328p"]
US = 16  # cycles
TICK = 64  # cycles of timer 1, and the error of a time
TURN = 65536 * TICK  # cycles until the timer overflows
LATE = 250  # cycles from an edge to its stamp, with another interrupt in between


class Shaft:
    """Apps/servo with its encoder 0, which stands at A = B = 0, and a host."""

    def __init__(self, elf):
        self.board = Board(elf)
        self.sim = self.board.sim
        self.board.ask("a2jTransd", "B", bytes((QUAD, c.TRANSD_ENABLED, 0)))  # no SIFs
        self.steps = 0
        self.step(self.sim.cycle + 5000)
        self.offset = self.edge - self.time_us() * US  # the cycle at which the clock began

    def step(self, cycle):
        """Turn forward by one at a cycle, and let some time pass."""
        at = self.steps % 4
        self.sim.pins.drive(CHIP.encoders[at % 2], FORWARD[at][at % 2], cycle)
        self.steps += 1
        self.edge = cycle
        self.board.run_to(cycle + 2000)

    def time_us(self):
        sample = self.board.ask("a2jTransd", "QhQh", bytes((QUAD, c.TRANSD_SAMPLE)))
        assert sample[1:] == (self.steps, 0, 0)
        return sample[0]

    def late(self):
        """Cycles by which the newest sample says that the edge came later than it did."""
        return self.time_us() * US + self.offset - self.edge


@pytest.fixture
def shaft(build):
    made = Shaft(build("servo", "avr-serial", BAUD="500000"))
    yield made
    assert made.sim.log == ""
    made.sim.close()


def test_an_edge_at_any_cycle_around_an_overflow_of_the_timer(shaft):
    """The interrupt that counts overflows comes before, behind or while the time is taken."""
    for before in range(-100, 400, 15):
        turn = (shaft.sim.cycle - shaft.offset) // TURN + 1
        shaft.step(shaft.offset + turn * TURN - before)
        assert -2 * TICK <= shaft.late() <= 2 * TICK + LATE, before


def test_a_value_keeps_its_time_while_the_timer_goes_around(shaft):
    shaft.step(shaft.sim.cycle + 3000)
    first = shaft.late()
    assert -2 * TICK <= first <= 2 * TICK + LATE
    for _ in range(3):
        shaft.sim.run(TURN + 12345)
        assert shaft.late() == first


@pytest.mark.parametrize(
    ("options", "figures", "most"),
    [
        ("", r"takes (\d+) cycles for a step, (\d+) for both encoders", 300),
        ("-DJ2A_WITH_SYNC=1", r"`J2A_WITH_SYNC` they are (\d+) and (\d+)", 1000),
    ],
)
def test_the_interrupt_takes_the_cycles_of_the_page(build, options, figures, most):
    (found,) = re.findall(figures, " ".join(PAGE.read_text("utf-8").split()))
    one, both = map(int, found)
    shaft = Shaft(build("servo", "avr-serial", BAUD="500000", OPTIONS=options))
    for channels, cycles in (((0,), one), ((1,), one), ((0, 1), both)):
        shaft.sim.clear_interrupts()
        at = shaft.sim.cycle + 2000
        for channel in channels:
            for wire in (0, 1):
                shaft.sim.pins.drive(CHIP.encoders[2 * channel + wire], 0, at - 1000)
            shaft.sim.pins.drive(CHIP.encoders[2 * channel], 1, at)
        shaft.sim.run(6000)
        assert cycles - 10 <= shaft.sim.interrupts(CHIP.quad).longest_cycles <= cycles
    assert one < most
    shaft.sim.close()
