"""What the port avr-usb carries, against what the endpoint can carry with the cycles of a byte.

In: the app usb_rates, built with marks and without. Out: a Row for each kind of traffic: cycles of
the firmware per byte, measured where nothing waits for the bus; the rate that these, the wire and
the banks of the chip allow; the rate that was seen. Rules: all of it is simulated time and comes
out the same in each run; a rate counts only when every byte was right.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from j2a_sim import AvrSim
from j2a_spec import constants as c
from j2a_spec.oracle import Frame, decode, encode

__all__ = ["APP", "CHIPS", "TABLE", "WIRE", "Line", "Row", "measure", "page", "rows"]

APP = Path(__file__).parent / "usb_rates"
TABLE = Path(__file__).with_suffix(".md")
WIRE = 19 * 64 * 1000
"""Bytes per second of a bulk endpoint with packets of 64 bytes at full speed (table 5-10)."""

PACKET_S = (13 + 64) * 8 / 12e6
"""Seconds that such a packet takes on the bus, by the same table."""

SINGLE = {"atmega32u2"}
"""Chips whose endpoints hold one packet: the bus and the program are at it in turn."""

CHIPS = {"atmega32u4": (60, 124), "atmega32u2": (12, 60)}
"""Two sizes of a frame that the banks of an endpoint hold; where there are two banks, in both."""

HEAD = 5  # bytes of a frame beside its payload
MANY = HEAD + c.MANY_HEADER
LARGEST = HEAD + c.MAX_PAYLOAD
SIF_LARGEST = HEAD + c.MANY_DATA  # of the app
BUILTINS = [name for name in c.BUILTINS if name != c.GET_DEBUG]
OPCODE = {name: at for at, name in enumerate((*BUILTINS, "chunk", "sifs", "sink", "source"))}
SIF = 1
BYTES = bytes(0x80 + at % 64 for at in range(256))  # those of the app, none is escaped
POLL, PROCESS, SEND = 1, 2, 3  # marks of the app
FRAMES = 96


@dataclass(frozen=True, slots=True)
class Line:
    """Cycles as a function of the bytes of a frame: a part that is always there, and each byte."""

    fixed: float
    byte: float

    def __call__(self, size: int) -> float:
        """The cycles of so many bytes."""
        return self.fixed + size * self.byte


@dataclass(frozen=True, slots=True)
class Row:
    """A row of the table.

    Attributes:
        traffic: what was done.
        direction: whose bytes are counted.
        cycles: of the firmware per byte, with all that the traffic asks of it.
        can: bytes per second that the endpoint can carry: with two banks what the cycles allow, or
            the wire; with one, cycles and wire one after the other.
        seen: bytes per second that it carried.
    """

    traffic: str
    direction: str
    cycles: float
    can: float
    seen: float

    @property
    def share(self) -> float:
        """What was carried of what can be, 0..1."""
        return self.seen / self.can


def request(function: str, payload: bytes = b"", seq: int = 0x20) -> bytes:
    """A request on the wire, of which no byte is escaped."""
    data = encode(Frame(c.SOF, seq, OPCODE[function], payload))
    assert len(data) == HEAD + len(payload), data.hex()
    return data


def many(function: str, data: bytes = b"") -> bytes:
    """The same through a2jMany; a write when there is data."""
    head = bytes((OPCODE[function], c.FLAG_WRITE if data else 0, 0, 0, 0, 0))
    return request(c.MANY, head + data)


class Board:
    """The app on a chip, enumerated."""

    def __init__(self, elf: Path, mcu: str) -> None:
        self.sim = AvrSim(elf, mcu)
        self.bus = self.sim.usb
        self.sim.run(self.sim.cycles(0.01))
        self.bus.enumerate()

    def __enter__(self) -> Board:
        return self

    def __exit__(self, *_: object) -> None:
        self.sim.close()

    def exchange(self, data: bytes, expected: bytes, limit_s: float = 5) -> float:
        """Send, and read until so much has come; returns the seconds, raises when it is wrong."""
        start = self.sim.cycle
        end = start + self.sim.cycles(limit_s)
        if data:
            self.bus.submit_out(c.USB_OUT, data)
        reading = {self.bus.submit_in(c.USB_IN, 64) for _ in range(4)}
        got, last = b"", start
        while len(got) < len(expected):
            assert self.sim.cycle < end, f"{len(got)} of {len(expected)} bytes came"
            self.sim.run_until_usb(end - self.sim.cycle)
            for done in self.bus.completed():
                assert done.status == "ok", done
                if done.id in reading:
                    got, last = got + done.data, done.cycle
                    reading.remove(done.id)
                    reading.add(self.bus.submit_in(c.USB_IN, 64))
        for transfer in reading:
            self.bus.cancel(transfer)
        self.bus.completed()
        assert got == expected, (decode(got)[:3], decode(expected)[:3])
        return (last - start) / self.sim.frequency_hz


def sif(seq: int, size: int) -> bytes:
    """A SIF of the app, by the bytes of its frame."""
    return encode(Frame(c.SOS, seq % 256, SIF, BYTES[: size - HEAD]))


def reply(code: int, payload: bytes = b"") -> bytes:
    return encode(Frame(c.SOF, 0x20, code, payload))


def chunk(function: str, size: int = MANY) -> bytes:
    """A reply of a2jMany of so many bytes."""
    return reply(0, bytes(c.MANY_HEADER) + BYTES[: size - MANY])


# -- cycles --------------------------------------------------------------------------------------


def measure(elf: Path, mcu: str) -> dict[str, Line]:
    """The cycles of each step, by the marks of the app.

    Args:
        elf: the app with RATES_MARKS=1, which lets a millisecond pass before it polls: all that
            has come fits into the banks and is there, and what it sends finds them empty.
        mcu: its chip.

    Returns:
        "poll", of the bytes of a request; "echo", "sink", "source": the call and its reply, and
        "sif", all of the bytes to the host.
    """
    with Board(elf, mcu) as board:

        def longest(mark: int, data: bytes, expected: bytes) -> int:
            board.sim.run(board.sim.cycles(0.005))
            board.sim.spans()
            board.exchange(data, expected)
            board.sim.run(board.sim.cycles(0.005))
            return max(span.cycles for span in board.sim.spans() if span.mark == mark)

        def line(cycles: Callable[[int], int]) -> Line:
            small, large = CHIPS[mcu]
            byte = (cycles(large) - cycles(small)) / (large - small)
            return Line(cycles(small) - small * byte, byte)

        def echo(mark: int, size: int) -> int:
            payload = BYTES[: size - HEAD]
            return longest(mark, request(c.GET_ECHO, payload), reply(c.ECHO, payload))

        def source(size: int) -> int:
            board.exchange(request("chunk", bytes((size - MANY,))), reply(0))
            return longest(PROCESS, many("source"), chunk("source", size))

        count = 0

        def sifs(size: int) -> int:
            nonlocal count
            board.exchange(request("chunk", bytes((size - HEAD,))), reply(0))
            count += 1
            return longest(SEND, request("sifs", b"\1\0"), reply(0) + sif(count - 1, size))

        sink = longest(PROCESS, many("sink", BYTES[:40]), chunk("sink"))
        return {
            "poll": line(lambda size: echo(POLL, size)),
            "echo": line(lambda size: echo(PROCESS, size)),
            "sink": Line(sink, 0),
            "source": line(source),
            "sif": line(sifs),
        }


# -- rates ---------------------------------------------------------------------------------------


def rows(elf: Path, marked: Path, mcu: str) -> list[Row]:
    """The table of a chip.

    Args:
        elf: the app as it is.
        marked: the app with RATES_MARKS=1.
        mcu: the chip that both are built for.
    """
    steps = measure(marked, mcu)
    poll = steps["poll"]
    made = []

    def add(traffic: str, direction: str, cycles: float, data: bytes, expected: bytes) -> None:
        """Cycles are those of a frame; its bytes are those of the direction's."""
        size = len(expected if direction == "board to host" else data)
        both = direction == "both ways"
        with Board(elf, mcu) as board:
            seconds = board.exchange(data, expected)
        each = cycles * FRAMES / size
        can = min(WIRE / (1 + both), 16e6 / each)
        if mcu in SINGLE:
            can = 64 / (64 * each / 16e6 + PACKET_S * (1 + both))
        made.append(Row(traffic, direction, each, can, size / seconds))

    write = many("sink", BYTES[: c.MANY_DATA])
    add(
        "a2jMany, writes",
        "host to board",
        poll(LARGEST) + steps["sink"](MANY),
        write * FRAMES,
        chunk("sink") * FRAMES,
    )
    add(
        "a2jMany, reads",
        "board to host",
        poll(MANY) + steps["source"](LARGEST),
        many("source") * FRAMES,
        chunk("source", LARGEST) * FRAMES,
    )
    add(
        "SIFs",
        "board to host",
        steps["sif"](SIF_LARGEST),
        request("sifs", FRAMES.to_bytes(2, "little")),
        reply(0) + b"".join(sif(seq, SIF_LARGEST) for seq in range(FRAMES)),
    )
    payload = BYTES[: c.MAX_PAYLOAD]
    add(
        "a2jEcho",
        "both ways",
        poll(LARGEST) + steps["echo"](LARGEST),
        request(c.GET_ECHO, payload) * FRAMES,
        reply(c.ECHO, payload) * FRAMES,
    )
    return made


