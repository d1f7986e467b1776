"""Mutants that break a rule only under a condition: `kill.py --dimensions`.

What flows in: `dimensions/core.toml`, `device.toml` and `host.toml`: sites, edits that break a rule
wherever the placeholder GUARD holds, each with the expressions that are known there. What flows
out: a `Mutant` for each site and each condition on these expressions. Rules: the same tables give
the same mutants in the same order; a condition that cannot hold at a site is not in its table, or
it is excluded there with a reason.
"""

import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from random import Random
from typing import Any, Final

from conformance.mutants import tables
from conformance.mutants.tables import FOLDER, Edit, Mutant, TableError, edits_of

__all__ = ["Condition", "Excluded", "Site", "find", "generate", "read", "sample"]

TARGETS: Final = tuple(
    target for target in tables.TARGETS if (FOLDER / f"dimensions/{target}.toml").exists()
)
ABOVE: Final = (11, 31, 63, 64, 127, 128, 200, 254)
"""A rule is broken for lengths or at positions above one of these: limits of types, buffers."""
EXACT: Final = (0, 1, 2, 12, 33, 64, 100, 128, 200, 255)
"""A rule is broken for exactly one of these lengths."""
BYTES: Final = (0x00, 0x01, 0x11, 0x12, 0x41, 0x7C, 0x7D, 0x7F, 0x80, 0xEC, 0xED, 0xFE, 0xFF)
"""A rule is broken for one of these values of a field."""
COUNTS: Final = (1, 2, 3, 10)
"""A rule is broken only this time."""

_GUARD: Final = "GUARD"
_ID: Final = re.compile(r"(core|device|host)-([a-z]+-\d{3})(-[a-z])?")


@dataclass(frozen=True, slots=True)
class Condition:
    """When a rule is broken.

    Attributes:
        name: the part of an id behind "@".
        test: an expression of the target's language.
        text: the same in words.
        needs_state: the expression uses what the edits of the table's `state` keep.
    """

    name: str
    test: str
    text: str
    needs_state: bool = False


@dataclass(frozen=True, slots=True)
class Excluded:
    """Generated mutants that no case can kill: a pattern of ids, and why."""

    id: str
    why: str


@dataclass(frozen=True, slots=True)
class Site:
    """A place where a rule is broken while a condition holds.

    Attributes:
        id: as that of a mutant; the requirement is named by it.
        what: what the mutant does while the condition holds.
        edits: with GUARD in the place of the condition.
        length: an expression: the length that matters there.
        lengths: lengths that are possible there, the first and the last.
        position: an expression: where in the payload, from 0.
        last: the last position that is possible.
        kinds: expressions by name: which frames.
        fields: expressions by name: which field; crossed with `kinds`.
        values: expressions by name: bytes whose value is compared.
        only: the values that are meant, where not `BYTES`: a list, or one for each name.
        history: conditions on what came before are of use: how often, and `past`.
        past: the conditions of the table's `state` are of use.
        counts: the times that are of use.
        state: the edits of the table's `state` are needed in any case.
        settings: of the mutant: port, app, options, program.
    """

    id: str
    what: str
    edits: tuple[Edit, ...]
    length: str = ""
    lengths: tuple[int, int] = (0, 255)
    position: str = ""
    last: int = 255
    kinds: Mapping[str, str] = field(default_factory=dict)
    fields: Mapping[str, str] = field(default_factory=dict)
    values: Mapping[str, str] = field(default_factory=dict)
    only: Sequence[int] | Mapping[str, Sequence[int]] = BYTES
    history: bool = True
    past: bool = True
    counts: tuple[int, ...] = COUNTS
    state: bool = False
    settings: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class _State:
    """What is kept for conditions on the past: edits, and expressions by name."""

    edits: tuple[Edit, ...]
    tests: Mapping[str, str]


def generate(target: str) -> list[Mutant]:
    """Return the dimensional mutants of a target, without those that are excluded.

    Raises:
        TableError: the table breaks a rule.
    """
    sites, state, excluded = read(target)
    found = [mutant for site in sites for mutant in _mutants(target, site, state)]
    for entry in excluded:
        left = [mutant for mutant in found if not fnmatchcase(mutant.id, entry.id)]
        if len(left) == len(found):
            raise TableError(f"dimensions/{target}.toml: {entry.id} excludes nothing")
        found = left
    return found


def read(target: str) -> tuple[list[Site], _State, list[Excluded]]:
    """Read the table of a target.

    Raises:
        TableError: the table breaks a rule.
    """
    path = FOLDER / "dimensions" / f"{target}.toml"
    try:
        entries = tomllib.loads(path.read_text("utf-8"))
        state = entries.pop("state")
        edits = edits_of(state)
        sites = [_site(target, entry) for entry in entries.pop("site")]
        excluded = [Excluded(**entry) for entry in entries.pop("excluded", [])]
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise TableError(f"dimensions/{path.name}: {error!r}") from error
    ids = [site.id for site in sites]
    if twice := {name for name in ids if ids.count(name) > 1}:
        raise TableError(f"dimensions/{path.name}: used twice: {', '.join(sorted(twice))}")
    return sites, _State(edits, state), excluded


