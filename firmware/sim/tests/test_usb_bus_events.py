"""The USB device controller: control transfers, address, bus events, interrupts."""

import pytest
from j2a_sim import SimError
from j2a_sim._usb_bus.port import UsbPort

from firmware.sim.tests.usb_chip import (
    BULK_IN,
    BULK_OUT,
    CLKPR,
    CONTROL,
    EORSMI,
    EORSTI,
    EPEN,
    FIFOCON,
    MCUSR,
    NAKINI,
    NAKOUTI,
    PLLCSR,
    RWAL,
    RXOUTI,
    RXSTPI,
    SOFI,
    STALLEDI,
    STALLRQ,
    SUSPI,
    TXINI,
    UDADDR,
    UDCON,
    UDFNUMH,
    UDFNUML,
    UDIEN,
    UDINT,
    UEBCLX,
    UECFG1X,
    UECONX,
    UEIENX,
    UEINT,
    UENUM,
    UESTA0X,
    UESTA1X,
    UPRSMI,
    USBCON,
    WAKEUPI,
    size_bits,
)

pytestmark = pytest.mark.avr

READ = bytes([0x80, 6, 0, 1, 0, 0, 64, 0])
WRITE = bytes([0x00, 9, 1, 0, 0, 0, 4, 0])


@pytest.fixture(params=["atmega32u4", "atmega32u2"])
def chip(request, open_chip):
    chip = open_chip(request.param)
    chip.start((1, BULK_IN, size_bits(8)), (2, BULK_OUT, size_bits(8)))
    chip.select(0)
    return chip


@pytest.fixture
def u4(open_chip):
    return open_chip("atmega32u4")


# -- control transfers ----------------------------------------------------------------------------


def test_a_control_read(chip):
    assert chip.flags() == TXINI
    assert chip.bus.transact("SETUP", 0, READ)[0] == "ACK"
    assert chip.flags() == RXSTPI
    assert chip.get(UESTA1X) == 4
    assert chip.get(UEBCLX) == 8
    assert chip.bus.transact("IN", 0)[0] == "NAK"
    assert chip.read_fifo(8) == READ
    chip.clear(RXSTPI | TXINI)  # TXINI was not set yet, so nothing is sent
    assert chip.flags() == TXINI | NAKINI
    assert chip.bus.transact("IN", 0)[0] == "NAK"
    chip.fill(b"12345678")
    chip.clear(TXINI)
    assert chip.bus.transact("IN", 0, toggle=1) == ("ACK", b"12345678")
    assert chip.flags() & TXINI
    chip.fill(b"9")
    chip.clear(TXINI)
    # The host has enough: its first OUT gets NAK, what was to be sent is dropped.
    assert chip.bus.transact("OUT", 0, toggle=1)[0] == "NAK"
    assert chip.flags() & (NAKOUTI | RXOUTI) == NAKOUTI
    assert chip.bus.transact("IN", 0)[0] == "NAK"
    assert chip.bus.transact("OUT", 0, toggle=1)[0] == "ACK"
    assert chip.flags() & (RXOUTI | TXINI) == RXOUTI | TXINI
    chip.clear(RXOUTI)
    assert chip.flags() & (RXOUTI | TXINI | FIFOCON | RWAL) == TXINI
    assert chip.bus.counters.fifo_errors == 0


def test_what_comes_after_the_data_stage_is_not_sent(chip):
    chip.bus.transact("SETUP", 0, READ)
    chip.clear(RXSTPI)
    chip.fill(b"all")
    chip.clear(TXINI)
    assert chip.bus.transact("IN", 0) == ("ACK", b"all")
    assert chip.bus.transact("OUT", 0, toggle=1)[0] == "NAK"
    chip.fill(b"too late")
    chip.clear(TXINI)
    assert chip.bus.transact("IN", 0)[0] == "NAK"
    assert chip.bus.transact("OUT", 0, toggle=1)[0] == "ACK"
    assert chip.flags() & (RXOUTI | TXINI) == RXOUTI | TXINI
    assert chip.bus.counters.fifo_errors == 0


