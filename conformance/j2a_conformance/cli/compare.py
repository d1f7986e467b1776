"""`j2a-conform compare`: what changed from one run to another.

What flows in: two reports in JSON. What flows out: text, and an exit code.
"""

import argparse
from pathlib import Path

from j2a_conformance.reports import _compare, _json

from ._exit import CONFORMANT, FAILED, HARNESS, NOTHING
from ._output import show

__all__ = ["add_arguments", "main"]


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    command.description = (
        "Compares two runs: cases, levels and claims. A regression is a case with a worse verdict. "
        "Exit code: 0 no regression, 1 regressions, 3 a file is no report or the newer run ended "
        "early, 4 no case in common beside those that every run begins with."
    )
    command.add_argument("before", type=Path, metavar="A.json", help="older report of `run --json`")
    command.add_argument("after", type=Path, metavar="B.json", help="newer report of `run --json`")


def main(args: argparse.Namespace) -> int:
    """Carry the command out; return the exit code.

    Raises:
        HarnessError: a file is no report.
    """
    found = _compare.compare(_json.read(args.before), _json.read(args.after))
    show(_compare.report(found), flush=True)
    if found.regressions:
        return FAILED
    if found.lost:
        return HARNESS  # what was not judged may have become worse
    return CONFORMANT if found.compared else NOTHING