def _site(target: str, entry: dict[str, Any]) -> Site:
    edits = edits_of(entry)
    for name in ("lengths", "counts"):
        if name in entry:
            entry[name] = tuple(entry[name])
    site = Site(edits=edits, **entry)
    if not (match := _ID.fullmatch(site.id)) or match[1] != target:
        raise ValueError(f"{site.id}: an id is like {target}-stuff-004 or {target}-stuff-004-b")
    if not any(_GUARD in edit.replace for edit in site.edits):
        raise ValueError(f"{site.id}: no edit holds {_GUARD}")
    return site


def _mutants(target: str, site: Site, state: _State) -> Iterator[Mutant]:
    match = _ID.fullmatch(site.id)
    assert match is not None
    for condition in _conditions(target, site, state):
        edits = tuple(
            Edit(edit.file, edit.find, edit.replace.replace(_GUARD, f"({condition.test})"))
            for edit in site.edits
        )
        if condition.needs_state or site.state:
            edits += state.edits
        yield Mutant(
            id=f"{site.id}@{condition.name}",
            requirement=f"J2A-{match[2].upper()}",
            what=f"{site.what}, {condition.text}",
            edits=edits,
            **site.settings,
        )


def _conditions(target: str, site: Site, state: _State) -> Iterator[Condition]:
    """Return the conditions of a site: the product of what is known there and the dimensions."""
    yield from _of_lengths(site)
    if site.position:
        yield from _of_positions(target, site)
    yield from _of_kinds(target, site)
    for name, expression in site.values.items():
        for value in site.only[name] if isinstance(site.only, Mapping) else site.only:
            yield Condition(
                f"{name}-{value:02x}", f"{expression} == {value}", f"if {name} is 0x{value:02X}"
            )
    if site.history:
        for count in site.counts:
            yield Condition(f"time-{count}", _times(target, count), f"only the {count}. time")
        for name, test in state.tests.items() if site.past else ():
            yield Condition(name, test, f"only {name.replace('-', ' ')}", needs_state=True)


def _of_lengths(site: Site) -> Iterator[Condition]:
    if not site.length:
        return
    first, last = site.lengths
    for value in ABOVE:
        if first <= value < last:
            yield Condition(f"above-{value}", f"{site.length} > {value}", f"above {value} bytes")
    for value in EXACT:
        if first <= value <= last:
            yield Condition(f"length-{value}", f"{site.length} == {value}", f"with {value} bytes")


def _of_positions(target: str, site: Site) -> Iterator[Condition]:
    at, half, and_ = site.position, "/" if target == "core" else "//", _and(target)
    yield Condition("first", f"{at} == 0", "at the first byte")
    if site.length:
        size = site.length
        yield Condition(
            "middle", f"{size} > 2 {and_} {at} == {size} {half} 2", "at the byte in the middle"
        )
        yield Condition("last", f"{at} == {size} - 1", "at the last byte")
    for value in ABOVE:
        if value < min(site.lengths[1], site.last):
            yield Condition(f"behind-{value}", f"{at} > {value}", f"behind byte {value}")


def _of_kinds(target: str, site: Site) -> Iterator[Condition]:
    for name, test in {**site.kinds, **site.fields}.items():
        yield Condition(name, test, f"for {name}")
    for kind, test in site.kinds.items():
        for part, where in site.fields.items():
            yield Condition(
                f"{kind}-{part}", f"({test}) {_and(target)} ({where})", f"for {kind}, {part}"
            )


def _and(target: str) -> str:
    return "&&" if target == "core" else "and"


def _times(target: str, count: int) -> str:
    """Return an expression that is true only when it is evaluated for the n-th time."""
    if target == "core":
        return f"__extension__({{ static unsigned n; ++n == {count}; }})"
    counter = '__import__("sys").__dict__.setdefault("j2a_times", __import__("itertools").count(1))'
    return f"next({counter}) == {count}"


def find(name: str) -> tuple[Mutant, str]:
    """Return the generated mutant with this id and its target.

    Raises:
        TableError: there is none.
    """
    target = name.partition("-")[0]
    for mutant in generate(target) if target in TARGETS else ():
        if mutant.id == name:
            return mutant, target
    raise TableError(f"{name} is not generated by the tables of {FOLDER / 'dimensions'}")


def sample(mutants: Sequence[Mutant], count: int, seed: int) -> list[Mutant]:
    """Return so many of them, spread over the sites, the same ones for the same seed."""
    chooser = Random(seed)
    by_site: dict[str, list[Mutant]] = {}
    for mutant in chooser.sample(list(mutants), len(mutants)):
        by_site.setdefault(mutant.id.partition("@")[0], []).append(mutant)
    sites = chooser.sample(sorted(by_site), len(by_site))
    chosen: list[Mutant] = []
    while sites and len(chosen) < count:
        for site in list(sites):
            if len(chosen) == count:
                break
            chosen.append(by_site[site].pop())
            if not by_site[site]:
                sites.remove(site)
    return chosen
