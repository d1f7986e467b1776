"""The EEPROM of simulated chips: its size, how long it takes, and what a reset leaves."""

import pytest
from j2a_sim import SimError

pytestmark = pytest.mark.avr

EECR, EEDR, EEARL, EEARH = 0x3F, 0x40, 0x41, 0x42
EEPE, EEMPE = 0x02, 0x04


def begin_write(chip, address, value):
    """As firmware whose two stores follow one another; those of the fixture are further apart."""
    chip.put(EEARL, address & 0xFF)
    chip.put(EEARH, address >> 8)
    chip.put(EEDR, value)
    chip.sim.write_memory(EECR, bytes([chip.get(EECR) | EEMPE]))
    chip.put(EECR, EEPE)


def reset_behind_a_write(chip, wait_ms):
    """Write 0x55 to address 7, wait, reset the chip, and let it start."""
    begin_write(chip, 7, 0x55)
    chip.ms(wait_ms)
    chip.sim.reset()
    chip.ms(0.1)


def test_each_chip_has_its_own_size(open_chip):
    """The ATmega32U2 runs as a chip with half its EEPROM."""
    chip = open_chip("atmega32u2")
    assert chip.sim.read_eeprom(0, 1024) == b"\xff" * 1024
    begin_write(chip, 0x205, 0x22)
    assert chip.sim.read_eeprom(0x205, 1) == b"\x22"
    assert chip.sim.read_eeprom(0x005, 1) == b"\xff"
    with pytest.raises(SimError, match="outside"):
        chip.sim.read_eeprom(1024, 1)


def test_a_write_goes_on_through_a_reset(open_chip):
    chip = open_chip("atmega32u4")
    reset_behind_a_write(chip, 1)
    assert chip.get(EECR) & EEPE
    begin_write(chip, 8, 0x66)
    assert chip.sim.read_eeprom(7, 2) == b"\x55\xff"
    chip.ms(2.4)
    assert not chip.get(EECR) & EEPE


def test_a_reset_while_nothing_is_written(open_chip):
    chip = open_chip("atmega32u4")
    reset_behind_a_write(chip, 4)
    assert not chip.get(EECR) & EEPE


def test_the_cpu_stands_still(simulate):
    """Four cycles at a read and two at a write."""
    sim = simulate("eeprom")
    sim.run(1000)
    plain, read, write = (span.cycles for span in sim.spans())
    assert (read - plain, write - plain) == (4, 2)


def test_the_interrupt_comes_while_no_write_lasts(simulate):
    sim = simulate("eeprom")
    sim.run(sim.cycles(0.0036))
    assert sim.read_memory("entries", 1) == b"\1"
    sim.run(sim.cycles(0.012))
    assert sim.read_memory("entries", 1) == b"\3"
    assert sim.read_eeprom(0, 4) == b"\1\2\3\xff"
    assert sim.read_memory(EECR, 1) == b"\0"
