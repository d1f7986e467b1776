"""The port avr-usb with the interrupts off: it sends on, and does not wait for a host that is gone.

In: an app that sends 1000 bytes within a function, with no interrupt allowed. Out: all of them at a
host that reads, after a suspend too; a board that comes back after a reset or an unplugged cable.
"""

from pathlib import Path

import pytest
from j2a_sim import AvrSim
from j2a_spec import constants as c
from j2a_spec.oracle import Frame, decode, encode

pytestmark = [pytest.mark.avr, pytest.mark.requirement("USB-010")]

APP = Path(__file__).parent / "usb_blocked"
CHIPS = ("atmega32u4", "atmega32u2")
ECHO = c.BUILTINS.index(c.GET_ECHO)
BLOCKED, DEAF = range(len(c.BUILTINS), len(c.BUILTINS) + 2)
SIF, SIFS, SIZE = 5, 10, 100
REPLIES = [
    *(Frame(c.SOS, seq, SIF, bytes((SIFS,)) * SIZE) for seq in range(SIFS)),
    Frame(c.SOF, 1, 0),
]


@pytest.fixture(params=CHIPS)
def quiet(request, build):
    elf = build("usb_blocked", "avr-usb", APP_DIR=str(APP), MCU=request.param)
    with AvrSim(elf, request.param) as sim:
        sim.usb.enumerate()
        yield sim


@pytest.fixture
def sim(quiet):
    quiet.usb.write(c.USB_OUT, encode(Frame(c.SOF, 1, BLOCKED, bytes((SIFS,)) * SIZE)))
    quiet.run(quiet.cycles(0.005))
    return quiet


def read_all(sim):
    """What the function sends, to its reply."""
    got = b""
    while not got.endswith(encode(REPLIES[-1])):
        got += sim.usb.read(c.USB_IN)
    return got


def interrupts_are_on(sim):
    return bool(sim.read_memory(0x5F, 1)[0] & 0x80)


def interrupts_come_on(sim):
    """Whether they are on within 1000 cycles: an interrupt that runs has them off."""
    for _ in range(1000):
        if interrupts_are_on(sim):
            return True
        sim.run(1)
    return False


def works(sim):
    """An echo comes back, and nothing else."""
    sim.usb.write(c.USB_OUT, encode(Frame(c.SOF, 9, ECHO, b"here again")))
    assert decode(sim.usb.read(c.USB_IN)) == [Frame(c.SOF, 9, c.ECHO, b"here again")]


def test_a_host_that_reads_gets_all(sim):
    assert not interrupts_are_on(sim)
    assert decode(read_all(sim)) == REPLIES
    works(sim)


def test_a_host_that_does_not_read_blocks_it(sim):
    sim.run(sim.cycles(1))
    assert not interrupts_are_on(sim)


@pytest.mark.requirement("USB-011")
def test_a_reset_ends_it(sim):
    sim.usb.enumerate(address=2)
    assert interrupts_come_on(sim)
    works(sim)


def test_a_suspend_loses_nothing(sim):
    """It waits on while the bus is still, and for the host to read after it."""
    for ms in (10, 500):
        sim.usb.suspend()
        sim.run(sim.cycles(ms / 1000))
        sim.usb.resume()
        sim.run(sim.cycles(0.010))
    assert not interrupts_are_on(sim)
    assert decode(read_all(sim)) == REPLIES
    works(sim)


def test_a_suspend_that_is_over_is_none(quiet):
    """Interrupts are off from before a suspend to after the resume: the board is there at once."""
    quiet.usb.write(c.USB_OUT, encode(Frame(c.SOF, 1, DEAF, b"\x50")))
    quiet.run(quiet.cycles(0.001))
    quiet.usb.suspend()
    quiet.run(quiet.cycles(0.010))
    quiet.usb.resume()
    assert quiet.usb.transact("IN", c.USB_IN)[0] == "NAK"
    assert decode(quiet.usb.read(c.USB_IN)) == [Frame(c.SOF, 1, 0)]
    works(quiet)


def test_a_reset_ends_a_suspend(sim):
    sim.usb.suspend()
    sim.run(sim.cycles(0.010))
    assert not interrupts_are_on(sim)
    sim.usb.enumerate(address=2)
    assert interrupts_come_on(sim)
    works(sim)


def test_an_unplugged_cable(sim):
    """A chip that watches VBUS goes on at once, another one at the next reset."""
    sim.usb.unplug()
    sim.run(sim.cycles(0.020))
    assert interrupts_are_on(sim) == (sim.mcu == "atmega32u4")
    sim.usb.enumerate()
    assert interrupts_are_on(sim)
    works(sim)
