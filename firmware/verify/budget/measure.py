"""What the firmware takes: `python -m firmware.verify.budget.measure`.

In: budget.toml, snapshot.json, the sources. Out: a table; with --write the snapshot and table.md;
with --check exit code 1 when a limit is broken or the snapshot differs; with --against a revision,
what has changed since.
With --changed only that is measured whose sources are not those of the snapshot, by the hashes in
measured.json; the others have its figures.
Rules: everything is built by firmware/Makefile as a user builds it; every figure is exact, so that
the same sources and compilers give the same figures on every machine. A missing tool leaves its
builds out and says so; where J2A_REQUIRE_AVR=1 is set, as in CI, it is an error.
"""

import argparse
import fcntl
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from fnmatch import fnmatch
from pathlib import Path
from typing import TextIO

try:
    from firmware.verify.budget import builds, measured, report, runs, snapshot
    from firmware.verify.budget.builds import BudgetError, Build
except ImportError as error:
    sys.exit(f"{error}: run `make venv` in the project's folder, and take .venv/bin/python")

__all__ = ["main"]

_JOBS = 2


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit code."""
    args = _parser().parse_args(argv)
    try:
        every = builds.load(args.budget)
        chosen = [build for build in every if any(fnmatch(build.name, only) for only in args.only)]
        if not chosen:
            raise BudgetError(f"no build is called {' or '.join(args.only)}")
        if args.write and (args.changed or args.figures):
            raise BudgetError("--write measures: leave --changed and --figures out")
        if args.write and len(chosen) != len(every):
            raise BudgetError("--write needs all builds: leave --only out")
        if args.save:
            _check_file(args.save)  # to measure takes minutes
        if args.figures:
            kept = snapshot.read(args.figures)
            results = {build.name: kept[build.name] for build in chosen if build.name in kept}
        else:
            hashes = _hashes(chosen)
            results = _kept(hashes) if args.changed else {}
            rest = [build for build in chosen if build.name not in results]
            if args.changed:
                print(f"{len(results)} builds are as they were measured, {len(rest)} are not\n")
            results |= _measure(rest, args.out, builds.FIRMWARE, strict=True)
            results = {build.name: results[build.name] for build in chosen if build.name in results}
        if args.write and len(results) != len(every):
            raise BudgetError("--write needs all builds, and some were not measured")
        if not results:
            raise BudgetError("nothing was measured")
        if args.save:
            snapshot.write(results, args.save)
        code = _report(args, every, results, len(results) == len(every))
        if args.write and code == 0 and args.snapshot == snapshot.SNAPSHOT:
            measured.write(hashes)
        return code
    except BudgetError as error:
        print(f"measure.py: {error}", file=sys.stderr)
        return 2


def _check_file(path: Path) -> None:
    """Raise BudgetError where a file cannot be written; what is there stays."""
    was_there = path.exists()
    try:
        path.open("a").close()
        if not was_there:
            path.unlink()
    except OSError as error:
        raise BudgetError(f"cannot write {path}: {error.strerror}") from None


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="measure.py", description="Measure flash, RAM, stack and cycles of the firmware."
    )
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--write", action="store_true", help="renew snapshot.json and table.md")
    what.add_argument(
        "--check", action="store_true", help="fail when a limit is exceeded or the snapshot differs"
    )
    what.add_argument("--against", metavar="REV", help="show the changes since a git revision")
    parser.add_argument(
        "--rebuild",
        action="store_true",
        help="with --against: measure that revision",
    )
    parser.add_argument(
        "--changed",
        action="store_true",
        help="measure only what has changed since the snapshot was written",
    )
    parser.add_argument("--markdown", action="store_true", help="tables as Markdown")
    parser.add_argument(
        "--only", metavar="NAME", nargs="+", default=["*"], help="builds, such as avr-serial/*"
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=builds.FIRMWARE / "build/budget",
        help="build folder (default: firmware/build/budget)",
    )
    parser.add_argument("--save", type=Path, metavar="FILE", help="write the figures there as well")
    parser.add_argument(
        "--figures",
        type=Path,
        metavar="FILE",
        help="read figures that --save wrote, measure nothing",
    )
    parser.add_argument("--budget", type=Path, default=builds.BUDGET, help="another budget.toml")
    parser.add_argument("--snapshot", type=Path, default=snapshot.SNAPSHOT, help="another snapshot")
    return parser


def _hashes(chosen: Sequence[Build]) -> dict[str, str]:
    """The hash of each build by its name, but of those whose compiler is missing."""
    hashes = {}
    for build in chosen:
        with suppress(builds.ToolMissing):
            compiler = runs.compiler(build, builds.FIRMWARE)
            hashes[build.name] = measured.digest(build, compiler, builds.FIRMWARE)
    return hashes


def _kept(hashes: Mapping[str, str]) -> dict[str, snapshot.Result]:
    """The figures in the snapshot of the builds that have these hashes there, too."""
    before, figures = measured.read(), snapshot.read()
    return {
        name: figures[name]
        for name in hashes.keys() & figures.keys()
        if hashes[name] == before.get(name)
    }


def _measure(
    chosen: Sequence[Build], out: Path, firmware: Path, strict: bool
) -> dict[str, snapshot.Result]:
    """Measure builds. With `strict` what cannot be measured is an error, else left out."""
    required = os.environ.get("J2A_REQUIRE_AVR") == "1"

    def one(build: Build) -> snapshot.Result | BudgetError:
        try:
            return runs.measure(build, out.resolve(), firmware, strict)
        except BudgetError as error:
            return error

    results: dict[str, snapshot.Result] = {}
    problems = []
    try:
        out.mkdir(parents=True, exist_ok=True)
        lock_file = (out / "lock").open("w")
    except OSError as error:
        raise BudgetError(f"cannot write to {out}: {error.strerror}; give another --out") from None
    with lock_file as lock, ThreadPoolExecutor(_JOBS) as pool:
        _lock(lock, out)
        for build, result in zip(chosen, pool.map(one, chosen), strict=True):
            if isinstance(result, snapshot.Result):
                results[build.name] = result
            elif strict and (required or not isinstance(result, runs.ToolMissing)):
                problems.append(str(result))
            else:
                print(f"left out: {result}", file=sys.stderr)
    if problems:
        raise BudgetError("\n".join(problems))
    return results


def _lock(file: TextIO, out: Path) -> None:
    """Wait until no other run builds in the same folder, and say so."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        print(f"waiting for another run that builds in {out}", file=sys.stderr, flush=True)
        fcntl.flock(file, fcntl.LOCK_EX)


