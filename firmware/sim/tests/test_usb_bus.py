"""The USB device controller: registers, memory, banks, toggles, STALL, on both families."""

import pytest
from j2a_sim import AvrSim, SimError

from firmware.sim.tests.usb_chip import (
    BULK_IN,
    BULK_OUT,
    CONTROL,
    DOUBLE,
    EPEN,
    FIFOCON,
    NAKINI,
    NAKOUTI,
    PLLCSR,
    REGCR,
    RSTDT,
    RWAL,
    RXOUTI,
    STALLEDI,
    STALLRQ,
    STALLRQC,
    TXINI,
    UDCON,
    UDIEN,
    UDINT,
    UEBCLX,
    UECFG1X,
    UECONX,
    UEDATX,
    UEINTX,
    UERST,
    UESTA0X,
    UESTA1X,
    UHWCON,
    USBCON,
    USBINT,
    USBSTA,
    size_bits,
)

pytestmark = pytest.mark.avr

SETUP_READ = bytes([0x80, 6, 0, 1, 0, 0, 64, 0])
SETUP_WRITE = bytes([0x00, 9, 1, 0, 0, 0, 4, 0])


@pytest.fixture(params=["atmega32u4", "atmega32u2"])
def chip(request, open_chip):
    return open_chip(request.param)


@pytest.fixture
def u4(open_chip):
    return open_chip("atmega16u4")


@pytest.fixture
def u2(open_chip):
    return open_chip("atmega8u2")


def test_registers_after_reset(chip):
    assert chip.get(USBCON) == 0x20
    assert chip.get(UDCON) == 0x01
    assert chip.get(PLLCSR) == 0
    assert chip.get(UDINT) == chip.get(UDIEN) == 0
    assert chip.sim.frequency_hz == 16_000_000
    assert not chip.bus.attached


def test_nothing_can_be_set_before_the_controller_is_on(chip):
    chip.put(UDCON, 0)
    chip.put(UDIEN, 0x7D)
    assert (chip.get(UDCON), chip.get(UDIEN)) == (0x01, 0)
    chip.power()
    assert chip.get(UDCON) == 0
    chip.put(UDIEN, 0xFF)
    assert chip.get(UDIEN) == 0x7D
    chip.put(USBCON, 0)
    assert (chip.get(UDCON), chip.get(UDIEN)) == (0x01, 0)


@pytest.mark.parametrize(
    ("register", "value"), [(UHWCON, 0), (USBCON, 0x80), (UDCON, 1), (UDCON, 4)]
)
def test_what_an_atmega_u4_needs_to_attach(u4, register, value):
    u4.power()
    assert not u4.bus.attached
    u4.bus.plug()
    assert u4.bus.attached
    u4.put(register, value)
    assert not u4.bus.attached


def test_what_an_atmega_u2_needs_to_attach(u2):
    u2.power()
    u2.bus.plug()
    assert u2.bus.attached
    u2.put(REGCR, 1)
    assert not u2.bus.attached
    u2.put(REGCR, 0)
    u2.bus.unplug()
    assert not u2.bus.attached


@pytest.mark.parametrize(
    ("mcu", "value", "locks"),
    [
        ("atmega32u4", 0x12, True),
        ("atmega32u4", 0x02, False),
        ("atmega32u2", 0x06, True),
        ("atmega32u2", 0x02, False),
        ("atmega32u2", 0x0A, False),
    ],
)
def test_the_pll_needs_its_prescaler_and_time(open_chip, mcu, value, locks):
    chip = open_chip(mcu)
    chip.put(PLLCSR, value)
    chip.ms(1.5)
    assert chip.get(PLLCSR) == value
    chip.ms(1)
    assert chip.get(PLLCSR) == value | locks
    chip.put(PLLCSR, 0)
    assert chip.get(PLLCSR) == 0


def test_vbus_is_seen_and_interrupts(u4):
    u4.power()
    u4.put(USBCON, 0x91)
    assert u4.get(USBSTA) == 0x08
    u4.bus.plug()
    assert u4.get(USBSTA) == 0x09
    assert u4.get(USBINT) == 1
    assert u4.variable("gen_entries") > 2  # nobody clears it
    u4.put(USBINT, 0)
    before = u4.variable("gen_entries")
    u4.ms(1)
    assert u4.variable("gen_entries") == before
    u4.bus.unplug()
    assert u4.get(USBSTA) == 0x08
    assert u4.get(USBINT) == 1


