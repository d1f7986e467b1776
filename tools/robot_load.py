"""What the sensors of a robot take of a board: `python tools/robot_load.py`.

An ATmega328P in the simulator has all sensors of the thesis' table 5.1 but cameras and LIDAR, at
their top rates, over 115200 baud. Then all bumpers and cliff sensors change at one moment, too,
once a second.

What flows in: the firmware of apps/robot. What flows out: of each sensor what the table asks, what
that takes of the wire by calculation, how often it came and what was lost; the share of the wire
and that of the processor, as measured; and what channels in place of arrays would take. Exit status
1 where a value was lost.
Rule: time is simulated, so the figures are the same each time, within a percent.
"""

import argparse
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from j2a_sim import AvrSim, SimLink
from j2a_spec import constants as c
from j2a_spec.oracle import Frame, encode

import j2a
from j2a.types.transds_file import read_transds
from j2a.types.transducers import TIME_BYTES, longest_sample

ROOT: Final = Path(__file__).resolve().parent.parent
LIST: Final = ROOT / "firmware/apps/robot/transds.def"
BAUD: Final = 115200
BITS_PER_BYTE: Final = 10
CRASHES: Final = 3
AS_ARRAYS: Final = ("infrared", "ultrasonic")
"""Sensors that are one array, whose values were measured at one time."""


@dataclass(frozen=True, slots=True)
class Row:
    """A line of the thesis' tables: 2.2 has the bits and the rate, 5.1 the number and the product.

    Attributes:
        sensors: the most on a robot.
        bits: of one value.
        rate: values of each sensor in a second, at the most.
        per_sample: sensors whose values the board sends in one sample.
    """

    sensors: int
    bits: int
    rate: float
    per_sample: int

    @property
    def bandwidth(self) -> float:
        """Bits in a second, of all."""
        return self.sensors * self.bits * self.rate

    @property
    def samples(self) -> float:
        """Samples in a second."""
        return self.rate * self.sensors / self.per_sample


TABLE: Final = {
    "bumper": Row(16, 1, 1.0, 1),  # "irregular, < 1 bit/s": each changes once a second
    "cliff": Row(8, 1, 1.0, 1),
    "infrared": Row(16, 8, 50.0, 16),
    "ultrasonic": Row(16, 16, 25.0, 16),
    "gps": Row(1, 132, 10.0, 1),
    "ahrs": Row(1, 16 * 3 + 16 * 3 + 13 * 3, 50.0, 1),
}


def asked(as_channels: tuple[str, ...] = ()) -> dict[str, float]:
    """Return the bytes in a second that each sensor takes of the wire, without escapes.

    Args:
        as_channels: sensors that are to have channels, each with a time, in place of an array.
    """
    known = read_transds(LIST.read_text("utf-8"))
    result = {}
    for name, row in TABLE.items():
        payload = longest_sample(known[name])
        if name in as_channels:
            payload = row.sensors * TIME_BYTES + known[name].type.size
        frame = encode(Frame(c.SOS, 0, 0, bytes(payload)))
        result[name] = row.samples * len(frame)
    return result


def share(bytes_per_s: float) -> float:
    """Return the share of the wire, 0 to 1, or more than it has."""
    return bytes_per_s * BITS_PER_BYTE / BAUD


def fit() -> float:
    """Return at which share of their top rates infrared and ultrasonic fit as channels, 0 to 1."""
    channels = asked(AS_ARRAYS)
    asks = sum(channels[name] for name in AS_ARRAYS)
    return (1 - share(sum(channels.values()) - asks)) / share(asks)


@dataclass(frozen=True, slots=True)
class Load:
    """What was seen.

    Attributes:
        seconds: for how long, by the clock of the board.
        counts: values that were measured then and came, by the name of the sensor.
        crash_seconds, crashed: the same while all bumpers and cliff sensors changed at one moment,
            too, CRASHES times.
        wrong: of each sensor the values that are not the next one.
        lost: values and SIFs that the board or the link lost.
        wire_bytes: that came from the board.
        busy: the share of the processor, 0 to 1, that an idle board has for itself.
    """

    seconds: float
    counts: Mapping[str, int]
    crash_seconds: float
    crashed: Mapping[str, int]
    wrong: Mapping[str, int]
    lost: int
    wire_bytes: int
    busy: float

    @property
    def wire(self) -> float:
        """The share of the wire, 0 to 1."""
        return share(self.wire_bytes / self.seconds)


def build() -> Path:
    """Build the firmware; return the program."""
    command = ["make", "-s", "-C", "firmware", "PORT=avr-serial", "APP=robot", "OUT=build/robot"]
    subprocess.run([*command, f"PYTHON={sys.executable}"], cwd=ROOT, check=True, stdout=sys.stderr)
    return ROOT / "firmware/build/robot/robot.elf"


def number(name: str, reading: j2a.Reading) -> int:
    """Return the number of a measurement; each driver counts in its own way."""
    if name == "bumper":
        return int(reading.channel) + (0 if reading.value else 16)
    if name == "cliff":
        return int(reading.channel) + (0 if reading.value else 8)
    value: Any = reading.value
    if name in ("infrared", "ultrasonic"):
        if len(set(value)) != 1:
            raise ValueError(f"a value of {name} is torn: {value}")
        return int(value[0])
    return int(value.latitude if name == "gps" else value.rate[0])


