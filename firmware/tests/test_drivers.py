"""The drivers: their arithmetic on this machine, and each with its stimulus on a simulated chip.

Volts, edges and cycles come from here or are measured here; what is expected of them is calculated
by models of this file, which share nothing with the firmware.
"""

import ctypes
import itertools
import json
import math
import random
import re
import shutil
import struct
import subprocess
from functools import cache, partial
from pathlib import Path

import pytest
from j2a_sim import AvrSim, pulses
from j2a_spec import constants as c
from j2a_spec.oracle import Frame, decode, encode

from firmware.verify.budget.sensor_load import (
    ADC,
    BACKWARD,
    CHIPS,
    DIST_IR,
    FORWARD,
    LAMP,
    MISSES,
    QUAD,
    QUAD_AT,
    SERVO,
    Board,
    goes_on,
    values,
)

DRIVERS = Path(__file__).parent.parent / "drivers"
PAGE = DRIVERS.parent.parent / "docs" / "drivers.md"
OVERFLOW, CONVERSION = 13, 21  # vectors of the ATmega328P
US = 16  # cycles
TICK = 64  # cycles of timer 1
# Distance in mm and volts: the typical curves in the data sheets of GP2Y0A21YK and GP2Y0A02YK.
SHARP = ((100, 2.30), (120, 2.00), (150, 1.64), (200, 1.30), (250, 1.07), (300, 0.92))
SHARP += ((400, 0.74), (500, 0.60), (600, 0.51), (700, 0.45), (800, 0.40))
SHARP_02 = (
    (200, 2.51),
    (300, 1.99),
    (400, 1.52),
    (500, 1.25),
    (600, 1.04),
    (700, 0.87),
    (800, 0.79),
)
SHARP_02 += ((900, 0.74), (1000, 0.69), (1100, 0.60), (1200, 0.55), (1300, 0.50), (1400, 0.47))
SHARP_02 += ((1500, 0.45),)


def test_bytes_of_a_frame_that_goes_on_are_not_decoded():
    """At its end it does not, and before the last byte nothing whole is kept back."""
    rng = random.Random(1)
    bytes_ = (c.SOF, c.SOS, c.ESC, c.ESC + 1, 0, 0xFF)
    for length in [*range(20), c.SOF, c.ESC, c.ESC + 1, c.SOS, 255] * 3:
        frames = [
            Frame(c.SOS, *rng.choices(bytes_, k=2)),
            Frame(c.SOF, *rng.choices(bytes_, k=2), bytes(rng.choices(bytes_, k=length))),
        ]
        wire = b"".join(map(encode, frames))
        assert not goes_on(wire)
        whole = [n for n in range(len(wire)) if all(isinstance(e, Frame) for e in decode(wire[:n]))]
        assert whole == [0, len(encode(frames[0]))]
        assert not goes_on(wire[: whole[1]])
        assert goes_on(wire[: whole[1] + 1])
        assert goes_on(wire[: whole[1] + 3 + length])


def samples(board, sensor):
    """The samples of a sensor in the SIFs that came: time and raw value by channel."""
    return [values(sensor, sif.payload) for sif in board.sifs if sif.opcode == sensor]


@pytest.fixture(scope="session")
def build(build_firmware):
    """Build as the Makefile does it by itself: the cycles of interrupts are on the page."""
    return partial(build_firmware, core_as_one=False)


@pytest.fixture
def board(build):
    made = Board(build("sensors", "avr-serial", BAUD="500000"))
    made.quiet()
    yield made
    assert made.sim.log == ""
    made.sim.close()


def test_each_source_is_short():
    """A driver is an example, to be read at a glance: fewer than 150 lines."""
    sources = [path for path in DRIVERS.rglob("*") if path.suffix in {".c", ".h"}]
    assert len(sources) > 15
    lines = {path.name: len(path.read_text("utf-8").splitlines()) for path in sources}
    assert {name: count for name, count in lines.items() if count >= 150} == {}


# -- arithmetic, on this machine ---------------------------------------------------------------


def compiled(need, tmp_path_factory, *options):
    """The drivers' hardware-independent parts as a library."""
    need("cc")
    folder = tmp_path_factory.mktemp("arithmetic")
    (folder / "step.c").write_text(
        '#include "quadrature.h"\nint8_t step(uint8_t before, uint8_t now);\n'
        "int8_t step(uint8_t before, uint8_t now) { return quadrature_step(before, now); }\n"
    )
    library = folder / "drivers.so"
    command = ["cc", "-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-shared", "-fPIC"]
    command += [*options, "-DF_CPU=16000000", f"-I{DRIVERS}", f"-I{DRIVERS.parent / 'core'}"]
    sources = (DRIVERS / f"{name}.c" for name in ("quadrature", "sharp", "ticks"))
    command += [*map(str, sources), str(folder / "step.c"), "-o", str(library)]
    subprocess.run(command, check=True)
    made = ctypes.CDLL(str(library))
    made.step.restype = ctypes.c_int8
    made.sharp_mm.restype = ctypes.c_uint16
    made.ticks_of_servo.restype, made.ticks_of_servo.argtypes = ctypes.c_uint16, (ctypes.c_int8,)
    return made


@pytest.fixture(scope="module")
def arithmetic(need, tmp_path_factory):
    return compiled(need, tmp_path_factory)


@pytest.fixture(scope="module")
def farther(need, tmp_path_factory):
    """The same for a GP2Y0A02YK."""
    return compiled(need, tmp_path_factory, "-DSHARP_MODEL=SHARP_GP2Y0A02YK")


def test_quadrature_steps(arithmetic):
    """The place in the cycle of four states says what a step is."""
    cycle = [a | b << 1 for a, b in FORWARD]
    for before, now in itertools.product(range(4), repeat=2):
        turned = (cycle.index(now) - cycle.index(before)) % 4
        assert arithmetic.step(before, now) == {0: 0, 1: 1, 2: 2, 3: -1}[turned]


