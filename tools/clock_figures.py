"""The table of docs/clock-bench.md: how well clocks agree, measured by `j2a sim clocks`.

What flows in: how many seeds. What flows out: the table, printed, or with --write in the page.
Rule: each row is the worst of its seeds, 1 to N, so anybody gets the same figures.
"""

import argparse
import re
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from j2a_sim._clocks.run import run
from j2a_sim._clocks.settings import Settings

ROOT: Final = Path(__file__).resolve().parent.parent
PAGE: Final = ROOT / "docs/clock-bench.md"
BEGIN, END = "<!-- figures -->\n", "<!-- end of figures -->\n"
READINGS: Final = 200_000


@dataclass(frozen=True, slots=True)
class Row:
    """A row: what it is called, and the settings besides the seed."""

    title: str
    settings: dict[str, Any]
    hours: bool = False


ROWS: Final = (
    Row("USB, 8 boards, 20 s, real firmware", {"engine": "avr", "readings": 40_000}),
    Row("USB, 8 boards, 60 s", {"seconds": 60, "engine": "native"}),
    Row("USB, 8 boards, 1 h, 0.1 % of frames lost", {"seconds": 3600, "lost_sof": 0.001}, True),
    Row("USB, 8 boards, 60 s, busy host", {"seconds": 60, "engine": "native", "load": "heavy"}),
    Row(
        "USB, 8 boards, 120 s, host's clock slewed by 500 ppm for 60 s",
        {"seconds": 120, "engine": "native", "slew_at": 40.0},
    ),
    Row("USB, 64 boards, 60 s", {"boards": 64, "seconds": 60}),
    Row(
        "115200 baud, 4 boards, 60 s, real firmware",
        {"link": "serial", "boards": 4, "seconds": 60, "engine": "avr", "readings": 40_000},
    ),
    Row("115200 baud, 8 boards, 120 s", {"link": "serial", "seconds": 120}),
    Row(
        "115200 baud, 8 boards, 120 s, host's clock slewed by 500 ppm for 60 s",
        {"link": "serial", "seconds": 120, "slew_at": 40.0},
    ),
    Row("115200 baud, 8 boards, 1 h", {"link": "serial", "seconds": 3600}, True),
    Row("TCP, 8 boards, 120 s", {"link": "tcp", "seconds": 120}),
    Row("RFCOMM, 8 boards, 120 s", {"link": "rfcomm", "seconds": 120}),
)
HEAD: Final = (
    "| run | pair rms | (bound) | pair peak | (bound) | host rms | (bound) | announced | (bound) |"
    " inside | back |\n"
    "|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|\n"
)


def line(row: Row, seeds: int) -> str:
    """Return a row of the table."""
    reports = [
        run(Settings(**{"readings": READINGS, **row.settings, "seed": seed}))
        for seed in range(1, seeds + 1)
    ]
    figures = [report.figures for report in reports]
    bounds = [report.bounds for report in reports]

    def worst(name: str, of: list[dict[str, Any]] = figures) -> str:
        return f"{max(one[name] for one in of):.3g}" if all(name in one for one in of) else "-"

    cells = (
        row.title,
        worst("pair_rms_us"),
        worst("pair_rms_us", bounds),
        worst("pair_peak_us"),
        worst("pair_peak_us", bounds),
        worst("host_rms_us"),
        worst("host_rms_us", bounds),
        worst("uncertainty_us"),
        worst("uncertainty_us", bounds),
        f"{100 * min(one['inside_uncertainty'] for one in figures):.2f} %",
        str(sum(one["backwards"] for one in figures)),
    )
    return "| " + " | ".join(cells) + " |\n"


def main() -> int:
    """Print or write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3, help="of each row (%(default)s)")
    parser.add_argument("--hours", action="store_true", help="with the rows that last an hour")
    parser.add_argument("--write", action="store_true", help="write it into the page")
    args = parser.parse_args()
    if args.seeds < 1:
        parser.error("--seeds is 1 or more")
    table = HEAD
    for row in ROWS:
        if row.hours and not args.hours:
            continue
        made = line(row, args.seeds)
        print(made, end="", flush=True)
        table += made
    if args.write:
        note = f"\nMicroseconds; each the worst of {args.seeds} seeds.\n"
        page = PAGE.read_text("utf-8")
        pattern = re.escape(BEGIN) + ".*" + re.escape(END)
        made = re.sub(pattern, lambda _: BEGIN + table + note + END, page, flags=re.DOTALL)
        PAGE.write_text(made, "utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
