"""The simulated pins and analog inputs: levels, edges, voltages, and their cycles."""

import itertools
import time

import pytest
from j2a_sim import AvrSim, Edge, Pulse, SimError, pulses

pytestmark = pytest.mark.avr

SECOND = 16_000_000


def ask(sim, request, count):
    """Send a request, and wait for so many bytes."""
    sim.uart_write(request)
    answer = b""
    while len(answer) < count:
        assert sim.run_until_output(SECOND)
        answer += sim.uart_read()
    return answer


@pytest.fixture
def sim(simulate):
    sim = simulate("pins")
    sim.boot()
    sim.run(100)
    return sim


def test_an_output_that_the_program_drives(sim):
    sim.pins.watch("PB1")
    sim.uart_write(b"t")
    sim.run(20000)
    (pulse,) = pulses(sim.pins.edges("PB1"))
    assert pulse.cycles == 160
    assert sim.pins.edges("PB1") == []
    assert sim.pins.level("PB1") == 0


def test_an_output_of_a_compare_unit_is_exact(sim):
    """2000 cycles, in a program that polls with instructions of several cycles."""
    sim.pins.watch("PB1", "PB0")
    sim.uart_write(b"c")
    sim.run(20000)
    assert [pulse.cycles for pulse in pulses(sim.pins.edges("PB1"))] == [2000]
    assert [edge.level for edge in sim.pins.edges("PB0")] == [1]


def test_edges_that_come_at_their_cycles(sim):
    """Scheduled out of order; INT0 counts each, and the watched pin tells the same cycles."""
    start = sim.cycle + 1000
    edges = [Edge(start + 300 * n, 1 - n % 2) for n in range(41)]
    sim.pins.watch("PD2")
    sim.pins.play("PD2", [(edge.cycle, edge.level) for edge in edges[20:]])
    sim.pins.play("PD2", [(edge.cycle, edge.level) for edge in edges[:20]])
    assert sim.pins.waiting == 41
    sim.run(start - sim.cycle + 300 * 41)
    assert sim.pins.waiting == 0
    assert sim.pins.edges("PD2") == edges
    assert sim.pins.level("PD2") == 1
    assert ask(sim, b"n", 1) == bytes([41])


def test_an_interrupt_comes_again_and_again_while_its_pin_is_low(simulate):
    sim = simulate("low")
    sim.boot()
    sim.pins.drive("PD2", 1)

    def count():
        before = sim.interrupts(1).count
        sim.run(10_000)
        return sim.interrupts(1).count - before

    assert count() == 0
    assert ask(sim, b"e", 1) == b"e"
    assert count() == 0
    sim.pins.drive("PD2", 0)
    assert 200 < count() < 1000
    assert ask(sim, b"d", 1) == b"d"
    assert count() == 0
    sim.pins.drive("PD2", 1)
    assert ask(sim, b"e", 1) == b"e"
    sim.run(1000)
    assert count() == 0