# -- memory ---------------------------------------------------------------------------------------


def test_memory_of_an_atmega_u4(u4):
    u4.start()
    sizes = [(64, 0), (256, DOUBLE), (64, DOUBLE), (64, 0), (64, 0)]  # 832 bytes in all
    for number, (size, banks) in enumerate(sizes):
        assert u4.endpoint(number, BULK_IN if number else CONTROL, size_bits(size) | banks)
    assert not u4.endpoint(5, BULK_IN, size_bits(8))


def test_memory_of_an_atmega_u2(u2):
    u2.start()
    for number, size in enumerate([64, 64, 32, 16]):  # 176 bytes in all
        assert u2.endpoint(number, BULK_IN if number else CONTROL, size_bits(size))
    assert not u2.endpoint(4, BULK_IN, size_bits(8))
    u2.select(3)
    u2.put(UECFG1X, 0)
    assert u2.endpoint(4, BULK_IN, size_bits(8) | DOUBLE)
    u2.select(5)
    u2.put(UECONX, EPEN)
    assert u2.get(UECONX) == 0


@pytest.mark.parametrize(
    ("mcu", "number", "bits", "fits"),
    [
        ("atmega32u4", 0, size_bits(64) | DOUBLE, False),
        ("atmega32u4", 0, size_bits(128), False),
        ("atmega32u4", 1, size_bits(256) | DOUBLE, True),
        ("atmega32u4", 1, size_bits(512), False),
        ("atmega32u4", 6, size_bits(64) | DOUBLE, True),
        ("atmega32u4", 6, size_bits(128), False),
        ("atmega32u2", 1, size_bits(64), True),
        ("atmega32u2", 1, size_bits(128), False),
        ("atmega32u2", 2, size_bits(32) | DOUBLE, False),
        ("atmega32u2", 3, size_bits(64) | DOUBLE, True),
    ],
)
def test_what_an_endpoint_can_have(open_chip, mcu, number, bits, fits):
    chip = open_chip(mcu)
    chip.start()
    assert chip.endpoint(number, BULK_OUT if number else CONTROL, bits) == fits
    answer, _ = chip.bus.transact("OUT", number, b"x", 0)
    assert (answer is not None) == fits


def test_an_endpoint_that_grows_runs_into_the_one_after_the_next(u4):
    u4.start(*((n, BULK_IN, size_bits(8)) for n in (1, 2, 3)))
    u4.select(3)
    u4.send(b"ABCDEFGH")
    assert u4.endpoint(1, BULK_IN, size_bits(64))
    assert u4.bus.read(0x83, 8) == b"ABCDEFGH"
    for number in (2, 3):
        u4.select(number)
        u4.send(b"abcdefgh")
    u4.select(1)
    u4.fill(bytes(24))
    assert u4.bus.read(0x82, 8) == b"abcdefgh"  # has moved up
    assert u4.bus.read(0x83, 8) == bytes(8)


# -- banks ----------------------------------------------------------------------------------------


def test_two_banks_take_two_packets(chip):
    chip.start((3, BULK_OUT, size_bits(16) | DOUBLE))
    out = [chip.bus.transact("OUT", 3, data)[0] for data in (b"first", b"second", b"third")]
    assert out == ["ACK", "ACK", "NAK"]
    assert chip.flags() == FIFOCON | RWAL | RXOUTI | NAKOUTI
    assert chip.get(UESTA0X) & 3 == 2
    assert chip.get(UESTA1X) == 0
    assert chip.take() == b"first"
    assert chip.get(UESTA1X) == 1
    assert chip.get(UESTA0X) & 3 == 1
    assert chip.bus.transact("OUT", 3, b"third")[0] == "ACK"
    assert chip.take() == b"second"
    assert chip.flags() & (FIFOCON | RXOUTI) == FIFOCON | RXOUTI
    assert chip.take() == b"third"
    assert chip.flags() & (FIFOCON | RXOUTI | RWAL) == 0
    assert chip.get(UESTA0X) & 3 == 0


