"""`j2a clock`: the clocks of boards beside that of this computer.

In: URLs of boards. Out: a line for each board: what sets its clock, its offset, rate, and the bound
of the error; with `--watch` again and again, with `--discipline` while it keeps the clocks right.
Rules: a board that is lost does not end the others; clocks are set only with `--discipline`.
"""

import argparse
import contextlib
import dataclasses
import time
from collections.abc import Sequence
from typing import Final

import j2a
from j2a.cli._exit import LINK, OK, error_facts, exit_code
from j2a.cli._link import (
    add_json_argument,
    add_link_options,
    connect,
    finite_seconds,
    whole_number,
)
from j2a.cli._output import note, show, show_json
from j2a.io.clock import MAX_PERIOD_S, ROUNDS, ClockKeeper
from j2a.io.clock_base import ClockReading

NOTES: Final = """\
examples:
  j2a clock tcp://127.0.0.1:5000
  j2a clock tcp://127.0.0.1:5000 tcp://127.0.0.1:5001 --discipline --watch
  j2a clock tcp://127.0.0.1:5000 --watch --json

offset is the time of the board less that of this computer; rate is by how much the counter of the
board runs too fast; uncertainty bounds the error of the offset, whatever the link did. A board with
sensors but without the capability clock can be read, not set."""
HEAD: Final = (
    "board                           state     epoch          offset        rate  uncertainty"
)
_S_US: Final = 1e6
_MOST_US: Final = 10 * _S_US
_WIDEST: Final = 30


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument(
        "urls", metavar="URL", nargs="+", help="a board, such as tcp://127.0.0.1:5000"
    )
    parser.add_argument(
        "--discipline",
        action="store_true",
        help="set the clocks by that of this computer, and keep them right until Ctrl-C",
    )
    parser.add_argument(
        "--watch", action="store_true", help="print them again each period, until Ctrl-C"
    )
    parser.add_argument(
        "--seconds", type=finite_seconds, metavar="N", help="end after N seconds; else by Ctrl-C"
    )
    parser.add_argument(
        "--period",
        type=_period,
        default=1.0,
        metavar="S",
        help=f"time between two rounds, in seconds, {MAX_PERIOD_S:g} at most (1)",
    )
    parser.add_argument(
        "--rounds",
        type=whole_number(1),
        default=ROUNDS,
        metavar="N",
        help=f"exchanges with each board before it is printed first ({ROUNDS})",
    )
    add_json_argument(parser, "a line for each board and round")
    add_link_options(parser)


def _period(text: str) -> float:
    value = finite_seconds(text)
    if value > MAX_PERIOD_S:
        raise argparse.ArgumentTypeError(f"must be at most {MAX_PERIOD_S:g}, not {text}")
    return value


def run(args: argparse.Namespace) -> int:
    """Ask the boards; returns the exit code."""
    with contextlib.ExitStack() as stack:
        boards = [stack.enter_context(connect(args, url)) for url in args.urls]
        if not args.discipline and not args.watch:
            return _once(boards, args)
        keepers = []
        for board in boards:
            with contextlib.suppress(j2a.J2AError):  # as the keeper tells
                board.clock.measure(args.rounds)
            keep = board.clock.discipline if args.discipline else board.clock.follow
            keepers.append(stack.enter_context(keep(args.period)))
        return _watch(boards, keepers, args)


def _once(boards: Sequence[j2a.Client], args: argparse.Namespace) -> int:
    code, failure = OK, None
    table = _Table(as_json=args.json)
    for board in boards:
        try:
            table.show(board.url, board.clock.measure(args.rounds))
        except j2a.J2AError as error:
            if len(boards) == 1:
                raise
            note(f"j2a: {board.url}: {error}")
            failure = error
            code = exit_code(error) or code
    if failure is not None and args.json:
        show_json({"error": error_facts(failure, code)})
    return code


def _watch(
    boards: Sequence[j2a.Client], keepers: Sequence[ClockKeeper], args: argparse.Namespace
) -> int:
    """Print until the end, by the time of the links; returns the exit code."""
    table = _Table(as_json=args.json)
    passed_s = 0.0
    last: dict[str, tuple[str, int]] = {}
    gone: set[str] = set()
    failed: set[str] = set()
    doubted: set[str] = set()
    while True:
        leader = next((board for board in boards if board.is_open), boards[0])
        begun_s = leader.now()
        for board, keeper in zip(boards, keepers, strict=True):
            if keeper.error is not None and not keeper.rounds and board.url not in failed:
                failed.add(board.url)  # once, whatever it answers each time
                note(f"j2a: {board.url}: no exchange has succeeded yet: {keeper.error}")
            if not board.is_open and board.url not in gone:
                gone.add(board.url)
                note(f"j2a: lost {board.url}")
            with contextlib.suppress(j2a.J2AError):  # nothing is known, or no more
                reading = _read(board, doubted)
                state = reading.state, reading.epoch
                if board.url not in gone and (args.watch or last.get(board.url) != state):
                    table.show(board.url, reading)
                    last[board.url] = state
        if len(gone) == len(boards):
            return LINK
        left_s = args.period
        if args.seconds is not None:
            left_s = min(left_s, args.seconds - passed_s - (leader.now() - begun_s))
        if left_s <= 0:
            never = [one.error for one in keepers if one.error is not None and not one.rounds]
            return LINK if gone else (exit_code(never[0]) or OK) if never else OK
        leader.clock._pause(left_s)
        passed_s += leader.now() - begun_s


def _read(board: j2a.Client, told: set[str]) -> ClockReading:
    """Read the clock of a board; tell once that it is no clock, as the table would just end."""
    try:
        return board.clock.read()
    except j2a.NoClock as error:
        if board.url not in told:
            told.add(board.url)
            note(f"j2a: {error}")
        raise


class _Table:
    """What is printed; the head comes with the first board that answers."""

    def __init__(self, *, as_json: bool) -> None:
        self._as_json = as_json
        self._has_head = as_json

    def show(self, url: str, reading: ClockReading) -> None:
        if self._as_json:
            facts = {
                key: round(value, 3) if isinstance(value, float) else value
                for key, value in dataclasses.asdict(reading).items()
            }
            show_json({"url": url, "time": round(time.time(), 6), **facts})
            return
        if not self._has_head:
            self._has_head = True
            show(HEAD)
        show(clock_line(url, reading), flush=True)


def clock_line(name: str, reading: ClockReading) -> str:
    """Return a line of the table."""
    return (
        f"{name:<{_WIDEST}}  {reading.state:<8}  {reading.epoch:>5}  "
        f"{offset_text(reading.offset_us):>14}  {reading.rate_ppb / 1000:>+8.3f} ppm  "
        f"{'+-' + time_text(reading.uncertainty_us):>10}"
    )


def offset_text(offset_us: float) -> str:
    """Return an offset: in microseconds, or in seconds where the clock was never set."""
    if abs(offset_us) >= _MOST_US:
        return f"{offset_us / _S_US:+.3f} s"
    return f"{offset_us:+.1f} us"


def time_text(us: float) -> str:
    """Return a time with the unit that suits it."""
    return f"{us:.1f} us" if us < 10_000 else f"{us / 1000:.1f} ms"
