"""Proves that the suite notices: `python conformance/mutants/kill.py`.

What flows in: the tables, and `matrix.json`. What flows out: what each mutant was killed by, and an
exit code: 0 when each of them was; with `--dimensions` the same for the generated mutants of
`dimensional`, of which nothing is kept. Rules: the targets without a mutant pass the same cases in
the same run, else a failure would prove nothing; a mutant that survives, and a requirement without
mutant or exception, are each a failure; so is a run in which there was nothing to judge. To save
time a mutant that `matrix.json` knows is judged first by the cases that kill it there, the quickest
first, and one is enough. Only when none of them fails, all cases of the rule are done, twice if
need be: a stall of this machine may hide one kill, so a kill that does not come is a mere note.
With `--changed` a mutant is left out as long as nothing that its verdict depends on has changed
since it was killed, see `judged`; a sample of these is judged nevertheless.
"""

import argparse
import sys
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from multiprocessing import get_context

from conformance.mutants import dimensional, judged, matrix
from conformance.mutants.matrix import Row
from conformance.mutants.tables import TARGETS, Mutant, Table, TableError, load
from conformance.mutants.targets import (
    Job,
    Outcome,
    Variant,
    cases,
    judge,
    needing_start,
    prepare,
    variant,
)

__all__ = ["main"]

_JOBS = 3  # both cores of a runner; most mutants wait most of the time
_BASELINES = 3  # a stall of this machine may spoil one run of the unmutated target, not all


