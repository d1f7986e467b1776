"""The numbered requirements: reads `requirements.toml`.

What flows out: `Requirement` objects by id, in the order of SPEC.md. Rules: an id never changes its
meaning and is never used again; a requirement without `exception` has a conformance case. One that
was replaced stays in the file with `superseded_by`, behind the others, and binds no longer.
"""

import re
import tomllib
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Literal, get_args

from j2a_spec.capabilities import LEVELS

__all__ = ["Level", "Requirement", "Role", "load", "superseded"]

if TYPE_CHECKING:
    Level = str  # a checker of types cannot read the table
else:
    Level = Literal[LEVELS]
Role = Literal["device", "host", "both"]

_KEY_WORD = re.compile(r"\b(MUST|SHOULD|MAY)\b")
_ID = re.compile(r"J2A-(?P<area>[A-Z]+)-\d{3}")


@dataclass(frozen=True, slots=True)
class Requirement:
    """One normative sentence of the specification.

    Attributes:
        id: `J2A-AREA-NNN`.
        level: the level of conformance that it belongs to.
        role: whom it binds.
        source: section of the thesis, "observed" or "decision".
        text: the sentence.
        exception: why it cannot be observed on the wire, or "".
        superseded_by: id of the requirement that replaced it, or "" while it is in force.
    """

    id: str
    level: Level
    role: Role
    source: str
    text: str
    exception: str = ""
    superseded_by: str = ""

    @property
    def area(self) -> str:
        """The chapter of SPEC.md that it stands in: FRAME, STUFF, ..."""
        match = _ID.fullmatch(self.id)
        assert match is not None
        return match["area"]


def load() -> dict[str, Requirement]:
    """Return every requirement in force by its id, in the order of SPEC.md.

    Raises:
        ValueError: the file breaks its own rules; the message names the entry.
    """
    return {name: r for name, r in _read().items() if not r.superseded_by}


def superseded() -> dict[str, Requirement]:
    """Return the requirements that were replaced, by id; raises as `load`."""
    return {name: r for name, r in _read().items() if r.superseded_by}


@cache
def _read() -> dict[str, Requirement]:
    text = files("j2a_spec").joinpath("requirements.toml").read_text("utf-8")
    found: dict[str, Requirement] = {}
    for entry in tomllib.loads(text)["requirement"]:
        requirement = Requirement(**entry)
        if not _ID.fullmatch(requirement.id) or requirement.id in found:
            raise ValueError(f"requirement id {requirement.id!r} is malformed or used twice")
        if requirement.level not in get_args(Level) or requirement.role not in get_args(Role):
            raise ValueError(f"{requirement.id}: unknown level or role")
        if not _KEY_WORD.search(requirement.text):
            raise ValueError(f"{requirement.id}: no MUST, SHOULD or MAY in its text")
        found[requirement.id] = requirement
    for requirement in found.values():
        by = requirement.superseded_by
        if by and (by not in found or found[by].superseded_by):
            raise ValueError(f"{requirement.id}: {by!r}, which replaces it, is not in force")
    return found
