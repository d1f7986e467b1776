"""Runs the programs that the documentation shows again and again, and compares what they print.

    python docs/tests/repeat.py [--times 30] [URL ...]

The programs are the last ones of README.md and docs/index.md and the examples that take the URL of
a device with the demo functions. Without a URL they talk to the Python device over TCP, and to the
demo firmware for this machine and in a simulated AVR where these can be built. The command fails
when two runs of a program differ, or one of them does not end well; with J2A_REQUIRE_AVR=1 also
when firmware cannot be built.
"""

import argparse
import os
import re
import subprocess
import sys
import threading
from collections import Counter
from pathlib import Path

import j2a_transports

from j2a.demo import DemoDevice

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "docs/examples"
SHOWN_URL = "serial:///dev/ttyACM0?baud=115200"
LIMIT_S = 60

FIRMWARE = {
    "exec:firmware/build/posix/demo": ["PORT=posix", "APP=demo"],
    "sim:firmware/build/avr-serial/demo.elf": ["PORT=avr-serial", "APP=demo"],
    "exec:firmware/build/posix/bytes": ["PORT=posix", "APP=bytes"],
    "firmware/build/avr-usb/demo.elf": ["PORT=avr-usb", "APP=demo"],
}
# The examples that take something else than a device with the demo functions.
OTHERS = {
    "exec:firmware/build/posix/bytes": "echo_bytes.py",
    "firmware/build/avr-usb/demo.elf": "simulated_usb.py",
}


def shown(page: str, number: int = -1) -> str:
    """Return a Python program of a page, by default the last: it is for the demo functions."""
    return re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(), re.DOTALL)[number]


def programs(url: str) -> dict[str, list[str]]:
    """Return the arguments of Python for each program, with the URL of a device."""
    if url in OTHERS:
        return {OTHERS[url]: [str(EXAMPLES / OTHERS[url]), url]}
    pages = {
        page: ["-c", shown(page).replace(SHOWN_URL, url)] for page in ("README.md", "docs/index.md")
    }
    examples = ("tour.py", "asynchronous.py")
    return pages | {name: [str(EXAMPLES / name), url] for name in examples}


def run(arguments: list[str]) -> str:
    """Return what a program printed, or how it failed."""
    try:
        result = subprocess.run(
            [sys.executable, "-W", "error", *arguments],
            capture_output=True,
            text=True,
            timeout=LIMIT_S,
            check=False,
            cwd=ROOT,
        )
    except subprocess.TimeoutExpired:
        return f"FAILED: not done after {LIMIT_S} s"
    if result.returncode or result.stderr:
        return f"FAILED: exit code {result.returncode}\n{result.stdout}{result.stderr}"
    return result.stdout


def differences(url: str, times: int) -> int:
    """Run each program so many times; return how many programs did not print the same."""
    differing = 0
    for name, arguments in programs(url).items():
        printed = Counter(run(arguments) for _ in range(times))
        is_good = len(printed) == 1 and not next(iter(printed)).startswith("FAILED")
        differing += not is_good
        print(f"{url:45} {name:18} {times} runs, {'the same' if is_good else 'DIFFERENT'}")
        if not is_good:
            for text, count in printed.most_common():
                print(f"--- {count} times:\n{text}")
        sys.stdout.flush()
    return differing


def main() -> int:
    """Run the command; return the exit code."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--times", type=int, default=30, help="runs of each program (%(default)s)")
    parser.add_argument("urls", nargs="*", metavar="URL")
    options = parser.parse_args()
    if options.urls:
        return int(sum(differences(url, options.times) for url in options.urls) > 0)
    device = DemoDevice()
    with j2a_transports.listen("tcp://127.0.0.1:0") as listener:
        thread = threading.Thread(target=device.serve_forever, args=(listener,))
        thread.start()
        differing = differences(listener.url, options.times)
        device.stop()
        thread.join(LIMIT_S)
    for url, settings in FIRMWARE.items():
        make = ["make", "-s", "-C", str(ROOT / "firmware"), *settings]
        if subprocess.run(make, capture_output=True, check=False).returncode:
            print(f"{url}: skipped, it cannot be built here")
            differing += os.environ.get("J2A_REQUIRE_AVR") == "1"
        else:
            differing += differences(url, options.times)
    return int(differing > 0)


if __name__ == "__main__":
    sys.exit(main())
