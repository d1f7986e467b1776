"""`make demo-servo`: the demonstration of the thesis (chapter 9) on a simulated ATmega328P.

An encoder is turned by edges at its pins. The board sends samples, the host scales them and sets a
servo, and the width of its pulses is measured at the pin.

What flows in: the firmware of apps/servo. What flows out: how long each part took, as a table and
as build/demo-servo.svg, and exit status 0 when each pulse was what the host had set. Rule:
simulated time passes as fast as real time, so that what the host takes counts, too.
"""

import argparse
import math
import statistics
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from j2a_sim import AvrSim, SimLink, pulses

import j2a

ROOT: Final = Path(__file__).resolve().parent.parent
PICTURE: Final = ROOT / "build/demo-servo.svg"
WIRES: Final = ("PD2", "PD3")
PULSE_PIN: Final = "PB1"
LEVELS: Final = ((0, 0), (1, 0), (1, 1), (0, 1))  # A and B at each place of the cycle
STEP_DEG: Final = 0.18
SWING_DEG: Final = 180.0
SWING_S: Final = 1.0
START_S: Final = 1.0
MIDDLE_US: Final = 1500
US_PER_PERCENT: Final = 5
TICK_US: Final = 4


@dataclass(frozen=True, slots=True)
class Pulse:
    """A pulse of the servo, and how its width came about; times in simulated microseconds.

    Attributes:
        edge_us: the edge of the encoder that the sample is of.
        arrived_us: the sample is at the host.
        set_us: the board has said that the servo is set.
        start_us, width_us: of the pulse at the pin.
        degrees: of the shaft.
        percent: that the host has set.
    """

    edge_us: float
    arrived_us: float
    set_us: float
    start_us: float
    width_us: float
    degrees: float
    percent: int

    @property
    def is_right(self) -> bool:
        """The width is what was set, to half a tick of the timer and one at its rounding."""
        return abs(self.width_us - MIDDLE_US - US_PER_PERCENT * self.percent) <= TICK_US


def build() -> Path:
    """Build the firmware; return the program."""
    command = [
        "make",
        "-s",
        "-C",
        "firmware",
        "PORT=avr-serial",
        "APP=servo",
        "OUT=build/demo-servo",
    ]
    subprocess.run([*command, f"PYTHON={sys.executable}"], cwd=ROOT, check=True, stdout=sys.stderr)
    return ROOT / "firmware/build/demo-servo/servo.elf"


def turns(swings: int) -> Iterator[tuple[float, int]]:
    """Yield the seconds and the place in steps of a shaft that swings to SWING_DEG and back."""
    most = round(SWING_DEG / STEP_DEG)
    for swing in range(swings):
        up = [math.acos(1 - 2 * step / most) / math.tau for step in range(1, most + 1)]
        for step, part in enumerate(up, 1):
            yield (swing + part) * SWING_S, step
        for step, part in enumerate(reversed(up), 1):
            yield (swing + 1 - part) * SWING_S + 1e-4, most - step


def run(program: Path, swings: int = 2) -> list[Pulse]:
    """Turn the encoder and let the servo follow; return its pulses."""
    sim = AvrSim(program)
    for wire in ("PD2", "PD3", "PD4", "PD5"):
        sim.pins.drive(wire, 0)
    sim.pins.watch(PULSE_PIN)
    start = sim.cycle + sim.cycles(START_S)
    calibration = start - sim.cycles(0.1)
    place = _drive(sim, calibration, [1])
    for seconds, step in turns(swings):
        place = _drive(sim, start + sim.cycles(seconds), [step], place)
    heard: list[tuple[float, float, float, float, int]] = []
    with j2a.Client(SimLink(sim, speed=1)) as board:
        quad, servo = board.transducers["quad"], board.transducers["servo"]
        with quad.samples() as samples:
            first = samples.wait(2 * START_S)
            offset_us = 1e6 * calibration / sim.frequency_hz - first.times_us[0]
            end_s = START_S + swings * SWING_S
            while board.now() < end_s:
                try:
                    samples.wait(0.1)
                except j2a.CallTimeout:
                    continue
                sample = quad.latest()
                arrived_us = 1e6 * sample.host_time
                degrees = sample.values[0]
                percent = max(-100, min(100, round(degrees / SWING_DEG * 200 - 100)))
                servo.set(percent)
                edge_us = sample.times_us[0] + offset_us
                heard.append((edge_us, arrived_us, 1e6 * board.now(), degrees, percent))
        board.call("a2jEcho")
        edges = sim.pins.edges(PULSE_PIN)
    sim.close()
    return _followed(heard, [(p.start / 16, p.cycles / 16) for p in pulses(edges)])


def _drive(sim: AvrSim, cycle: int, steps: Sequence[int], place: int = 0) -> int:
    for step in steps:
        for wire, before, now in zip(WIRES, LEVELS[place % 4], LEVELS[step % 4], strict=True):
            if before != now:
                sim.pins.drive(wire, now, cycle)
        place = step
    return place


