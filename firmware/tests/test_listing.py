"""The sensor board of the thesis' listing 9.2, with real drivers: apps/listing on two chips.

Distances, voltages and edges come from here. On an ATmega328P all three drivers have hardware; on
an ATmega32U2, over USB and in 1 KB of RAM, the encoders do.
"""

import j2a_transports
import pytest
import usb.core
from j2a_sim import AvrSim, SimBackend, SimError, SimLink
from j2a_spec import constants as c
from j2a_spec import usb as usb_grammar
from j2a_spec.oracle import Frame, decode, encode

import j2a
from firmware.tests.usb9 import Device
from firmware.verify.budget import avr_stack, builds
from firmware.verify.budget.sensor_load import CHIPS, FORWARD

pytestmark = pytest.mark.avr

NOTHING = 0x00FFFFFF
CHANNELS = 12
FIRST = 0x70
QUAD = 0
ECHO = [name for name in c.BUILTINS if name != c.GET_DEBUG].index(c.GET_ECHO)
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


def answers(link, sim):
    """Return how long the board takes to answer each of the calls of two rounds, in seconds."""
    took_s, end = [], sim.time_s + 2 * ROUND_S
    while sim.time_s < end:
        request = Frame(c.SOF, len(took_s) % 256, ECHO, b"")
        before, data = sim.time_s, b""
        link.write(encode(request))
        while not any(one == Frame(c.SOF, request.seq, c.ECHO, b"") for one in decode(data)):
            assert sim.time_s < before + 1
            data += link.read(1)
        took_s.append(sim.time_s - before)
    return took_s


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
    board.client.close()  # whose thread lets time pass while this one is not awake
    took_s = answers(SimLink(board.sim), board.sim)
    assert len(took_s) > 100
    assert max(took_s) < 0.03
    board.client = j2a.Client(SimLink(board.sim))
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


# -- with the clock, too: all that the prototype of the thesis had ---------------------------------

UNIX = 1_700_000_000_000_000
CYCLES_PER_US = 16
LATE_US = 80  # the other interrupts, before that of the encoders, and what the clock is wrong by


class Bus:
    """A board on a simulated bus: a client of the library, SyncUSB beside it, and the true time.

    Rule: only the host of the bus runs the simulator, and what looks into it asks that host.
    """

    def __init__(self, sim):
        self.sim = sim
        backend = SimBackend(sim)
        (self._host,) = backend._hosts
        self.device = usb.core.find(backend=backend)
        self.client = j2a.Client(j2a_transports.open_usb_device(self.device), timeout=60)
        self.zero = self._host.call(lambda: sim.cycle)

    def time(self, cycle):
        """The time that the host tells, in microseconds."""
        return UNIX + (cycle - self.zero) / CYCLES_PER_US

    def sync(self):
        """Send a packet of SyncUSB: when the current frame began."""
        bus = self.sim.usb
        number, began = self._host.call(lambda: (bus.frame, bus.frame_start))
        packet = usb_grammar.sync.build(
            {"time_us": round(self.time(began)), "frame": number % 1024}
        )
        assert self.device.write(c.SYNCUSB_OUT, packet) == len(packet)

    def drive(self, pin, level):
        """Set a pin; returns the time."""

        def set_pin():
            self.sim.pins.drive(pin, level)
            return self.time(self.sim.cycle)

        return self._host.call(set_pin)

    def run(self, seconds):
        end = self.sim.time_s + seconds
        while self.sim.time_s < end:
            self.client.echo(b"")


@pytest.fixture
def bus(build):
    elf = build("listing", "avr-usb", MCU="atmega32u2", OPTIONS="-DJ2A_WITH_SYNC=1")
    with AvrSim(elf, "atmega32u2") as sim:
        found = Bus(sim)
        with found.client:
            yield found
            [row] = [one for one in builds.load() if one.name == "avr-usb/listing-clock"]
            bound = avr_stack.stack_bound(elf, row)
            assert 200 < sim.stack_bytes <= bound
            assert sim.program.ram_end - 0x100 + bound <= 1024


