"""The sensor board of the thesis' listing 9.2, with real drivers: apps/listing on two chips.

Distances, voltages and edges come from here. On an ATmega328P all three drivers have hardware; on
an ATmega32U2, over USB and in 1 KB of RAM, the encoders do.
"""

import pytest
from j2a_sim import AvrSim, SimError, SimLink

import j2a
from firmware.verify.budget import avr_stack, builds
from firmware.verify.budget.sensor_load import CHIPS, FORWARD

pytestmark = pytest.mark.avr

NOTHING = 0x00FFFFFF
CHANNELS = 12
FIRST = 0x70
ROUND_S = 0.4  # more than two rounds of measurements take


class Board:
    """The board with a host at its UART."""

    def __init__(self, elf):
        self.sim = AvrSim(elf)
        for pin in CHIPS["atmega328p"].encoders:
            self.sim.pins.drive(pin, 0)
        self.client = j2a.Client(SimLink(self.sim))

    def run(self, seconds=ROUND_S):
        """Let simulated time pass; what comes meanwhile is taken."""
        end = self.sim.time_s + seconds
        while self.sim.time_s < end:
            self.client.call("a2jEcho")

    def distances(self):
        return [one.value for one in self.client.transducers["dist_us"].read()]


@pytest.fixture
def board(build):
    made = Board(build("listing", "avr-serial"))
    yield made
    made.client.close()
    assert made.sim.log == ""
    made.sim.close()


def test_distances_of_all_sensors_on_the_bus(board):
    for channel in range(CHANNELS):
        board.sim.twi.set_distance(FIRST + channel, 20 + 40 * channel)
    board.run()
    assert board.distances() == [20 + 40 * channel for channel in range(CHANNELS)]
    board.sim.twi.set_distance(FIRST + 3, 0x1FE)  # the higher byte comes first
    board.sim.twi.set_distance(FIRST + 4, 0)  # it sees nothing
    board.run()
    assert board.distances()[3:5] == [0x1FE, None]
    sample = board.client.transducers["dist_us"].wait(5)
    assert sample.values[0] == 20
    assert sample.readings[4].raw == NOTHING


def test_they_measure_again_and_again(board):
    board.sim.twi.set_distance(FIRST, 100)
    board.run()
    before, start = board.sim.twi.measurements(FIRST), board.sim.time_s
    board.run(1.0)
    rounds = (board.sim.twi.measurements(FIRST) - before) / (board.sim.time_s - start)
    assert 8 < rounds < 15  # 70 ms, and what 24 transfers take


def test_a_sensor_that_is_missing_gives_none_and_delays_no_other(board):
    for channel in (0, 5, 11):
        board.sim.twi.set_distance(FIRST + channel, 77)
    board.run()
    wanted = [77 if channel in (0, 5, 11) else None for channel in range(CHANNELS)]
    assert board.distances() == wanted
    board.sim.twi.remove(FIRST + 5)
    board.run()
    assert board.distances()[5] is None
    board.sim.twi.set_distance(FIRST + 5, 33)
    board.run()
    assert board.distances()[5] == 33


def test_a_sensor_that_does_not_acknowledge_commands(board):
    board.sim.twi.set_distance(FIRST, 50)
    board.sim.twi.deafen(FIRST + 1)
    board.run()
    assert board.distances()[:2] == [50, None]


def test_a_bus_that_hangs_stops_nothing_and_recovers(board):
    """Each transfer is given up after 5 ms; calls are answered as fast as before."""
    for channel in range(CHANNELS):
        board.sim.twi.set_distance(FIRST + channel, 60)
    board.run()
    board.sim.twi.hang()
    longest = 0.0
    end = board.sim.time_s + 2 * ROUND_S
    while board.sim.time_s < end:
        before = board.sim.time_s
        board.client.call("a2jEcho")
        longest = max(longest, board.sim.time_s - before)
    assert longest < 0.03
    assert board.distances() == [None] * CHANNELS
    board.sim.twi.hang(False)
    board.run(2 * ROUND_S)
    assert board.distances() == [60] * CHANNELS