def test_distance_follows_the_curve_of_the_data_sheet(arithmetic):
    """Within 3 % and one count; between the points the curve is straight over 1 / mm."""
    for (near, high), (far, low) in itertools.pairwise(SHARP):
        for mm in range(near, far, 5):
            part = (1 / mm - 1 / far) / (1 / near - 1 / far)
            counts = (low + part * (high - low)) * 1024 / 5
            one_count = mm * mm / 58000
            found = arithmetic.sharp_mm(int(counts))
            assert abs(found - mm) <= 0.03 * mm + one_count, (mm, counts, found)


def test_distance_agrees_with_a_power_law(arithmetic):
    """Another fit that is in use: 27.86 cm / V ^ 1.15; both are fits, so 8 % apart."""
    for mv in range(400, 2300, 10):
        counts = int(mv * 1.024 / 5)
        assert arithmetic.sharp_mm(counts) == pytest.approx(278.6 * (mv / 1000) ** -1.15, rel=0.08)


def test_distance_of_all_counts(arithmetic):
    found = [arithmetic.sharp_mm(counts) for counts in range(1024)]
    inside = [mm for mm in found if mm]
    assert inside == sorted(inside, reverse=True)
    assert (inside[0], inside[-1]) == (pytest.approx(850, abs=15), 95)
    first, last = found.index(inside[0]), found.index(inside[-1])
    assert set(found[:first]) == {0}
    assert all(found[first:last])
    assert set(found[found.index(95) + inside.count(95) :]) == {0}
    assert arithmetic.sharp_mm(65535) == 0


def test_distance_of_the_farther_model_follows_its_curve(farther):
    """Within 6 % and half a count at the points that were read from the data sheet."""
    for mm, volts in SHARP_02:
        half_a_count = (mm + 70) ** 2 / 144200 / 2
        found = farther.sharp_mm(round(volts * 1024 / 5))
        assert abs(found - mm) <= 0.06 * mm + half_a_count, (mm, found)


def test_distance_of_the_farther_model_of_all_counts(farther):
    """It falls with the counts; out of its range is nothing, also where 16 bits would overflow."""
    found = [farther.sharp_mm(counts) for counts in range(1024)]
    inside = [mm for mm in found if mm]
    assert inside == sorted(inside, reverse=True)
    assert (inside[0], inside[-1]) == (pytest.approx(1600, abs=20), 190)
    first = found.index(inside[0])
    assert found == [0] * first + inside + [0] * (1024 - first - len(inside))
    assert farther.sharp_mm(65535) == 0


