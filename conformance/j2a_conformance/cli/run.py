"""`j2a-conform run`: judge a device.

What flows in: a URL or a testee file, and which cases. What flows out: reports, and an exit code.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import j2a_transports
from j2a_spec.capabilities import LEVELS

from j2a_conformance._coverage import coverage
from j2a_conformance._model import Result, Run
from j2a_conformance.device import _deviations
from j2a_conformance.device._case import Case
from j2a_conformance.device._run import run
from j2a_conformance.device._smoke import SMOKE
from j2a_conformance.device.cases import load
from j2a_conformance.reports import _console

from . import _cases, _reports, _target
from ._exit import CONFORMANT, UsageError, status
from ._output import show, show_progress
from ._repeat import repeat
from ._target import Target, reach

__all__ = ["add_arguments", "main"]

_LOSSY_ATTEMPTS = 100


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    command.description = (
        "Runs the conformance cases against the device behind URL. "
        "Exit code: 0 conformant, 1 a case failed, 2 a known deviation was not seen, 3 harness, "
        "link or arguments wrong, 4 nothing of what was asked for could be tested."
    )
    command.epilog = "URL: " + ", ".join(f"{scheme}:" for scheme in j2a_transports.schemes())
    command.add_argument(
        "url",
        nargs="?",
        metavar="URL",
        help="e.g. serial:///dev/ttyACM0?boot=2, or a testee file, see conformance/testees",
    )
    _reports.add_arguments(command)
    _cases.add_arguments(command, "many.*")
    command.add_argument(
        "--profile",
        choices=_deviations.profiles(),
        default=_deviations.STRICT,
        help="rules to judge the device by: this version (strict), or those of an older device",
    )
    command.add_argument(
        "--deviations",
        type=Path,
        metavar="FILE",
        help="a list of the known deviations of the device, in TOML",
    )
    _target.add_arguments(command)
    _add_claims(command)
    command.add_argument(
        "--lossy",
        type=int,
        nargs="?",
        const=_LOSSY_ATTEMPTS,
        metavar="N",
        help="the link itself loses or damages bytes: an exchange fails only when it does so in "
        f"each of N attempts ({_LOSSY_ATTEMPTS})",
    )
    command.add_argument(
        "--repeat",
        type=int,
        default=1,
        metavar="N",
        help="run N times and compare the verdicts; reports are of the last run",
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


def _add_claims(command: argparse.ArgumentParser) -> None:
    levels = LEVELS
    command.add_argument(
        "--claims",
        nargs="+",
        choices=levels,
        default=[],
        metavar="LEVEL",
        help="levels that the device is said to reach: a function that their cases need and that "
        f"it lacks is a failure, not unimplemented; of {', '.join(levels)}",
    )


def main(args: argparse.Namespace) -> int:
    """Carry the command out; return the exit code.

    Raises:
        HarnessError: nothing can be said about the device.
    """
    args.url = args.url or _cases.misplaced_url(args)
    # Every run begins with the smoke step; to ask for a case of it is no mistake.
    cases = _cases.matching((*SMOKE, *load()), args.level, args.case)
    if args.list:
        _cases.show_cases(cases, coverage())
        return CONFORMANT
    if not args.url:
        raise UsageError("a URL is needed, e.g. tcp://127.0.0.1:5000")
    _check(args)
    return _run(args, cases)


def _check(args: argparse.Namespace) -> None:
    _target.check(args)
    if args.lossy is not None and not 2 <= args.lossy <= 10_000:
        raise UsageError("--lossy takes a number from 2 to 10000, or none")
    if args.repeat < 1:
        raise UsageError("--repeat takes a number of at least 1")


def _run(args: argparse.Namespace, cases: Sequence[Case]) -> int:
    reports = _reports.Reports(args)
    known = _deviations.read(args.deviations) if args.deviations else ()
    with reach(args.url, args.baud or 0) as target:
        if target.levels and args.level is None and args.case is None:
            cases = _cases.matching(cases, target.levels, None)
        rules = _deviations.Rules.of_profile(args.profile, _deviations.joined(target.known, known))
        if args.repeat == 1:
            found = _judge(target, rules, args, cases, reports)
            code = status(found)
        else:
            found, code = repeat(args.repeat, lambda: _judge(target, rules, args, cases, reports))
    try:
        show(_console.report(found), flush=True)
    finally:  # also if the reader of the output has closed it
        reports.write(found)
    return code


def _judge(
    target: Target,
    rules: _deviations.Rules,
    args: argparse.Namespace,
    cases: Sequence[Case],
    reports: _reports.Reports,
) -> Run:
    def tell(result: Result) -> None:
        if args.verbose:
            show_progress(_console.line(result), must_end=reports.is_asked)

    return run(
        target.opener,
        cases,
        url=target.url,
        title=target.title,
        rules=rules,
        timeout_scale=args.timeout_scale,
        baud=args.baud or 0,
        lossy=args.lossy or 0,
        fresh=target.fresh or args.fresh,
        emulated=target.emulated,
        builtins_only=args.builtins_only,
        claimed={*target.claims, *args.claims},
        stop_on_failure=args.stop_on_failure,
        on_result=tell,
    )
