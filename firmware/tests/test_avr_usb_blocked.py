"""The port avr-usb with the interrupts off: it sends on, and does not wait for a host that is gone.

In: an app that sends 1000 bytes within a function, with no interrupt allowed. Out: all of them at a
host that reads; and a board that comes back after a reset, a suspend or an unplugged cable.
"""

from pathlib import Path

import pytest
from j2a_spec import constants as c
from j2a_spec.oracle import Frame, decode, encode

from j2a.sim import AvrSim

pytestmark = [pytest.mark.avr, pytest.mark.requirement("USB-010")]

APP = Path(__file__).parent / "usb_blocked"
CHIPS = ("atmega32u4", "atmega32u2")
ECHO, BLOCKED = c.BUILTINS.index(c.GET_ECHO), len(c.BUILTINS)
SIF, SIFS, SIZE = 5, 10, 100


@pytest.fixture(params=CHIPS)
def sim(request, build):
    elf = build("usb_blocked", "avr-usb", APP_DIR=str(APP), MCU=request.param)
    with AvrSim(elf, request.param) as sim:
        sim.usb.enumerate()
        sim.usb.write(c.USB_OUT, encode(Frame(c.SOF, 1, BLOCKED, bytes((SIFS,)) * SIZE)))
        sim.run(sim.cycles(0.005))
        yield sim


def interrupts_are_on(sim):
    return bool(sim.read_memory(0x5F, 1)[0] & 0x80)


def works(sim):
    """An echo comes back, and nothing else."""
    sim.usb.write(c.USB_OUT, encode(Frame(c.SOF, 9, ECHO, b"here again")))
    assert decode(sim.usb.read(c.USB_IN)) == [Frame(c.SOF, 9, c.ECHO, b"here again")]


def test_a_host_that_reads_gets_all(sim):
    assert not interrupts_are_on(sim)
    got = b""
    while not got.endswith(encode(Frame(c.SOF, 1, 0))):
        got += sim.usb.read(c.USB_IN)
    frames = [Frame(c.SOS, seq, SIF, bytes((SIFS,)) * SIZE) for seq in range(SIFS)]
    assert decode(got) == [*frames, Frame(c.SOF, 1, 0)]
    works(sim)


def test_a_host_that_does_not_read_blocks_it(sim):
    sim.run(sim.cycles(1))
    assert not interrupts_are_on(sim)


@pytest.mark.requirement("USB-011")
def test_a_reset_ends_it(sim):
    sim.usb.enumerate(address=2)
    assert interrupts_are_on(sim)
    works(sim)


def test_a_suspend_ends_it(sim):
    """What was sent before stays; the rest of it is dropped, and no frame comes broken."""
    sim.usb.suspend()
    sim.run(sim.cycles(0.010))
    assert interrupts_are_on(sim)
    sim.usb.resume()
    sim.run(sim.cycles(0.010))
    sim.usb.enumerate(address=2)
    works(sim)


def test_an_unplugged_cable_ends_it(sim):
    sim.usb.unplug()
    sim.run(sim.cycles(0.020))
    assert interrupts_are_on(sim)
    sim.usb.enumerate()
    works(sim)
