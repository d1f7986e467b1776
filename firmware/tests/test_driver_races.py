"""What the drivers share between their interrupts and the main context: an interrupt at each cycle.

Each test lets the interrupt wander across the function in steps of one cycle. Where it has to look
is found by what the function says: before that cycle the new value, after it the old one.
"""

import struct
import subprocess
from pathlib import Path

import pytest
from j2a_sim import AvrSim, pulses

from firmware.verify.budget.sensor_load import CHIPS, QUAD, QUAD_AT, Board, values

HERE = Path(__file__).parent
DRIVERS = HERE.parent / "drivers"
AROUND = 150  # cycles before and after, which is more than either function takes

pytestmark = pytest.mark.avr


def first(low, high, holds):
    """The first number in a range for which something holds, as it then does for all others."""
    assert not holds(low)
    assert holds(high)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if holds(middle) else (middle, high)
    return high


@pytest.fixture(scope="module")
def app(build):
    """The sensors app."""
    board = Board(build("sensors", "avr-serial", BAUD="500000"))
    yield board
    board.sim.close()


def sample_and_step(board, cycle, is_sent):
    """Take a count of 255 while a step makes it 256, from a reset on, so each cycle is the same.

    A read of SAMPLE takes it, or a sample SIF. Returns the samples, time and count: the one of
    before, that which was taken when the step came at `cycle`, and the newest one behind it.
    """
    a, b = board.chip.encoders[:2]
    board.pins.drive(a, 0)
    board.pins.drive(b, 0)
    board.reset()
    board.quiet()
    if is_sent:
        board.send_each(0, QUAD)
    board.set(QUAD_AT, 255)
    old = None if is_sent else board.sample(QUAD)[0]
    board.pins.drive(a, 1, board.sim.cycle + cycle)
    if not is_sent:
        during = board.sample(QUAD)[0]
        board.pause(0.0005)
        return old, during, board.sample(QUAD)[0]
    board.pause(0.003)
    sent = [values(QUAD, sif.payload)[0] for sif in board.sifs]
    assert len(sent) <= 2  # none comes twice
    return old, sent[0], sent[-1]


@pytest.mark.parametrize("is_sent", [True, False])
def test_a_step_while_its_sample_is_taken(app, is_sent):
    """A sample is the old or the new one, time and count; and the new one comes at last."""
    assert app.chip is CHIPS["atmega328p"]
    last = 9000
    middle = first(0, last, lambda cycle: sample_and_step(app, cycle, is_sent)[1][1] == 255)
    assert middle > AROUND
    early, late = (sample_and_step(app, cycle, is_sent) for cycle in (0, last))
    olds = {late[1]}
    assert late[1][1] == 255
    seen = set()
    for cycle in range(middle - AROUND, middle + AROUND):
        old, during, after = sample_and_step(app, cycle, is_sent)
        assert old in {None, *olds}
        assert after[1] == 256
        # The step comes later than in `early` by so many cycles; a tick is 4 us.
        assert after[0] == pytest.approx(early[2][0] + cycle / 16, abs=16), cycle
        assert during in {*olds, after}, cycle
        seen.add(during[1])
    assert seen == {255, 256}


@pytest.fixture(scope="module")
def servo(need, tmp_path_factory):
    """The servos' driver alone, at 8 MHz, with pulses whose both bytes differ."""
    need("avr-gcc")
    elf = tmp_path_factory.mktemp("servo") / "servo_set.elf"
    command = ["avr-gcc", "-mmcu=atmega328p", "-std=gnu99", "-Os", "-Wall", "-Wextra", "-Werror"]
    command += ["-DF_CPU=8000000", "-DSERVO_SPAN_US=1000", f"-I{DRIVERS}", f"-I{DRIVERS}/avr"]
    command += [str(HERE / "drivers" / "servo_set.c"), f"{DRIVERS}/avr/servo.c"]
    command += [f"{DRIVERS}/ticks.c", "-o", str(elf)]
    subprocess.run(command, check=True)
    with AvrSim(elf, frequency_hz=8_000_000) as sim:
        sim.pins.watch("PB1")
        yield sim


def set_servo(sim, deflection, cycles):
    """Set it so many cycles after servo 1's interrupt; returns the pulses from there on, in us."""
    sim.write_memory("deflection", struct.pack("<b", deflection))
    sim.write_memory("fours", struct.pack("<H", cycles // 4))
    sim.write_memory("cycles", bytes((cycles % 4,)))
    sim.write_memory("go", b"\1")
    assert sim.run_until(lambda: sim.read_memory("go", 1) == b"\0", sim.cycles(0.05), 2000)
    start = sim.cycle - cycles - 4000  # servo 1's interrupt, or up to 4000 cycles before
    sim.run(sim.cycles(0.024))  # two pulses begin 10 and 30 ms after that interrupt
    found = pulses(sim.pins.edges("PB1"))
    return [pulse.cycles // 8 for pulse in found if pulse.start > start]


@pytest.mark.parametrize("deflection", [-100, 100])
def test_a_deflection_that_is_set_while_a_pulse_begins(servo, deflection):
    """A pulse of 63 ticks of 8 us or of 313; one with a byte of each is none."""
    old, new = (63 * 8, 313 * 8) if deflection > 0 else (313 * 8, 63 * 8)

    def shot(cycles):
        set_servo(servo, -deflection, 4)
        return set_servo(servo, deflection, cycles)

    shot(4)  # before the first one there are no pulses
    middle = first(4, 90_000, lambda cycles: shot(cycles)[0] == old)
    seen = set()
    for cycles in range(middle - AROUND, middle + AROUND):
        found = shot(cycles)
        assert set(found) <= {old, new}, cycles
        assert found[-1] == new
        seen.add(found[0])
    assert seen == {old, new}