def _revision(revision: str, chosen: Sequence[Build]) -> dict[str, snapshot.Result]:
    """Build and measure another revision, in a folder that is deleted afterwards."""
    done = subprocess.run(
        ["git", "archive", revision, "firmware", "docs/examples"],
        cwd=builds.FIRMWARE.parent,
        capture_output=True,
        check=False,
    )
    if done.returncode:
        raise BudgetError(done.stderr.decode(errors="replace").strip())
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(["tar", "-x", "-C", folder], input=done.stdout, check=True)
        firmware = Path(folder) / "firmware"
        return _measure(chosen, firmware / "build/budget", firmware, strict=False)


def _report(
    args: argparse.Namespace,
    every: Sequence[Build],
    results: dict[str, snapshot.Result],
    complete: bool,
) -> int:
    if args.against:
        measured = [build for build in every if build.name in results]
        old = _revision(args.against, measured) if args.rebuild else snapshot.read_of(args.against)
        if not complete:
            old = {name: result for name, result in old.items() if name in results}
        for note in snapshot.differences(old, results, every=False)[1]:
            print(f"{note}; the figures may differ for that reason alone\n")
        print(report.changed(snapshot.changes(old, results), every, args.markdown))
    else:
        print(report.tables(every, results, args.markdown))
    problems = list(snapshot.broken(every, results))
    if args.write and not problems:
        snapshot.write(results, args.snapshot)
        if args.snapshot == snapshot.SNAPSHOT:
            report.TABLE.write_text(report.document(every, results))
    if args.check:
        problems += _differences(args, every, results, complete)
    for problem in problems:
        print(f"measure.py: {problem}", file=sys.stderr)
    if args.write and problems:
        print("measure.py: nothing is written while a limit is broken", file=sys.stderr)
    return 1 if problems else 0


def _differences(
    args: argparse.Namespace,
    every: Sequence[Build],
    results: dict[str, snapshot.Result],
    complete: bool,
) -> list[str]:
    """What the committed files say otherwise."""
    kept = snapshot.read(args.snapshot)
    found, notes = snapshot.differences(kept, results, complete)
    for note in notes:
        print(note)
    problems = []
    if found:
        print(f"\n{report.changed(found, every)}")
        problems.append(
            f"{args.snapshot.name} says otherwise: commit what `measure.py --write` makes of it"
        )
    if args.snapshot == snapshot.SNAPSHOT and args.budget == builds.BUDGET:
        table = report.TABLE.read_text() if report.TABLE.exists() else ""
        if table != report.document(every, kept):
            problems.append(f"{report.TABLE.name} does not show {args.snapshot.name}: --write it")
    return problems


if __name__ == "__main__":
    sys.exit(main())
