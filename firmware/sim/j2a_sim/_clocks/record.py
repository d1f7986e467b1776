"""Records how late this machine's scheduler is: `python -m j2a_sim._clocks.record FILE`.

In: a file for the result, seconds. Out: quantiles in microseconds, without and with load, as JSON.
Rules: "wake" is from the expiry of a timer to the time stamp of the program that slept until then,
as from a link's interrupt to a program that waits for bytes, so without the timer slack by which
Linux saves power; "write" is from a time stamp to the end
of a system call that sends 16 bytes to a pipe. The load are busy processes, one more than there are
processors, which this program starts and ends. No privileges, no special scheduling.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, Final

from j2a_sim._clocks.delays import SHARES, quantiles

PERIOD_NS: Final = 1_000_000
REQUEST: Final = bytes(16)
SLACK: Final = Path("/proc/self/timerslack_ns")


def record(seconds: float) -> dict[str, list[float]]:
    """Record for some seconds of real time; returns the quantiles of both kinds of delay."""
    wakes: list[float] = []
    writes: list[float] = []
    reader, writer = os.pipe()
    if SLACK.exists():
        SLACK.write_text("1")
    try:
        due = time.monotonic_ns() + PERIOD_NS
        end = due + int(seconds * 1e9)
        while due < end:
            time.sleep(max(0, due - time.monotonic_ns()) / 1e9)
            awake = time.monotonic_ns()
            wakes.append((awake - due) / 1000)
            os.write(writer, REQUEST)
            writes.append((time.monotonic_ns() - awake) / 1000)
            os.read(reader, len(REQUEST))
            due = max(due + PERIOD_NS, time.monotonic_ns() + PERIOD_NS // 4)
    finally:
        os.close(reader)
        os.close(writer)
    return {"wake": quantiles(wakes), "write": quantiles(writes)}


def record_both(seconds: float) -> dict[str, Any]:
    """Record without load of its own, then with it."""
    found: dict[str, Any] = {
        "about": "microseconds at these shares; see record.py",
        "machine": f"{platform.machine()}, {os.cpu_count()} processors",
        "system": f"{platform.system()} {platform.release()}, Python {platform.python_version()}",
        "shares": list(SHARES),
        "light": record(seconds),
    }
    spin = [sys.executable, "-c", "while True: pass"]
    load = [subprocess.Popen(spin) for _ in range((os.cpu_count() or 1) + 1)]
    try:
        found["heavy"] = record(seconds)
    finally:
        for process in load:
            process.kill()
            process.wait()
    return found


def _text(found: dict[str, Any]) -> str:
    """As JSON with a line for each value of the outermost object."""
    rows = [f"{json.dumps(key)}: {json.dumps(value)}" for key, value in found.items()]
    return "{\n" + ",\n".join(rows) + "\n}\n"


def main() -> int:
    """Record and write the file."""
    parser = argparse.ArgumentParser(prog="python -m j2a_sim._clocks.record", description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("--seconds", type=float, default=30.0, help="of each half (%(default)s)")
    args = parser.parse_args()
    args.file.write_text(_text(record_both(args.seconds)), "utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
