"""What an AVR program takes while it runs in the simulator: stack under a load, and cycles.

In: a linked ELF file. Out: the most stack that was written to; cycles of the marked stretches of
tests/cycles. Rules: expected replies and bytes on the wire come from the oracle of the
specification; a device that does not answer all of the load is an error, because what it did not
do was not measured. Every number comes out the same in every run.
"""

from collections.abc import Iterator
from pathlib import Path

from j2a_sim import AvrSim, SimError, Span
from j2a_spec import constants as c
from j2a_spec.oracle import Frame, decode, encode

from firmware.verify.budget import sensor_load
from firmware.verify.budget.avr_stack import function_table
from firmware.verify.budget.builds import BudgetError, Build

__all__ = ["cycles", "requests", "stack"]

DELAY = 101  # cycles of a span of mark 3 in which no interrupt came
CALL = 3 + 4  # rcall and ret
MARKS = range(1, 11)  # see tests/cycles/app.c


def _room(build: Build) -> int:
    return build.option("J2A_ROOM", c.MAX_PAYLOAD)


# ------------------------------------------------------------------------------------ stack


def requests(functions: int, has_many: bool, room: int) -> Iterator[tuple[int, bytes]]:
    """(opcode, payload): each function, known or not, with payloads of every kind of length."""
    for opcode in range(functions + 1):
        for length in (0, 1, 8, room):
            yield opcode, (b"\1\0" + bytes(room))[:length]
        # Two bytes are milliseconds to some functions of the demo: SIFs from here on.
        yield opcode, b"\1\0"
        if has_many:
            for flags in (0, c.FLAG_LAST, c.FLAG_WRITE, c.FLAG_WRITE | c.FLAG_LAST):
                header = bytes((opcode, flags)) + bytes(4)
                yield 1, header
                yield 1, header + b"\x12\x7d\xed" * ((room - len(header)) // 3)


def stack(elf: Path, build: Build) -> int:
    """The most bytes of stack under a load of every function, of errors and of bytes meanwhile.

    Bytes outside of frames arrive while the device works, so that interrupts come at every place;
    more than it can hold are among them, and frames that break off.
    """
    try:
        if build.stimuli:
            return _stack_of_sensors(elf, build)
        with AvrSim(elf) as sim:
            sim.boot(limit_s=3)
            _load(sim, build)
            return sim.stack_bytes
    except SimError as error:
        raise BudgetError(f"{build.name}: {error}") from None


def _stack_of_sensors(elf: Path, build: Build) -> int:
    """The same under the drivers' own load: encoders, conversions, pulses."""
    mcu = build.variables.get("MCU", "atmega328p")
    with AvrSim(elf, mcu=mcu, uart=sensor_load.CHIPS[mcu].uart) as sim:
        try:
            sensor_load.load(sim)
        except AssertionError as error:
            raise BudgetError(
                f"{build.name} answers the load of the drivers wrong: {error}"
            ) from None
        return sim.stack_bytes


def _load(sim: AvrSim, build: Build) -> None:
    load = requests(
        len(function_table(sim.program.path, build)),
        bool(build.option("J2A_WITH_MANY", 1)),
        _room(build),
    )
    for number, (opcode, payload) in enumerate(load):
        seq = number % 256
        sim.uart_write(encode(Frame(c.SOF, seq, opcode, payload)) + bytes(40))
        _expect(sim, build, seq, opcode)
        broken = encode(Frame(c.SOF, seq, opcode, payload or b"x"))
        for bad in (broken[:-1] + bytes((broken[-1] ^ 1,)), broken[:4] + b"\x7d\xff", broken[:-1]):
            sim.uart_write(bad)
            sim.run(int(sim.char_cycles * (len(bad) + 8)) + sim.cycles(0.001))
        sim.run(sim.cycles(0.015))  # the last one ends by the byte timeout
        sim.uart_read()


def _expect(sim: AvrSim, build: Build, seq: int, opcode: int) -> None:
    """Wait for the reply to a request; SIFs may come in between."""
    got = b""
    end = sim.cycle + sim.cycles(0.1)
    while sim.cycle < end:
        sim.run(sim.cycles(0.001))
        got += sim.uart_read()
        events = [event for event in decode(got) if isinstance(event, Frame)]
        if any(event.start == c.SOF and event.seq == seq for event in events):
            return
    raise BudgetError(f"{build.name} does not answer opcode {opcode} within 0.1 s")


# ------------------------------------------------------------------------------------ cycles


def _spans(sim: AvrSim, mark: int) -> list[Span]:
    """Run until a span with this mark is closed; return all spans up to then."""
    spans: list[Span] = []
    end = sim.time_s + 20
    while not any(span.mark == mark for span in spans):
        sim.run(5000)
        spans += sim.spans()
        if sim.time_s > end:
            raise BudgetError(f"{sim.program.path} closes no span with mark {mark}")
    return spans


def _poll(sim: AvrSim, data: bytes) -> tuple[int, int]:
    """Send bytes while the firmware waits; return the cycles of j2a_poll() and of one interrupt."""
    sim.uart_write(data)
    spans = _spans(sim, 4)
    interrupt = max(span.cycles for span in spans if span.mark == 3) - DELAY
    return next(span.cycles for span in spans if span.mark == 4), interrupt


def cycles(elf: Path, build: Build) -> dict[str, float]:
    """Cycles for a byte on the wire and for a call, of the app tests/cycles."""
    room = _room(build)
    many = build.option("J2A_WITH_MANY", 1)
    echo = 1 + many + build.option("J2A_WITH_PROPERTIES", many)
    plain, escaped, empty = (
        len(encode(Frame(c.SOF, 0, echo, payload)))
        for payload in (b"\x55" * room, bytes((c.SOF,)) * room, b"")
    )
    try:
        with AvrSim(elf) as sim:
            sim.boot()
            spans = _spans(sim, 4)
            first = {span.mark: span.cycles for span in reversed(spans)}
            dearest = max(span.cycles for span in spans if span.mark == 9)
            if missing := set(MARKS) - first.keys():
                raise BudgetError(f"{build.name}: the app closes no spans {sorted(missing)}")
            head = encode(Frame(c.SOF, 1, echo, bytes(room)))[:4]
            _poll(sim, head)
            short, _ = _poll(sim, bytes(8))
            long, interrupt = _poll(sim, bytes(20))  # both end inside the payload
    except SimError as error:
        raise BudgetError(f"{build.name}: {error}") from None
    loop_byte = first[8] / plain
    loop = (long - short) / (20 - 8)
    parser = {
        "rx_plain": first[1] / plain - loop_byte + CALL,
        "rx_escaped": first[2] / escaped - loop_byte + CALL,
        "rx_dearest": dearest - first[10] + CALL,
    }
    # What a byte costs outside of the parser; mark 9 begins with a byte such as those of the loop.
    around = loop - (first[9] - first[10] + CALL) + interrupt
    return {
        **parser,
        "poll": loop,
        "interrupt": interrupt,
        "received": around + max(parser["rx_plain"], parser["rx_escaped"]),
        "received_dearest": around + parser["rx_dearest"],
        "call": first[5],
        "tx_plain": (first[6] - first[5]) / (plain - empty),
        "tx_escaped": (first[7] - first[5]) / (escaped - empty),
    }