def test_a_low_pin_without_an_interrupt_costs_no_time(simulate):
    """simavr would look at it in each cycle, and take 17 times as long."""
    took = {}
    for level in (1, 0):
        sim = simulate("echo")
        sim.boot()
        sim.pins.drive("PD3", level)
        began = time.process_time()
        sim.run(SECOND // 4)
        took[level] = time.process_time() - began
    assert took[0] < 5 * took[1]


def test_interrupts_are_counted_and_measured(sim):
    """INT1's handler: 4 cycles to enter, 3 for the jump, 2 for SBI, 4 for RETI."""
    sim.pins.watch("PB0")
    start = sim.cycle + 500
    sim.pins.play("PD3", [(start + 1000 * n, 1 - n % 2) for n in range(10)])
    sim.run(12000)
    figures = sim.interrupts(2)
    assert (figures.count, figures.longest_cycles, figures.total_cycles) == (10, 13, 130)
    assert figures.latest_cycles <= 4
    late = [edge.cycle - (start + 1000 * n) for n, edge in enumerate(sim.pins.edges("PB0"))]
    assert len(late) == 10
    # The interrupt waits for the end of an instruction, and SBI begins 7 cycles later.
    assert min(late) >= 7
    assert max(late) <= 7 + 4
    sim.clear_interrupts()
    assert sim.interrupts(2).count == 0
    with pytest.raises(SimError, match="no interrupt vector 40"):
        sim.interrupts(40)


def test_a_pin_held_low_against_its_pull_up(sim):
    """The program writes PORTD after it has switched the pull-up on; then the pin is let go."""
    sim.pins.drive("PD4", 0)
    sim.pins.watch("PD4")
    assert ask(sim, b"p", 1)[0] & 0x30 == 0x20  # PD5's pull-up, and nobody holds it
    assert sim.pins.edges("PD4") == []
    released = sim.cycle + 500
    sim.pins.release("PD4", released)
    sim.run(2000)
    assert sim.pins.edges("PD4") == [Edge(released, 1)]
    assert ask(sim, b"p", 1)[0] & 0x30 == 0x30


def test_an_open_collector_rises_as_slowly_as_its_wire(sim):
    """High a time after the pull-up was switched on, or after it was let go; held low meanwhile."""
    sim.pins.release("PD4", rise_cycles=700)
    sim.pins.watch("PD4", "PD5")
    sim.run(5000)
    assert sim.pins.edges("PD4") == []  # nothing pulls it up yet
    assert ask(sim, b"p", 1)[0] & 0x30 == 0x20
    on = sim.pins.edges("PD5")[0].cycle  # its pull-up is switched on next, by LDI or SBI
    sim.run(5000)
    (edge,) = sim.pins.edges("PD4")
    assert edge.level == 1
    assert -8 <= edge.cycle - 700 - on <= 0
    assert ask(sim, b"p", 1)[0] & 0x30 == 0x30
    start = sim.cycle + 100
    sim.pins.drive("PD4", 0, start)
    sim.pins.release("PD4", start + 300, rise_cycles=50)
    sim.pins.drive("PD4", 0, start + 1000)
    sim.pins.release("PD4", start + 1300, rise_cycles=50)
    sim.pins.drive("PD4", 0, start + 1330)  # before it was high
    sim.run(3000)
    assert sim.pins.edges("PD4") == [*(Edge(start, 0), Edge(start + 350, 1), Edge(start + 1000, 0))]


def test_a_reset_switches_the_pull_up_off(sim):
    """It ends the rise, which begins anew with the next pull-up."""
    sim.pins.release("PD4", rise_cycles=50_000)
    ask(sim, b"p", 1)
    sim.pins.watch("PD4")
    sim.reset()
    sim.boot()
    sim.run(100_000)
    assert sim.pins.edges("PD4") == []
    ask(sim, b"p", 1)
    sim.run(45_000)
    assert sim.pins.edges("PD4") == []
    sim.run(6_000)
    assert [edge.level for edge in sim.pins.edges("PD4")] == [1]


def test_the_flag_of_a_pin_change_interrupt(sim):
    """Set by a change while the interrupt is off; served when it is switched on, unless cleared."""
    assert ask(sim, b"i", 1) == b"\0"
    sim.pins.drive("PC0", 1)
    sim.run(500)
    assert ask(sim, b"i", 1) == b"\1"
    assert ask(sim, b"i", 1) == b"\1"
    sim.pins.drive("PC0", 0)
    sim.run(500)
    assert ask(sim, b"x", 1) == bytes([1 << 1])  # the flag, which it then clears
    assert ask(sim, b"x", 1) == b"\0"
    assert ask(sim, b"i", 1) == b"\1"


def test_what_is_driven_stays_across_a_reset(sim):
    sim.pins.drive("PD4", 1)
    sim.pins.drive("PD6", 1, sim.cycle + 3000)
    sim.reset()
    sim.boot()
    sim.run(5000)
    assert ask(sim, b"p", 1)[0] & 0x50 == 0x50


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda pins: pins.drive("D2", 1), "'D2' is no pin: name it by port and bit"),
        (lambda pins: pins.drive("PD8", 1), "'PD8' is no pin"),
        (lambda pins: pins.watch("PA0"), "atmega328p has no port A"),
        (lambda pins: pins.drive("PD2", 2), "level 2 of PD2 is neither 0 nor 1"),
        (lambda pins: pins.drive("PD2", 1, 5), "cycle 5 is over"),
        (lambda pins: pins.release("PD2", rise_cycles=-1), "rise_cycles -1 is out of range"),
    ],
)
def test_wrong_pins(sim, call, text):
    with pytest.raises(SimError, match=text):
        call(sim.pins)


def test_pulses_of_edges():
    edges = [Edge(5, 0), Edge(10, 1), Edge(30, 0), Edge(40, 1), Edge(45, 0), Edge(60, 1)]
    assert pulses(edges) == [Pulse(10, 20), Pulse(40, 5)]


@pytest.mark.parametrize(
    ("volts", "avcc", "counts"),
    [
        *((0, 5, 0), (5 / 1024, 5, 1), (2.5, 5, 512), (4.994, 5, 1022), (4.996, 5, 1023)),
        *((5, 5, 1023), (1.1, 3.3, 341), (3.3, 3.3, 1023), (5, 3.3, 1023)),
    ],
)
def test_counts_of_the_adc(sim, volts, avcc, counts):
    """The data sheet's formula: V * 1024 / reference, without its fraction, at most 1023."""
    sim.adc.set_references(avcc_volts=avcc)
    sim.adc.set_volts(3, volts)
    sim.adc.set_volts(2, 1.0)
    assert int.from_bytes(ask(sim, b"a\3", 2), "little") == counts
    assert sim.log == ""