def test_two_banks_send_two_packets(chip):
    chip.start((4, BULK_IN, size_bits(16) | DOUBLE))
    assert chip.flags() == FIFOCON | RWAL | TXINI
    chip.send(b"first")
    assert chip.flags() == FIFOCON | RWAL | TXINI
    chip.send(b"second")
    assert chip.flags() == 0
    assert chip.get(UESTA0X) & 3 == 2
    assert chip.bus.transact("IN", 4) == ("ACK", b"first")
    assert chip.flags() == FIFOCON | RWAL | TXINI
    chip.send(b"")
    assert [chip.bus.transact("IN", 4) for _ in range(3)] == [
        ("ACK", b"second"),
        ("ACK", b""),
        ("NAK", b""),
    ]
    assert chip.flags() == FIFOCON | RWAL | TXINI | NAKINI


def test_one_bank_is_either_the_hosts_or_the_cpus(chip):
    chip.start((1, BULK_OUT, size_bits(8)), (2, BULK_IN, size_bits(8)))
    chip.send(b"out")
    assert chip.flags() == 0
    assert chip.bus.transact("OUT", 1, b"in")[0] == "ACK"
    assert chip.bus.transact("OUT", 1, b"again")[0] == "NAK"
    assert chip.bus.transact("OUT", 1, b"")[0] == "NAK"
    chip.select(1)
    chip.clear(RXOUTI)
    assert chip.bus.transact("OUT", 1, b"again")[0] == "NAK"  # the bank is freed by FIFOCON
    chip.clear(FIFOCON)
    assert chip.bus.transact("OUT", 1, b"")[0] == "ACK"
    assert chip.flags() & (FIFOCON | RXOUTI | RWAL) == FIFOCON | RXOUTI


def test_the_fifo_ends_where_it_ends(chip):
    chip.start((1, BULK_IN, size_bits(8)), (2, BULK_OUT, size_bits(8)))
    chip.bus.transact("OUT", 2, b"abc")
    assert chip.get(UEBCLX) == 3
    assert chip.get(UEDATX) == ord("a")
    assert chip.get(UEBCLX) == 2
    assert chip.read_fifo(3) == b"bc\0"
    assert chip.flags() & RWAL == 0
    assert chip.bus.counters.fifo_errors == 1
    chip.select(1)
    chip.clear(TXINI)
    chip.fill(b"12345678")
    assert chip.get(UEBCLX) == 8
    assert chip.flags() == FIFOCON
    chip.put(UEDATX, ord("9"))
    assert chip.bus.counters.fifo_errors == 2
    chip.clear(FIFOCON)
    assert chip.bus.transact("IN", 1) == ("ACK", b"12345678")


def test_a_packet_that_is_too_long_is_cut(chip):
    chip.start((1, BULK_OUT, size_bits(8)))
    assert chip.bus.transact("OUT", 1, b"0123456789")[0] == "ACK"
    assert chip.get(UESTA0X) & 0x40
    assert chip.take() == b"01234567"
    chip.put(UESTA0X, 0)
    assert chip.get(UESTA0X) & 0x40 == 0


def test_a_killed_bank_is_not_sent(chip):
    chip.start((3, BULK_IN, size_bits(8) | DOUBLE))
    chip.send(b"one")
    chip.send(b"two")
    chip.put(UEINTX, 0xFF)  # FIFOCON cannot be set; bit 2 is KILLBK
    assert chip.flags() == FIFOCON | RWAL | TXINI
    assert chip.get(UESTA0X) & 3 == 1
    chip.send(b"three")
    assert [chip.bus.transact("IN", 3)[1] for _ in range(2)] == [b"one", b"three"]


# -- data toggles, STALL --------------------------------------------------------------------------


def test_a_packet_whose_ack_was_lost_is_taken_once(chip):
    chip.start((1, BULK_OUT, size_bits(8)))
    assert chip.bus.transact("OUT", 1, b"a", 0)[0] == "ACK"
    assert chip.take() == b"a"
    assert chip.get(UESTA0X) & 0x0C == 0
    assert chip.bus.transact("OUT", 1, b"a", 0)[0] == "ACK"
    assert chip.flags() & (RXOUTI | FIFOCON) == 0
    assert chip.bus.counters.wrong_toggles == 1
    assert chip.bus.transact("OUT", 1, b"b", 1)[0] == "ACK"
    assert chip.get(UESTA0X) & 0x0C == 4
    assert chip.take() == b"b"


