"""The tables of mutants: what is broken, where, and which rule it is.

What flows in: `core.toml`, `device.toml` and `host.toml`, and the sources. What flows out: `Table`
objects, and copies of the sources with the edits of one mutant. Rules: a mutant breaks one rule and
is an edit kept here, so that the sources show nothing of it; what an edit looks for occurs exactly
once. Nothing but Python is needed, because the Makefile of the firmware calls this.
"""

import re
import shutil
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

__all__ = [
    "ROOT",
    "TARGETS",
    "Edit",
    "Exempt",
    "Mutant",
    "Table",
    "TableError",
    "copy",
    "find",
    "load",
]

ROOT: Final = Path(__file__).resolve().parents[2]
FOLDER: Final = Path(__file__).resolve().parent

TARGETS: Final = {
    "core": ("firmware/Makefile", "firmware/core", "firmware/ports", "firmware/apps"),
    "device": ("j2a",),
    "host": ("j2a",),
}
"""What can be mutated, each with the files and folders that its edited copy is made of."""

_ID: Final = re.compile(r"(?P<target>[a-z]+)-(?P<rule>[a-z]+-\d{3})(-[a-z])?")


class TableError(Exception):
    """A table or one of its edits is wrong; the message names the entry."""


@dataclass(frozen=True, slots=True)
class Edit:
    """A change of one place in one file.

    Attributes:
        file: path in the repository.
        find: text that occurs exactly once there.
        replace: what stands there instead.
    """

    file: str
    find: str
    replace: str


@dataclass(frozen=True, slots=True)
class Mutant:
    """A broken implementation.

    Attributes:
        id: the target, then the requirement in lower case, then -b, -c for further ones.
        requirement: id of the one rule that it breaks.
        what: what it does, as a sentence without a full stop.
        edits: what makes it.
        port: for the C core, the port that it is built for.
        app: for the C core, the application.
        options: for the C core, build options such as "-DJ2A_WITH_MAPPING=0"; for the
            Python Device, arguments of its demo such as "room=119".
        program: for the host library, the host program, "client" or "aio", in conformance/hosts.
    """

    id: str
    requirement: str
    what: str
    edits: tuple[Edit, ...]
    port: str = "posix"
    app: str = "demo"
    options: str = ""
    program: str = "client"


@dataclass(frozen=True, slots=True)
class Exempt:
    """A requirement that no mutant of this target can break observably, and why."""

    requirement: str
    why: str


@dataclass(frozen=True, slots=True)
class Table:
    """The mutants of one target."""

    target: str
    mutants: tuple[Mutant, ...]
    exempt: tuple[Exempt, ...]


def load(target: str) -> Table:
    """Read the table of a target.

    Raises:
        TableError: it breaks a rule.
    """
    path = FOLDER / f"{target}.toml"
    try:
        entries = tomllib.loads(path.read_text("utf-8"))
        mutants = tuple(_mutant(target, entry) for entry in entries.pop("mutant"))
        exempt = tuple(Exempt(**entry) for entry in entries.pop("exception", []))
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise TableError(f"{path.name}: {error!r}") from error
    if entries:
        raise TableError(f"{path.name}: it holds mutant and exception, not {', '.join(entries)}")
    ids = [mutant.id for mutant in mutants]
    if twice := {name for name in ids if ids.count(name) > 1}:
        raise TableError(f"{path.name}: used twice: {', '.join(sorted(twice))}")
    return Table(target, mutants, exempt)


def _mutant(target: str, entry: dict[str, Any]) -> Mutant:
    edits = entry.pop("edits", [])
    if "find" in entry:
        edits = [{key: entry.pop(key) for key in ("file", "find", "replace")}, *edits]
    mutant = Mutant(edits=tuple(Edit(**edit) for edit in edits), **entry)
    match = _ID.fullmatch(mutant.id)
    if match is None or match["target"] != target:
        raise ValueError(f"{mutant.id}: an id is like {target}-stuff-004 or {target}-stuff-004-b")
    if mutant.requirement != f"J2A-{match['rule'].upper()}":
        raise ValueError(f"{mutant.id}: the id does not name {mutant.requirement}")
    if not mutant.edits:
        raise ValueError(f"{mutant.id}: it changes nothing")
    return mutant


def find(name: str) -> tuple[Mutant, str]:
    """Return the mutant with this id and its target.

    Raises:
        TableError: there is none.
    """
    target = name.partition("-")[0]
    if target in TARGETS:
        for mutant in load(target).mutants:
            if mutant.id == name:
                return mutant, target
    raise TableError(f"{name} is not in the tables of {FOLDER}")


def copy(target: str, mutant: Mutant | None, folder: Path) -> None:
    """Copy the sources of a target into a new folder, with the edits of a mutant if there is one.

    Raises:
        TableError: an edit does not fit the sources.
    """
    for name in TARGETS[target]:
        source, copied = ROOT / name, folder / name
        copied.parent.mkdir(parents=True, exist_ok=True)
        if source.is_dir():
            # With the times, and what was compiled already.
            shutil.copytree(source, copied, ignore=shutil.ignore_patterns("tests"))
        else:
            shutil.copy2(source, copied)
    for edit in mutant.edits if mutant else ():
        _apply(mutant.id if mutant else "", edit, folder)


def _apply(name: str, edit: Edit, folder: Path) -> None:
    path = folder / edit.file
    if not path.is_file():
        raise TableError(f"{name}: {edit.file} is no file of this target")
    text = path.read_text("utf-8")
    if (count := text.count(edit.find)) != 1:
        raise TableError(f"{name}: {edit.find!r} occurs {count} times in {edit.file}, not once")
    if edit.replace == edit.find:
        raise TableError(f"{name}: an edit changes nothing")
    path.write_text(text.replace(edit.find, edit.replace), "utf-8")
