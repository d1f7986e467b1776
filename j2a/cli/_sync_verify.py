"""`j2a sync verify`: one board's edge on another board's input tells how well their clocks agree.

In: two boards with the capability `clock`, a wire from a pin of the first, the *driver*, to a pin
of the second, the *referee*. Out: the distribution of (time stamp of the referee - commanded time),
beside what both boards announce.
Rules: both times are those that the boards take for the time of the host, so nothing of the host is
in the difference; only edges to the level 1 count, so a referee may stamp both kinds or one; every
wait has a deadline.
"""

import argparse
import contextlib
import math
import statistics
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final
from urllib.parse import unquote

from j2a_spec.plural import counted

import j2a
from j2a.cli._exit import FAILED, OK, TIMEOUT, CommandFailed, UsageError
from j2a.cli._link import connect
from j2a.cli._output import note, show, show_json
from j2a.protocol.clock import ClockState, Status
from j2a.syncd.singleton import NotRunning, ask, folders

_LEADS_US: Final = (300_000, 600_000, 1_200_000, 2_400_000)
"""An order is given so long before its time, and again where that was too short."""
_EDGE_S: Final = 2.0
"""So long after the time of an order the referee has told the edge."""
_QUIET_S: Final = 0.1
"""The referee tells edges back to 0 within this time; then the next order is given."""
_NOISE_S: Final = 5.0
"""So long a referee may tell edges that nobody has ordered."""
_FIRST_ROUNDS: Final = 16
_LOOK_S: Final = 0.1
_LOCKED_S: Final = 30.0


@dataclass(frozen=True, slots=True)
class _Edge:
    """One edge.

    Attributes:
        error_us: time stamp of the referee less commanded time, less the known delay.
        bound_us: sum of the uncertainties of both clocks then.
    """

    error_us: float
    bound_us: float


def verify(args: argparse.Namespace) -> int:
    """Run it; returns the exit code: FAILED when an error is beyond what the boards announce."""
    if len(args.urls) != 2:
        raise UsageError("verify takes two URLs: the board that drives the wire, and the referee")
    with contextlib.ExitStack() as stack:
        driver, referee = boards = [stack.enter_context(connect(args, one)) for one in args.urls]
        actuator = _chosen(driver, args.actuator, "actuator")
        sensor = _chosen(referee, args.sensor, "sensor")
        for board in boards:
            board.clock.status()  # NoClock says what to do
        if not args.no_discipline:
            _sync(boards, _FIRST_ROUNDS)
        _wait_for_locked(boards, args)
        stack.enter_context(_enabled(sensor))
        edges = []
        for number in range(args.count):
            edge = _edge(boards, actuator, sensor, args, number)
            edges.append(edge)
            if not args.json:
                show(f"{number + 1:>5} {edge.error_us:>+12.1f} us {edge.bound_us:>10.1f} us")
    return _show(edges, args)


def _chosen(board: j2a.Client, name: str | None, kind: str) -> Any:
    """Return the transducer of that name and kind, or the only one of this kind without a name.

    Raises:
        UsageError: there is none, or more than one.
    """
    there = {
        one.name: one
        for one in board.transducers.values()
        if one.descriptor.is_sensor == (kind == "sensor")
    }
    names = ", ".join(there) or "none"
    if name is None:
        if len(there) != 1:
            raise UsageError(f"{board.url}: --{kind} NAME says which one: {names}")
        return next(iter(there.values()))
    if name not in there:
        raise UsageError(f"{board.url} has no {kind} {name!r:.40}; it has: {names}")
    return there[name]


def _sync(boards: list[j2a.Client], rounds: int = 1) -> None:
    """Set both clocks."""
    for board in boards:
        board.clock.sync(rounds)


def _wait_for_locked(boards: list[j2a.Client], args: argparse.Namespace) -> None:
    """Wait until both clocks are at their targets.

    Raises:
        CommandFailed: one is not in time.
    """
    for board in boards:
        end = board.now() + _LOCKED_S
        while (state := board.clock.status().state) is not ClockState.LOCKED:
            if board.now() > end:
                raise CommandFailed(
                    f"the clock of {board.url} is {state.name.lower()} after {_LOCKED_S:g} s, not "
                    "locked: does syncd, or another program, keep it? (--no-discipline)",
                    TIMEOUT,
                )
            time.sleep(_LOOK_S)
            if not args.no_discipline:
                _sync(boards)


@contextlib.contextmanager
def _enabled(sensor: Any) -> Iterator[None]:
    """Let the referee send samples, and be as before at the end."""
    was_enabled = sensor.enabled
    if not was_enabled:
        sensor.enabled = True
    try:
        yield
    finally:
        if not was_enabled:
            with contextlib.suppress(j2a.J2AError):  # it is gone
                sensor.enabled = False


