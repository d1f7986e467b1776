"""`j2a sync`: what the daemon syncd does, and plots of it.

In: `status` or `plot`. Out: a table or JSON; an SVG file.
Rules: asks the daemon of this user first, then that of the system.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from j2a.cli._exit import LINK, OK, CommandFailed, UsageError
from j2a.cli._link import add_json_argument
from j2a.cli._output import show, show_json
from j2a.syncd.history import rounds_of
from j2a.syncd.plot import draw, panels_of
from j2a.syncd.singleton import NotRunning, ask, folders

NOTES = """\
examples:
  j2a sync status
  j2a sync status --json
  j2a sync plot -o clocks.svg"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("what", choices=("status", "plot"), help="show the boards, or plot them")
    parser.add_argument(
        "-o", "--output", type=Path, metavar="FILE.svg", help="where the plot goes, for plot"
    )
    add_json_argument(parser, "the status")


def run(args: argparse.Namespace) -> int:
    """Ask the daemon; returns the exit code."""
    if (args.what == "plot") != (args.output is not None):
        raise UsageError("plot takes -o FILE.svg, and status does not")
    if args.what == "plot":
        boards = rounds_of(_ask({"command": "history"}).get("boards", {}))
        try:
            args.output.write_text(draw("Clocks of J2A boards", panels_of(boards)), "utf-8")
        except OSError as error:
            raise UsageError(f"cannot write {args.output}: {error.strerror}") from None
        count = sum(map(len, boards.values()))
        show(f"wrote {args.output}: {count} rounds of {len(boards)} buses and boards")
        return OK
    status = _ask({"command": "status"})
    if args.json:
        show_json(status)
    else:
        _show(status)
    return OK


def _ask(request: dict[str, object]) -> dict[str, object]:
    errors = []
    for folder in folders():
        try:
            reply = ask(folder, request)
        except NotRunning as error:
            errors.append(str(error))
            continue
        if "error" in reply:
            raise CommandFailed(f"the daemon says: {reply['error']}", LINK)
        return reply
    raise CommandFailed("; ".join(errors), LINK)


def _show(status: dict[str, object]) -> None:
    show(
        f"daemon {status.get('pid')}, for {status.get('uptime_s')} s, steps: {status.get('steps')}"
    )
    boards = status.get("boards")
    if not isinstance(boards, list) or not boards:
        show("no boards")
        return
    show(f"{'board':<24} {'state':<10} {'offset':>12} {'rate':>12} {'uncertainty':>12} {'lost':>5}")
    for one in boards:
        show(
            f"{one['board']:<24} {one['state']:<10} {_number(one['offset_us'], 'us'):>12} "
            f"{_number(one['rate_ppb'], 'ppb'):>12} {_number(one['uncertainty_us'], 'us'):>12} "
            f"{one['lost']:>5}"
        )
        if one.get("problem"):
            show(f"  {one['problem']}")


def _number(value: object, unit: str) -> str:
    return f"{value:.0f} {unit}" if isinstance(value, int | float) else "-"
