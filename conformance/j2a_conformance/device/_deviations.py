"""Failures that are expected: profiles of older devices, and lists of known deviations.

What flows in: TOML tables `[[deviation]]`, each with `case` (an id, or several), `reason` (a
regular expression that is found in the reason of the failure) and `why` (words). What flows out:
`Rules`, which judge the results of a run. Rules: a failure that the profile has is NON_STRICT, and
need not occur; one that the list has is KNOWN_DEVIATION, and an entry whose case does not fail is
stale; every other failure stays one. A list with a mistake in it is refused as a whole.
"""

import re
import tomllib
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Final

from j2a_conformance._model import Evidence, HarnessError, Result, Verdict

from ._smoke import SMOKE
from .cases import load

__all__ = ["STRICT", "Deviation", "Rules", "joined", "parse", "profile", "profiles", "read"]

STRICT: Final = "strict"
_TABLE: Final = "deviation"
_PROFILES: Final = resources.files(__package__) / "profiles"


@dataclass(frozen=True, slots=True)
class Deviation:
    """A way in which a case may fail.

    Attributes:
        case: id of the case.
        reason: a regular expression that is found in the reason of the failure.
        why: what is behind it, in words.
    """

    case: str
    reason: str
    why: str


@dataclass(frozen=True, slots=True)
class Rules:
    """What failures a device is allowed, and which it is known to have.

    Attributes:
        profile: name of the profile.
        allowed: the deviations that the profile allows.
        known: the deviations that this device is known to have.
    """

    profile: str = STRICT
    allowed: tuple[Deviation, ...] = ()
    known: tuple[Deviation, ...] = ()

    @classmethod
    def of_profile(cls, name: str, known: tuple[Deviation, ...] = ()) -> "Rules":
        """Return the rules of a profile, by its name."""
        return cls(name, profile(name), known)

    def judge(self, result: Result) -> Result:
        """Return the result with its final verdict."""
        if result.verdict is not Verdict.FAILED:
            return result
        for entries, verdict in (
            (self.allowed, Verdict.NON_STRICT),
            (self.known, Verdict.KNOWN_DEVIATION),
        ):
            for entry in entries:
                if entry.case == result.case and re.search(entry.reason, result.reason):
                    seen = Evidence("note", result.duration_s * 1e3, text=f"seen: {result.reason}")
                    return replace(
                        result,
                        verdict=verdict,
                        reason=entry.why,
                        evidence=(*result.evidence, seen),
                    )
        for entry in self.known:
            if entry.case == result.case:
                reason = f"{result.reason}; known is another failure: {entry.why}"
                return replace(result, reason=reason)
        return result

    def stale(self, results: Iterable[Result], asked: Collection[str]) -> tuple[str, ...]:
        """Return what of the list of known deviations did not come true, in words.

        Args:
            results: of the whole run, judged.
            asked: ids of the cases that were asked for; entries of others are no matter.
        """
        found = {result.case: result for result in results}
        return tuple(_stale(self.known, found, asked))


def _stale(
    known: Iterable[Deviation], found: dict[str, Result], asked: Collection[str]
) -> Iterator[str]:
    for entry in known:
        if entry.case not in asked:
            continue
        result = found.get(entry.case)
        about = f"the known deviation of {entry.case} ({entry.why})"
        if result is None:
            yield f"{about} was not seen: the case was not run"
        elif result.verdict.passed:
            yield f"{about} is gone: the case is {result.verdict.value}; take it from the list"
        elif not result.verdict.judged:
            yield f"{about} was not seen: {result.verdict.value}, {result.reason}"


def read(path: Path) -> tuple[Deviation, ...]:
    """Read a list of known deviations, a TOML file.

    Raises:
        HarnessError: it cannot be read or has a mistake; the message says which.
    """
    try:
        return _document(path.read_text("utf-8"), str(path))
    except (OSError, UnicodeDecodeError) as error:
        raise HarnessError(f"{path} is no list of deviations: {error}") from error


def profiles() -> tuple[str, ...]:
    """Return the names of all profiles, the strict one first."""
    names = (Path(entry.name) for entry in _PROFILES.iterdir())
    return (STRICT, *sorted(name.stem for name in names if name.suffix == ".toml"))


def profile(name: str) -> tuple[Deviation, ...]:
    """Return what a profile allows; `name` is one of `profiles()`."""
    if name == STRICT:
        return ()
    return _document((_PROFILES / f"{name}.toml").read_text("utf-8"), name)


def _document(text: str, where: str) -> tuple[Deviation, ...]:
    try:
        found = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise HarnessError(f"{where} is no list of deviations: {error}") from error
    if others := set(found) - {_TABLE}:
        raise HarnessError(f"{where}: only [[{_TABLE}]] tables are known, not {min(others)}")
    return parse(found.get(_TABLE, []), where)


def parse(tables: object, where: str) -> tuple[Deviation, ...]:
    """Take the tables of a list apart; `where` is the list's name for messages.

    Raises:
        HarnessError: there is a mistake in one; the message says which.
    """
    if not isinstance(tables, list):
        raise HarnessError(f"{where}: deviations are [[{_TABLE}]] tables, with double brackets")
    return joined(*(_entries(table, where) for table in tables), where=where)


def joined(
    *lists: tuple[Deviation, ...], where: str = "the lists of deviations"
) -> tuple[Deviation, ...]:
    """Make one list of several; `where` is its name for messages.

    Raises:
        HarnessError: a case is in it twice.
    """
    entries = tuple(entry for entries in lists for entry in entries)
    cases = [entry.case for entry in entries]
    if twice := {case for case in cases if cases.count(case) > 1}:
        raise HarnessError(
            f"{where}: {min(twice)} is there twice; a case ends at its first failure, and one "
            "`reason` can hold several: 'this|that'"
        )
    return entries


def _entries(table: object, where: str) -> tuple[Deviation, ...]:
    if not isinstance(table, dict) or set(table) != {"case", "reason", "why"}:
        raise HarnessError(f"{where}: a deviation has `case`, `reason` and `why`, not {table}")
    cases = table["case"] if isinstance(table["case"], list) else [table["case"]]
    texts = (*cases, table["reason"], table["why"])
    if not cases or not all(isinstance(text, str) and text for text in texts):
        raise HarnessError(f"{where}: `case`, `reason` and `why` are texts, not empty: {table}")
    if unknown := set(cases) - {case.ID for case in (*SMOKE, *load())}:
        raise HarnessError(
            f"{where}: there is no case {min(unknown)}; `j2a-conform run --list` shows all"
        )
    try:
        re.compile(table["reason"])
    except re.error as error:
        raise HarnessError(f"{where}: the reason of {', '.join(cases)}: {error}") from error
    return tuple(Deviation(case, table["reason"], table["why"]) for case in cases)