def test_a_model_that_is_unknown_does_not_compile(need):
    need("cc")
    command = ["cc", "-fsyntax-only", "-DSHARP_MODEL=3", str(DRIVERS / "sharp.c")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode != 0
    assert "SHARP_GP2Y0A21YK or SHARP_GP2Y0A02YK" in done.stderr


def test_ticks_of_servos(arithmetic):
    for deflection in range(-128, 128):
        us = 1500 + 5 * max(-100, min(100, deflection))
        assert abs(4 * arithmetic.ticks_of_servo(deflection) - us) <= 2


# -- encoders ----------------------------------------------------------------------------------


@pytest.mark.avr
@pytest.mark.parametrize("channel", [0, 1])
def test_encoder_forward_and_backward(board, channel):
    end = board.turn(channel, 1001, board.sim.cycle + 100, 900)
    board.talk_until(end)
    assert board.encoder(channel) == (1001, 0)
    assert board.encoder(1 - channel) == (0, 0)
    board.pins.drive(board.chip.encoders[2 * channel], 0)  # one step back, to A = B = 0
    end = board.turn(channel, 2004, board.sim.cycle + 1000, 900, BACKWARD)
    board.talk_until(end)
    assert board.encoder(channel) == (1000 - 2004, 0)
    assert board.encoder(1 - channel) == (0, 0)


@pytest.mark.avr
def test_encoder_that_bounces(board):
    """Each edge is 11 edges; the count goes one up and one down, and ends where it belongs."""
    a, b, *_ = board.chip.encoders
    start = board.sim.cycle + 100
    for step in range(200):
        wire, level = (a, b)[step % 2], FORWARD[step % 4][step % 2]
        for bounce in range(11):
            board.pins.drive(wire, level ^ (bounce & 1), start + 8000 * step + 400 * bounce)
    board.talk_until(start + 200 * 8000)
    assert board.encoder(0) == (200, 0)


@pytest.mark.avr
def test_encoders_begin_where_they_stand(build):
    """Both wires are high when the chip starts: that is no step, and the first one is right."""
    board = Board(build("sensors", "avr-serial", BAUD="500000"), level=1)
    board.pause(0.001)
    assert [board.encoder(channel) for channel in (0, 1)] == [(0, 0), (0, 0)]
    board.pins.drive(board.chip.encoders[0], 0)
    board.pins.drive(board.chip.encoders[3], 0)
    board.pause(0.001)
    assert [board.encoder(channel) for channel in (0, 1)] == [(1, 0), (-1, 0)]
    board.sim.close()


@pytest.mark.avr
def test_encoders_with_open_collectors(build):
    """Nobody drives a wire high: the pull-ups do, in up to 45 us, and that is no step."""
    sim = AvrSim(build("sensors", "avr-serial", BAUD="500000"))
    for pin, us in zip(CHIPS["atmega328p"].encoders, (45, 3, 20, 44), strict=True):
        sim.pins.release(pin, rise_cycles=us * US)
    board = Board(sim, level=None)
    board.pause(0.001)
    assert [board.encoder(channel) for channel in (0, 1)] == [(0, 0), (0, 0)]
    a, b = board.chip.encoders[:2]
    for number, wire in enumerate((a, b)):  # from 11 to 01 to 00: forward
        board.pins.drive(wire, 0)
        board.pause(0.001)
        assert board.encoder(0) == (number + 1, 0)
    for number, wire in enumerate((a, b)):  # to 10, to 11
        board.pins.release(wire, rise_cycles=45 * US)
        board.pause(0.001)
        assert board.encoder(0) == (number + 3, 0)
    sim.close()


@pytest.mark.avr
def test_an_edge_at_each_cycle_of_the_start(build):
    """Before the levels are read it is where an encoder stands, after that a step; none is lost."""
    pcicr = 0x68
    sim = AvrSim(build("sensors", "avr-serial", BAUD="500000"))
    a, b, *_ = CHIPS["atmega328p"].encoders
    for wire in CHIPS["atmega328p"].encoders:
        sim.pins.drive(wire, 0)
    begin = sim.cycle
    assert sim.run_until(lambda: sim.read_memory(pcicr, 1)[0] != 0, sim.cycles(0.1), 1)
    on = sim.cycle - begin
    counts = []
    for cycle in range(on - 40, on + 40):
        sim.pins.drive(a, 0)
        sim.pins.drive(b, 0)
        sim.reset()
        begin = sim.cycle
        sim.pins.drive(a, 1, begin + cycle)
        sim.pins.drive(b, 1, begin + on + 2000)
        board = Board(sim, level=None)
        count, errors = board.encoder(0)
        assert errors == 0, cycle - on
        counts.append(count)
    assert counts == sorted(counts)
    assert set(counts) == {1, 2}
    sim.close()


@pytest.mark.avr
def test_illegal_transitions_are_counted(board):
    """Both wires within one instruction: nobody knows the direction, so the count stays."""
    a, b, *_ = board.chip.encoders
    for errors in range(1, 6):
        at = board.sim.cycle + 50
        board.pins.drive(a, errors & 1, at)
        board.pins.drive(b, errors & 1, at)
        board.pause(0.001)
        assert board.encoder(0) == (0, errors)
    assert board.encoder(1) == (0, 0)


@pytest.mark.avr
@pytest.mark.parametrize("encoders", [1, 2])
def test_fast_edges_of_encoders_while_the_host_talks(board, encoders):
    """Steps as near as the page says, with all other drivers at work."""
    both = printed(r"(\d+) cycles apart \((\d+) a second\) on both")
    one = printed(r"(\d+) cycles apart \((\d+) a second\) on one")
    distance, a_second = both if encoders == 2 else one
    assert a_second == 16_000_000 // distance // 1000 * 1000
    board.send_each(20, *board.chip.sensors)
    board.set(SERVO, 50)
    start = board.sim.cycle + 1000
    end = board.turn(0, 6000, start, distance)
    if encoders == 2:
        board.turn(1, 6000, start, distance, BACKWARD)
    assert board.talk_until(end) > 20
    counts = [board.encoder(channel) for channel in (0, 1)]
    assert counts == [(6000, 0), (-6000 if encoders == 2 else 0, 0)]
    assert board.sim.counters.overruns == 0
    assert board.ask("overruns", "H") == (0,)


@pytest.mark.avr
def test_edges_that_are_too_fast_are_noticed(board):
    """Steps of 6 us: most are missed, and what is seen of it is errors."""
    board.run_to(board.turn(0, 1000, board.sim.cycle + 1000, 100) + 10000)
    count, errors = board.encoder(0)
    assert count != 1000
    assert errors > 100


@pytest.mark.avr
@pytest.mark.sampled(2)  # the encoders of the ATmega32U4 are where those of the ATmega32U2 are
@pytest.mark.parametrize("mcu", CHIPS)
def test_a_storm_of_edges_does_no_harm(build, mcu):
    """Edges each 205 cycles leave no time for anything; no interrupt piles up on the stack."""
    board = Board(build("sensors", "avr-serial", BAUD="500000", MCU=mcu), mcu)
    board.storm()
    assert board.sim.stack_bytes < 200
    board.sim.close()


@pytest.mark.avr
def test_encoder_count_is_set_and_wraps(board):
    """The count that is set is a sample like that of a step, with the time at which it was set."""
    board.enable(QUAD)
    board.set(QUAD_AT, 32767, channel=1)
    assert board.encoder(1) == (32767, 0)
    board.pause(0.001)
    ((none, (time_us, count)),) = samples(board, QUAD)
    assert (none, count) == ((0, 0), 32767)
    assert 0 <= board.sample(QUAD_AT)[1][0] - time_us < 200
    board.run_to(board.turn(1, 2, board.sim.cycle + 1000, 1000))
    assert board.encoder(1) == (-32767, 0)
    assert board.encoder(0) == (0, 0)


# -- ADC and infrared --------------------------------------------------------------------------


@pytest.mark.avr
@pytest.mark.parametrize("mcu", ["atmega328p", "atmega32u4"])
def test_counts_of_voltages(build, mcu):
    """A 10-bit converter: 1024 steps from 0 to AVCC, the last one is full scale."""
    board = Board(build("sensors", "avr-serial", BAUD="500000", MCU=mcu), mcu)
    board.quiet()
    for step in range(0, 27):
        volts = [step * 0.2, 5.2 - step * 0.2, step * 5 / 1024, step * 5 / 1024 + 0.0048]
        for channel, value in zip(board.chip.analog, volts, strict=True):
            board.sim.adc.set_volts(channel, value)
        board.pause(0.006)  # longer than until the next scan is over
        for channel, (value, (_, counts)) in enumerate(zip(volts, board.sample(ADC), strict=True)):
            assert counts == min(1023, math.floor(value / 5 * 1024 + 1e-9)), (channel, value)
    assert board.sim.log == ""
    board.sim.close()


@pytest.mark.avr
def test_a_scan_takes_the_time_of_four_conversions(board):
    """13 periods of 128 cycles each, and at most another period until the next one begins."""
    board.send_each(0, ADC)
    before = board.sim.adc.conversions
    board.talk_until(board.sim.cycle + board.sim.cycles(0.2))
    times = [[time for time, _ in sample] for sample in samples(board, ADC)]
    scans = sorted({scan[3] for scan in times})
    assert len(scans) in range(35, 47)  # each 5 ms for these values, each 40 ms for distances
    assert board.sim.adc.conversions - before == pytest.approx(4 * len(scans), abs=8)
    whole = [scan for scan in times if scan == sorted(scan)]  # the others are of two scans
    assert len(whole) > 20
    for scan in whole:
        for early, late in itertools.pairwise(scan):
            assert 13 * 128 / US - 8 <= late - early <= 15 * 128 / US + 8
    for early, late in itertools.pairwise(scans):
        assert late - early <= 8000  # with what a turn of the main loop takes


@pytest.mark.avr
def test_a_period_as_long_as_that_of_scans_sends_each_scan(board):
    """From the second SIF on: the first one is sent with the first value, amid a scan."""
    board.send_each(5, ADC)
    board.pause(2)
    board.quiet()  # until its reply, the last SIF is whole
    found = samples(board, ADC)[1:]
    for channel in range(4):
        scans = sorted({sample[channel][0] for sample in found})
        gaps = [late - early for early, late in itertools.pairwise(scans)]
        assert len(gaps) > 380
        assert max(gaps) < 9000  # 10 ms where one is missing


@pytest.mark.avr
def test_a_value_is_that_of_its_sampling_moment(board):
    """A ramp that is known at each cycle: stamp and value of a sample are of the same moment.

    The stamp is taken by the interrupt at the end of the conversion, 11.5 of the ADC's periods
    after the sampling. The clock began with the port, some cycles after the reset; an edge tells
    when. Ramps last 7 ms, so that scans meet each part of them.
    """
    offset = clock_offset(board)
    start = board.sim.cycle + 10000
    for step in range(20 * 700):
        volts = (step % 700) * 5 / 1024 + 0.001
        board.sim.adc.set_volts(board.chip.analog[2], volts, start + step * 160)
    board.send_each(0, ADC)
    board.talk_until(start + 20 * 700 * 160)
    found = {sample[2] for sample in samples(board, ADC)}
    judged = []
    for time_us, counts in found:
        ramp = (time_us * US + offset - 11.5 * 128 - start) / 160
        if ramp > 5 and 5 < ramp % 700 < 695:
            assert ramp % 700 == pytest.approx(counts, abs=1.5)
            judged.append(counts)
    assert len(judged) > 15
    assert max(judged) - min(judged) > 400


def clock_offset(board, sensor=QUAD):
    """The cycle at which the device's clock said 0, within 4 us, by the time of an edge.

    With MISSES by that of two edges at once, which are no step; then the encoder stands as before.
    """
    at = board.sim.cycle + 3000
    wires = board.chip.encoders[: 1 if sensor == QUAD else 2]
    for wire in wires:
        board.pins.drive(wire, 1, at)
    board.pause(0.002)
    time_us, _ = board.sample(sensor)[0]
    if sensor == MISSES:
        for wire in wires:
            board.pins.drive(wire, 0)
        board.pause(0.001)
    return at - time_us * US


@pytest.mark.avr
@pytest.mark.parametrize("options", ["", "-DJ2A_WITH_SYNC=1"])
def test_distances(build, options):
    """Also where 16 bits of ticks last for less time than a measurement."""
    more = {"OPTIONS": options, "BAUD": "115200"} if options else {"BAUD": "500000"}
    board = Board(build("sensors", "avr-serial", **more))
    board.quiet()

    def found():
        board.pause(0.045)  # longer than until the next measurement
        return [mm for _, mm in board.sample(DIST_IR)]

    for channel in (0, 1):
        for mm, volts in SHARP:
            board.sim.adc.set_volts(board.chip.analog[channel], volts)
            board.sim.adc.set_volts(board.chip.analog[1 - channel], 0)
            seen = found()
            assert abs(seen[channel] - mm) <= 0.03 * mm + mm * mm / 58000
            assert seen[1 - channel] == 0
    for volts in (0.0, 0.2, 3.1, 5.0):
        board.sim.adc.set_volts(board.chip.analog[0], volts)
        assert found()[0] == 0
    board.sim.close()


# -- servos ------------------------------------------------------------------------------------


@pytest.mark.avr
@pytest.mark.parametrize(
    ("mcu", "options"),
    [
        ("atmega328p", ""),
        # Its servos are at timer 1, too, and its encoders where those of the ATmega32U2 are.
        pytest.param("atmega32u4", "", marks=pytest.mark.exhaustive),
        ("atmega32u2", ""),
        ("atmega328p", "-DJ2A_WITH_SYNC=1"),
    ],
)
def test_servo_pulses_while_the_host_talks(build, mcu, options):
    """Each edge is at its tick: no jitter at all, whatever else the chip does.

    Where the host disciplines the clock, timer 1 is eight times as fast, and an edge of an encoder
    takes four times as long: bytes and edges come less often.
    """
    more = {"OPTIONS": options, "BAUD": "115200"} if options else {"BAUD": "500000"}
    more |= {} if options else {"MCU": mcu}
    board = Board(build("sensors", "avr-serial", **more), mcu)
    servos = board.chip.servos
    board.talk_until(board.sim.cycle + board.sim.cycles(0.05))
    assert board.pins.edges(servos[0]) == board.pins.edges(servos[1]) == []  # none until asked
    board.turn(0, 4000, board.sim.cycle, 3200 if options else 1600)
    for deflection in (-100, -99, -37, 0, 1, 55, 100):
        board.set(SERVO, deflection, -deflection)
        board.talk_until(board.sim.cycle + board.sim.cycles(0.045))
        for servo in servos:
            board.pins.edges(servo)
        board.talk_until(board.sim.cycle + board.sim.cycles(0.065))
        us = 1500 + 5 * deflection
        found = [pulses(board.pins.edges(servo)) for servo in servos]
        for list_, wanted_us in zip(found, (us, 3000 - us), strict=True):
            assert len(list_) >= 2
            assert {pulse.cycles % (8 if options else TICK) for pulse in list_} == {0}
            assert len({pulse.cycles for pulse in list_}) == 1
            assert abs(list_[0].cycles / US - wanted_us) <= 2
            starts = [pulse.start for pulse in list_]
            assert {b - a for a, b in itertools.pairwise(starts)} == {20000 * US}
        assert (found[0][0].start - found[1][0].start) % (20000 * US) == 10000 * US
    board.sim.close()


@pytest.mark.avr
def test_a_new_deflection_makes_no_odd_pulse(board):
    """Set at all phases of the period: each pulse has one of the two widths."""
    board.set(SERVO, 0)
    board.pause(0.05)
    board.pins.edges(board.chip.servos[0])
    for count in range(60):
        board.set(SERVO, 100 * (count & 1))
        board.pause(0.0037)
    widths = [pulse.cycles for pulse in pulses(board.pins.edges(board.chip.servos[0]))]
    assert len(widths) > 8
    assert set(widths) == {1500 * US, 2000 * US}


# -- lamp --------------------------------------------------------------------------------------


@pytest.mark.avr
@pytest.mark.parametrize("mcu", CHIPS)
def test_the_lamp_is_what_it_was_set_to(build, mcu):
    board = Board(build("sensors", "avr-serial", BAUD="500000", MCU=mcu), mcu)
    for on in (1, 1, 0, 1, 0, 0):
        board.set(LAMP, on)
        assert board.sample(LAMP)[0][1] == on
    assert [edge.level for edge in board.pins.edges(board.chip.lamp)] == [1, 0, 1, 0]
    board.sim.close()


# -- SIFs --------------------------------------------------------------------------------------


@pytest.mark.avr
def test_samples_carry_the_time_of_their_edge(board):
    """The stamp is of the edge, within a tick and the interrupt, however late the SIF comes."""
    offset = clock_offset(board)
    board.send_each(7, QUAD)
    rng = random.Random(3)
    a, b = board.chip.encoders[2:]
    at, edges = board.sim.cycle + 20000, []
    for step in range(80):
        board.pins.drive((a, b)[step % 2], FORWARD[step % 4][step % 2], at)
        edges.append(at)
        at += rng.randrange(10000, 200000)
    board.talk_until(at + 200000)
    sifs = samples(board, QUAD)
    assert len(sifs) > 40
    assert {sif.opcode for sif in board.sifs} == {QUAD}
    for (_, first), (time_us, count) in sifs[1:]:
        assert first == 1
        late = time_us * US + offset - edges[count - 1]
        assert -2 * TICK <= late <= 2 * TICK + 200
    assert sifs[-1][1][1] == 80
    # No step, no SIF.
    board.sifs.clear()
    board.pause(0.05)
    assert board.sifs == []


@pytest.mark.avr
def test_a_sample_keeps_its_time_while_nobody_asks(board):
    """When timer 1 has gone around several times, the stamp is still that of the edge."""
    offset = clock_offset(board)
    at = board.sim.cycle + 5000
    board.pins.drive(board.chip.encoders[2], 1, at)
    board.pause(1.3)
    time_us, count = board.sample(QUAD)[1]
    assert count == 1
    assert time_us * US + offset == pytest.approx(at, abs=2 * TICK + 200)


@pytest.mark.avr
def test_periods_of_all_sensors(board):
    """A SIF comes with the first turn of the main loop, or value, behind the time it is due."""
    periods = ((QUAD, 25, 2), (DIST_IR, 80, 2), (ADC, 12, 4))
    for sensor, ms, _ in periods:
        board.send_each(ms, sensor)
    board.sim.adc.set_volts(0, 1.30)
    board.sim.adc.set_volts(3, 2.5)
    begins = []
    end = board.turn(0, 2000, board.sim.cycle, 3200)
    while board.sim.cycle < end:
        seen = len(board.sifs)
        board.talk_until(board.sim.cycle + 1)
        begins += [(sif.opcode, board.sim.cycle) for sif in board.sifs[seen:]]
    for sensor, ms, size in periods:
        sifs = samples(board, sensor)
        most = 2000 * 3200 / US / 1000 / ms
        assert 0.6 * most <= len(sifs) <= most + 1
        assert {len(sif) for sif in sifs} == {size}
        at = [cycle for opcode, cycle in begins if opcode == sensor]
        # Seen at the end of a call, which takes 8 ms at most; the first may have been late.
        for number, cycle in enumerate(at):
            assert cycle - at[0] > ((number - 1) * ms - 8) * 1000 * US
    assert [sif.seq for sif in board.sifs] == [n % 256 for n in range(len(board.sifs))]
    last = {sensor: samples(board, sensor)[-1] for sensor, _, _ in periods}
    assert last[DIST_IR][0][1] == pytest.approx(200, rel=0.04)
    assert last[ADC][0][1] == int(1.30 * 1024 / 5)
    assert last[ADC][3][1] == 512
    board.quiet()
    board.sifs.clear()
    board.pause(0.1)
    assert board.sifs == []


@pytest.mark.avr
def test_one_sif_in_a_turn_of_the_main_loop(build):
    """The ring has to hold what arrives during one SIF, of 46 bytes and what is escaped, not two.

    All sensors come due while one of them is sent; two of their SIFs make 72 bytes, and three 98.
    """
    board = Board(build("sensors", "avr-serial", BAUD="500000", RXBUF="96"))
    board.send_each(7, *board.chip.sensors)
    board.send_each(1, QUAD)
    board.turn(0, 1000, board.sim.cycle, 3200)
    payload = bytes(255)
    while len(board.sifs) < 120:
        assert board.call(c.GET_ECHO, payload).payload == payload
    order = [sif.opcode for sif in board.sifs]
    assert order.count(ADC) >= 6
    assert board.ask("overruns", "H") == (0,)
    assert board.sim.counters.overruns == 0
    board.sim.close()


# -- triggered ---------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def triggered(make, need, tmp_path_factory):
    """Build a copy of an app in which these lines of transds.def have the key trigger, once."""
    need("avr-gcc")

    @cache
    def build(app, *names, **variables):
        folder = tmp_path_factory.mktemp("triggered")
        copy = folder / app
        shutil.copytree(DRIVERS.parent / "apps" / app, copy)
        text, count = re.subn(
            rf"^(SENSOR\((?:{'|'.join(names)}),(?:[^,)]+,){{5}}[^,)]+)",
            r"\1, (trigger)",
            (copy / "transds.def").read_text("utf-8"),
            flags=re.M,
        )
        assert count == len(names)
        (copy / "transds.def").write_text(text, "utf-8")
        variables |= {"PORT": "avr-serial", "BAUD": "500000"}
        done = make(core_as_one=True, APP=app, APP_DIR=copy, OUT=folder / "out", **variables)
        assert done.returncode == 0, done.stderr
        return folder / "out" / f"{app}.elf"

    return build


# Microseconds. What a trigger is late by at most: a turn of the main loop in which no SIF is sent,
# while edges interrupt it; with SyncUSB the core waits for a time that is less than 1 ms ahead, and
# a turn takes up to 1.7 ms with so many edges. What a conversion takes at most: 13 to 15 periods of
# the ADC's clock, its interrupt with a stamp, and what interrupts that.
TURN_US = 700
BOUNDS = {"": (TURN_US, 128), "-DJ2A_WITH_SYNC=1": (TURN_US, 220)}
SAMPLED_US = 92  # before the end of its conversion, 11.5 periods


def trigger_at(board, delay_us, *sensors):
    """Trigger sensors at one time of the device, which is so far ahead; returns that time."""
    (now_us,) = struct.unpack("<Q", board.transd(sensors[0], c.TRANSD_TIME).payload)
    at_us = now_us + delay_us
    for sensor in sensors:
        reply = board.transd(sensor, c.TRANSD_TRIGGER, struct.pack("<Q", at_us))
        assert (reply.opcode, reply.payload) == (0, b"")
    return at_us


def ramp(board, start, steps, cycles):
    """Raise all inputs by one count each so many cycles; returns the count by cycle."""
    for step in range(steps):
        for channel in board.chip.analog:
            volts = (step + 1) * 5 / 1024 + 0.001
            board.sim.adc.set_volts(channel, volts, start + step * cycles)
    return lambda cycle: 1 + (cycle - start) / cycles


@pytest.mark.avr
def test_nothing_is_measured_before_the_trigger(triggered):
    """Edges, time and set counts are none; a trigger is one sample, of counts that went on."""
    board = Board(triggered("sensors", "quad", "dist_ir", "adc"))
    board.run_to(board.turn(0, 100, board.sim.cycle + 1000, 900))
    board.set(QUAD_AT, 7, channel=1)
    board.pause(0.2)
    for sensor in (QUAD, DIST_IR, ADC):
        assert {time_us for time_us, _ in board.sample(sensor)} == {0}
    assert board.sim.adc.conversions == 0
    assert board.sample(MISSES) == [(0, 0), (0, 0)]
    trigger_at(board, 0, QUAD)
    assert [count for _, count in board.sample(QUAD)] == [100, 7]
    board.sim.close()


@pytest.mark.avr
@pytest.mark.parametrize(
    ("options", "order", "is_enabled"),
    [
        pytest.param(
            *(options, order, is_enabled),
            # Each two of them have all their values in the half of an even number.
            marks=pytest.mark.exhaustive if (first + second + is_enabled) % 2 else [],
        )
        for first, options in enumerate(BOUNDS)
        for second, order in enumerate([(QUAD, DIST_IR, ADC), (ADC, DIST_IR, QUAD)])
        for is_enabled in (False, True)
    ],
)
def test_sensors_triggered_at_one_time_measure_at_that_time(triggered, order, options, is_enabled):
    """Each tells the moment by its value: an encoder counts steps, voltages rise.

    Each begins within a turn of the main loop, before the sample SIF of one that began. There is
    one converter, so channel n of it is n conversions behind, and both sensors at it take the same
    scan or one after the other.
    """
    board = Board(triggered("sensors", "quad", "dist_ir", "adc", OPTIONS=options))
    if not is_enabled:
        board.quiet()
    offset = clock_offset(board, MISSES)
    turn_us, conversion_us = BOUNDS[options]
    for delay_us in (5000, 5111, 6789, 7001, 13133, 4321):
        before = board.sim.adc.conversions
        board.set(QUAD_AT, 0, 0)
        start = board.sim.cycle + 1000
        count_at = ramp(board, start, 600, 800)
        end = board.turn(0, 300, start, 1600)
        at_us = trigger_at(board, delay_us, *order)
        board.run_to(end)
        (quad_us, count), (other_us, none) = board.sample(QUAD)
        assert 0 <= quad_us - at_us <= turn_us
        assert none == 0
        assert 0 <= other_us - quad_us <= 200  # a stamp, which takes its time with SyncUSB
        assert count == pytest.approx(0.5 + (quad_us * US + offset - start) / 1600, abs=1)
        for channel, (time_us, counts) in enumerate(board.sample(ADC)):
            late_us = (channel + 1) * conversion_us
            assert SAMPLED_US <= time_us - at_us <= turn_us + late_us
            assert -turn_us <= time_us - quad_us <= turn_us + late_us
            sampled = time_us * US + offset - SAMPLED_US * US
            assert counts == pytest.approx(count_at(sampled), abs=1.5)
        # By a division behind its scan, in the main loop, which may send a sample SIF before.
        sent_us = 1500 if is_enabled else 0
        for time_us, _ in board.sample(DIST_IR):
            assert 0 < time_us - at_us <= 2 * turn_us + 8 * conversion_us + sent_us
        assert board.sim.adc.conversions - before in {4, 8}
    assert board.sim.log == ""
    board.sim.close()


@pytest.mark.avr
def test_a_trigger_while_another_sensor_scans(triggered):
    """A scan for distances may run when its time comes: then the one behind it counts, as a whole.

    Scans for distances come each 40 ms and last 0.4 ms; triggers come each 100 us around one.
    Distances, which nobody triggers here, share the scan that runs when their time comes.
    """
    board = Board(triggered("sensors", "adc"))
    board.quiet()
    offset = clock_offset(board)
    behind = 0
    for step in range(0, 30, 2):
        scanned = board.sample(DIST_IR)[0][0]
        while board.sample(DIST_IR)[0][0] == scanned:
            board.pause(0.0005)
        start = board.sim.cycle
        count_at = ramp(board, start, 900, 1000)
        at_us = board.sample(DIST_IR)[0][0] + 39_000 + 50 * step
        before = board.sim.adc.conversions
        assert board.transd(ADC, c.TRANSD_TRIGGER, struct.pack("<Q", at_us)).opcode == 0
        board.run_to(start + 900 * 1000)
        sample = board.sample(ADC)
        for channel, (time_us, counts) in enumerate(sample):
            assert time_us - SAMPLED_US >= at_us
            assert time_us - sample[0][0] <= channel * 128
            assert counts == pytest.approx(count_at((time_us - SAMPLED_US) * US + offset), abs=1.5)
        is_behind = board.sample(DIST_IR)[0][0] < sample[3][0]
        assert board.sim.adc.conversions - before == (8 if is_behind else 4)
        behind += is_behind
    assert behind >= 10
    board.sim.close()


@pytest.mark.avr
def test_ultrasonic_sensors_and_encoders_triggered_at_one_time(triggered):
    """An SRF02 is told by three bytes at 100 kHz, and the next one in the turn behind that.

    Without a trigger none measures. A trigger while they measure is one more measurement.
    """
    dist_us = 2
    board = Board(triggered("listing", "quad", "dist_us"))
    twi, addresses = board.sim.twi, range(0x70, 0x7C)
    for sensor in (QUAD, dist_us):
        board.enable(sensor, on=False)
    for number, address in enumerate(addresses):
        twi.set_distance(address, 20 + 40 * number)

    def seen():
        return list(struct.iter_unpack("<QI", board.transd(dist_us, c.TRANSD_SAMPLE).payload))

    board.pause(0.3)
    assert seen() == [(0, 0)] * 12
    assert {twi.measurements(address) for address in addresses} == {0}
    board.pins.drive("PD2", 1)
    trigger_at(board, 0, QUAD)
    offset = board.sim.cycle - board.sample(QUAD)[0][0] * US  # 2 ms too much at most
    at_us = trigger_at(board, 30_000, QUAD, dist_us)
    due = at_us * US + offset
    board.pins.drive("PD3", 1, due - 4000 * US)
    board.pins.drive("PD2", 0, due + 4000 * US)
    for count, address in enumerate(addresses, 1):
        while twi.measurements(address) == 0:
            board.sim.run(160)
        assert -2000 <= (board.sim.cycle - due) / US <= TURN_US + 450 * count
    board.pause(0.05)
    trigger_at(board, 0, dist_us)
    board.pause(0.3)
    assert {twi.measurements(address) for address in addresses} == {2}
    assert [cm for _, cm in seen()] == [20 + 40 * number for number in range(12)]
    (one_us, one), (other_us, other) = board.sample(QUAD)
    assert (one, other) == (2, 0)
    assert 0 <= one_us - at_us <= other_us - at_us <= TURN_US
    board.sim.close()


@pytest.mark.avr
def test_a_distance_is_measured_behind_its_trigger_or_is_none(triggered):
    """A sensor that was away while all were told to measure has only the distance of before."""
    dist_us, sensor, other = 2, 0x75, 0x7B
    board = Board(triggered("listing", "quad", "dist_us"))
    twi = board.sim.twi
    board.enable(QUAD, on=False)
    for address in (sensor, other):
        twi.set_distance(address, 100)

    def seen():
        trigger_at(board, 0, dist_us)
        told = twi.measurements(other) + 1
        while twi.measurements(other) < told:
            board.sim.run(160)
        twi.set_distance(sensor, 300)  # it is back while the others measure
        board.pause(0.1)
        sample = board.transd(dist_us, c.TRANSD_SAMPLE).payload
        return [cm for _, cm in struct.iter_unpack("<QI", sample)]

    none = 0x00FFFFFF
    assert seen() == [none] * 5 + [100] + [none] * 5 + [100]
    twi.remove(sensor)
    assert seen() == [none] * 11 + [100]
    assert seen() == [none] * 5 + [300] + [none] * 5 + [100]
    board.sim.close()


# -- the app, its size and its time ------------------------------------------------------------


@pytest.mark.avr
def test_wrong_arguments(build):
    board = Board(build("sensors", "avr-serial", BAUD="500000"))
    for actuator, raw, channel in (
        (SERVO, (101,), 0),
        (SERVO, (-128,), 1),
        (SERVO, (0, -101), 0),
        (SERVO, (0,), 2),
        (SERVO, (0, 0), 1),
        (QUAD_AT, (0,), 2),
        (QUAD_AT, (0, 0, 0), 0),
        (LAMP, (0,), 1),
    ):
        reply = board.try_set(actuator, *raw, channel=channel)
        assert (reply.opcode, reply.payload) == (c.TRANSD_BAD_VALUE, b"")
    for actuator, value in ((SERVO, b""), (QUAD_AT, b"\0"), (LAMP, b"")):
        reply = board.transd(actuator, c.TRANSD_SET, bytes(9) + value)
        assert (reply.opcode, reply.payload) == (c.TRANSD_BAD_LENGTH, b"")
    for sensor, item, value, code in (
        (QUAD, c.TRANSD_PERIOD, bytes(3), c.TRANSD_BAD_LENGTH),
        (ADC, c.TRANSD_ENABLED, b"\2", c.TRANSD_BAD_VALUE),
        (MISSES, c.TRANSD_SET, bytes(11), c.TRANSD_NO_ITEM),
        (LAMP + 1, c.TRANSD_SAMPLE, b"", c.TRANSD_NO_ID),
    ):
        reply = board.transd(sensor, item, value)
        assert (reply.opcode, reply.payload) == (code, b"")
    for actuator in (SERVO, QUAD_AT, LAMP):
        assert {time_us for time_us, _ in board.sample(actuator)} == {0}  # nothing was set
    board.sim.close()


@pytest.mark.avr
def test_the_full_build_fits_the_1_kb_of_an_atmega32u2(build):
    """Function map, properties, transducers and debug text, two encoders, two servos: no option is
    off."""
    elf = build("sensors", "avr-serial", BAUD="500000", MCU="atmega32u2")
    board = Board(elf, "atmega32u2")
    assert {"a2jGetProperties", "a2jDebug", c.GET_TRANSDS, c.TRANSD} <= set(board.names)
    for sensor in (DIST_IR, ADC):  # the chip has no ADC
        assert board.transd(sensor, c.TRANSD_SAMPLE).opcode == c.TRANSD_NO_ID
    board.exercise()
    # The longest frames of the protocol, too.
    assert board.call(c.GET_ECHO, bytes((c.SOF,)) * 255).payload == bytes((c.SOF,)) * 255
    static = board.sim.program.ram_end - 0x100
    print(f"ATmega32U2: static {static} B, stack {board.sim.stack_bytes} B, of 1024")
    assert 80 < board.sim.stack_bytes < 250
    assert static + board.sim.stack_bytes < 1024 - 200
    board.sim.close()


STEPS = r"(\d+) a step, (\d+) for both encoders"


def printed(pattern):
    """The numbers in the one place of the page that looks like this."""
    (found,) = re.findall(pattern, " ".join(PAGE.read_text("utf-8").split()))
    return [int(number) for number in ([found] if isinstance(found, str) else found)]


@pytest.mark.avr
def test_interrupts_are_short(build):
    """The receiver holds two bytes: at 500 kbaud its interrupt may be 640 cycles late."""
    one, both = printed(STEPS)
    (servo,) = printed(r"\| (\d+) at most, after each edge")
    (clock,) = printed(r"(\d+), every 262 ms")
    (at_500, _) = printed(r"permitted delay \| (\d+) \| (\d+) \|")
    board = Board(build("sensors", "avr-serial", BAUD="500000"))
    chip, sim = board.chip, board.sim
    board.run_to(board.turn(0, 500, sim.cycle + 1000, 900))
    assert one - 10 <= sim.interrupts(chip.quad).longest_cycles <= one
    board.pins.drive(chip.encoders[0], 0)
    sim.clear_interrupts()
    board.exercise(1601, 10)
    names = ("quad", "servo_a", "servo_b")
    longest = {name: sim.interrupts(getattr(chip, name)).longest_cycles for name in names}
    receive = sim.interrupts(chip.receive)
    print(longest, receive)
    assert both - 5 <= longest["quad"] <= both
    assert servo - 5 <= max(longest["servo_a"], longest["servo_b"]) <= servo
    assert sim.interrupts(OVERFLOW).longest_cycles == clock
    assert receive.latest_cycles < at_500 == 2 * 10 * 16_000_000 / 500_000
    assert sim.counters.overruns == 0
    assert board.ask("overruns", "H") == (0,)
    board.sim.close()


@pytest.mark.avr
def test_the_interrupt_that_lets_others_in(board):
    """Its own cycles, while no others come: the host is quiet, and servos' do each 10 ms."""
    longest = set()
    for _ in range(40):
        board.sim.clear_interrupts()
        board.pause(0.001)
        longest.add(board.sim.interrupts(CONVERSION).longest_cycles)
    assert printed(r"\| ADC \| (\d+);") == [min(longest - {0})]


def test_the_sum_and_the_sizes_on_the_page():
    """What the receiver waits for is the sum of the handlers; sizes are those of the budget."""
    _, both = printed(STEPS)
    (servo,), (clock,) = printed(r"\| (\d+) at most, after"), printed(r"(\d+), every 262 ms")
    assert printed(r"interrupt at once \| (\d+) \| (\d+):") == [both + servo + clock] * 2
    snapshot = json.loads((DRIVERS.parent / "verify/budget/snapshot.json").read_text("utf-8"))
    for name, row in (("sensors", "ATmega328P"), ("sensors-32u2", "ATmega32U2, all [^|]*")):
        sizes = snapshot[f"avr-serial/{name}"]
        found = printed(rf"\| {row} \| (\d+) \| (\d+) \| (\d+) \| \d+ \|")
        assert found == [sizes["flash"], sizes["ram"], sizes["stack"]]


@pytest.mark.avr
def test_the_example_in_the_documentation(build, capsys):
    page = PAGE.read_text("utf-8")
    _, code = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    elf = build("sensors", "avr-serial", BAUD="500000")
    placed = code.replace('"firmware/build/avr-serial/sensors.elf"', repr(str(elf)))
    assert placed != code
    exec(compile(placed, "drivers.md", "exec"), {})
    assert capsys.readouterr().out.splitlines() == [
        "100 steps, the last one at 1.006 s",
        "255 mm",
        "1752.0 us",
    ]


def test_the_app_says_what_it_needs(make, need, tmp_path):
    result = make(PORT="posix", APP="sensors", OUT=tmp_path)
    assert result.returncode != 0
    assert "PORT=avr-serial" in result.stderr
    need("avr-gcc")
    for variables, text in (
        ({"MCU": "atmega2560"}, "pins.h does not know this chip"),
        ({"FREQ": "20000000", "BAUD": "250000"}, "F_CPU must be"),
    ):
        goal = tmp_path / "sensors.obj/servo.o"  # no more of it is compiled than shows the error
        result = make(goal, PORT="avr-serial", APP="sensors", OUT=tmp_path, **variables)
        assert result.returncode != 0
        assert text in result.stderr