MODULI: Final = {"bumper": 32, "cliff": 16, "infrared": 1 << 8, "ultrasonic": 1 << 16}


def measure(program: Path, seconds: float) -> Load:
    """Let the board measure for so many simulated seconds, and then crash."""
    sim = AvrSim(program)
    try:
        with j2a.Client(SimLink(sim), timeout=5.0) as board:
            samples: list[j2a.Sample] = []
            for one in board.transducers.values():
                one.on_sample(samples.append)
            idle = _watch(board, 1.0)
            board.functions.measure(True)
            begin = board.counters.bytes_received
            alone = _watch(board, seconds)
            taken = board.counters.bytes_received - begin
            for _ in range(CRASHES):
                board.functions.crash()
                crash = _watch(board, 1.0)
            board.functions.measure(False)
            board.echo()
    finally:
        sim.close()
    counts = _counts(samples, alone.begin_us, alone.end_us)
    crashed = _counts(samples, alone.end_us, crash.end_us)
    wrong = dict.fromkeys(TABLE, 0)
    last: dict[str, int] = {}
    for sample in samples:
        for reading in sample.readings:
            now = number(sample.name, reading)
            modulus = MODULI.get(sample.name, 1 << 31)
            if sample.name in last and (now - last[sample.name]) % modulus != 1:
                wrong[sample.name] += 1
            last[sample.name] = now
    lost = sum(sample.lost + sample.missed for sample in samples)
    return Load(
        seconds=alone.seconds,
        counts=counts,
        crash_seconds=(crash.end_us - alone.end_us) / 1e6,
        crashed=crashed,
        wrong=wrong,
        lost=lost,
        wire_bytes=taken,
        busy=1 - alone.turns_per_s / idle.turns_per_s,
    )


def _counts(samples: list[j2a.Sample], begin_us: int, end_us: int) -> dict[str, int]:
    """Return how many readings have a time of this span, by the name of the sensor."""
    counts = dict.fromkeys(TABLE, 0)
    for sample in samples:
        for reading in sample.readings:
            at_us = reading.time_us
            counts[sample.name] += at_us is not None and begin_us <= at_us < end_us
    return counts


@dataclass(frozen=True, slots=True)
class _Span:
    """What the board did from one time of its clock to another one."""

    begin_us: int
    end_us: int
    turns: int

    @property
    def seconds(self) -> float:
        return (self.end_us - self.begin_us) / 1e6

    @property
    def turns_per_s(self) -> float:
        return self.turns / self.seconds


def _watch(board: j2a.Client, seconds: float) -> _Span:
    """Let at least so many seconds pass: a host that has to wait for a processor looks later."""
    before, start = board.functions.turns(), board.now()
    while board.now() < start + seconds:
        try:
            # Only the boot SIF has this opcode, and this board sends none.
            board.wait_sif(255, timeout=start + seconds - board.now())
        except (j2a.CallTimeout, j2a.LocalError):
            break
    after = board.functions.turns()
    return _Span(before.time, after.time, after.count - before.count)


def _show(load: Load) -> None:
    """Print the figures."""
    arrays = asked()
    print(
        f"\n{'':12}{'thesis':>21}{'':>10}{'on the wire':>22}{'':>3}{'came':>8}{'wrong':>7}\n"
        f"{'':12}{'each':>11}{'bit/s':>10}{'samples/s':>12}{'bytes/s':>10}{'share':>11}"
    )
    for name, row in TABLE.items():
        print(
            f"{name:12}{row.sensors:3} x {row.rate:2g} Hz{row.bandwidth:10g}{row.samples:12g}"
            f"{arrays[name]:10g}{100 * share(arrays[name]):9.1f} %{load.counts[name]:10}"
            f"{load.wrong[name]:7}"
        )
    total = sum(arrays.values())
    bits = sum(row.bandwidth for row in TABLE.values())
    print(f"{'all':21}{bits:10g}{'':12}{total:10g}{100 * share(total):9.1f} %")
    print(
        f"\nin {load.seconds:.1f} s of simulated time, and {CRASHES} with a crash each, "
        f"{load.lost} lost;\n{100 * load.wire:.1f} % of the wire at {BAUD} baud, "
        f"{100 * load.busy:.1f} % of the processor"
    )
    channels = asked(AS_ARRAYS)
    asks = sum(channels[name] for name in AS_ARRAYS)
    print(
        f"\nas channels, each value with a time of its own, infrared and ultrasonic would take "
        f"{100 * share(asks):.1f} %\nof the wire, and all together "
        f"{100 * share(sum(channels.values())):.1f} %: with the others at their top rates, these "
        f"two\nfit at {100 * fit():.0f} % of theirs at most, {50 * fit():.1f} and "
        f"{25 * fit():.1f} Hz"
    )


def main() -> int:
    """Print the figures; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seconds", type=float, default=10.0, help="of simulated time (10)")
    args = parser.parse_args()
    if not args.seconds >= 1:
        parser.error("--seconds is 1 or more")
    load = measure(build(), args.seconds)
    _show(load)
    return 1 if load.lost or any(load.wrong.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
