"""The USB host: time on the wire, turns, NAK, errors, the cable, the same run each time."""

import pytest
from j2a_sim import AvrSim, SimError
from j2a_sim._usb_bus.bus import UsbError, UsbNoAnswer, UsbStall, UsbTimeout

from firmware.sim.tests.usb_chip import (
    BIT,
    BULK_IN,
    BULK_OUT,
    CONTROL,
    DOUBLE,
    EPEN,
    FIFOCON,
    FRAME,
    STALLRQ,
    SUSPI,
    UDCON,
    UDINT,
    UECONX,
    in_frame,
    size_bits,
)

pytestmark = pytest.mark.avr

READ = bytes([0x80, 6, 0, 1, 0, 0, 64, 0])


@pytest.fixture(params=["atmega32u4", "atmega32u2"])
def chip(request, open_chip):
    chip = open_chip(request.param)
    chip.start((1, BULK_IN, size_bits(64)), (3, BULK_OUT, size_bits(16) | DOUBLE))
    return chip


@pytest.fixture
def flood(firmware):
    sims = []

    def start(banks):
        sim = AvrSim(firmware("usb_flood", "atmega32u4", BANKS=banks), "atmega32u4")
        sims.append(sim)
        sim.usb.plug()
        assert sim.run_until(lambda: sim.usb.attached, 100_000)
        sim.usb.reset()
        sim.run(FRAME)
        return sim

    yield start
    for sim in sims:
        sim.close()


# -- time -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [0, 1, 8, 16])
def test_the_time_of_an_out(chip, size):
    began = in_frame(chip.sim)
    chip.bus.submit_out(3, bytes(size))
    assert chip.sim.run_until_usb(FRAME)
    (done,) = chip.bus.completed()
    assert done.cycle == chip.sim.cycle
    assert 0 <= done.cycle - began - (13 + size) * 8 * BIT < 2
    assert (done.status, done.transferred, done.data, done.naks) == ("ok", size, b"", 0)


@pytest.mark.parametrize("size", [0, 1, 64])
def test_the_time_of_an_in(chip, size):
    chip.select(1)
    chip.send(bytes(size))
    began = in_frame(chip.sim)
    chip.bus.submit_in(0x81, 100)
    assert chip.sim.run_until_usb(FRAME) or size == 64
    if size == 64:
        assert chip.bus.pending == 1  # wants more
        chip.bus.cancel(1)
        assert chip.sim.run_until_usb(FRAME)
    (done,) = chip.bus.completed()
    if size < 64:
        assert 0 <= done.cycle - began - (13 + size) * 8 * BIT < 2
    assert done.data == bytes(size)


def test_what_does_not_fit_waits_for_the_next_frame(chip):
    in_frame(chip.sim, 0.95)
    end = chip.bus.frame_start + FRAME
    chip.select(1)
    chip.bus.submit_in(0x81, 8)  # the host must reckon with 64 bytes
    assert chip.sim.run_until(lambda: chip.bus.counters.transactions > 0, FRAME, 1)
    assert chip.sim.cycle >= end + (40 + 64) * BIT
    assert chip.bus.counters.transactions == 1


@pytest.mark.parametrize("banks", [1, 2])
def test_nineteen_full_packets_fit_a_frame(flood, banks):
    sim = flood(banks)
    sim.usb.submit_out(2, bytes(100 * 64))
    in_frame(sim, 0)
    before = sim.usb.counters.bytes_out
    sim.run(10 * FRAME if banks == 1 else 4 * FRAME)
    moved = sim.usb.counters.bytes_out - before
    if banks == 2:
        assert moved == 4 * 19 * 64
        assert sim.usb.counters.naks == 0
    assert sim.run_until_usb(FRAME)
    (done,) = sim.usb.completed()
    assert done.transferred == 6400


def test_a_chip_that_has_always_data_sends_nineteen_packets_a_frame(flood):
    sim = flood(2)
    sim.usb.submit_in(0x81, 100 * 64)
    in_frame(sim, 0)
    before = sim.usb.counters.bytes_in
    sim.run(4 * FRAME)
    assert sim.usb.counters.bytes_in - before == 4 * 19 * 64
    assert sim.run_until_usb(3 * FRAME)
    (done,) = sim.usb.completed()
    assert done.data == bytes([1, 2, 3, 4] * 1600)


