"""The USB host repeats what got NAK, without letting it cost anything."""

import pytest

from firmware.sim.tests.usb_chip import (
    BIT,
    BULK_IN,
    BULK_OUT,
    DOUBLE,
    FIFOCON,
    FRAME,
    NAKINI,
    RXOUTI,
    TXINI,
    UEINTX,
    in_frame,
    size_bits,
)

pytestmark = pytest.mark.avr


@pytest.fixture(params=["atmega32u4", "atmega32u2"])
def chip(request, open_chip):
    chip = open_chip(request.param)
    chip.start((1, BULK_IN, size_bits(64)), (3, BULK_OUT, size_bits(16) | DOUBLE))
    return chip


def test_nak_is_repeated_on_the_wires_grid(chip):
    """Refused for 4 ms: each try takes 64 bit times, and none begins that could not end."""
    began = in_frame(chip.sim)
    chip.bus.submit_in(0x81, 64)
    chip.sim.run(4 * FRAME)
    chip.select(1)
    chip.send(b"now")
    sent = chip.sim.cycle
    assert chip.sim.run_until_usb(FRAME)
    (done,) = chip.bus.completed()
    assert done.data == b"now"
    assert 0 < done.cycle - sent <= (64 + 16 * 8) * BIT + 250  # send() itself returns late
    per_frame = (12_000 - 40 - 77 * 8) // 64 + 1
    expected = (done.cycle - began - 16 * 8 * BIT) / FRAME * per_frame
    assert abs(done.naks - expected) < 12
    assert chip.bus.counters.naks == done.naks
    # The completion lies on the grid of its frame.
    first = chip.bus.frame_start + 40 * BIT
    slots = (done.cycle - first - 16 * 8 * BIT) / (64 * BIT)
    assert abs(slots - round(slots)) < 0.03


def test_looking_at_a_refused_transfer_moves_nothing(chip, open_chip):
    """Waiting in theory gives the same turns as trying again and again."""

    def play(looks):
        other = open_chip(chip.sim.mcu)
        other.start((1, BULK_IN, size_bits(64)), (3, BULK_OUT, size_bits(16)))
        other.bus.transact("OUT", 3, b"")
        other.select(1)
        other.clear(TXINI)
        other.sim.run(1_000_000 - other.sim.cycle)
        other.bus.submit_in(0x81, 64)
        other.bus.submit_out(3, bytes(16))
        for _ in range(looks):
            other.clear(NAKINI)  # so that the next NAK must be seen
        other.sim.run(1_100_000 - other.sim.cycle)
        other.clear(FIFOCON)
        assert other.sim.run_until_usb(FRAME)
        return [(c.cycle, c.naks) for c in other.bus.completed()]

    assert play(0) == play(7) == play(100)


def test_whenever_the_chip_is_ready_the_next_turn_takes_it(chip, open_chip):
    """In whatever part of a transaction that comes, and whether one was tried or only counted."""

    def play(flags, phase):
        other = open_chip(chip.sim.mcu)
        other.start((1, BULK_IN, size_bits(64)))
        other.clear(TXINI)
        other.bus.submit_in(0x81, 64)
        began = in_frame(other.sim, 0.2)
        other.sim.run(1000 + phase - (other.sim.cycle - began))
        other.put(UEINTX, flags)
        other.put(UEINTX, 0xFB & ~FIFOCON)
        ready = other.sim.cycle
        assert other.sim.run_until_usb(FRAME)
        (done,) = other.bus.completed()
        assert done.cycle - ready < (64 + 13 * 8) * BIT
        other.sim.close()
        return done.cycle, done.naks

    for phase in range(0, 90, 5):
        assert play(0xFB, phase) == play(0xFB & ~NAKINI, phase)


def test_transactions_by_hand_leave_turns_to_others(chip):
    in_frame(chip.sim)
    chip.bus.submit_out(3, bytes(32), packet=16)
    assert chip.bus.transact("IN", 1)[0] == "NAK"
    refused = chip.sim.cycle
    assert chip.sim.run_until_usb(FRAME)
    assert chip.sim.cycle - refused < 30 * 8 * BIT
    assert [c.transferred for c in chip.bus.completed()] == [32]


def test_refused_transfers_cost_no_steps_and_change_nothing(chip, open_chip):
    """Transfers that wait end at the same cycle whether the run is cut in pieces or not."""

    def play(step):
        other = open_chip(chip.sim.mcu)
        other.start((1, BULK_IN, size_bits(64)), (3, BULK_OUT, size_bits(16)))
        other.bus.submit_in(0x81, 64)
        other.bus.submit_out(3, bytes(48))
        other.sim.run_until(lambda: False, 3 * FRAME, step)
        other.sim.run(1_000_000 - other.sim.cycle)
        other.select(3)
        for _ in range(3):
            other.clear(RXOUTI | FIFOCON)
            other.sim.run(1234)
        assert other.sim.run_until_usb(FRAME)
        return other.bus.completed(), other.bus.counters, other.sim.cycle

    once = play(FRAME)
    assert once[0][0].transferred == 48
    assert once == play(FRAME) == play(777)


def test_naks_are_seen_by_the_firmware_each_time(chip):
    chip.select(1)
    chip.bus.submit_in(0x81, 64)
    for _ in range(3):
        chip.ms(0.5)
        assert chip.flags() & 0x40
        chip.clear(0x40)
