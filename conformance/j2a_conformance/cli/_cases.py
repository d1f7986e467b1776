"""Which cases run, and how: the options that all commands share that judge by cases.

What flows in: arguments. What flows out: the cases that they choose. Rules: what chooses nothing is
a mistake, also beside what does.
"""

import argparse
import sys
from collections.abc import Iterable, Sequence
from fnmatch import fnmatchcase
from typing import TypeVar

from j2a_spec.capabilities import LEVELS

from j2a_conformance._case import BaseCase
from j2a_conformance._model import HarnessError

from ._exit import UsageError
from ._output import show

__all__ = ["add_arguments", "matching", "misplaced_url", "show_cases"]

_Case = TypeVar("_Case", bound=BaseCase)


def add_arguments(command: argparse.ArgumentParser, example: str) -> None:
    """Declare the options.

    Args:
        command: the command that gets them.
        example: a pattern that matches some of its cases.
    """
    command.add_argument(
        "--level",
        nargs="+",
        action="extend",
        metavar="LEVEL",
        help="only cases of these levels: " + ", ".join(LEVELS),
    )
    command.add_argument(
        "--case",
        nargs="+",
        action="extend",
        metavar="ID",
        help=f"only these cases: ids, patterns like '{example}', or ids of requirements",
    )
    command.add_argument(
        "--list", action="store_true", help="show the cases and what they cover, and run nothing"
    )
    command.add_argument("--stop-on-failure", action="store_true", help="stop at the first failure")
    command.add_argument("-v", "--verbose", action="store_true", help="show each case as it ends")


def misplaced_url(args: argparse.Namespace) -> str:
    """Take the URL out of the values of `--level` and `--case`, which come before it; "" for none.

    These options take all the words that follow; a URL or a testee file is no level and no case.
    """
    for words in (args.level, args.case):
        for word in words or ():
            if ":" in word or word.endswith(".toml"):
                words.remove(word)
                return str(word)
    return ""


def matching(
    cases: Iterable[_Case], levels: Sequence[str] | None, patterns: Sequence[str] | None
) -> list[_Case]:
    """Return the cases of these levels that match one of these patterns; None means all.

    Those that run on demand have to be named by their id.

    Raises:
        HarnessError: nothing matches, or one of the patterns matches nothing.
        UsageError: there is no such level.
    """
    if unknown := set(levels or ()) - set(LEVELS):
        raise UsageError(f"there is no level {min(unknown)}; the levels are {', '.join(LEVELS)}")
    named = patterns or ()
    found = [
        case
        for case in cases
        if (levels is None or case.LEVEL in levels) and (not case.ON_DEMAND or case.ID in named)
    ]
    if patterns is not None:
        chosen = {p: [case for case in found if _matches(case, p)] for p in patterns}
        if missed := [pattern for pattern in chosen if not chosen[pattern]]:
            where = f" of the levels {', '.join(levels)}" if levels else ""
            raise HarnessError(f"no case{where} matches {missed[0]}; --list shows all")
        found = [case for case in found if any(case in some for some in chosen.values())]
    if not found:
        raise HarnessError("no case matches; --list shows all")
    return found


def _matches(case: BaseCase, pattern: str) -> bool:
    return any(fnmatchcase(name, pattern) for name in (case.ID, *case.REQUIREMENTS))


def show_cases(cases: Iterable[BaseCase], coverage: dict[str, str]) -> None:
    """Print the cases, and what covers each requirement."""
    for case in cases:
        show(f"{case.ID}  ({case.LEVEL})\n  {case.DESCRIPTION}\n  {' '.join(case.REQUIREMENTS)}")
    show()
    for name, by in coverage.items():
        show(f"{name}  {by}")
    sys.stdout.flush()