def test_endpoints_take_turns(flood):
    sim = flood(2)
    sim.usb.submit_out(2, bytes(200 * 64))
    sim.usb.submit_in(0x81, 200 * 64)
    sim.run(10 * FRAME)
    counters = sim.usb.counters
    assert abs(counters.bytes_in - counters.bytes_out) <= 64 * 10
    assert counters.bytes_in + counters.bytes_out > 64 * 18 * 9


def test_the_hosts_clock_may_differ(chip):
    chip.bus.frame_cycles = FRAME * 1.001
    in_frame(chip.sim, 0.5)
    starts = []
    for _ in range(4):
        starts.append(chip.bus.frame_start)
        chip.sim.run(FRAME)
    assert starts[3] - starts[0] == pytest.approx(3 * FRAME * 1.001)
    began = in_frame(chip.sim)
    chip.bus.submit_out(3, bytes(16))
    assert chip.sim.run_until_usb(FRAME)
    assert 0 <= chip.sim.cycle - began - 29 * 8 * BIT * 1.001 < 2
    with pytest.raises(SimError, match="frame_cycles"):
        chip.bus.frame_cycles = 12.0


# -- results --------------------------------------------------------------------------------------


def test_a_packet_without_data_follows_full_ones_when_asked_for(chip):
    chip.select(3)
    for zero_packet, packets in ((False, [16]), (True, [16, 0])):
        chip.bus.submit_out(3, bytes(16), packet=16, zero_packet=zero_packet)
        chip.ms(0.5)
        assert [c.transferred for c in chip.bus.completed()] == [16]
        assert [len(chip.take()) for _ in packets] == packets
        assert chip.flags() & FIFOCON == 0


def test_more_than_asked_for_is_an_overflow(chip):
    chip.select(1)
    chip.send(bytes(9))
    with pytest.raises(UsbError, match="overflow"):
        chip.bus.read(0x81, 8)
    assert chip.bus.read(0x81, 9) == bytes(9)  # it was not acknowledged
    chip.send(bytes(17))
    chip.bus.submit_in(0x81, 32, packet=16)
    assert chip.sim.run_until_usb(FRAME)
    assert chip.bus.completed()[0].status == "overflow"


def test_three_times_no_answer_end_a_transfer(chip):
    before = chip.bus.counters.transactions
    with pytest.raises(UsbNoAnswer, match="read from endpoint 0x82"):
        chip.bus.read(0x82)
    assert chip.bus.counters.transactions - before == 3


def test_stall_and_timeout(chip):
    chip.select(1)
    with pytest.raises(UsbTimeout):
        chip.bus.read(0x81, timeout_s=0.01)
    chip.put(UECONX, EPEN | STALLRQ)
    with pytest.raises(UsbStall):
        chip.bus.read(0x81)
    assert chip.bus.pending == 0
    assert chip.bus.completed() == []


def test_what_came_before_a_timeout_is_kept(chip):
    chip.select(1)
    chip.send(bytes(64))
    with pytest.raises(UsbTimeout) as caught:
        chip.bus.read(0x81, 65, timeout_s=0.01)
    assert caught.value.data == bytes(64)


def test_transfers_of_one_endpoint_follow_one_another(chip):
    chip.select(3)
    ids = [chip.bus.submit_out(3, bytes([i])) for i in range(5)]
    taken = []
    for _ in ids:
        chip.ms(0.2)
        taken.append(chip.take())
    assert taken == [bytes([i]) for i in range(5)]
    assert [c.id for c in chip.bus.completed()] == ids


def test_cancelled_in_mid_transfer(chip):
    number = chip.bus.submit_out(3, bytes(64), packet=16)
    other = chip.bus.submit_out(3, b"other")
    chip.ms(1)
    chip.bus.cancel(number)
    chip.bus.cancel(number)
    (done,) = chip.bus.completed()
    assert (done.id, done.status, done.transferred) == (number, "cancelled", 32)
    chip.select(3)
    for _ in range(3):
        last = chip.take()
        chip.ms(0.2)
    assert last == b"other"
    assert chip.bus.completed()[0].id == other


