"""The signature row of simulated chips with USB: what they are, and their serial numbers."""

import pytest
from j2a_sim import AvrSim, SimError, chip_serial

pytestmark = pytest.mark.avr

SERIAL = bytes(range(0xA0, 0xAA))
EECR, EEPE = 0x3F, 0x02
SIGNATURES = {
    "atmega16u4": "1e9488",
    "atmega32u4": "1e9587",
    "at90usb82": "1e9382",
    "at90usb162": "1e9482",
    "atmega8u2": "1e9389",
    "atmega16u2": "1e9489",
    "atmega32u2": "1e958a",
}


class Reader:
    """A chip that reads its signature row as it is told."""

    def __init__(self, elf, mcu, **options):
        self.sim = AvrSim(elf, mcu, **options)
        self.sim.run(1000)

    def variable(self, name):
        return self.sim.read_memory(name, 1)[0]

    def read(self, at, wait=0):
        """Returns what LPM reads in time, and later."""
        self.sim.write_memory("from", bytes([at]))
        self.sim.write_memory("wait", bytes([wait]))
        self.sim.write_memory("go", b"\1")
        assert self.sim.run_until(lambda: self.variable("go") == 0, 10_000, 1)
        assert self.variable("after") & 0x21 == 0
        return self.variable("in_row"), self.variable("in_flash")


@pytest.fixture
def reader(firmware):
    readers = []

    def start(mcu="atmega32u4", **options):
        readers.append(Reader(firmware("signature", mcu), mcu, **options))
        return readers[-1]

    yield start
    for reader in readers:
        reader.sim.close()


@pytest.mark.parametrize("mcu", SIGNATURES)
def test_what_the_chip_is(reader, mcu):
    chip = reader(mcu)
    assert bytes(chip.read(at)[0] for at in (0, 2, 4)).hex() == SIGNATURES[mcu]


@pytest.mark.parametrize(
    ("options", "serial"),
    [({}, chip_serial(1)), ({"serial": SERIAL}, SERIAL)],
)
def test_its_serial_number(reader, options, serial):
    chip = reader(**options)
    assert bytes(chip.read(at)[0] for at in range(0x0E, 0x18)) == serial
    assert [chip.read(at)[0] for at in (1, 0x0D, 0x18)] == [0xFF] * 3
    assert chip.variable("ticks")


def test_the_flash_is_as_it_was(reader):
    chip = reader()
    for at in range(64):
        assert chip.read(at)[1] == chip.sim.program.flash[at]


def test_three_cycles_and_no_more(reader):
    chip = reader(serial=SERIAL)
    code = chip.sim.program.flash[0x10]
    assert code != SERIAL[2]
    assert [chip.read(0x10, wait)[0] for wait in range(4)] == [SERIAL[2]] * 3 + [code]


def test_a_chip_that_writes_eeprom_reads_no_row(reader):
    chip = reader(serial=SERIAL)
    chip.sim.write_memory(EECR, bytes([EEPE]))
    assert chip.read(0x10)[0] == chip.sim.program.flash[0x10]
    chip.sim.write_memory(EECR, b"\0")
    assert chip.read(0x10)[0] == SERIAL[2]


def test_serial_numbers_have_ten_bytes(firmware):
    assert len({chip_serial(number) for number in (1, 2, 0xFFFFFF)}) == 3
    with pytest.raises(SimError, match="has 10 bytes, not 9"):
        AvrSim(firmware("signature", "atmega32u4"), "atmega32u4", serial=bytes(9))
