"""The tables of mutants: what is broken, where, and which rule it is.

What flows in: `core.toml`, `device.toml` and `host.toml`, and the sources. What flows out: `Table`
objects, and copies of the sources with the edits of one mutant. Rules: a mutant breaks one rule and
is an edit kept here, so that the sources show nothing of it; a table names a file by the end of its
path, as far as only one file of the targets has it; `anchors.py` finds exactly one place in it.
Nothing but Python is needed, because the Makefile of the firmware calls this.
"""

import re
import shutil
import tomllib
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

from conformance.mutants.anchors import AnchorError, Place, locate, names_of

__all__ = [
    "ROOT",
    "TARGETS",
    "Edit",
    "Exempt",
    "Mutant",
    "Table",
    "TableError",
    "changed",
    "copy",
    "edit_of",
    "edits_of",
    "find",
    "load",
    "place_of",
]

ROOT: Final = Path(__file__).resolve().parents[2]
FOLDER: Final = Path(__file__).resolve().parent

TARGETS: Final = {
    "core": ("firmware/Makefile", "firmware/core", "firmware/ports", "firmware/apps"),
    "device": ("j2a",),
    "host": ("j2a",),
}
"""What can be mutated, each with the files and folders that its edited copy is made of."""

_ID: Final = re.compile(r"(?P<target>[a-z]+)-(?P<rule>[a-z]+-\d{3})(-[a-z]{1,2})?")


class TableError(Exception):
    """A table or one of its edits is wrong; the message names the entry."""


@dataclass(frozen=True, slots=True)
class Edit:
    """A change of one place in one file.

    Attributes:
        file: path in the repository.
        find: text that stands for exactly one place there, see `anchors`.
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
        app: for the C core, the application; for the Python Device "demo", "transducers" or
            "clock".
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


def edit_of(entry: dict[str, str]) -> Edit:
    """Return the edit of an entry of a table."""
    return Edit(_path(entry["file"]), entry["find"], entry["replace"])


@cache
def _path(name: str) -> str:
    """Return the path in the repository of the file that a table calls `name`."""
    if (ROOT / name).is_file():
        return name
    folders = {ROOT / folder for sources in TARGETS.values() for folder in sources}
    found = [path.relative_to(ROOT) for folder in folders for path in folder.glob(f"**/{name}")]
    found = [path for path in found if "tests" not in path.parts]
    if len(found) != 1:
        raise TableError(f"{name} is {len(found)} files of the targets, not one")
    return found[0].as_posix()


def edits_of(entry: dict[str, Any]) -> tuple[Edit, ...]:
    """Take the edits out of an entry: its own one, and those of its list."""
    edits = [edit_of(edit) for edit in entry.pop("edits", [])]
    if "find" in entry:
        edits.insert(0, edit_of({key: entry.pop(key) for key in ("file", "find", "replace")}))
    return tuple(edits)


def _mutant(target: str, entry: dict[str, Any]) -> Mutant:
    mutant = Mutant(edits=edits_of(entry), **entry)
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
        path = folder / edit.file
        if not path.is_file():
            raise TableError(f"{_name(mutant)}: {edit.file} is no file of this target")
        path.write_text(changed(path.read_text("utf-8"), edit, _name(mutant)), "utf-8")


def changed(text: str, edit: Edit, name: str) -> str:
    """Return a source file with an edit of the mutant `name`.

    Raises:
        TableError: there is no one place for the edit.
    """
    if edit.replace == edit.find:
        raise TableError(f"{name}: an edit changes nothing")
    place = place_of(text, edit, name)
    return text[: place.start] + place.text(edit.find, edit.replace) + text[place.end :]


def place_of(text: str, edit: Edit, name: str) -> Place:
    """Return the place of an edit of the mutant `name` in its source file.

    Raises:
        TableError: there is no such place, or more than one.
    """
    known = _known_names(edit.file) if edit.find not in text else ()
    try:
        return locate(text, edit.find, is_python=edit.file.endswith(".py"), known=known)
    except AnchorError as error:
        raise TableError(f"{name}: {edit.file}: {error}") from error


@cache
def _known_names(file: str) -> frozenset[str]:
    """Return the names that the edits of a file look for."""
    found: set[str] = set()
    for target in TARGETS:
        for mutant in load(target).mutants:
            for edit in mutant.edits:
                if edit.file == file:
                    found |= names_of(edit.find, is_python=file.endswith(".py"))
    return frozenset(found)


def _name(mutant: Mutant | None) -> str:
    return mutant.id if mutant else ""
