"""The serial wire: character times, buffers, overruns, interrupts, and a host at a wrong rate."""

from itertools import pairwise

import pytest
from j2a_sim import SimError

pytestmark = pytest.mark.avr

SECOND = 16_000_000
ALL_BYTES = bytes(range(256))
DOR, FE, UPE, UDRE, RXC = 0x08, 0x10, 0x04, 0x20, 0x80
UCSR1A, UCSR1B, UBRR1L, UDR1 = 0xC8, 0xC9, 0xCC, 0xCE
TXEN, RXEN = 0x08, 0x10


def exchange(sim, data, seconds=1.0):
    sim.uart_write(data)
    sim.run_until(lambda: sim.readable >= len(data), int(seconds * SECOND))
    return sim.uart_read_stamped()


@pytest.mark.parametrize("name", ["echo", "echo_irq"])
@pytest.mark.parametrize("baud", [115200, 1_000_000])
def test_echo_of_every_byte_at_wire_rate(simulate, name, baud):
    sim = simulate(name, BAUD=baud)
    sim.boot()
    began = sim.cycle
    out = exchange(sim, ALL_BYTES)
    assert bytes(byte.value for byte in out) == ALL_BYTES
    # 115200 is 117647 in truth: the divider is 17.
    char = {115200: 10 * 8 * 17, 1_000_000: 10 * 8 * 2}[baud]
    assert sim.char_cycles == char
    assert sim.baud == SECOND * 10 / char
    assert 256 * char <= out[-1].cycle - began < 259 * char
    # A character is never shorter than its bits; only the firmware's polling moves its start.
    for before, after in pairwise(out):
        assert abs(after.cycle - before.cycle - char) < 100
    counters = sim.counters
    assert (counters.bytes_in, counters.bytes_out) == (256, 256)
    assert (counters.overruns, counters.queued, counters.tx_ignored) == (0, 0, 0)


def test_running_while_output_comes_ends_with_a_gap_or_with_enough(simulate):
    sim = simulate("echo", BAUD=115200)
    sim.boot()
    sim.uart_write(b"0123456789")
    assert sim.run_until_output(SECOND)
    gap = int(2 * sim.char_cycles)
    sim.run_while_output(gap, 4)
    fourth = sim.cycle
    sim.run_while_output(gap, 100)
    out = sim.uart_read_stamped()
    assert bytes(byte.value for byte in out) == b"0123456789"
    assert 0 <= fourth - out[3].cycle < 8
    assert 0 <= sim.cycle - out[-1].cycle - gap < 16


@pytest.mark.parametrize(
    ("ucsr0c", "bits"),
    [(0x06, 10), (0x2E, 12), (0x36, 11), (0x04, 9), (0x00, 7)],
    ids=["8N1", "8E2", "8O1", "7N1", "5N1"],
)
def test_formats(simulate, ucsr0c, bits):
    sim = simulate("echo", FORMAT=ucsr0c, BAUD=57600)
    sim.boot()
    assert sim.char_cycles == bits * 8 * 35
    data = bytes(byte & (0x1F if ucsr0c == 0 else 0x7F) for byte in ALL_BYTES)
    out = exchange(sim, data)
    assert bytes(byte.value for byte in out) == data
    assert sim.counters.rx_framing_errors == 0


def test_a_slow_reader_loses_what_the_chip_loses(simulate):
    sim = simulate("slow")
    sim.boot()
    sim.uart_write(b"ABCDEF")
    assert sim.run_until_output(SECOND)
    # Two characters are buffered; each new start bit overwrites the one in the shift register.
    assert sim.read_memory("count", 1) == b"\3"
    assert sim.read_memory("bytes", 3) == b"ABF"
    status = sim.read_memory("status", 3)
    assert [bool(value & DOR) for value in status] == [True, False, False]
    assert all(value & RXC for value in status)
    assert sim.counters.overruns == 3
    assert sim.uart_read() == b"!"
    assert exchange(sim, b"on")[-1].value == ord("n")


def test_three_characters_wait_without_loss(simulate):
    sim = simulate("slow")
    sim.boot()
    sim.uart_write(b"ABC")
    assert sim.run_until_output(SECOND)
    assert sim.read_memory("bytes", 3) == b"ABC"
    assert not any(value & DOR for value in sim.read_memory("status", 3))
    assert sim.counters.overruns == 0


def test_the_transmitter_holds_two_characters(simulate):
    sim = simulate("transmit")
    assert sim.run_until_span(SECOND)
    assert sim.uart_read() == b"ab"
    assert sim.counters.tx_ignored == 1
    assert sim.read_memory("after_first", 1)[0] & UDRE
    assert not sim.read_memory("after_second", 1)[0] & UDRE
    # TXC comes when both characters, 1360 cycles each, are out.
    assert sim.spans()[0].start > 2 * 1360


