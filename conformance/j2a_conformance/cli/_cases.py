"""Which cases run, and how: the options that all commands share that judge by cases.

What flows in: arguments. What flows out: the cases that they choose.
"""

import argparse
import sys
from collections.abc import Iterable, Sequence
from fnmatch import fnmatchcase
from typing import TypeVar, get_args

from j2a_spec.requirements import Level

from j2a_conformance._case import About
from j2a_conformance._model import HarnessError

__all__ = ["add_arguments", "matching", "show"]

_Case = TypeVar("_Case", bound=About)


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
        choices=get_args(Level),
        metavar="LEVEL",
        help="only cases of these levels: " + ", ".join(get_args(Level)),
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


def matching(
    cases: Iterable[_Case], levels: Sequence[str] | None, patterns: Sequence[str] | None
) -> list[_Case]:
    """Return the cases of these levels that match one of these patterns; None means all.

    Raises:
        HarnessError: nothing matches.
    """
    found = [case for case in cases if levels is None or case.LEVEL in levels]
    if patterns is not None:
        found = [
            case
            for case in found
            if any(fnmatchcase(name, p) for p in patterns for name in (case.ID, *case.REQUIREMENTS))
        ]
    if not found:
        raise HarnessError("no case matches; --list shows all")
    return found


def show(cases: Iterable[About], coverage: dict[str, str]) -> None:
    """Print the cases, and what covers each requirement."""
    for case in cases:
        print(f"{case.ID}  ({case.LEVEL})\n  {case.DESCRIPTION}\n  {' '.join(case.REQUIREMENTS)}")
    print()
    for name, by in coverage.items():
        print(f"{name}  {by}")
    sys.stdout.flush()
