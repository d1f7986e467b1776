"""Proves that the suite notices: `python conformance/mutants/kill.py`.

What flows in: the tables, and `matrix.json`. What flows out: what each mutant was killed by, and an
exit code: 0 when each of them was. Rules: the targets without a mutant pass the same cases in the
same run, else a failure would prove nothing; a mutant that survives, a requirement without mutant
or exception, and a kill of `matrix.json` that does not come again are each a failure; so is a run
in which there was nothing to judge. To save time a mutant that `matrix.json` knows is judged only
by the cases that kill it there.
"""

import argparse
import sys
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from multiprocessing import get_context

import matrix
from matrix import Row
from tables import TARGETS, Mutant, Table, TableError, load
from targets import Job, Outcome, Variant, cases, judge, variant

__all__ = ["main"]

_BASELINES = 3  # a stall of this machine may spoil one run of the unmutated target, not all


@dataclass
class Found:
    """What the jobs have shown: cases that failed, by mutant, and what is wrong."""

    failed: dict[str, frozenset[str]] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit code."""
    args = _parser().parse_args(argv)
    try:
        tables = [load(target) for target in TARGETS]
        chosen = _chosen(tables, args.target, args.only)
    except TableError as error:
        print(f"kill.py: {error}", file=sys.stderr)
        return 1
    kept = matrix.read(matrix.MATRIX) if matrix.MATRIX.exists() else {}
    every = args.all_cases or args.write
    found = _judge_all(list(_jobs(chosen, {} if args.write else kept, every, args.write)), args)
    problems = found.problems
    rows = {
        mutant.id: _row(target, mutant, found.failed[mutant.id])
        for target, mutant in chosen
        if mutant.id in found.failed
    }
    if args.write:
        kept = kept | rows
        matrix.write(tables, kept, matrix.MATRIX)
    if not args.only:
        for table in tables:
            if not args.target or table.target in args.target:
                problems += matrix.uncovered(table) + matrix.differences(table, kept)
        problems += matrix.strangers(tables, kept)
    killed = [row for row in rows.values() if row.killed_by]
    problems += [f"{row.id}: survives" for row in rows.values() if not row.killed_by]
    problems += _missing(rows, kept)
    for problem in problems:
        print(problem)
    print(f"{len(chosen)} mutants, {len(killed)} killed")
    return 1 if problems or not killed or len(killed) != len(chosen) else 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="kill.py", description="Judges every mutant by the suite."
    )
    parser.add_argument("--only", nargs="+", metavar="ID", help="only these mutants")
    parser.add_argument("--target", nargs="+", choices=TARGETS, help="only mutants of these")
    parser.add_argument(
        "--all-cases", action="store_true", help="every case, not only those that kill"
    )
    parser.add_argument(
        "--write",
        action="store_true",
        help="write matrix.json: every case, and again those that fail",
    )
    parser.add_argument(
        "-j", "--jobs", type=int, default=4, metavar="N", help="mutants at a time (4)"
    )
    parser.add_argument("-v", "--verbose", action="store_true", help="show each mutant as it ends")
    return parser


def _chosen(
    tables: Iterable[Table], targets: Sequence[str] | None, only: Sequence[str] | None
) -> list[tuple[str, Mutant]]:
    every = [(t.target, m) for t in tables if not targets or t.target in targets for m in t.mutants]
    if only is None:
        return every
    if unknown := set(only) - {mutant.id for _, mutant in every}:
        raise TableError(f"no such mutant: {', '.join(sorted(unknown))}")
    return [(target, mutant) for target, mutant in every if mutant.id in only]


def _jobs(
    chosen: Iterable[tuple[str, Mutant]], kept: dict[str, Row], every: bool, twice: bool
) -> Iterator[tuple[Job, int]]:
    """Yield each job and how often it may be done: first the targets without a mutant."""
    jobs: list[Job] = []
    used: defaultdict[Variant, frozenset[str]] = defaultdict(frozenset)
    for target, mutant in chosen:
        due = frozenset(kept[mutant.id].killed_by if mutant.id in kept else ())
        known = cases(target)
        named = (
            frozenset(known) if every else due or matrix.killers(mutant.requirement, known, known)
        )
        jobs.append(Job(variant(target, mutant), mutant, named, due, twice))
        used[jobs[-1].how] |= named
    for how, named in used.items():
        yield Job(how, None, named), _BASELINES
    for job in jobs:
        yield job, 1


def _judge_all(jobs: Sequence[tuple[Job, int]], args: argparse.Namespace) -> Found:
    """Do the jobs, side by side."""
    found = Found()
    with ProcessPoolExecutor(args.jobs, get_context("spawn")) as pool:
        waiting = {pool.submit(_do, *job): job[0] for job in jobs}
        for done in as_completed(waiting):
            job, error = waiting[done], done.exception()
            outcome = Outcome(trouble=repr(error)) if error else done.result()
            _note(job, outcome, found, args.verbose)
    return found


def _do(job: Job, attempts: int) -> Outcome:
    for _ in range(attempts):
        outcome = judge(job)
        if not outcome.failed and not outcome.trouble:
            break
    return outcome


def _note(job: Job, outcome: Outcome, found: Found, verbose: bool) -> None:
    name = job.mutant.id if job.mutant else f"unmutated {job.how}"
    if verbose:
        print(f"{name}: {outcome.trouble or ', '.join(sorted(outcome.failed)) or 'nothing failed'}")
        sys.stdout.flush()
    if outcome.trouble:
        found.problems.append(f"{name}: {outcome.trouble}")
    elif job.mutant:
        found.failed[job.mutant.id] = outcome.failed
    elif outcome.failed:
        found.problems.append(f"{name}: fails {', '.join(sorted(outcome.failed))}")


def _row(target: str, mutant: Mutant, failed: frozenset[str]) -> Row:
    named = matrix.killers(mutant.requirement, failed, cases(target))
    return matrix.row(mutant, named, failed - named)


def _missing(rows: dict[str, Row], kept: dict[str, Row]) -> list[str]:
    """Say which kills of `matrix.json` did not come again."""
    return [
        f"{name}: {case} does not fail any more, as matrix.json says"
        for name, row in rows.items()
        if name in kept
        for case in kept[name].killed_by
        if case not in row.killed_by
    ]


if __name__ == "__main__":
    sys.exit(main())
