"""How UEBCLX counts where the data sheet does not say: the model's readings, and that avr-usb bears
each of them."""

import pytest
from j2a_sim import AvrSim, SimError
from j2a_sim._usb_bus.port import UsbPort
from j2a_spec import constants as c
from j2a_spec.oracle import Frame, encode

from firmware.sim.tests.usb_chip import BULK_IN, CONTROL, DOUBLE, RXSTPI, UEBCLX, size_bits

pytestmark = pytest.mark.avr

READ = bytes([0x80, 6, 0, 1, 0, 0, 64, 0])
A2J_ECHO = c.BUILTINS.index("a2jEcho")
MODELS = UsbPort.BYTE_COUNT_MODELS


@pytest.mark.parametrize(
    ("counting", "of_in", "of_setup"),
    list(zip(MODELS, (1, 4, 1, 1), ([8, 7], [8, 7], [0, 0], [8, 8]), strict=True)),
)
def test_the_readings(open_chip, counting, of_in, of_setup):
    chip = open_chip("atmega32u4")
    chip.start((1, BULK_IN, size_bits(8) | DOUBLE))
    chip.bus.counting = counting
    assert chip.bus.counting == counting
    chip.select(1)
    chip.send(b"abc")
    chip.fill(b"d")
    assert chip.get(UEBCLX) == of_in
    assert chip.bus.transact("IN", 1) == ("ACK", b"abc")
    assert chip.get(UEBCLX) == 1
    chip.select(CONTROL)
    chip.bus.transact("SETUP", 0, READ)
    first = chip.get(UEBCLX)
    chip.read_fifo(1)
    assert [first, chip.get(UEBCLX)] == of_setup
    assert chip.read_fifo(7) == READ[1:]
    chip.clear(RXSTPI)
    assert chip.get(UEBCLX) == 0


def test_an_unknown_reading(open_chip):
    with pytest.raises(SimError, match="'both' is none of bank, banks"):
        open_chip("atmega32u4").bus.counting = "both"


@pytest.mark.parametrize("counting", MODELS)
@pytest.mark.parametrize("mcu", ["atmega32u4", "atmega32u2"])
def test_the_port_bears_each(build_firmware, counting, mcu):
    elf = build_firmware(port="avr-usb", MCU=mcu)
    with AvrSim(elf, mcu) as sim:
        bus = sim.usb
        bus.counting = counting
        bus.enumerate()
        assert bus.control(0x80, 8, 0, 0, 1) == b"\1"
        for size in (1, 60, 200):
            payload = bytes(range(size))
            bus.write(0x02, encode(Frame(c.SOF, 1, A2J_ECHO, payload)), zero_packet=True)
            sim.run(sim.cycles(0.02))  # the host does not ask yet
            got, empty = b"", 0
            for _ in range(20):
                transfer = bus.submit_in(0x81, 64)
                if not sim.run_until_usb(sim.cycles(0.005)):
                    bus.cancel(transfer)
                    sim.run(sim.cycles(0.001))
                    bus.completed()
                    break
                (done,) = bus.completed()
                got += done.data
                empty += not done.data
            assert got == encode(Frame(c.SOF, 1, c.ECHO, payload))
            assert empty <= 1
        assert bus.counters.fifo_errors == 0
