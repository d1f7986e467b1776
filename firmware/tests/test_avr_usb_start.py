"""The port avr-usb at its start, and while the EEPROM is being written.

In: an app that starts itself anew, with and without the watchdog, on the simulated chips. Out: a
board that leaves the bus for so long that a host notices, and is there again; a reset's cause that
the application can still read; a serial number that waits for the EEPROM.
"""

from pathlib import Path

import pytest
from j2a_sim import AvrSim
from j2a_spec import constants as c
from j2a_spec import usb
from j2a_spec.oracle import Frame, decode, encode

pytestmark = pytest.mark.avr

APP = Path(__file__).parent / "usb_start"
RESTART, WATCHDOG, CAUSES = range(len(c.BUILTINS), len(c.BUILTINS) + 3)
EXTRF = 2
EECR, EEPE = 0x3F, b"\x02"
NOTICED_MS = 2  # more than the 2.5 us of USB 2.0, 7.1.7.3: hubs look every now and then
SERIAL_NUMBER = 3
CHIPS = ("atmega32u4", "atmega32u2")


@pytest.fixture(params=CHIPS)
def mcu(request):
    return request.param


@pytest.fixture(params=["-Os", "-O0"])
def sim(request, build, mcu):
    elf = build("usb_start", "avr-usb", APP_DIR=str(APP), MCU=mcu, CFLAGS=request.param)
    with AvrSim(elf, mcu) as sim:
        sim.usb.enumerate()
        yield sim


def call(sim, opcode):
    sim.usb.write(c.USB_OUT, encode(Frame(c.SOF, 1, opcode)))


def causes(sim):
    """The causes of a reset that the application finds."""
    call(sim, CAUSES)
    (reply,) = decode(sim.usb.read(c.USB_IN))
    return reply.payload[0]


def away_ms(sim):
    """How long the board is off the bus, which it leaves soon."""
    assert sim.run_until(lambda: not sim.usb.attached, sim.cycles(0.005))
    start = sim.cycle
    assert sim.run_until(lambda: sim.usb.attached, sim.cycles(0.1))
    return (sim.cycle - start) / sim.frequency_hz * 1000


def test_a_program_that_starts_anew_leaves_the_bus(sim):
    for address in (2, 3):
        call(sim, RESTART)
        assert away_ms(sim) >= NOTICED_MS
        sim.usb.enumerate(address=address)
        assert causes(sim) == EXTRF


def test_the_watchdog_is_off_and_the_other_causes_are_kept(sim):
    """It would bite after 60 ms."""
    assert causes(sim) == EXTRF
    call(sim, WATCHDOG)
    assert away_ms(sim) >= NOTICED_MS
    sim.usb.enumerate(address=2)
    sim.run(sim.cycles(0.5))
    assert causes(sim) == EXTRF


def test_the_serial_number_waits_for_the_eeprom(build, mcu):
    """Its row of the flash cannot be read meanwhile; the host waits, and others are answered."""
    with AvrSim(build("builtins", "avr-usb", MCU=mcu), mcu) as sim:
        serial = sim.usb.enumerate().strings[SERIAL_NUMBER]
        before = sim.usb.counters.naks
        sim.write_memory(EECR, EEPE)
        ask = bytes((0x80, 6, SERIAL_NUMBER, usb.STRING, 0, 0, 255, 0))
        transfer = sim.usb.submit_control(ask, packet=16)
        sim.run(sim.cycles(0.0034))
        assert not sim.usb.completed()
        assert sim.usb.counters.naks > before
        sim.write_memory(EECR, b"\0")
        assert sim.run_until_usb(sim.cycles(0.001))
        (done,) = sim.usb.completed()
        assert (done.id, done.status) == (transfer, "ok")
        assert str(usb.string.parse(done.data)) == serial
        sim.write_memory(EECR, EEPE)
        assert len(sim.usb.descriptor(usb.DEVICE)) == 18
