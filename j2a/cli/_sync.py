"""`j2a sync`: shows the state of syncd, plots it, and checks whether clocks keep their bounds.

In: `status`, `plot` or `verify`. Out: a table or JSON; an SVG file.
Rules: asks the daemon of this user first, then that of the system; `verify` needs no daemon and is
in `_sync_verify`. Any program may be at the socket, so what it sends is checked before it is used.
"""

import argparse
import math
import time
from pathlib import Path
from typing import Final

from j2a_spec.plural import counted
from j2a_spec.printable import printable

from j2a.cli._exit import LINK, OK, TIMEOUT, CommandFailed, UsageError
from j2a.cli._files import write_file
from j2a.cli._link import (
    add_json_argument,
    add_link_options,
    finite_number,
    positive_number,
    whole_number,
)
from j2a.cli._output import show, show_json
from j2a.cli._sync_verify import verify
from j2a.syncd.history import MAX_BOARDS, Round, rounds_of
from j2a.syncd.numbering import SHORT
from j2a.syncd.plot import draw, panels_of
from j2a.syncd.singleton import OTHER_VERSION, NotRunning, ask_any

NOTES = """\
examples:
  j2a sync status
  j2a sync status --json
  j2a sync plot -o clocks.svg
  j2a sync verify usb://left usb://right --actuator lamp --sensor edge

verify lets the first board set its actuator to 1 at a given time; a wire leads from its pin to that
of a sensor of the second, which sends a sample with a time stamp for each edge. Printed are time
stamp less given time, and how far off the two boards say they can be. The exit code is 1 if an edge
is farther off."""

