"""`j2a-conform host`: judge a host.

What flows in: the command of a host program, or a URL at which one is waited for, and which cases.
What flows out: reports, and an exit code.
"""

import argparse
import re
import shlex
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import j2a_transports
from j2a_transports import OpenFailed

from j2a_conformance._coverage import host_coverage
from j2a_conformance._model import Result, Run
from j2a_conformance.host import START, HostCase, Listening, Program, load, run
from j2a_conformance.reports import _console

from . import _cases, _reports
from ._exit import CONFORMANT, UsageError, status
from ._output import show, show_progress
from ._target import check_scale

__all__ = ["add_arguments", "main"]

_URL = re.compile(r"([a-z][a-z0-9]+):\S*")
_ANY_PORT = "tcp://127.0.0.1:0"
_START_S = 20.0


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    command.usage = "%(prog)s [options] (-- COMMAND ... | URL)"
    command.description = (
        "Plays a device and judges the host program that COMMAND starts, or that connects to URL. "
        "The program gets the address as its last argument, or in place of {url}. "
        "Exit code: 0 conformant, 1 a case failed, 3 the program does not start or the arguments "
        "are wrong, 4 nothing of what was asked for could be tested."
    )
    command.add_argument(
        "target",
        nargs="*",
        metavar="COMMAND",
        help="e.g. -- python conformance/hosts/client.py, or tcp://127.0.0.1:5000 to wait there",
    )
    _reports.add_arguments(command)
    _cases.add_arguments(command, "host.many.*")
    command.add_argument(
        "--timeout-scale",
        type=float,
        default=1.0,
        metavar="X",
        help="multiply every wait and every time limit that the host is given, for slow hosts",
    )
    command.add_argument(
        "--wait",
        type=float,
        default=300.0,
        metavar="S",
        help="seconds to wait at URL for the host to connect for the first time (300)",
    )


def main(args: argparse.Namespace) -> int:
    """Carry the command out; return the exit code.

    Raises:
        HarnessError: nothing can be said about the host.
    """
    if not args.target and (url := _cases.misplaced_url(args)):
        args.target = [url]
    cases = _cases.matching((START, *load(on_demand=True)), args.level, args.case)
    if args.list:
        _cases.show_cases(cases, host_coverage())
        return CONFORMANT
    if not args.target:
        raise UsageError("a host is needed, e.g. -- python conformance/hosts/client.py")
    check_scale(args.timeout_scale)
    if not 0 < args.wait < 1e6:
        raise UsageError("--wait takes a number above 0 and below 1000000")
    reports = _reports.Reports(args)
    with _place(args) as place:
        found = _judge(place, args, cases, reports)
    try:
        show(_console.report(found), flush=True)
    finally:  # also if the reader of the output has closed it
        reports.write(found)
    return status(found)


def _place(args: argparse.Namespace) -> Listening:
    if len(args.target) == 1 and (match := _URL.fullmatch(args.target[0])):
        able = _places()
        if match[1] not in able:
            where, example = " or ".join(f"{name}://" for name in able), next(iter(able.values()))
            raise UsageError(f"the suite waits for hosts at {where} only, e.g. {example}")
        return Listening(args.target[0], None, args.wait, _tell)
    return Listening(_ANY_PORT, Program(args.target), _START_S * args.timeout_scale)


def _places() -> dict[str, str]:
    """Return the schemes of places to wait at, where the host can connect again, and examples."""
    found = {}
    for name in j2a_transports.schemes():
        with suppress(OpenFailed):  # of another package: the other schemes work without it
            declared = j2a_transports.describe(name)
            if declared.accepts_again and declared.listen:
                found[name] = declared.listen.examples[0]
    return found


def _tell(url: str) -> None:
    show(f"Waiting for a host at {url}", flush=True)


def _judge(
    place: Listening,
    args: argparse.Namespace,
    cases: Sequence[HostCase],
    reports: _reports.Reports,
) -> Run:
    def tell(result: Result) -> None:
        if args.verbose:
            show_progress(_console.line(result), must_end=reports.is_asked)

    return run(
        place,
        cases,
        url=shlex.join(_shown(args.target)),
        timeout_scale=args.timeout_scale,
        stop_on_failure=args.stop_on_failure,
        on_result=tell,
    )


def _shown(words: Sequence[str]) -> list[str]:
    """Return the command as reports show it: without the places of this machine."""
    here = Path.cwd()
    program, *rest = (
        str(path.relative_to(here)) if (path := Path(word)).is_relative_to(here) else word
        for word in words
    )
    return [Path(program).name if Path(program).is_absolute() else program, *rest]