@dataclass
class Found:
    """What the jobs have shown.

    Attributes:
        outcomes: of the mutants, by id.
        problems: what is wrong.
        unproven: the variants whose unmutated target did not pass, so that no kill there counts.
    """

    outcomes: dict[str, Outcome] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)
    unproven: set[Variant] = field(default_factory=set)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit code."""
    parser = _parser()
    args = parser.parse_args(argv)
    if args.sample and not args.dimensions:
        parser.error("--sample is for --dimensions")
    if args.dimensions and (args.write or args.record or args.changed):
        parser.error("--dimensions keeps nothing: leave out --write, --record and --changed")
    try:
        if args.dimensions:
            return _dimensions(args)
        tables = [load(target) for target in TARGETS]
        every = _chosen(tables, args.target, args.only)
    except TableError as error:
        print(f"kill.py: {error}", file=sys.stderr)
        return 1
    known = matrix.MATRIX.exists()
    kept = matrix.read(matrix.MATRIX) if known else {}
    kills = judged.read(judged.JUDGED)
    judged.freeze()
    chosen = [
        (target, mutant)
        for target, mutant in every
        if not args.changed or judged.is_due(target, mutant, kills, cases(target))
    ]
    found = _judge_all(chosen, kept, args)
    problems = found.problems
    rows = {
        mutant.id: _row(target, mutant, found.outcomes[mutant.id].failed)
        for target, mutant in chosen
        if mutant.id in found.outcomes
    }
    if not args.write:
        for note in _not_seen(rows, kept, found):
            print(note)
    else:
        kept = kept | rows
        matrix.write(tables, kept, matrix.MATRIX)
        known = True
    if args.write or args.record:
        for target, mutant in chosen:
            row = rows.get(mutant.id)
            if row and row.killed_by and variant(target, mutant) not in found.unproven:
                killed_by = row.killed_by[0]
                kills[mutant.id] = killed_by, judged.digest(target, mutant, killed_by)
        judged.write(judged.JUDGED, kills, (m.id for table in tables for m in table.mutants))
    if not args.only:
        exceptions = matrix.exceptions(matrix.MATRIX) if known else []
        for table in tables:
            if not args.target or table.target in args.target:
                problems += matrix.uncovered(table)
                problems += matrix.differences(table, kept, exceptions)
        problems += matrix.strangers(tables, kept)
    killed = [row for row in rows.values() if row.killed_by]
    problems += [f"{row.id}: survives" for row in rows.values() if not row.killed_by]
    for problem in problems:
        print(problem)
    print(f"{len(chosen)} mutants, {len(killed)} killed")
    if args.changed:
        print(f"{len(every) - len(chosen)} more are as they were when they were killed")
    return 1 if problems or not every or len(killed) != len(chosen) else 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="kill.py", description="Judges every mutant by the suite."
    )
    parser.add_argument(
        "--only", nargs="+", metavar="MUTANT", help="only these mutants, by their ids"
    )
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
        "--changed",
        action="store_true",
        help="only mutants whose verdict may have changed since judged.json, and a sample",
    )
    parser.add_argument(
        "--record", action="store_true", help="write judged.json: what was killed by these sources"
    )
    parser.add_argument(
        "-j", "--jobs", type=_count, default=_JOBS, metavar="N", help=f"mutants at a time ({_JOBS})"
    )
    parser.add_argument(
        "--dimensions",
        action="store_true",
        help="the generated mutants, which break a rule only under a condition",
    )
    parser.add_argument(
        "--sample", type=_count, metavar="N", help="with --dimensions: so many of each target"
    )
    parser.add_argument("--seed", type=int, default=0, help="of the sample (0)")
    parser.add_argument("-v", "--verbose", action="store_true", help="show each mutant as it ends")
    return parser


def _dimensions(args: argparse.Namespace) -> int:
    """Judge the dimensional mutants, all or a sample; return the exit code."""
    chosen = []
    for target in args.target or dimensional.TARGETS:
        mutants = dimensional.generate(target)
        if args.only:
            mutants = [mutant for mutant in mutants if any(map(mutant.id.startswith, args.only))]
        if args.sample:
            mutants = dimensional.sample(mutants, args.sample, args.seed)
        chosen += [(target, mutant) for mutant in mutants]
    args.all_cases = False
    known = matrix.read(matrix.MATRIX) if matrix.MATRIX.exists() else {}
    found = _judge_all(chosen, _likely(chosen, known), args)
    killed = [
        m.id
        for target, m in chosen
        if m.id in found.outcomes
        and matrix.killers(m.requirement, found.outcomes[m.id].failed, cases(target))
    ]
    problems = [f"{m.id}: survives: {m.what}" for _, m in chosen if m.id not in killed]
    for problem in found.problems + problems:
        print(problem)
    print(f"{len(chosen)} dimensional mutants, {len(killed)} killed")
    return 1 if found.problems or problems or not chosen else 0


def _likely(chosen: Iterable[tuple[str, Mutant]], rows: dict[str, Row]) -> dict[str, Row]:
    """Return rows for mutants that `matrix.json` does not have: first what kills their like.

    Both parts are in the order of the suite, and so is all of a rule with a case that needs a
    device on which no other was done.
    """
    found = {}
    for target, mutant in chosen:
        like = [row for row in rows.values() if row.requirement == mutant.requirement]
        naming = matrix.killers(mutant.requirement, cases(target), cases(target))
        first = {name for row in like for name in row.killed_by[:3]}
        if not needing_start(target).isdisjoint(naming):
            first.update(naming)
        ordered = [name for name in cases(target) if name in naming]
        found[mutant.id] = matrix.row(mutant, sorted(ordered, key=lambda name: name not in first))
    return found


def _count(text: str) -> int:
    """Return a number of at least 1; argparse turns a ValueError into an error of the usage."""
    if (count := int(text)) < 1:
        raise argparse.ArgumentTypeError(f"{text} is too few, 1 is the least")
    return count


def _chosen(
    tables: Iterable[Table], targets: Sequence[str] | None, only: Sequence[str] | None
) -> list[tuple[str, Mutant]]:
    every = [(table.target, mutant) for table in tables for mutant in table.mutants]
    chosen = [(target, mutant) for target, mutant in every if not targets or target in targets]
    if only is None:
        return chosen
    if unknown := set(only) - {mutant.id for _, mutant in every}:
        raise TableError(f"no such mutant: {', '.join(sorted(unknown))}")
    if others := set(only) - {mutant.id for _, mutant in chosen}:
        raise TableError(f"--target leaves out {', '.join(sorted(others))}")
    return [(target, mutant) for target, mutant in chosen if mutant.id in only]


def _jobs(
    chosen: Iterable[tuple[str, Mutant]], kept: dict[str, Row], every: bool, quick: bool
) -> Iterator[Job]:
    for target, mutant in chosen:
        known = cases(target)
        if every:
            named = tuple(known)
        elif mutant.id in kept and kept[mutant.id].killed_by:
            named = kept[mutant.id].killed_by
        else:
            named = tuple(sorted(matrix.killers(mutant.requirement, known, known)))
        yield Job(variant(target, mutant), mutant, named, every, quick)


def _judge_all(
    chosen: Sequence[tuple[str, Mutant]], kept: dict[str, Row], args: argparse.Namespace
) -> Found:
    """Judge the mutants, and the targets without one by all cases that were of use."""
    found = Found()
    jobs = list(_jobs(chosen, kept, args.all_cases or args.write, args.dimensions))
    prepare(job.how for job in jobs)
    passed: defaultdict[Variant, set[str]] = defaultdict(set)
    for job in jobs:
        passed[job.how].update(job.cases)
    with ProcessPoolExecutor(args.jobs, get_context("spawn")) as pool:
        _all(pool, [*_unmutated(passed), *jobs], found, args.verbose)
        # Where no kill that was known came, more cases were done.
        more: defaultdict[Variant, set[str]] = defaultdict(set)
        for job in jobs:
            if job.mutant and job.mutant.id in found.outcomes:
                more[job.how] |= found.outcomes[job.mutant.id].tried - passed[job.how]
        _all(pool, _unmutated(more), found, args.verbose)
    return found


def _unmutated(used: dict[Variant, set[str]]) -> list[Job]:
    return [Job(how, None, tuple(sorted(names))) for how, names in used.items() if names]


def _all(pool: ProcessPoolExecutor, jobs: Iterable[Job], found: Found, verbose: bool) -> None:
    """Do the jobs, side by side."""
    waiting = {pool.submit(_do, job): job for job in jobs}
    for done in as_completed(waiting):
        error = done.exception()
        outcome = Outcome(trouble=repr(error)) if error else done.result()
        _note(waiting[done], outcome, found, verbose)


def _do(job: Job) -> Outcome:
    for _ in range(1 if job.mutant else _BASELINES):
        outcome = judge(job)
        if not outcome.failed and not outcome.trouble:
            break
    return outcome


def _note(job: Job, outcome: Outcome, found: Found, verbose: bool) -> None:
    name = job.mutant.id if job.mutant else f"unmutated {job.how}"
    if verbose:
        print(f"{name}: {outcome.trouble or ', '.join(outcome.failed) or 'nothing failed'}")
        sys.stdout.flush()
    if job.mutant is None and (outcome.trouble or outcome.failed):
        found.unproven.add(job.how)
    if outcome.trouble:
        found.problems.append(f"{name}: {outcome.trouble}")
    elif job.mutant:
        found.outcomes[job.mutant.id] = outcome
    elif outcome.failed:
        found.problems.append(f"{name}: fails {', '.join(sorted(outcome.failed))}")


def _row(target: str, mutant: Mutant, failed: Sequence[str]) -> Row:
    named = matrix.killers(mutant.requirement, failed, cases(target))
    killed_by = [name for name in failed if name in named]
    return matrix.row(mutant, killed_by, set(failed) - named)


def _not_seen(rows: dict[str, Row], kept: dict[str, Row], found: Found) -> list[str]:
    """Say which kills of `matrix.json` did not come, though the mutant is killed."""
    return [
        f"note: {name}: {case} kills it, says matrix.json; not seen this time"
        for name, row in rows.items()
        if name in kept and row.killed_by
        for case in kept[name].killed_by
        if case in found.outcomes[name].tried and case not in row.killed_by
    ]


if __name__ == "__main__":
    sys.exit(main())
