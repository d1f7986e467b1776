"""Runs the conformance suite against all testees, and the suite for hosts against our hosts.

What flows in: conformance/testees/*.toml and conformance/hosts/*.py. What flows out: reports of
each in build/conformance, a matrix page over all of them, one line a testee, and exit status 0 when
all conform. Rules: three runs at a time, of different kinds as long as there are some: an emulator
needs a core, on this machine a run waits most of the time, and simulated time is disturbed by
nothing; a testee that cannot be built here fails. With `--sample` those of PARTS do their parts
only, all but those of COMPLETE and SWEEPING and the hosts leave out SWEEPS, and FURTHER is left to
a run without it.
"""

import argparse
import contextlib
import os
import re
import shlex
import subprocess
import sys
import time
import tomllib
from collections import defaultdict, deque
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import j2a_transports
from j2a_conformance import load
from j2a_conformance.device._testee import TesteeFile, load_testee
from j2a_spec.capabilities import LEVELS

ROOT = Path(__file__).resolve().parent.parent
OUT = ROOT / "build" / "conformance"
CONFORM = [sys.executable, "-m", "j2a_conformance"]
# One testee of each kind of code, clock and link, the quickest. The others run the same sources
# but with another compiler, chip, port or option: they can differ in a kind of frame, a time or a
# limit, but hardly in one of the thousand lengths and places that a sweep tries; what each sweep is
# about has a shorter case, too, which all of them run.
COMPLETE = ("posix-sanitized", "avr-1m", "avr-usb", "python")
SWEEPS = (
    *("frame.interrupted-anywhere", "frame.lengths", "frame.noise", "frame.pieces"),
    *("frame.sos-to-device", "stuff.escape-ff-anywhere", "stuff.needless", "stuff.replies"),
    *("sum.every-length", "sum.every-wrong-value", "seq.every-value", "sif.every-length"),
    *("error.opcode-out-of-range", "error.seq", "debug.text", "interface.chunks"),
    *("many.echo-lengths", "many.four-offset-bytes", "types.bools", "types.lengths"),
    *("timing.gives-up-long", "timing.pause-in-long-frame", "timing.trickle-long"),
    *("timing.wraps", "clock.refusals", "transducers.chunks", "transducers.queue"),
    *("transducers.refused", "transducers.refused-meanwhile", "transducers.threshold"),
)
# The same firmware as that of another testee, on a further chip or in a further shell: each costs
# the processor as much as three others.
FURTHER = (
    *("transducers-328p", "transducers-arduino", "transducers-rp2040", "listing-32u2"),
    *("clock-328p", "clock-32bit", "clock-big-endian", "clock-rp2040"),
    "transducers-32bit",
)
LINK = ("frame", "core", "sif", "timing")
# The clock, and what transducers do at a time of the clock.
TIMED = (
    *("clock", "transducers.at-once", "transducers.period", "transducers.period-late"),
    *("transducers.period-short", "transducers.samples", "transducers.set", "transducers.trigger"),
    *("transducers.unheard", "transducers.waiting", "transducers.watchdog"),
)
# The clock with USB frames: what asks for none leads the same lines as over a UART.
FRAMES = (
    *("clock.announced", "clock.epochs", "clock.exchanges", "clock.first", "clock.frames"),
    *("clock.free", "clock.states", "clock.steps", "clock.together", "clock.turnaround"),
    *("clock.values", "clock.waiting"),
)
# What transducers send of themselves, and what comes as often or as late as the link lets it.
SENT = (
    *("transducers.announced", "transducers.counted", "transducers.heard", "transducers.period"),
    *("transducers.samples", "transducers.set", "transducers.watchdog"),
)
# Testees that are another one with a part more, in another shell, on another chip of the same kind
# or another of its links: the levels and cases of that part, or those in which the link has a part.
# The rest is what the other one shows.
PARTS = {
    "arduino": (*LINK, "mapping", "interface"),
    "avr": LINK,
    "avr-32u4": LINK,
    "avr-usb-32u2": LINK,
    "clock": TIMED,
    "clock-avr": ("clock",),
    "clock-usb": FRAMES,
    "cortex-m-two": LINK,
    "python-clock": TIMED,
    "python-transducers": ("transducers",),
    "rp2040": LINK,
    "selftest-avr": ("properties",),
    "selftest-posix": ("properties",),
    "transducers": ("transducers",),
    "transducers-avr": ("transducers",),
    "transducers-avr-usb": SENT,
}
# Of PARTS, the one of each kind of code that does the sweeps of its levels, too.
SWEEPING = (
    *("clock", "clock-avr", "python-clock"),
    *("python-transducers", "transducers", "transducers-avr"),
)
# What decides about the folder of a build: without OUT it is that of the port.
_WORD = re.compile(r"\b(OUT|PORT)=([\w/-]+)")
KINDS = ("simulated", "machine", "emulator")


def commands() -> dict[str, list[str]]:
    """Return the arguments of j2a-conform for each testee, by the name of its reports."""
    found = {
        path.stem: ["run", str(path)] for path in sorted(ROOT.glob("conformance/testees/*.toml"))
    }
    for path in sorted(ROOT.glob("conformance/hosts/*.py")):
        found[f"host-{path.stem}"] = ["host", "--", sys.executable, str(path)]
    return found


