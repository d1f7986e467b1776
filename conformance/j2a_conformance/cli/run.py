"""`j2a-conform run`: judge a device.

What flows in: a URL or a testee file, and which cases. What flows out: reports, and an exit code.
"""

import argparse
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from fnmatch import fnmatchcase
from pathlib import Path
from typing import get_args

import j2a_transports
from j2a_spec.requirements import Level

from j2a_conformance import _console
from j2a_conformance._case import Case
from j2a_conformance._coverage import coverage
from j2a_conformance._model import HarnessError, Result, Run, Verdict
from j2a_conformance._runner import run
from j2a_conformance._smoke import SMOKE
from j2a_conformance._testee import load_testee
from j2a_conformance.cases import load

from . import _reports
from ._exit import CONFORMANT, FAILED, HARNESS, UsageError

__all__ = ["add_arguments", "main", "select"]

_FRESH = ("exec:", "pty:", "sim:")  # opening one of these starts the device


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    command.description = (
        "Runs the conformance cases against the device behind URL. "
        "Exit code: 0 conformant, 1 not, 3 harness, link or arguments wrong."
    )
    command.epilog = "URL: " + ", ".join(f"{scheme}:" for scheme in j2a_transports.schemes())
    command.add_argument(
        "url",
        nargs="?",
        metavar="URL",
        help="e.g. serial:///dev/ttyACM0?boot=2, or a testee file, see conformance/testees",
    )
    _reports.add_arguments(command)
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
        help="only these cases: ids, patterns like 'many.*', or ids of requirements",
    )
    command.add_argument(
        "--list", action="store_true", help="show the cases and what they cover, and run nothing"
    )
    command.add_argument(
        "--timeout-scale",
        type=float,
        default=1.0,
        metavar="X",
        help="multiply every wait for an answer, for slow links",
    )
    command.add_argument(
        "--fresh",
        action="store_true",
        help="opening the link resets the device: its first SIF has seq 0; so it is with exec:",
    )
    command.add_argument(
        "--builtins-only",
        action="store_true",
        help="do not use functions with the names of the demo application: they are something else",
    )
    command.add_argument("--stop-on-failure", action="store_true", help="stop at the first failure")
    command.add_argument("-v", "--verbose", action="store_true", help="show each case as it ends")


def main(args: argparse.Namespace) -> int:
    """Carry the command out; return the exit code.

    Raises:
        HarnessError: nothing can be said about the device.
    """
    cases = select(args.level, args.case)
    if args.list:
        _list(cases)
        return CONFORMANT
    if not args.url:
        raise UsageError("a URL is needed, e.g. tcp://127.0.0.1:5000")
    if not 0 < args.timeout_scale < 1000:
        raise UsageError("--timeout-scale takes a number above 0 and below 1000")
    return _run(args, cases)


def select(levels: Sequence[str] | None, patterns: Sequence[str] | None) -> list[Case]:
    """Return the cases of these levels that match one of these patterns; None means all.

    The cases of the smoke step are among them, though every run begins with it.

    Raises:
        HarnessError: nothing matches.
    """
    found = [case for case in (*SMOKE, *load()) if levels is None or case.LEVEL in levels]
    if patterns is not None:
        found = [
            case
            for case in found
            if any(fnmatchcase(name, p) for p in patterns for name in (case.ID, *case.REQUIREMENTS))
        ]
    if not found:
        raise HarnessError("no case matches; `j2a-conform run --list` shows all")
    return found


def _list(cases: Sequence[Case]) -> None:
    for case in cases:
        print(f"{case.ID}  ({case.LEVEL})\n  {case.DESCRIPTION}\n  {' '.join(case.REQUIREMENTS)}")
    print()
    for name, by in coverage().items():
        print(f"{name}  {by}")
    sys.stdout.flush()


def _run(args: argparse.Namespace, cases: Sequence[Case]) -> int:
    reports = _reports.Reports(args)
    with ExitStack() as running:
        url, fresh = args.url, args.fresh
        if url.endswith(".toml"):
            testee = load_testee(Path(url))
            url, fresh = running.enter_context(testee.started()), fresh or testee.fresh
        found = _judge(url, fresh, args, cases)
    try:
        print(_console.report(found), flush=True)
    finally:  # also where nobody reads the output
        reports.write(found)
    if found.with_verdict(Verdict.FAILED):
        return FAILED
    # An interrupted run has judged only a part, which is no proof of conformance.
    return HARNESS if found.stopped else CONFORMANT


def _judge(url: str, fresh: bool, args: argparse.Namespace, cases: Sequence[Case]) -> Run:
    def show(result: Result) -> None:
        if args.verbose:
            print(_console.line(result), flush=True)

    return run(
        lambda: j2a_transports.open(url),
        cases,
        url=url,
        timeout_scale=args.timeout_scale,
        fresh=fresh or url.startswith(_FRESH),
        builtins_only=args.builtins_only,
        stop_on_failure=args.stop_on_failure,
        on_result=show,
    )
