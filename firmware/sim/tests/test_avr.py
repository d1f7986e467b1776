"""The simulated core: cycles, spans, memory, resets, and how it stops."""

import pytest
from j2a_sim import FirmwareStopped, SimError

pytestmark = pytest.mark.avr

SECOND = 16_000_000


def test_cycles_are_those_of_the_data_sheet(simulate):
    sim = simulate("spans")
    assert sim.run_until_output(SECOND)
    empty, nops, interrupted = sim.spans()
    assert (empty.mark, empty.cycles) == (1, 1)  # the OUT that opens it
    assert (nops.mark, nops.cycles) == (2, 101)
    # Each interrupt: 4 cycles to enter, 3 for the jump in the vector table, 4 for reti.
    assert (interrupted.mark, interrupted.cycles) == (3, 101 + 2 * 11)
    assert empty.start < nops.start < interrupted.start
    assert sim.spans() == []


@pytest.mark.parametrize("name", ["echo", "echo_irq"])
def test_the_same_run_gives_the_same_cycles(simulate, name):
    def record(step):
        sim = simulate(name)
        sim.boot()
        sim.uart_write(b"determinism")
        end = sim.cycle + 200_000
        while sim.cycle < end:
            sim.run(min(step, end - sim.cycle))
        return sim.uart_read_stamped()

    first = record(200_000)
    assert bytes(byte.value for byte in first) == b"determinism"
    assert record(200_000) == first
    assert record(777) == first
    # Also when it is stopped after each instruction.
    assert record(1) == first


def test_run_returns_what_passed(simulate):
    sim = simulate("echo")
    assert sim.cycle == 0
    passed = sim.run(1000)
    assert 1000 <= passed <= 1004
    assert sim.cycle == passed
    assert sim.time_s == passed / SECOND
    assert sim.run(0) == 0
    assert sim.cycles(1e-6) == 16
    assert sim.cycles(1.01e-6) == 17


def test_a_sleeping_core_is_not_run_past_the_end(simulate):
    sim = simulate("echo_irq")
    sim.boot()
    sim.run(1000)
    assert sim.run(5000) == 5000
    assert sim.run(1) == 1


def test_run_until_span_stops_right_after_it(simulate):
    sim = simulate("spans")
    assert sim.run_until_span(SECOND)
    spans = sim.spans()
    assert [span.mark for span in spans] == [1]
    assert sim.cycle - spans[0].start <= 4
    sim.run(SECOND // 100)
    sim.spans()
    assert not sim.run_until_span(1000)


def test_run_until_a_condition_or_the_limit(simulate):
    sim = simulate("echo")
    assert sim.run_until(lambda: sim.receiver_on, 10_000, step_cycles=10)
    before = sim.cycle
    assert not sim.run_until(lambda: False, 5000)
    assert 5000 <= sim.cycle - before <= 5004


def test_memory_by_name_and_address(simulate):
    sim = simulate("stop")
    sim.boot()
    address = sim.program.symbols["table"]
    assert sim.read_memory("table", 3) == sim.read_memory(address, 3) == b"\1\2\3"
    sim.write_memory("table", b"\7")
    assert sim.read_memory(address, 3) == b"\7\2\3"
    with pytest.raises(SimError, match="no symbol 'nowhere'"):
        sim.read_memory("nowhere", 1)
    with pytest.raises(SimError, match="outside"):
        sim.read_memory(0x8FF, 2)


def test_stack_depth(simulate):
    sim = simulate("spans")
    assert sim.stack_bytes == 0
    assert sim.run_until_output(SECOND)
    # The block of 100 bytes, two return addresses, and little else.
    assert 104 <= sim.stack_bytes < 120
    assert 0x8F0 < sim.stack_pointer <= 0x8FF


@pytest.mark.parametrize(
    ("how", "text"),
    [
        (b"i", "illegal instruction"),
        (b"j", "crashed, .* atmega328p cannot.*built for MCU=atmega328p"),
        (b"s", "sleep with interrupts off"),
    ],
)
def test_a_firmware_that_stops(simulate, capfd, how, text):
    sim = simulate("stop")
    sim.boot()
    sim.uart_write(how)
    with pytest.raises(FirmwareStopped, match=text) as stopped:
        sim.run(SECOND)
    assert stopped.value.cycle == sim.cycle < SECOND
    with pytest.raises(FirmwareStopped):
        sim.run(1)
    assert sim.uart_read() == b"0"
    sim.reset()
    assert sim.run_until_output(SECOND)
    assert capfd.readouterr() == ("", "")


def test_resets_keep_ram_and_cycle_count(simulate):
    sim = simulate("stop")
    sim.write_memory("starts", b"\0")
    for count in b"012":
        assert sim.run_until_output(SECOND)
        assert sim.uart_read() == bytes([count])
        before = sim.cycle
        sim.uart_write(b"w")
        assert sim.run_until_output(SECOND)
        # The watchdog's 15 ms, a byte each way, the start of the program.
        assert 15 * 16_000 < sim.cycle - before < 18 * 16_000
    assert sim.stack_bytes < 20


def test_a_closed_simulator_says_so(simulate):
    sim = simulate("echo")
    sim.close()
    sim.close()
    with pytest.raises(SimError, match="closed"):
        sim.run(1)
    for name in ("cycle", "readable", "is_woken"):  # places in memory that is free now
        with pytest.raises(SimError, match="closed"):
            getattr(sim, name)
    sim.wake()