def sampled(name: str, arguments: list[str]) -> list[str]:
    """Return the arguments for a testee, without the sweeps where it is not one of COMPLETE.

    One that names levels, itself or in PARTS, runs only their cases, of SWEEPING all of them; PARTS
    may name single cases, too.
    """
    if arguments[0] != "run" or name in COMPLETE:
        return arguments
    testee = tomllib.loads(Path(arguments[1]).read_text("utf-8"))
    parts = {*(PARTS.get(name) or testee.get("levels") or LEVELS)}
    # Without levels, all; else the rest is what another testee of that chip shows.
    every = [case.ID for case in load() if not case.ON_DEMAND and parts & {case.ID, case.LEVEL}]
    named = {*SWEEPS, *TIMED, *FRAMES, *SENT} - {*LEVELS}
    if unknown := named - {case.ID for case in load()}:
        raise SystemExit(f"there is no case {', '.join(sorted(unknown))}")
    left_out = () if name in SWEEPING else SWEEPS
    return [*arguments, "--case", *(case for case in every if case not in left_out)]


def kind(arguments: list[str]) -> str:
    """Return where the testee of a run is: in an emulator, on this machine or in simulated time."""
    testee = Path(arguments[1])
    if testee.suffix != ".toml":
        return "machine"
    url = str(tomllib.loads(testee.read_text("utf-8")).get("url", ""))
    if url and j2a_transports.innermost(url)[1].is_simulated:
        return "simulated"
    return "emulator" if "qemu-system" in url or "/emulators/" in url else "machine"


def run(name: str, arguments: list[str]) -> tuple[bool, str]:
    """Run the suite once; return whether it passed, and the line to print."""
    start_s = time.monotonic()
    kinds = {"json": "json", "html": "html", "junit": "xml", "badge": "svg"}
    reports = [f"--{option}={OUT / name}.{suffix}" for option, suffix in kinds.items()]
    command = [*CONFORM, arguments[0], *reports, *arguments[1:]]
    said = OUT / f"{name}.txt"
    with said.open("wb") as log:
        process = subprocess.Popen(
            command, cwd=ROOT, stdin=subprocess.DEVNULL, stdout=log, stderr=log
        )
        _, status, used = os.wait4(process.pid, 0)
    process.returncode = code = os.waitstatus_to_exitcode(status)
    took_s = time.monotonic() - start_s
    text = said.read_text("utf-8")
    last = (text.strip() or "(nothing was printed)").splitlines()[-1]
    if code:
        last = f"exit code {code}\n{text}"
    cpu_s = used.ru_utime + used.ru_stime  # its emulator's, too: it has waited for its end
    return code == 0, f"{name:24} {took_s:5.1f} s, {cpu_s:5.1f} s of the processors  {last}"


def build(files: Iterable[Path]) -> None:
    """Build testees, and see that each starts: two at a time, but none in a folder of another.

    Raises:
        HarnessError: one cannot be built, or does not start.
    """
    folders = defaultdict(list)
    for file in files:
        testee = load_testee(file)
        words = dict(_WORD.findall(shlex.join(testee.build)))
        folders[words.get("OUT") or f"build/{words.get('PORT')}"].append(testee)

    def work(testees: list[TesteeFile]) -> None:
        for testee in testees:
            with testee.started():
                pass

    with ThreadPoolExecutor(max_workers=2) as pool:
        list(pool.map(work, folders.values()))


def main() -> int:
    """Run what was asked for; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="only these testees")
    parser.add_argument("--build", action="store_true", help="build the testees, and run nothing")
    parser.add_argument("--sample", action="store_true", help="fewer testees and sweeps")
    args = parser.parse_args()
    every = commands()
    if unknown := set(args.names) - set(every):
        parser.error(f"no testee {', '.join(sorted(unknown))}; there are {', '.join(every)}")
    chosen = {name: every[name] for name in args.names} or every
    if args.sample:
        if not args.names:
            chosen = {name: chosen[name] for name in chosen if name not in FURTHER}
            print(f"left to make conformance: {', '.join(FURTHER)}", flush=True)
        chosen = {name: sampled(name, arguments) for name, arguments in chosen.items()}
    if args.build:
        build(Path(words[1]) for words in chosen.values() if words[1].endswith(".toml"))
        return 0
    OUT.mkdir(parents=True, exist_ok=True)
    for old in OUT.iterdir():
        if not args.names or old.stem in chosen:
            old.unlink()
    left: dict[str, deque[str]] = {name: deque() for name in KINDS}
    for name, arguments in chosen.items():
        left[kind(arguments)].append(name)

    def take(first: str) -> str | None:
        for name in (first, *KINDS):
            with contextlib.suppress(IndexError):
                return left[name].popleft()
        return None

    def work(first: str) -> bool:
        good = True
        while (name := take(first)) is not None:
            passed, line = run(name, chosen[name])
            print(line, flush=True)
            good &= passed
        return good

    with ThreadPoolExecutor(max_workers=len(KINDS)) as pool:
        good = all(list(pool.map(work, KINDS)))
    reports = [str(path) for path in sorted(OUT.glob("*.json"))]
    page = [*CONFORM, "matrix", *reports, "--html", str(OUT / "index.html")]
    return 0 if subprocess.run(page, check=False).returncode == 0 and good else 1


if __name__ == "__main__":
    sys.exit(main())