def test_a_control_write(chip):
    assert chip.bus.transact("SETUP", 0, WRITE)[0] == "ACK"
    assert chip.get(UESTA1X) == 0
    assert chip.bus.transact("OUT", 0, b"ab", 1)[0] == "NAK"
    chip.clear(RXSTPI)
    assert chip.bus.transact("OUT", 0, b"ab", 1)[0] == "ACK"
    assert chip.flags() & (RXOUTI | TXINI) == RXOUTI
    assert chip.bus.transact("OUT", 0, b"cd", 0)[0] == "NAK"
    assert chip.read_fifo(2) == b"ab"
    chip.clear(RXOUTI)
    assert chip.bus.transact("OUT", 0, b"cd", 0)[0] == "ACK"
    chip.clear(RXOUTI)
    chip.clear(NAKINI)
    assert chip.bus.transact("IN", 0)[0] == "NAK"
    assert chip.flags() & NAKINI
    chip.clear(TXINI)
    assert chip.bus.transact("IN", 0, toggle=1) == ("ACK", b"")


def test_a_setup_ends_stall(chip):
    chip.put(UECONX, EPEN | STALLRQ)
    assert chip.bus.transact("IN", 0, toggle=1)[0] == "STALL"
    assert chip.bus.transact("OUT", 0, toggle=0)[0] == "STALL"
    assert chip.flags() & STALLEDI
    assert chip.bus.transact("SETUP", 0, READ)[0] == "ACK"
    assert chip.flags() == RXSTPI
    assert chip.get(UECONX) == EPEN
    assert chip.bus.transact("IN", 0)[0] == "NAK"


def test_a_setup_ends_the_transfer_before(chip):
    chip.bus.transact("SETUP", 0, READ)
    chip.clear(RXSTPI)
    chip.fill(b"old")
    chip.clear(TXINI)
    assert chip.bus.transact("SETUP", 0, WRITE)[0] == "ACK"
    assert chip.bus.transact("IN", 0)[0] == "NAK"
    assert chip.read_fifo(8) == WRITE
    chip.clear(RXSTPI)
    chip.bus.transact("OUT", 0, b"x", 1)
    # One that the firmware has not read yet is overwritten; the flag of the OUT before it stays.
    assert chip.bus.transact("SETUP", 0, WRITE)[0] == "ACK"
    assert chip.bus.transact("SETUP", 0, READ)[0] == "ACK"
    assert chip.flags() & (RXSTPI | RXOUTI | TXINI) == RXSTPI | RXOUTI
    chip.clear(RXOUTI)
    assert chip.read_fifo(8) == READ


def test_setup_is_for_control_endpoints(chip):
    assert chip.bus.transact("SETUP", 2, READ)[0] is None
    assert chip.bus.transact("SETUP", 0, READ[:7])[0] is None
    assert chip.bus.transact("IN", 2)[0] is None
    assert chip.bus.transact("OUT", 1, b"x", 0)[0] is None


def test_the_address_counts_when_it_is_enabled(chip):
    chip.put(UDADDR, 5)
    assert chip.bus.transact("IN", 1)[0] == "NAK"
    assert chip.bus.transact("IN", 1, address=5)[0] is None
    chip.put(UDADDR, 0x85)
    assert chip.bus.transact("IN", 1)[0] is None
    assert chip.bus.transact("IN", 1, address=5)[0] == "NAK"
    chip.put(UDADDR, 5)
    assert chip.get(UDADDR) == 0x85


# -- bus events -----------------------------------------------------------------------------------


def test_a_bus_reset(chip):
    chip.bus.transact("OUT", 2, b"a")
    chip.put(UDADDR, 0x85)
    chip.bus.address = 5
    chip.bus.reset()
    assert chip.bus.address == 0
    assert chip.get(UDINT) & (EORSTI | SUSPI) == EORSTI
    assert chip.get(UDADDR) == 0
    for number in (0, 1, 2):
        chip.select(number)
        assert chip.get(UECONX) == 0
        assert chip.get(UECFG1X) == 0  # without ALLOC
        assert chip.get(UESTA0X) == 0
        assert chip.flags() == 0
    chip.ms(1.1)
    assert chip.bus.transact("SETUP", 0, READ)[0] is None
    chip.put(UECONX, EPEN)  # does not bring the memory back
    assert chip.bus.transact("OUT", 2, b"b")[0] is None
    assert chip.endpoint(0, CONTROL, size_bits(64))
    assert chip.bus.transact("SETUP", 0, READ)[0] == "ACK"
    assert chip.endpoint(2, BULK_OUT, size_bits(8))
    assert chip.bus.transact("OUT", 2, b"b")[0] == "ACK"
    assert chip.take() == b"b"


def test_a_bus_reset_goes_past_a_controller_without_clock(chip):
    chip.put(USBCON, chip.get(USBCON) | 0x20)
    chip.bus.reset()
    chip.put(USBCON, chip.get(USBCON) & ~0x20)
    assert chip.get(UDINT) & EORSTI == 0