def test_a_packet_that_was_not_acknowledged_comes_again(chip):
    chip.start((1, BULK_IN, size_bits(8)))
    chip.send(b"a")
    assert chip.bus.transact("IN", 1, acknowledge=False) == ("ACK", b"a")
    assert chip.flags() & TXINI == 0
    chip.put(UECONX, EPEN | STALLRQ)  # what must be repeated goes before STALL
    assert chip.bus.transact("IN", 1) == ("ACK", b"a")
    assert chip.bus.transact("IN", 1)[0] == "STALL"
    chip.put(UECONX, EPEN | STALLRQC)
    assert chip.get(UESTA0X) & 0x0C == 4
    chip.send(b"b")
    assert chip.bus.transact("IN", 1, toggle=0) == ("ACK", b"b")
    assert chip.bus.counters.wrong_toggles == 1


def test_rstdt_begins_with_data0(chip):
    chip.start((1, BULK_OUT, size_bits(8)))
    chip.bus.transact("OUT", 1, b"a", 0)
    chip.take()
    chip.put(UERST, 2)
    chip.put(UERST, 0)
    chip.bus.transact("OUT", 1, b"lost", 0)
    assert chip.flags() & RXOUTI == 0
    chip.put(UECONX, EPEN | RSTDT)
    assert chip.get(UECONX) == EPEN
    chip.bus.transact("OUT", 1, b"b", 0)
    assert chip.take() == b"b"
    chip.put(UECONX, 0)
    chip.put(UECONX, EPEN)
    chip.bus.transact("OUT", 1, b"c", 0)
    assert chip.take() == b"c"


def test_stall_of_an_endpoint_lasts(chip):
    chip.start((1, BULK_OUT, size_bits(8)), (2, BULK_IN, size_bits(8)))
    for number, token in ((1, "OUT"), (2, "IN")):
        chip.select(number)
        chip.put(UECONX, EPEN | STALLRQ)
        for _ in range(2):
            assert chip.bus.transact(token, number, b"", 0)[0] == "STALL"
        assert chip.flags() & STALLEDI
        assert chip.flags() & RWAL == 0
        chip.put(UECONX, EPEN)
        assert chip.bus.transact(token, number, b"", 0)[0] == "STALL"
        chip.put(UECONX, EPEN | STALLRQC)
        assert chip.bus.transact(token, number, b"", 0)[0] in {"ACK", "NAK"}


def test_an_endpoint_in_reset_does_not_answer(chip):
    chip.start((1, BULK_IN, size_bits(8)))
    chip.send(b"old")
    chip.put(UERST, 2)
    assert chip.flags() == 0
    assert chip.bus.transact("IN", 1)[0] is None
    chip.put(UERST, 0)
    assert chip.flags() == FIFOCON | RWAL | TXINI
    assert chip.bus.transact("IN", 1)[0] == "NAK"
    assert chip.get(UESTA0X) & 0x83 == 0x80


def test_a_chip_without_usb_has_no_bus(simulate):
    with pytest.raises(SimError, match="atmega328p has no USB"):
        _ = simulate("echo").usb


def test_the_uart_of_these_chips_is_found_by_itself(firmware):
    with AvrSim(firmware("relative", "atmega32u2"), "atmega32u2") as sim:
        sim.boot()
        sim.run(20_000)
        assert sim.uart_read() == b"\xa5\x5a"


@pytest.mark.parametrize("mcu", ["at90usb82", "at90usb162", "atmega16u2"])
def test_relatives_have_the_controller_too(open_chip, mcu):
    chip = open_chip(mcu)
    chip.start((4, BULK_IN, size_bits(16) | DOUBLE))
    chip.send(b"x")
    assert chip.bus.read(0x84) == b"x"


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda bus: bus.read(0x81, -1), "-1 bytes is out of range"),
        (lambda bus: bus.submit_in(0x81, 2**32 - 1), "4294967295 bytes is out of range"),
        (lambda bus: bus.transact("PING", 1), "'PING' with toggle None is no transaction"),
        (lambda bus: bus.transact("IN", 1, toggle=2), "'IN' with toggle 2 is no transaction"),
        (lambda bus: bus.plan_frames([float("nan")], [1]), "do not rise"),
    ],
)
def test_odd_numbers_are_refused(open_chip, call, text):
    """A transfer of 2^32 - 1 bytes had a buffer of 1023."""
    bus = open_chip("atmega32u4").bus
    with pytest.raises(SimError, match=text):
        call(bus)
