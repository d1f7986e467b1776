"""The kill matrix: which case fails for which mutant, as `matrix.json` keeps it.

What flows in: tables and outcomes. What flows out: rows, and what is wrong with them as sentences.
Rules: a mutant is killed when a case fails that names the requirement that the mutant breaks, and
by nothing else; `matrix.json` holds what failed each time, so that it can be compared.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Final

from j2a_spec import requirements
from j2a_spec.capabilities import ANNOUNCED

from conformance.mutants.tables import FOLDER, Mutant, Table

__all__ = [
    "MATRIX",
    "Row",
    "differences",
    "exceptions",
    "killers",
    "read",
    "row",
    "strangers",
    "uncovered",
    "write",
]

MATRIX: Final = FOLDER / "matrix.json"
_ROLES: Final = {"core": "device", "device": "device", "host": "host"}


@dataclass(frozen=True, slots=True)
class Row:
    """A mutant and what became of it.

    Attributes:
        id: of the mutant.
        requirement: id of the requirement that it breaks.
        what: what it does.
        files: the files that it changes.
        killed_by: ids of the cases that name the requirement and fail, the quickest first.
        also: ids of the other cases that fail.
    """

    id: str
    requirement: str
    what: str
    files: tuple[str, ...]
    killed_by: tuple[str, ...] = ()
    also: tuple[str, ...] = ()


def row(mutant: Mutant, killed_by: Iterable[str] = (), also: Iterable[str] = ()) -> Row:
    """Return the row of a mutant."""
    files = tuple(dict.fromkeys(edit.file for edit in mutant.edits))
    return Row(
        mutant.id, mutant.requirement, mutant.what, files, tuple(killed_by), tuple(sorted(also))
    )


def killers(
    requirement: str, failed: Iterable[str], cases: Mapping[str, Sequence[str]]
) -> frozenset[str]:
    """Return those of the failed cases that name the requirement."""
    return frozenset(name for name in failed if requirement in cases[name])


def uncovered(table: Table) -> list[str]:
    """Say where a requirement has neither mutant nor exception, or both, or does not bind."""
    found = []
    broken = {mutant.requirement for mutant in table.mutants}
    exempt = {entry.requirement for entry in table.exempt}
    known = requirements.load()
    for name in sorted(broken | exempt):
        if name not in known or known[name].role not in ("both", _ROLES[table.target]):
            found.append(f"{table.target}.toml: {name} is no requirement that binds it")
        elif name in broken and (name in exempt or known[name].exception):
            found.append(f"{table.target}.toml: {name} has both an exception and a mutant")
    for name, requirement in known.items():
        due = requirement.role in ("both", _ROLES[table.target]) and not requirement.exception
        if requirement.level in ANNOUNCED:  # the Python Device need not have such a part
            due = due and table.target != "device"
        if due and name not in broken | exempt:
            found.append(f"{table.target}.toml: {name} has neither a mutant nor an exception")
    return found


def differences(
    table: Table, rows: Mapping[str, Row], exceptions: Sequence[dict[str, str]]
) -> list[str]:
    """Say where the rows and the exceptions are not those of the table."""
    found = []
    for mutant in table.mutants:
        kept, due = rows.get(mutant.id), row(mutant)
        if kept is None or replace(kept, killed_by=(), also=()) != due:
            found.append(f"{mutant.id}: is not so in matrix.json; run kill.py --write")
        elif not kept.killed_by:
            found.append(f"{mutant.id}: survives, says matrix.json")
    if [entry for entry in exceptions if entry["target"] == table.target] != _exempt(table):
        found.append(
            f"{table.target}.toml: its exceptions are not so in matrix.json; run kill.py --write"
        )
    return found


def _exempt(table: Table) -> list[dict[str, str]]:
    """Return the exceptions of a table as `matrix.json` holds them."""
    return [{"target": table.target, **asdict(entry)} for entry in table.exempt]


def strangers(tables: Iterable[Table], rows: Iterable[str]) -> list[str]:
    """Say which rows belong to no mutant."""
    known = {mutant.id for table in tables for mutant in table.mutants}
    return [f"{name}: is in matrix.json and in no table" for name in rows if name not in known]


def read(path: Path) -> dict[str, Row]:
    """Return the rows of the file by the ids of their mutants."""
    entries = json.loads(path.read_text("utf-8"))["mutants"]
    lists = ("files", "killed_by", "also")
    rows = (Row(**entry | {key: tuple(entry[key]) for key in lists}) for entry in entries)
    return {row.id: row for row in rows}


def exceptions(path: Path) -> list[dict[str, str]]:
    """Return the exceptions of the file."""
    found: list[dict[str, str]] = json.loads(path.read_text("utf-8"))["exceptions"]
    return found


def write(tables: Sequence[Table], rows: Mapping[str, Row], path: Path) -> None:
    """Write the rows, each in a line, in the order of the tables, and the exceptions."""
    kept = [rows[m.id] for table in tables for m in table.mutants if m.id in rows]
    exempt = [entry for table in tables for entry in _exempt(table)]
    parts = (("mutants", [asdict(entry) for entry in kept]), ("exceptions", exempt))
    blocks = [
        f'"{name}": [\n' + ",\n".join(json.dumps(e, ensure_ascii=False) for e in entries) + "\n]"
        for name, entries in parts
    ]
    path.write_text("{" + ",\n".join(blocks) + "}\n", "utf-8")