def test_hanging_at_any_moment_of_a_transfer(board):
    """The bus hangs and is free again, from cycle to cycle of a round."""
    for channel in range(CHANNELS):
        board.sim.twi.set_distance(FIRST + channel, 60)
    for step in range(25):
        board.sim.run(board.sim.cycles(0.0031) + 7 * step)
        board.sim.twi.hang()
        board.sim.run(board.sim.cycles(0.004) * (step % 4))
        board.sim.twi.hang(False)
    board.run(2 * ROUND_S)
    assert board.distances() == [60] * CHANNELS


def test_infrared_and_encoders_beside_them(board):
    volts = (2.51, 1.25, 0.50, 0.0)  # of a GP2Y0A02YK, as its data sheet has them
    for channel, value in enumerate(volts):
        board.sim.adc.set_volts(channel, value)
    at = board.sim.cycle + board.sim.cycles(0.5)  # the reader of the client lets time pass, too
    for step in range(300):
        wire = step % 2
        pin = CHIPS["atmega328p"].encoders[wire]
        board.sim.pins.drive(pin, FORWARD[step % 4][wire], at + 4000 * step)
    board.run(1.0)
    assert [one.value for one in board.client.transducers["quad"].read()] == [300, None]
    found = [one.value for one in board.client.transducers["dist_ir"].read()]
    assert found[:3] == [pytest.approx(mm, rel=0.06) for mm in (200, 500, 1300)]
    assert found[3:] == [None] * 5  # it sees nothing there, and has four inputs
    assert board.sim.counters.overruns == 0


def test_the_bus_has_limits(board):
    with pytest.raises(SimError, match="out of range"):
        board.sim.twi.set_distance(0x60, 5)
    with pytest.raises(SimError, match="out of range"):
        board.sim.twi.set_distance(FIRST, -1)


# -- over USB, in 1 KB of RAM --------------------------------------------------------------------


def test_all_of_it_over_usb_in_1_kb(build):
    elf = build("listing", "avr-usb", MCU="atmega32u2")
    with AvrSim(elf, "atmega32u2") as sim, pytest.raises(SimError, match="no TWI"):
        sim.twi  # noqa: B018
    with j2a.connect(f"sim:{elf}?mcu=atmega32u2&link=usb", timeout=10) as board:
        assert board.properties["name"] == "J2A listing 9.2"
        assert [
            (one.name, one.id, one.channels) for one in board.transducers.descriptors.transducers
        ] == [("quad", 0, 2), ("dist_ir", 1, 8), ("dist_us", 2, 12)]
        quad = board.transducers["quad"]
        quad.period = 0.02
        assert quad.period == 0.02
        assert board.transducers["dist_us"].wait(20).values == (None,) * 12
        infrared = board.transducers["dist_ir"].read()
        assert [(one.value, one.time_us > 0) for one in infrared] == [(None, True)] * 8
        assert len(board.transducers["quad"].read()) == 2


def test_ram_and_stack_fit_the_chip():
    """The bound of the stack holds for each input; the budget prints it."""
    [row] = [one for one in builds.load() if one.name == "avr-usb/listing"]
    assert row.limit["total"] == 1024
    assert "bound" in row.measure
    assert row.variables["MCU"] == "atmega32u2"


def test_the_encoders_are_read_over_usb(build):
    """Edges at the pins while the host is connected over USB; the stack stays below its bound."""
    elf = build("listing", "avr-usb", MCU="atmega32u2")
    [row] = [one for one in builds.load() if one.name == "avr-usb/listing"]
    bound = avr_stack.stack_bound(elf, row)
    with j2a.connect(f"sim:{elf}?mcu=atmega32u2&link=usb", timeout=10) as board:
        sim = board._transport.sim
        a, b, *_ = CHIPS["atmega32u2"].encoders
        with board.transducers["quad"].samples() as samples:
            # The pull-ups have both wires high, and from there it goes forward.
            for step in range(12):
                sim.pins.drive((a, b)[step % 2], step // 2 % 2)
                count = samples.wait(20).readings[0]
                assert (count.raw, count.time_us > 0) == (step + 1, True)
        for _ in range(5):
            board.read_many("a2jGetTransds")
        assert 100 < sim.stack_bytes <= bound
        assert sim.program.ram_end - 0x100 + bound <= 1024
