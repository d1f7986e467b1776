"""What the sensors of a robot take of a board: `python tools/robot_load.py`.

An ATmega328P in the simulator has all sensors of the thesis' table 5.1 but cameras and LIDAR, at
their top rates, over 115200 baud.

What flows in: the firmware of apps/robot. What flows out: of each sensor how often it came and what
was lost, the share of the wire and that of the processor; exit status 1 where a value was lost.
Rule: time is simulated, so the figures are the same each time.
"""

import argparse
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from j2a_sim import AvrSim, SimLink

import j2a

ROOT: Final = Path(__file__).resolve().parent.parent
BAUD: Final = 115200
BITS_PER_BYTE: Final = 10
RATES: Final = {
    "bumper": 1.0,
    "cliff": 1.0,
    "infrared": 50.0,
    "ultrasonic": 25.0,
    "gps": 5.0,
    "ahrs": 50.0,
}


@dataclass(frozen=True, slots=True)
class Load:
    """What was seen.

    Attributes:
        seconds: of simulated time.
        counts: samples that came, by the name of the sensor.
        wrong: of each sensor the samples that are not the next one.
        lost: values and SIFs that the board or the link lost.
        wire_bytes: that came from the board.
        busy: the share of the processor, 0 to 1, that an idle board has for itself.
    """

    seconds: float
    counts: Mapping[str, int]
    wrong: Mapping[str, int]
    lost: int
    wire_bytes: int
    busy: float

    @property
    def wire(self) -> float:
        """The share of the wire, 0 to 1."""
        return self.wire_bytes * BITS_PER_BYTE / BAUD / self.seconds


def build() -> Path:
    """Build the firmware; return the program."""
    command = ["make", "-s", "-C", "firmware", "PORT=avr-serial", "APP=robot", "OUT=build/robot"]
    subprocess.run([*command, f"PYTHON={sys.executable}"], cwd=ROOT, check=True, stdout=sys.stderr)
    return ROOT / "firmware/build/robot/robot.elf"


def number(sample: j2a.Sample) -> int:
    """Return the number of a measurement; each driver counts in its own way."""
    reading = sample.readings[0]
    if sample.name == "bumper":
        return int(reading.channel) + (0 if reading.value else 16)
    if sample.name == "cliff":
        return int(reading.channel) + (0 if reading.value else 8)
    value: Any = reading.value
    if sample.name in ("infrared", "ultrasonic"):
        if len(set(value)) != 1:
            raise ValueError(f"a value of {sample.name} is torn: {value}")
        return int(value[0])
    return int(value.latitude if sample.name == "gps" else value.rate[0])


MODULI: Final = {"bumper": 32, "cliff": 16, "infrared": 1 << 8, "ultrasonic": 1 << 16}


def measure(program: Path, seconds: float) -> Load:
    """Let the board measure for so many simulated seconds."""
    sim = AvrSim(program)
    try:
        with j2a.Client(SimLink(sim), timeout=5.0) as board:
            samples: list[j2a.Sample] = []
            for one in board.transducers.values():
                one.on_sample(samples.append)
            idle = _turns(board, 1.0)
            board.functions.measure(True)
            begin = board.counters.bytes_received
            turns = _turns(board, seconds)
            taken = board.counters.bytes_received - begin
            board.functions.measure(False)
            board.echo()
    finally:
        sim.close()
    counts = dict.fromkeys(RATES, 0)
    wrong = dict.fromkeys(RATES, 0)
    last: dict[str, int] = {}
    for sample in samples:
        now = number(sample)
        modulus = MODULI.get(sample.name, 1 << 31)
        if sample.name in last and (now - last[sample.name]) % modulus != 1:
            wrong[sample.name] += 1
        last[sample.name] = now
        counts[sample.name] += len(sample.readings)
    lost = sum(sample.lost + sample.missed for sample in samples)
    return Load(seconds, counts, wrong, lost, taken, 1 - turns / idle)


def _turns(board: j2a.Client, seconds: float) -> float:
    """Return the turns of the main loop in a second."""
    before, start = board.functions.turns(), board.now()
    while board.now() < start + seconds:
        try:
            # Only the boot SIF has this opcode, and this board sends none.
            board.wait_sif(255, timeout=start + seconds - board.now())
        except (j2a.CallTimeout, j2a.LocalError):
            break
    return float(board.functions.turns() - before) / (board.now() - start)


def main() -> int:
    """Print the figures; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seconds", type=float, default=10.0, help="of simulated time (10)")
    args = parser.parse_args()
    if not args.seconds >= 1:
        parser.error("--seconds is 1 or more")
    load = measure(build(), args.seconds)
    print(f"\n{'sensor':12}{'per second':>12}{'came':>10}{'wrong':>8}")
    for name, rate in RATES.items():
        print(f"{name:12}{rate:12g}{load.counts[name]:10}{load.wrong[name]:8}")
    print(
        f"\nin {load.seconds:g} s of simulated time {load.lost} lost; "
        f"{100 * load.wire:.1f} % of the wire at {BAUD} baud, {100 * load.busy:.1f} % of the "
        "processor"
    )
    return 1 if load.lost or any(load.wrong.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