def _followed(
    heard: Sequence[tuple[float, float, float, float, int]], found: Sequence[tuple[float, float]]
) -> list[Pulse]:
    """Return each pulse with the value that it shows, of those that it may show.

    These are the last one that the board had confirmed before the pulse began, and the ones that
    the host was setting meanwhile.
    """
    made = []
    for start_us, width_us in found:
        confirmed = [one for one in heard if one[2] < start_us][-1:]
        on_the_way = [one for one in heard if one[1] < start_us <= one[2]]
        shown = [
            Pulse(edge_us, arrived_us, set_us, start_us, width_us, degrees, percent)
            for edge_us, arrived_us, set_us, degrees, percent in confirmed + on_the_way
        ]
        if confirmed:
            made.append(next((one for one in reversed(shown) if one.is_right), shown[0]))
    return made


# ------------------------------------------------------------------------- what is shown


def quantiles(values: Sequence[float]) -> tuple[float, ...]:
    """Return least, median, 90 % and greatest of values."""
    ordered = sorted(values)
    return (
        ordered[0],
        statistics.median(ordered),
        ordered[min(len(ordered) - 1, int(0.9 * len(ordered)))],
        ordered[-1],
    )


def latencies(found: Sequence[Pulse]) -> dict[str, list[float]]:
    """Return milliseconds from the edge of the encoder to each event."""
    return {
        "sample at the host": [(one.arrived_us - one.edge_us) / 1e3 for one in found],
        "servo set, confirmed": [(one.set_us - one.edge_us) / 1e3 for one in found],
        "begin of the pulse": [(one.start_us - one.edge_us) / 1e3 for one in found],
        "end of the pulse": [(one.start_us + one.width_us - one.edge_us) / 1e3 for one in found],
    }


def _line(points: Sequence[tuple[float, float]], color: str) -> str:
    text = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    return f'<polyline points="{text}" fill="none" stroke="{color}" stroke-width="1.5"/>'


def picture(found: Sequence[Pulse]) -> str:
    """Return a plot of shaft, servo and latency over time, as SVG."""
    first, last = found[0].start_us, found[-1].start_us
    left, width, height = 70, 640, 130

    def x(us: float) -> float:
        return left + width * (us - first) / max(1.0, last - first)

    worst = max(latencies(found)["end of the pulse"])
    panels = (
        ("shaft, deg", "#0072b2", 0.0, SWING_DEG, [(one.start_us, one.degrees) for one in found]),
        ("pulse, us", "#d55e00", 1000.0, 2000.0, [(one.start_us, one.width_us) for one in found]),
        (
            "edge to end of pulse, ms", "#009e73", 0.0, 5.0 * math.ceil(worst / 5),
            [
                (one.start_us, ms)
                for one, ms in zip(found, latencies(found)["end of the pulse"], strict=True)
            ],
        ),
    )  # fmt: skip
    parts = []
    for number, (title, color, low, high, points) in enumerate(panels):
        top = 40 + number * (height + 50)
        parts.append(f'<text x="{left}" y="{top - 8}" font-weight="bold">{title}</text>')
        parts.append(
            f'<rect x="{left}" y="{top}" width="{width}" height="{height}" fill="none" '
            'stroke="#888"/>'
        )
        for value in (low, (low + high) / 2, high):
            y = top + height * (1 - (value - low) / (high - low))
            parts.append(f'<text x="{left - 8}" y="{y + 4:.0f}" text-anchor="end">{value:g}</text>')
        scaled = [(x(us), top + height * (1 - (v - low) / (high - low))) for us, v in points]
        parts.append(_line(scaled, color))
    bottom = 40 + 3 * (height + 50) - 30
    for part in range(5):
        us = first + (last - first) * part / 4
        label = f"{(us - first) / 1e6:.2f} s"
        parts.append(f'<text x="{x(us):.0f}" y="{bottom}" text-anchor="middle">{label}</text>')
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {left + width + 40} {bottom + 20}" '
        'font-family="sans-serif" font-size="13"><rect width="100%" height="100%" fill="white"/>'
        + "".join(parts)
        + "</svg>\n"
    )


def main() -> int:
    """Run the demonstration; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--swings", type=int, default=2, help="of the shaft, a second each (2)")
    args = parser.parse_args()
    if args.swings < 1:
        parser.error("--swings is 1 or more")
    print(
        "building apps/servo for an ATmega328P: its transds.def lists two encoders and two servos"
    )
    program = build()
    print(f"turning the encoder {args.swings} times by {SWING_DEG:g} deg and back, in real time")
    found = run(program, args.swings)
    heads = "".join(f"{head:>8}" for head in ("least", "median", "90 %", "most"))
    print(f"\n{'from the edge of the encoder to, ms':38}{heads}")
    for what, values in latencies(found).items():
        print(f"{what:38}" + "".join(f"{value:8.2f}" for value in quantiles(values)))
    print("(the thesis saw 10 to 25 ms to the host; a servo takes a new width each 20 ms)")
    wrong = [one for one in found if not one.is_right]
    for one in wrong:
        print(f"a pulse of {one.width_us:.0f} us where {one.percent} % was set")
    PICTURE.parent.mkdir(exist_ok=True)
    PICTURE.write_text(picture(found), "utf-8")
    print(f"\n{len(found)} pulses, {len(found) - len(wrong)} as wide as the host had set them")
    print(f"wrote {PICTURE.relative_to(ROOT)}")
    return 1 if wrong or not found else 0


if __name__ == "__main__":
    sys.exit(main())