def _edge(
    boards: list[j2a.Client], actuator: Any, sensor: Any, args: argparse.Namespace, number: int
) -> _Edge:
    """Let the driver make one edge, and return what the referee says of it."""
    driver, referee = boards
    what = f"edge {number + 1} of {args.count}"
    with sensor.samples() as samples:
        for lead_us in _LEADS_US:
            actuator.set(0, raw=True)
            _wait_for_quiet(samples, sensor, referee)
            if not args.no_discipline:
                _sync(boards)
            before = [board.clock.status() for board in boards]
            at_us = before[0].time_us + lead_us
            actuator.set(1, at_us=at_us, raw=True)
            if driver.clock.status().time_us < at_us:
                break
        else:
            raise CommandFailed(
                f"{what}: each order reached its board after its time, the last one though it was "
                f"given {_LEADS_US[-1] / 1e6:g} s before; is the link busy?",
                TIMEOUT,
            )
        stamp_us = _stamp(samples, sensor, referee.now() + lead_us / 1e6 + _EDGE_S, referee, what)
    after = [board.clock.status() for board in boards]
    for board, one, other in zip(boards, before, after, strict=True):
        if one.epoch != other.epoch:
            raise CommandFailed(f"the clock of {board.url} was set between order and edge", FAILED)
    return _Edge(stamp_us - at_us - args.delay, _bound_us(boards, [*before, *after], args))


def _wait_for_quiet(samples: Any, sensor: Any, referee: j2a.Client) -> None:
    """Take the samples of what was before.

    Raises:
        CommandFailed: they have no end.
    """
    end = referee.now() + _NOISE_S
    with contextlib.suppress(j2a.CallTimeout):
        while referee.now() < end:
            samples.wait(_QUIET_S)
        raise CommandFailed(
            f"{sensor.name} sends samples all the time, not only at an edge; has it a period, or a "
            "pin that nothing drives?",
            FAILED,
        )


def _stamp(samples: Any, sensor: Any, end: float, referee: j2a.Client, what: str) -> int:
    """Return the time stamp of the next sample that is not 0.

    Raises:
        CommandFailed: none comes until `end`, or it has no time stamp.
    """
    with contextlib.suppress(j2a.CallTimeout):
        while (left_s := end - referee.now()) > 0:
            for reading in samples.wait(left_s).readings:
                if reading.raw:
                    if reading.time_us is None:
                        raise CommandFailed(f"samples of {sensor.name} have no time stamps", FAILED)
                    return int(reading.time_us)
    raise CommandFailed(
        f"{what}: no sample of {sensor.name} came within {_EDGE_S:g} s of the time of the order; "
        "is the wire between both pins, with a common ground, and does the sensor tell the level "
        "1?",
        TIMEOUT,
    )


def _bound_us(boards: list[j2a.Client], statuses: list[Status], args: argparse.Namespace) -> float:
    """Return the greatest sum of what was announced of both boards around an edge."""
    if args.bound is not None:
        return float(args.bound)
    told = [_announced_us(*one) for one in zip([*boards, *boards], statuses, strict=True)]
    return float(max(sum(told[:2]), sum(told[2:])))


def _announced_us(board: j2a.Client, status: Status) -> float:
    """Return what a board says of its clock, or the daemon, which tells it only the time.

    Raises:
        UsageError: neither does.
    """
    if status.uncertainty_us is not None:
        return status.uncertainty_us
    # The daemon knows a board by its URL, or by its serial number or path of ports, the URL's end.
    url = unquote(board.url.partition("?")[0])
    names = {url, url.partition(":")[2].rpartition("/")[2]}
    # A daemon of another version may tell something else.
    unknown = (NotRunning, AttributeError, LookupError, OverflowError, TypeError, ValueError)
    for folder in folders():
        with contextlib.suppress(*unknown):
            rows: Any = ask(folder, {"command": "status"}).get("boards", [])
            found = [row for row in rows if names & {row["board"], row["place"].split()[-1]}]
            [told] = [row["uncertainty_us"] for row in found]
            if type(told) in {int, float} and 0 <= told < math.inf:
                return float(told)
    raise UsageError(
        f"{board.url} does not know how far off its clock is, because it was told the time by "
        "SyncUSB only, and no j2a syncd says so: --bound US says what is allowed"
    )


def _show(edges: list[_Edge], args: argparse.Namespace) -> int:
    errors = [one.error_us for one in edges]
    bounds = [one.bound_us for one in edges]
    outside = sum(abs(error) > bound for error, bound in zip(errors, bounds, strict=True))
    facts = {
        "edges": len(errors),
        "median_us": round(statistics.median(errors), 3),
        "rms_us": round(math.sqrt(statistics.fmean(one * one for one in errors)), 3),
        "peak_us": max(map(abs, errors)),
        "bound_us": round(statistics.median(bounds), 3),
        "outside": outside,
        "errors_us": errors,
        "bounds_us": bounds,
    }
    if args.json:
        show_json(facts)
    else:
        show(
            f"{counted(len(edges), 'edge')}: median {facts['median_us']} us, "
            f"rms {facts['rms_us']} us, peak {facts['peak_us']} us; "
            f"announced {facts['bound_us']} us"
        )
    if outside:
        told = counted(len(edges), "edge is", "edges are")
        note(f"j2a: {outside} of {told} outside what is announced")
        return FAILED
    return OK