def test_bytes_come_at_wire_rate_and_not_before(simulate):
    sim = simulate("echo")
    sim.boot()
    sim.uart_write(bytes(10))
    sim.run(5 * 1360 - 100)
    counters = sim.counters
    assert counters.bytes_in == 5
    assert counters.queued == 5


def test_interrupt_flags_are_levels(simulate):
    sim = simulate("echo_irq")
    sim.boot()
    sim.run(1000)
    exchange(sim, b"xyz")
    sim.run(10_000)
    # One entry per received byte; one per sent byte and those that found nothing left.
    assert int.from_bytes(sim.read_memory("rx_entries", 2), "little") == 3
    assert int.from_bytes(sim.read_memory("udre_entries", 2), "little") == 6


def test_a_handler_that_leaves_its_flag_is_entered_again(simulate):
    sim = simulate("level")
    sim.boot()
    sim.uart_write(b"x")
    sim.run(100_000)
    assert sim.read_memory("entries", 1) == b"\4"
    assert sim.read_memory("byte", 1) == b"x"


def test_bytes_to_a_receiver_that_is_off_are_counted(simulate):
    sim = simulate("echo")
    sim.uart_write(b"too early")
    sim.run(100_000)
    counters = sim.counters
    assert 0 < counters.unheard <= counters.bytes_in == 9


@pytest.mark.parametrize(
    ("byte", "at_bit", "heard"),
    [(0x0F, 2.5, 0xF8), (0xFF, 0.5, None), (0xFF, 1.5, None), (0x55, 3.5, 0xF5)],
)
def test_a_receiver_that_is_switched_on_amid_a_character(open_chip, byte, at_bit, heard):
    """It takes the next falling edge for a start bit; bits 4 to 7 of 0x0F are low."""
    chip = open_chip("atmega32u4")
    bit = 16 * 208
    chip.put(UBRR1L, 207)
    chip.sim.uart_write(bytes([byte]))
    chip.sim.run(int(at_bit * bit))
    chip.put(UCSR1B, RXEN)
    chip.sim.run(20 * bit)
    assert bool(chip.get(UCSR1A) & RXC) == (heard is not None)
    assert chip.get(UDR1) == (heard or 0)


def test_a_receiver_that_is_switched_off_and_on_has_lost_the_character(open_chip):
    chip = open_chip("atmega32u4")
    bit = 16 * 208
    chip.put(UBRR1L, 207)
    chip.put(UCSR1B, RXEN)
    chip.sim.uart_write(b"\xff\x42")
    chip.sim.run(5 * bit)
    chip.put(UCSR1B, 0)
    chip.put(UCSR1B, RXEN)
    chip.sim.run(20 * bit)
    assert chip.get(UDR1) == 0x42
    assert not chip.get(UCSR1A) & RXC


@pytest.mark.parametrize(("at_bit", "heard"), [(0.5, b"\xff"), (3.5, b"\xf9"), (9.5, b"\x01")])
def test_a_reset_amid_a_character_leaves_the_rest_high(open_chip, at_bit, heard):
    """The host has it at once: who opens the link anew behind a reset is not to read it."""
    chip = open_chip("atmega32u4")
    bit = 16 * 208
    chip.put(UBRR1L, 207)
    chip.put(UCSR1B, TXEN)
    chip.put(UDR1, 0x01)
    chip.sim.run(int(at_bit * bit))
    chip.sim.reset()
    assert chip.sim.uart_read() == heard
    chip.sim.run(20 * bit)
    assert chip.sim.uart_read() == b""


@pytest.mark.parametrize("host_baud", [115200, 113_000, 121_000])
def test_a_host_within_tolerance_is_understood(simulate, host_baud):
    sim = simulate("echo", host_baud=host_baud)
    sim.boot()
    # A host that sends faster than the firmware can send back must stop before the buffer is full.
    data = ALL_BYTES if host_baud < 117_647 else ALL_BYTES[::6]
    out = exchange(sim, data)
    assert bytes(byte.value for byte in out) == data
    assert sim.counters.rx_framing_errors == sim.counters.tx_framing_errors == 0
    # The host sets the pace when it is the slower one.
    if host_baud < 117_647:
        span = out[-1].cycle - out[0].cycle
        assert abs(span - 255 * 10 * SECOND / host_baud) < 2000


@pytest.mark.parametrize("host_baud", [9600, 57600, 104_000, 130_000, 230_400])
def test_a_host_at_a_wrong_rate_is_not_understood(simulate, host_baud):
    sim = simulate("slow", PAUSE=1, host_baud=host_baud)
    sim.boot()
    sim.run(SECOND // 10)
    sim.uart_read()
    sim.uart_write(ALL_BYTES)
    sim.run(SECOND // 2)
    assert sim.uart_read() != ALL_BYTES
    assert sim.counters.rx_framing_errors > 0


def test_an_odd_host_rate_is_refused(simulate):
    with pytest.raises(SimError, match="host_baud"):
        simulate("echo", host_baud=-1)
    with pytest.raises(SimError, match="host_baud"):
        simulate("echo", host_baud=16_000_000)