@pytest.mark.parametrize(("mcu", "bit", "cause"), [("atmega32u4", 8, 0), ("atmega32u2", 4, 0x20)])
def test_a_bus_reset_can_reset_the_cpu(open_chip, mcu, bit, cause):
    chip = open_chip(mcu)
    chip.power()
    chip.bus.plug()
    chip.put(UDCON, bit)
    chip.put(CLKPR, 0)
    chip.sim.write_memory("serve", b"\1")
    chip.bus.reset()
    chip.ms(0.1)
    assert chip.variable("serve") == 0
    assert chip.get(MCUSR) == cause
    assert chip.get(UDINT) & EORSTI
    assert chip.get(UDCON) == bit
    assert chip.get(PLLCSR) & 1
    assert chip.endpoint(0, CONTROL, size_bits(8))
    chip.ms(1.1)
    assert chip.bus.transact("SETUP", 0, READ)[0] == "ACK"


@pytest.mark.parametrize("reading", UsbPort.SUSPEND_FLAGS)
def test_suspend_and_resume(chip, reading):
    chip.bus.suspend_flags = reading
    assert chip.bus.suspend_flags == reading
    chip.put(UDINT, 0)
    chip.ms(5)
    assert chip.get(UDINT) == SOFI | WAKEUPI
    chip.put(UDINT, 0)
    chip.bus.suspend()
    chip.put(UDINT, 0)
    sofs = chip.bus.counters.sofs
    chip.ms(1.9)
    assert chip.get(UDINT) == 0
    chip.ms(1.2)
    assert chip.get(UDINT) == SUSPI
    chip.ms(10)
    assert chip.bus.counters.sofs == sofs
    assert chip.get(UDINT) == SUSPI
    chip.bus.resume()
    flags = {"exclusive": WAKEUPI, "independent": SUSPI | WAKEUPI}[reading]
    assert chip.get(UDINT) & ~SOFI == flags | EORSMI
    chip.ms(1.1)
    assert chip.get(UDINT) & SOFI
    assert chip.bus.transact("IN", 1)[0] == "NAK"


def test_a_frozen_controller_wakes_up_and_cannot_talk(chip):
    chip.bus.suspend()
    chip.ms(4)
    chip.put(UDINT, SUSPI)
    chip.put(USBCON, chip.get(USBCON) | 0x20)
    chip.put(UDIEN, SUSPI)
    assert chip.variable("gen_entries") == 0
    chip.put(UDIEN, WAKEUPI)
    chip.sim.write_memory("serve", b"\1")
    assert chip.variable("gen_entries") == 0
    assert chip.get(UENUM) == 0
    assert chip.flags() == 0
    chip.put(UENUM, 1)
    chip.bus.resume()
    chip.ms(1)
    assert chip.variable("gen_entries") > 3  # without clock the flag cannot be cleared
    assert chip.variable("gen_seen") == WAKEUPI
    assert chip.bus.transact("IN", 1)[0] is None
    chip.put(USBCON, chip.get(USBCON) & ~0x20)
    assert chip.get(UENUM) == 0
    assert chip.bus.transact("IN", 1)[0] == "NAK"


def test_remote_wakeup(chip):
    chip.put(UDCON, 2)
    assert chip.get(UDCON) == 0  # nobody sleeps
    chip.bus.suspend()
    chip.ms(5)
    chip.put(UDINT, 0)
    chip.put(UDCON, 2)
    assert chip.get(UDCON) == 2
    assert chip.get(UDINT) == UPRSMI
    assert not chip.bus.suspended
    chip.ms(21)
    assert chip.bus.active
    assert chip.get(UDCON) == 0
    assert chip.get(UDINT) & EORSMI


def test_an_idle_bus_before_the_first_reset_is_suspend(chip):
    chip.put(USBCON, 0)
    chip.put(PLLCSR, 0)
    chip.power()
    chip.ms(2)
    assert chip.get(UDINT) == 0
    chip.ms(2)
    assert chip.get(UDINT) == SUSPI


def test_frame_numbers(chip):
    for _ in range(3):
        number = chip.get(UDFNUML) | chip.get(UDFNUMH) << 8
        assert number == chip.bus.frame
        assert 0 <= chip.sim.cycle - chip.bus.frame_start < 16_200
        chip.sim.run(16_000)
    before = chip.bus.frame
    chip.ms(2048)
    assert chip.bus.frame == before


