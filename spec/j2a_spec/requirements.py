"""The numbered requirements: reads `requirements.toml`.

What flows out: `Requirement` objects by id, in the order of SPEC.md. Rules: an id never changes its
meaning and is never used again; a requirement without `exception` has a conformance case.
"""

import re
import tomllib
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Literal, get_args

__all__ = ["Level", "Requirement", "Role", "load"]

Level = Literal["frame", "core", "mapping", "many", "properties", "debug", "sif", "timing"]
Role = Literal["device", "host", "both"]

_ID = re.compile(r"J2A-(?P<area>[A-Z]+)-\d{3}")
_STRENGTH = re.compile(r"\b(MUST NOT|MUST|SHOULD|MAY)\b")


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
    """

    id: str
    level: Level
    role: Role
    source: str
    text: str
    exception: str = ""

    @property
    def area(self) -> str:
        """The chapter of SPEC.md that it stands in: FRAME, STUFF, ..."""
        match = _ID.fullmatch(self.id)
        assert match is not None
        return match["area"]

    @property
    def strength(self) -> str:
        """The strongest key word of the text: MUST, SHOULD or MAY."""
        words = {word.split()[0] for word in _STRENGTH.findall(self.text)}
        return next(word for word in ("MUST", "SHOULD", "MAY") if word in words)


@cache
def load() -> dict[str, Requirement]:
    """Return every requirement by its id, in the order of SPEC.md.

    Raises:
        ValueError: the file breaks its own rules; the message names the entry.
    """
    text = files("j2a_spec").joinpath("requirements.toml").read_text("utf-8")
    found: dict[str, Requirement] = {}
    for entry in tomllib.loads(text)["requirement"]:
        requirement = Requirement(**entry)
        if not _ID.fullmatch(requirement.id) or requirement.id in found:
            raise ValueError(f"requirement id {requirement.id!r} is malformed or used twice")
        if requirement.level not in get_args(Level) or requirement.role not in get_args(Role):
            raise ValueError(f"{requirement.id}: unknown level or role")
        if not _STRENGTH.search(requirement.text):
            raise ValueError(f"{requirement.id}: no MUST, SHOULD or MAY in its text")
        found[requirement.id] = requirement
    return found