def test_a_transaction_on_the_wire_counts_though_its_transfer_is_cancelled(chip):
    chip.select(1)
    chip.send(b"data")
    in_frame(chip.sim)
    number = chip.bus.submit_in(0x81, 64)
    chip.sim.run(int(70 * BIT))  # in the midst of the packet
    chip.bus.cancel(number)
    assert chip.bus.completed() == []
    assert chip.sim.run_until_usb(FRAME)
    (done,) = chip.bus.completed()
    assert (done.status, done.data) == ("ok", b"data")
    sent = [chip.bus.submit_out(3, bytes([i] * 32), packet=16) for i in range(2)]
    chip.sim.run(int(70 * BIT))
    chip.bus.cancel(sent[0])
    chip.ms(0.3)
    first, *_ = chip.bus.completed()
    assert (first.id, first.status, first.transferred) == (sent[0], "cancelled", 16)
    chip.select(3)
    assert [chip.take() for _ in range(2)] == [bytes(16), bytes([1] * 16)]


@pytest.mark.parametrize(
    "wrong",
    [
        lambda bus: bus.submit_out(0x81, b""),
        lambda bus: bus.submit_in(0x10, 8),
        lambda bus: bus.submit_in(0x81, 8, packet=0),
        lambda bus: bus.submit_in(0x81, 8, address=128),
        lambda bus: bus.submit_control(READ[:7]),
        lambda bus: bus.submit_control(READ, b"x"),
        lambda bus: setattr(bus, "address", 128),
    ],
)
def test_wrong_arguments(chip, wrong):
    with pytest.raises(SimError):
        wrong(chip.bus)
    assert chip.bus.pending == 0


# -- the cable ------------------------------------------------------------------------------------


def test_a_chip_that_detaches_ends_all_transfers(chip):
    ids = [chip.bus.submit_in(0x81, 8), chip.bus.submit_control(READ)]
    chip.ms(1)
    assert chip.bus.pending == 2
    chip.put(UDCON, 1)
    chip.ms(1.1)
    done = chip.bus.completed()
    assert sorted(c.id for c in done) == ids
    assert {c.status for c in done} == {"no_answer"}
    assert chip.bus.transact("IN", 1)[0] is None
    chip.put(UDCON, 0)
    assert chip.bus.attached
    assert chip.bus.transact("IN", 1)[0] is None  # until the next bus reset
    chip.bus.reset()
    assert chip.endpoint(0, CONTROL, size_bits(8))
    chip.ms(1.1)
    assert chip.bus.transact("SETUP", 0, READ)[0] == "ACK"


def test_a_short_gap_in_the_pull_up_is_not_seen(chip):
    number = chip.bus.submit_in(0x81, 8)
    in_frame(chip.sim, 0.3)
    chip.pulse(UDCON, 1, 12)  # 37 cycles
    assert chip.get(UDCON) == 0
    chip.ms(1.1)
    assert chip.bus.enabled
    chip.select(1)
    chip.send(b"1")
    chip.ms(1.1)
    assert [(c.id, c.status) for c in chip.bus.completed()] == [(number, "ok")]


def test_a_gap_in_the_pull_up_is_a_disconnect(chip):
    """Even if it is over before the next frame; 2.5 us make one (USB 2.0, 7.1.7.3)."""
    number = chip.bus.submit_in(0x81, 8)
    in_frame(chip.sim, 0.3)
    frame = chip.bus.frame
    chip.pulse(UDCON, 1, 14)  # 43 cycles
    assert [(c.id, c.status) for c in chip.bus.completed()] == [(number, "no_answer")]
    assert chip.bus.attached
    assert not chip.bus.enabled
    chip.ms(1.1)
    assert chip.bus.frame == frame
    chip.bus.reset()
    assert chip.bus.enabled
    assert chip.endpoint(0, CONTROL, size_bits(8))
    assert chip.bus.transact("SETUP", 0, READ)[0] == "ACK"


def test_a_reset_of_the_chip_detaches(chip):
    frame = chip.bus.frame
    chip.bus.submit_in(0x81, 8)
    chip.sim.reset()
    chip.ms(5)
    assert not chip.bus.attached
    assert not chip.bus.active
    assert [c.status for c in chip.bus.completed()] == ["no_answer"]
    assert chip.bus.frame == frame
    with pytest.raises(UsbError, match="nothing is attached"):
        chip.bus.reset()
    with pytest.raises(UsbNoAnswer):
        chip.bus.read(0x81)


def test_a_chip_that_is_unplugged(chip):
    chip.bus.submit_in(0x81, 8)
    chip.bus.unplug()
    assert [c.status for c in chip.bus.completed()] == ["no_answer"]
    assert not chip.bus.attached
    chip.put(UDINT, 0)
    chip.ms(4)
    # A U2 that does not look at VBUS by a pin of its own only notices that the bus is idle.
    assert chip.get(UDINT) == (0 if chip.is_u4 else SUSPI)
