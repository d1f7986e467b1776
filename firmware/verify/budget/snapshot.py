"""The committed figures, and what differs from them.

In: what was measured, and snapshot.json of this or another revision. Out: the file, and lines that
say what is wrong or what has changed. Rule: the file is sorted and has one figure a line, so that
a pull request shows each change; figures of another compiler than the snapshot's are held to the
limits alone.
"""

import json
import subprocess
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from firmware.verify.budget.builds import METRICS, BudgetError, Build

__all__ = [
    "SNAPSHOT",
    "Change",
    "Result",
    "broken",
    "changes",
    "differences",
    "read",
    "read_of",
    "write",
]

SNAPSHOT = Path(__file__).with_name("snapshot.json")


@dataclass(frozen=True, slots=True)
class Result:
    """What a build takes.

    Attributes:
        compiler: its name and version, and the linker's.
        figures: metric -> bytes, cycles or instructions.
    """

    compiler: str
    figures: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Change:
    """A figure that is not what it was; None where the build or the figure was or is not there."""

    build: str
    metric: str
    old: float | None
    new: float | None


def _number(value: float) -> float:
    rounded = round(value, 1)
    return int(rounded) if rounded == int(rounded) else rounded


def write(results: Mapping[str, Result], path: Path = SNAPSHOT) -> None:
    """Write what was measured."""
    table = {
        name: {"compiler": result.compiler}
        | {key: _number(result.figures[key]) for key in METRICS if key in result.figures}
        for name, result in sorted(results.items())
    }
    path.write_text(json.dumps(table, indent=1) + "\n")


def _parse(text: str | bytes, where: str) -> dict[str, Result]:
    try:
        table: dict[str, dict[str, float | str]] = json.loads(text)
        return {
            name: Result(
                str(entry["compiler"]),
                {key: float(entry[key]) for key in METRICS if key in entry},
            )
            for name, entry in table.items()
        }
    except (ValueError, KeyError, TypeError) as error:
        raise BudgetError(f"{where} is damaged: {error}; renew it: measure.py --write") from None


def read(path: Path = SNAPSHOT) -> dict[str, Result]:
    """Read the committed figures."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise BudgetError(f"{path.name}: {error.strerror}; make it: measure.py --write") from None
    return _parse(data, path.name)


def read_of(revision: str) -> dict[str, Result]:
    """The figures as another revision has committed them."""
    name = f"{revision}:./{SNAPSHOT.name}"
    done = subprocess.run(
        ["git", "show", name], cwd=SNAPSHOT.parent, capture_output=True, text=True, check=False
    )
    if done.returncode:
        lines = done.stderr.strip().splitlines() or ["git failed"]
        raise BudgetError(f"{lines[0]}; --rebuild measures that revision itself")
    return _parse(done.stdout, name)


def broken(builds: Iterable[Build], results: Mapping[str, Result]) -> Iterator[str]:
    """Every limit that is not kept."""
    for build in builds:
        if build.name not in results:
            continue
        for metric, limit in build.limit.items():
            value = results[build.name].figures.get(metric)
            if value is None:
                yield f"{build.name}: {METRICS[metric].title} has a limit and is not measured"
            elif value > limit:
                yield (
                    f"{build.name}: {METRICS[metric].title} is {_number(value)}, "
                    f"{_number(value - limit)} more than the {limit} that are allowed"
                )


def changes(old: Mapping[str, Result], new: Mapping[str, Result]) -> list[Change]:
    """Each figure that differs, in the order of the builds' names."""
    found = []
    for name in sorted(old.keys() | new.keys()):
        before = old[name].figures if name in old else {}
        after = new[name].figures if name in new else {}
        for metric in METRICS:
            was, now = before.get(metric), after.get(metric)
            was, now = (value if value is None else _number(value) for value in (was, now))
            if was != now:
                found.append(Change(name, metric, was, now))
    return found


def differences(
    kept: Mapping[str, Result], results: Mapping[str, Result], every: bool
) -> tuple[list[Change], list[str]]:
    """What the snapshot says otherwise, and notes about figures that cannot be compared.

    Args:
        kept: the snapshot.
        results: what was measured.
        every: whether all builds were; else only those that were are compared.
    """
    notes = []
    other = {
        name
        for name in kept.keys() & results.keys()
        if kept[name].compiler != results[name].compiler
    }
    for ours, theirs in sorted({(results[n].compiler, kept[n].compiler) for n in other}):
        notes.append(f"compiled by {ours}, the snapshot by {theirs}: only the limits count")
    names = (kept.keys() | results.keys()) if every else results.keys()
    chosen = names - other
    return (
        changes(
            {name: kept[name] for name in chosen & kept.keys()},
            {name: results[name] for name in chosen & results.keys()},
        ),
        notes,
    )