def test_a_conversion_takes_25_periods_then_13(sim):
    """Sampled 1.5 periods of 128 cycles after its beginning; the result is of that moment."""
    taken = []
    for _ in range(3):
        done = sim.adc.conversions
        sim.uart_write(b"a\0")
        sim.run_until(lambda: sim.read_memory(0x7A, 1)[0] & 0x40, SECOND, 1)
        begin = sim.cycle
        sim.run_until(lambda done=done: sim.adc.conversions > done, SECOND, 1)
        taken.append(sim.cycle - begin)
        sim.run(5000)
    assert 25 * 128 <= taken[0] <= 26 * 128 + 4
    for cycles in taken[1:]:
        assert 13 * 128 <= cycles <= 14 * 128 + 4
    sim.uart_read()
    # The voltage changes some time after the beginning; the last moment at which that counts:
    seen = set()
    for after in range(0, 500, 20):
        sim.adc.set_volts(0, 0)
        sim.uart_write(b"a\0")
        sim.run_until(lambda: sim.read_memory(0x7A, 1)[0] & 0x40, SECOND, 1)
        sim.adc.set_volts(0, 5, sim.cycle + after)
        sim.run(5000)
        seen.add((after, int.from_bytes(sim.uart_read(), "little")))
    limit = max(after for after, counts in seen if counts == 1023)
    assert {counts for after, counts in seen if after <= 128} == {1023}
    assert 1.5 * 128 - 20 <= limit <= 2.5 * 128 + 4
    assert {counts for after, counts in seen if after > limit} == {0}


def test_free_running(sim):
    """Left adjusted, prescaler 64: the voltage of each conversion, 832 cycles apart."""
    sim.adc.set_volts(0, 2.5)
    assert ask(sim, b"f", 4) == bytes([128] * 4)
    assert sim.adc.conversions >= 4


@pytest.mark.parametrize(("trigger", "many"), [(0, True), (4, False)])
def test_only_free_running_begins_a_conversion_of_itself(open_chip, trigger, many):
    """ADTS 4 waits for timer 0, which stands still."""
    chip = open_chip("atmega32u4")
    adcsra, adcsrb = 0x7A, 0x7B
    chip.put(adcsrb, trigger)
    chip.put(adcsra, 0xE4)
    chip.ms(10)
    assert (chip.sim.adc.conversions > 1) == many
    assert chip.sim.adc.conversions > 0
    assert bool(chip.get(adcsra) & 0x40) == many
    assert ("ADTS is 4" in chip.sim.log) == (not many)


@pytest.mark.parametrize("asked", [b"d", b"a\x09"], ids=["differential", "reserved"])
def test_what_the_adc_does_not_model_is_in_the_log(sim, asked):
    assert ask(sim, asked, 2) == b"\0\0"
    assert "only single-ended channels" in sim.log


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda adc: adc.set_volts(16, 1), "channel 16 is out of range 0..15"),
        (lambda adc: adc.set_volts(0, -0.1), "-0.1 V is out of range"),
        (lambda adc: adc.set_volts(0, float("nan")), "nan V is out of range"),
        (lambda adc: adc.set_volts(0, 1, 5), "cycle 5 is over"),
        (lambda adc: adc.set_references(0), "a reference of 0 V is out of range"),
    ],
)
def test_wrong_voltages(sim, call, text):
    with pytest.raises(SimError, match=text):
        call(sim.adc)


def test_the_same_stimuli_give_the_same_cycles(simulate):
    def record(step):
        sim = simulate("pins")
        sim.boot()
        sim.pins.watch("PB0", "PB1")
        sim.pins.play("PD3", [(20_000 + 777 * n, 1 - n % 2) for n in range(50)])
        sim.uart_write(b"ctc")
        while sim.cycle < 100_000:
            sim.run(min(step, 100_000 - sim.cycle))
        return sim.pins.edges("PB0"), sim.pins.edges("PB1")

    first = record(100_000)
    assert all(len(edges) > 3 for edges in first)
    assert record(999) == first
    assert record(1) == first


def test_relatives_of_chips_of_simavr(firmware):
    """An ATmega32U2 has 1 KB of RAM and 32 KB of flash; it has no ADC."""
    with AvrSim(firmware("relative", mcu="atmega32u2"), "atmega32u2", uart="1") as sim:
        sim.run(20000)
        assert sim.uart_read() == b"\xa5\x5a"
        assert 0x4F0 < sim.stack_pointer <= 0x4FF
        sim.pins.watch(*(f"P{port}{bit}" for port, bit in itertools.product("BCD", range(8))))
        with pytest.raises(SimError, match="atmega32u2 has no ADC"):
            _ = sim.adc