_HISTORY_S: Final = 60.0
"""For so long the daemon may take to tell the rounds of all boards."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument(
        "what",
        choices=("status", "plot", "verify"),
        help="show the boards, plot them, or check two clocks by a wire",
    )
    parser.add_argument(
        "urls",
        nargs="*",
        default=[],
        metavar="URL",
        help="for verify: the board that sets a pin, the referee",
    )
    parser.add_argument(
        "-o", "--output", type=Path, metavar="FILE.svg", help="where the plot goes, for plot"
    )
    add_json_argument(parser, "the status, the figures, or what was plotted,")
    group = parser.add_argument_group("verify")
    only_verify = [
        group.add_argument("--actuator", metavar="NAME", help="of the first board (the only one)"),
        group.add_argument("--sensor", metavar="NAME", help="of the referee (the only one)"),
        group.add_argument(
            "--count", type=whole_number(1), default=20, metavar="N", help="edges (%(default)s)"
        ),
        group.add_argument(
            "--delay",
            type=finite_number,
            default=0.0,
            metavar="US",
            help="known time from an order to its time stamp, in microseconds (0)",
        ),
        group.add_argument(
            "--bound",
            type=positive_number,
            metavar="US",
            help="what is allowed, in place of the sum of what is announced of both boards",
        ),
        group.add_argument(
            "--no-discipline",
            action="store_true",
            help="leave both clocks to who sets them, such as syncd",
        ),
    ]
    parser.set_defaults(only_verify=only_verify)
    add_link_options(parser)


def run(args: argparse.Namespace) -> int:
    """Ask the daemon, or the boards; returns the exit code."""
    if args.what != "verify" and args.urls:
        raise UsageError(f"{args.what} takes no URL")
    if (args.what == "plot") != (args.output is not None):
        raise UsageError(
            "plot needs -o FILE.svg"
            if args.what == "plot"
            else f"{args.what} takes no -o, only plot does"
        )
    if args.what == "verify":
        return verify(args)
    for option in args.only_verify:
        if getattr(args, option.dest) != option.default:
            name = option.option_strings[0]
            raise UsageError(f"{args.what} takes no {name}, only verify does")
    if args.what == "plot":
        boards = _history()
        plot = draw("Clocks of J2A boards", panels_of(boards))
        write_file(args.output, plot)
        count = sum(map(len, boards.values()))
        if args.json:
            rounds = {board: len(those) for board, those in boards.items()}
            show_json({"file": str(args.output), "rounds": rounds})
        else:
            show(f"wrote {args.output}: {counted(count, 'round')}, buses and boards: {len(boards)}")
        return OK
    status = _ask({"command": "status"})
    if args.json:
        show_json(status)
    else:
        _show(status)
    return OK


def _history() -> dict[str, list[Round]]:
    """Ask for the rounds of each board that has some.

    Raises:
        CommandFailed: the daemon sends something else, or takes too long.
    """
    deadline = time.monotonic() + _HISTORY_S
    history = {}
    try:
        names = [_text(one) for one in _list(_ask({"command": "history"})["boards"])]
        if len(names) > MAX_BOARDS:
            raise ValueError(f"it has {len(names)} boards")
        for name in names:
            if time.monotonic() >= deadline:
                raise CommandFailed(f"the history took longer than {_HISTORY_S:g} s", TIMEOUT)
            rounds = _ask({"command": "history", "board": name})["rounds"]
            history[printable(name)] = rounds_of(rounds)
    except (KeyError, TypeError, ValueError) as error:
        raise CommandFailed(
            f"the daemon sent no history ({error!r:.80}): {OTHER_VERSION}", LINK
        ) from None
    return history


def _list(value: object) -> list[object]:
    if not isinstance(value, list):
        raise TypeError(f"{value!r:.40} is no list")
    return value


def _text(value: object) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{value!r:.40} is no text")
    return value


def _count(value: object) -> int:
    if type(value) is not int:
        raise TypeError(f"{value!r:.40} is no integer")
    return value


def _ask(request: dict[str, object]) -> dict[str, object]:
    try:
        reply = ask_any(request)
    except NotRunning as error:
        raise CommandFailed(str(error), LINK) from None
    if "error" in reply:
        raise CommandFailed(f"the daemon says: {reply['error']!s:.500}", LINK)
    return reply


def _show(status: dict[str, object]) -> None:
    try:
        lines = _lines(status)
    except (KeyError, OverflowError, TypeError, ValueError) as error:
        raise CommandFailed(
            f"what the daemon told is no status ({error!r:.80}): {OTHER_VERSION}, or see what it "
            "told by --json",
            LINK,
        ) from None
    for line in lines:
        show(line)


def _lines(status: dict[str, object]) -> list[str]:
    """Return the table of a status.

    Raises:
        KeyError, OverflowError, TypeError, ValueError: it is none.
    """
    pid, uptime_s, steps = (_count(status[name]) for name in ("pid", "uptime_s", "steps"))
    lines = [f"daemon {pid}, for {uptime_s} s, steps: {steps}", *_problem_of(status)]
    boards = _list(status["boards"])
    if not boards:
        return [*lines, "no boards"]
    lines.append(
        f"{'board':<24} {'state':<10} {'offset':>12} {'rate':>12} {'uncertainty':>12} {'lost':>5}"
    )
    for one in boards:
        if not isinstance(one, dict):
            raise TypeError(f"{one!r:.40} is no board")
        lines.append(
            f"{_text(one['board']):<24} {_text(one['state']):<10} "
            f"{_number(one['offset_us'], 'us'):>12} {_number(one['rate_ppb'], 'ppb'):>12} "
            f"{_number(one['uncertainty_us'], 'us'):>12} {_count(one['lost']):>5}"
        )
        if one.get("frames_modulo") == SHORT:
            lines.append(f"  frames modulo {SHORT}")
        lines += _problem_of(one)
    return lines


def _problem_of(facts: dict[str, object]) -> list[str]:
    """Return the line about the problem of the daemon or of a board, none without one."""
    return [f"  {_text(facts['problem'])}"] if facts.get("problem") else []


def _number(value: object, unit: str) -> str:
    if value is None:
        return "-"
    if not isinstance(value, int | float) or isinstance(value, bool) or not math.isfinite(value):
        raise TypeError(f"{value!r:.40} is no number")
    return f"{value:.0f} {unit}"