def test_frames_start_when_they_are_planned(chip):
    first = chip.bus.frame_start + 16_500
    starts = [first + 16_000.25 * i + (-1) ** i * 8.5 for i in range(30)]
    numbers = [(2040 + i) % 2048 for i in range(30)]
    chip.bus.plan_frames(starts, numbers, [i == 20 for i in range(30)])
    for i, (start, number) in enumerate(zip(starts, numbers, strict=True)):
        chip.sim.run(int(start) + 100 - chip.sim.cycle)
        assert (chip.bus.frame, chip.bus.frame_start) == (number, start)
        seen = chip.get(UDFNUML) | chip.get(UDFNUMH) << 8
        assert seen == (numbers[19] if i == 20 else number)
    chip.ms(2)
    assert chip.bus.frame == numbers[-1] + 2
    assert chip.bus.frame_start == starts[-1] + 2 * chip.bus.frame_cycles


def test_planned_frames_that_a_suspend_passes_over_are_left_out(chip):
    first = chip.bus.frame_start + 16_000
    chip.bus.plan_frames([first + 16_000 * i for i in range(100)], range(100))
    chip.ms(3)
    chip.bus.suspend()
    chip.ms(10)
    chip.bus.resume()
    chip.ms(5)
    assert chip.bus.frame_start == first + 16_000 * chip.bus.frame


def test_frames_must_be_planned_in_order(chip):
    with pytest.raises(SimError, match="do not rise"):
        chip.bus.plan_frames([2.0, 2.0], [1, 2])
    with pytest.raises(SimError, match="1 numbers"):
        chip.bus.plan_frames([1.0, 2.0], [1])


# -- interrupts -----------------------------------------------------------------------------------


def test_each_frame_interrupts(chip):
    chip.put(UDINT, 0)
    chip.sim.write_memory("serve", b"\1")
    chip.put(UDIEN, SOFI)
    sofs = chip.bus.counters.sofs
    chip.ms(20)
    assert chip.bus.counters.sofs - sofs in {20, 21}
    assert chip.variable("gen_entries") == chip.bus.counters.sofs - sofs
    # The handler begins with the end of the packet, 35 bit times after the frame.
    vector = 10 if chip.is_u4 else 11
    assert chip.sim.interrupts(vector).latest_cycles < 10


def test_an_interrupt_that_is_not_served_comes_again(chip):
    chip.put(UDINT, 0)
    chip.put(UDIEN, SOFI)
    chip.ms(1.1)
    assert chip.variable("gen_entries") == 3
    assert chip.variable("gen_seen") & SOFI
    assert chip.get(UDIEN) == 0


def test_an_interrupt_that_was_cleared_does_not_come(chip):
    chip.put(UEIENX, RXSTPI)
    assert chip.bus.transact("SETUP", 0, READ)[0] == "ACK"
    chip.ms(0.1)
    assert chip.variable("com_entries") == 3
    assert chip.variable("com_seen") == 1
    assert chip.get(UEIENX) == 0
    assert chip.get(UEINT) == 0
    chip.clear(RXSTPI)
    chip.put(UEIENX, RXSTPI)
    chip.ms(0.1)
    assert chip.variable("com_entries") == 3


@pytest.mark.parametrize(("number", "enable"), [(1, NAKINI), (2, NAKOUTI), (2, RXOUTI), (1, TXINI)])
def test_events_of_endpoints_interrupt(chip, number, enable):
    chip.select(number)
    if number == 1:
        chip.clear(TXINI)
    chip.put(UEIENX, enable)
    assert chip.variable("com_entries") == 0
    if number == 1:
        chip.bus.transact("IN", 1)
        if enable == TXINI:
            chip.clear(FIFOCON)
            chip.bus.transact("IN", 1)
    else:
        chip.bus.transact("OUT", 2, b"x")
        if enable == NAKOUTI:
            assert chip.variable("com_entries") == 0
            chip.bus.transact("OUT", 2, b"x")
    chip.ms(0.1)
    assert chip.variable("com_entries") == 3
    assert chip.variable("com_seen") == 1 << number


def test_a_transfer_that_is_cancelled_ends_also_if_its_packet_is_cut_by_a_suspend(open_chip):
    """Wherever the packet is; else it would end behind the resume."""
    chip = open_chip("atmega32u4")
    chip.start((1, BULK_IN, size_bits(64)))
    for cycles in range(0, 240, 16):
        number = chip.bus.submit_in(0x81, 64)
        chip.sim.run(cycles)
        chip.bus.cancel(number)
        chip.bus.suspend()
        chip.ms(0.1)
        assert [(done.id, done.status) for done in chip.bus.completed()] == [(number, "cancelled")]
        chip.bus.resume()
