"""Runs the conformance suite against all testees, and the suite for hosts against our hosts.

What flows in: conformance/testees/*.toml and conformance/hosts/*.py. What flows out: reports of
each in build/conformance, a matrix page over all of them, one line a testee, and exit status 0 when
all conform. Rules: two runs at a time, because some cases measure time: one begins with the
emulators, which need a core each, the other with simulated time, which nothing can disturb; a
testee that cannot be built here fails.
"""

import argparse
import subprocess
import sys
import time
import tomllib
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
OUT = ROOT / "build" / "conformance"
CONFORM = [sys.executable, "-m", "j2a_conformance"]


def commands() -> dict[str, list[str]]:
    """Return the arguments of j2a-conform for each testee, by the name of its reports."""
    found = {
        path.stem: ["run", str(path)] for path in sorted(ROOT.glob("conformance/testees/*.toml"))
    }
    for path in sorted(ROOT.glob("conformance/hosts/*.py")):
        found[f"host-{path.stem}"] = ["host", "--", sys.executable, str(path)]
    return found


def demand(arguments: list[str]) -> int:
    """Return how much a run minds company: 0 is an emulator, 1 this machine, 2 simulated time."""
    testee = Path(arguments[1])
    if testee.suffix != ".toml":
        return 1
    url = str(tomllib.loads(testee.read_text("utf-8")).get("url", ""))
    if url.startswith("sim:"):
        return 2
    return 0 if "qemu-system" in url or "/emulators/" in url else 1


def run(name: str, arguments: list[str]) -> tuple[bool, str]:
    """Run the suite once; return whether it passed, and the line to print."""
    start_s = time.monotonic()
    kinds = {"json": "json", "html": "html", "junit": "xml", "badge": "svg"}
    reports = [f"--{option}={OUT / name}.{suffix}" for option, suffix in kinds.items()]
    command = [*CONFORM, arguments[0], *reports, *arguments[1:]]
    done = subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL
    )
    (OUT / f"{name}.txt").write_text(done.stdout + done.stderr, "utf-8")
    took_s = time.monotonic() - start_s
    last = (done.stdout.strip() or done.stderr.strip() or "(nothing was printed)").splitlines()[-1]
    if done.returncode:
        last = f"exit code {done.returncode}\n{done.stdout}{done.stderr}"
    return done.returncode == 0, f"{name:16} {took_s:5.1f} s  {last}"


def main() -> int:
    """Run what was asked for; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="only these testees")
    args = parser.parse_args()
    every = commands()
    if unknown := set(args.names) - set(every):
        parser.error(f"no testee {', '.join(sorted(unknown))}; there are {', '.join(every)}")
    chosen = {name: every[name] for name in args.names} or every
    OUT.mkdir(parents=True, exist_ok=True)
    for old in OUT.iterdir():
        if chosen is every or old.stem in chosen:
            old.unlink()
    left = deque(sorted(chosen.items(), key=lambda item: demand(item[1])))

    def work(take: Callable[[], tuple[str, list[str]]]) -> bool:
        good = True
        while True:
            try:
                name, arguments = take()
            except IndexError:
                return good
            passed, line = run(name, arguments)
            print(line, flush=True)
            good &= passed

    with ThreadPoolExecutor(max_workers=2) as pool:
        good = all(list(pool.map(work, (left.popleft, left.pop))))
    reports = [str(path) for path in sorted(OUT.glob("*.json"))]
    page = [*CONFORM, "matrix", *reports, "--html", str(OUT / "index.html")]
    return 0 if subprocess.run(page, check=False).returncode == 0 and good else 1


if __name__ == "__main__":
    sys.exit(main())