def table(chips: dict[str, list[Row]]) -> str:
    """The table for the documentation, in Markdown."""
    head = ("chip", "traffic", "direction", "cycles per byte", "can carry", "seen", "share")
    lines = [f"| {' | '.join(head)} |", "|---|---|---|--:|--:|--:|--:|"]
    for mcu, found in chips.items():
        for row in found:
            lines.append(
                f"| {mcu} | {row.traffic} | {row.direction} | {row.cycles:.1f} "
                f"| {row.can / 1000:.1f} kB/s | {row.seen / 1000:.1f} kB/s | {row.share:.1%} |"
            )
    return "\n".join(lines)


def page(chips: dict[str, list[Row]]) -> str:
    """The table as it is committed."""
    command = "python firmware/tests/usb_throughput.py --write"
    return f"<!-- Written by `{command}`. -->\n{table(chips)}\n"


def main(arguments: list[str]) -> int:
    """Measure all chips, and write the table or print it; returns the exit code."""
    if arguments not in ([], ["--write"]):
        print("usage: usb_throughput.py [--write]", file=sys.stderr)
        return 2
    chips = {}
    with tempfile.TemporaryDirectory() as folder:
        for mcu in CHIPS:
            programs = []
            for marks in (0, 1):
                out = Path(folder) / f"{mcu}-{marks}"
                settings = (f"MCU={mcu}", f"APP_DIR={APP}", f"OUT={out}")
                options = f"OPTIONS=-DRATES_MARKS={marks}"
                make = ["make", "-s", "-C", APP.parents[1], "PORT=avr-usb", "APP=usb_rates"]
                subprocess.run([*make, *settings, options], check=True, stdout=subprocess.DEVNULL)
                programs.append(out / "usb_rates.elf")
            chips[mcu] = rows(*programs, mcu)
    text = page(chips)
    if arguments:
        TABLE.write_text(text, "utf-8")
    print(text, end="")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