def test_syncusb_leads_the_time_of_samples(bus):
    board = bus.client
    described = [(one.name, one.channels) for one in board.transducers.descriptors.transducers]
    assert described == [("quad", 2), ("dist_ir", 8), ("dist_us", 12)]
    assert board.clock.status().state == c.CLOCK_FREE
    for _ in range(10):
        bus.sync()
        bus.run(0.25)
    status = board.clock.status()
    assert (status.state, status.epoch) == (c.CLOCK_LOCKED, 1)
    assert board.transducers["dist_us"].wait(20).values == (None,) * 12
    wires = CHIPS["atmega32u2"].encoders
    with board.transducers["quad"].samples() as samples:
        for step in range(12):
            driven = bus.drive(wires[step % 2], step // 2 % 2)
            count = samples.wait(20).readings[0]
            assert count.raw == step + 1
            assert 0 <= count.time_us - driven + 3 < LATE_US
    bus.sync()
    for size in range(0, 145, 16):
        assert board.echo(bytes(size)) == bytes(size)
    assert board.clock.status().epoch == 1


def test_a_sample_waits_for_a_request_that_is_being_received(build):
    """Both are in the same memory: the request stays whole, and the sample comes behind it."""
    elf = build("listing", "avr-usb", MCU="atmega32u2")
    echo = Frame(c.SOF, 9, ECHO, bytes(range(100)))
    first, rest = encode(echo)[:64], encode(echo)[64:]
    wires = CHIPS["atmega32u2"].encoders

    def begin(step):
        """Half of a request, and in the middle of it an edge."""
        device.finish(device.bus.submit_out(c.USB_OUT, first, packet=64))
        device.pause(1)  # until the main loop has taken it
        device.sim.pins.drive(wires[step % 2], step // 2 % 2)

    def end():
        """What answers it, and the sample of the encoders; those of dist_us come when they like."""
        found = device.listen(1, limit_ms=50)
        while QUAD not in [frame.opcode for frame in found if frame.start == c.SOS]:
            more = device.listen(1, limit_ms=50)
            assert more
            found += more
        (sample,) = [frame for frame in found if (frame.start, frame.opcode) == (c.SOS, QUAD)]
        return found[0], int.from_bytes(sample.payload[8:10], "little")

    with Device(elf, "atmega32u2") as device:
        device.to_configured()
        device.pause(300)
        device.listen(100, limit_ms=100)  # what the drivers report at the start
        for step in range(24):
            begin(step)
            assert device.listen(1, limit_ms=5) == []
            device.finish(device.bus.submit_out(c.USB_OUT, rest, packet=64))
            assert end() == (Frame(c.SOF, 9, c.ECHO, echo.payload), step + 1)
        begin(0)  # this one breaks off: the sample waits no longer than the pause that ends it
        answer, count = end()
        assert (answer.opcode, count) == (c.ERR_TIMEOUT, 25)


def test_a_request_that_is_cut_anywhere_stays_whole(build):
    """Behind an ESC, too: at the start, in the middle and at the end of the payload."""
    elf = build("listing", "avr-usb", MCU="atmega32u2")
    payload = bytes((0x7D, 1, 2, 0x7E, 0x7D, 3, 4, 0x7F, 5, 0x7E))
    wire = encode(Frame(c.SOF, 0x7D, ECHO, payload))
    wires = CHIPS["atmega32u2"].encoders

    def listen_for(count):
        """The reply, and the sample of the encoders that has this count."""
        reply = sample = None
        while reply is None or sample is None:
            found = device.listen(1, limit_ms=50)
            assert found, (reply, sample)
            for frame in found:
                if frame.start == c.SOF:
                    reply = frame
                elif frame.opcode == QUAD:
                    sample = int.from_bytes(frame.payload[8:10], "little")
                    assert sample == count
        return reply

    with Device(elf, "atmega32u2") as device:
        device.to_configured()
        device.pause(300)
        device.listen(100, limit_ms=100)
        for step, cut in enumerate(range(1, len(wire))):
            device.finish(device.bus.submit_out(c.USB_OUT, wire[:cut], packet=64))
            device.pause(1)
            device.sim.pins.drive(wires[step % 2], step // 2 % 2)
            device.pause(2)
            device.finish(device.bus.submit_out(c.USB_OUT, wire[cut:], packet=64))
            assert listen_for(step + 1) == Frame(c.SOF, 0x7D, c.ECHO, payload), cut
