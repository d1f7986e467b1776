"""SyncUSB of a board with the firmware of avr-usb, beside a program that has its link."""

import itertools
import time

import j2a_transports
import pytest
import usb.core
from j2a_sim import AvrSim, SimBackend

import j2a

pytestmark = pytest.mark.avr
WAIT_S = 60


@pytest.fixture
def backend(build_firmware):
    elf = build_firmware(
        "demo", port="avr-usb", MCU="atmega32u4", SERIAL="SYNC", OPTIONS="-DJ2A_WITH_SYNC=1"
    )
    with AvrSim(elf, "atmega32u4") as sim:
        yield SimBackend(sim)


def test_a_board_tells_the_frame_of_each_request(backend):
    [port] = j2a_transports.sync_ports(backend)
    assert (port.serial, port.bus, port.name) == ("SYNC", 1, "1-1")
    port.open()
    seen = [port.frame(nonce) for nonce in (0, 1, 0xFFFF, 0x12ED)]
    port.close()
    assert None not in seen
    assert all(0 <= one.frame < 2048 and one.age_us < 2000 for one in seen)
    steps = [(b.frame - a.frame) % 2048 for a, b in itertools.pairwise(seen)]
    assert all(step < 500 for step in steps)


def test_packets_set_the_clock_while_a_program_has_the_link(backend):
    [port] = j2a_transports.sync_ports(backend)
    device = usb.core.find(backend=backend, serial_number="SYNC")
    with j2a.Client(j2a_transports.open_usb_device(device), timeout=WAIT_S) as board:
        free = board.clock.status()
        assert (free.state.name, free.epoch) == ("FREE", 0)
        port.open()
        # Frames are 1 ms of the board, so a line through the first of them tells all others.
        first = port.frame(1)
        told_us = 1_700_000_000_000_000
        port.send(told_us, first.frame)
        end = time.monotonic() + WAIT_S
        while (status := board.clock.status()).epoch == 0:
            assert time.monotonic() < end
        seen = port.frame(2)
        passed_us = (seen.frame - first.frame) % 2048 * 1000
        # What the board told was between the two requests of frames.
        assert told_us <= status.time_us <= told_us + passed_us + 1000
        assert status.state.name == "SETTLING"
        port.close()
        assert board.call("a2jEcho", b"beside").payload == b"beside"
