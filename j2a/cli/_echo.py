"""`j2a echo`: test a link: send bytes there and back, verify and time them.

In: how many bytes, how often. Out: how many came back right, rate and round trip times; what was
found so far when Ctrl-C ends it.
Rules: an echo that fails is counted and the test goes on, as long as the link is there and not
everything fails; the bytes are those that hurt most: markers, escapes and their neighbours.
"""

import argparse
import dataclasses
import random
import statistics
import time
from collections import Counter
from collections.abc import Iterator

from j2a_spec.constants import ECHO, ESC, GET_ECHO, MAX_PAYLOAD, SOF, SOS
from j2a_spec.plural import counted

import j2a
from j2a.cli._exit import FAILED, INTERRUPTED, OK, UsageError, exit_code
from j2a.cli._info import counters_text
from j2a.cli._link import (
    add_json_argument,
    add_link_arguments,
    add_progress_argument,
    connect,
    whole_number,
)
from j2a.cli._output import note, show, show_json
from j2a.cli._progress import Progress, size_text

_FILLS = (SOF, SOS, ESC, SOF - 1, SOS - 1, ESC - 1)
_PATTERNS = len(_FILLS) + 2
_SIZE = 64
_GIVE_UP_AFTER = 5
_MANY_MAX = 64 * 2**20  # the data is in memory twice


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument(
        "--count",
        type=whole_number(1),
        metavar="N",
        help="number of echoes (100); with --all-lengths number of rounds (1)",
    )
    size = parser.add_mutually_exclusive_group()
    size.add_argument(
        "--size",
        type=whole_number(0, MAX_PAYLOAD),
        metavar="N",
        help="payload bytes of each echo, 0..255 (64, or the room of the device if smaller)",
    )
    size.add_argument(
        "--all-lengths",
        action="store_true",
        help=f"each length that the device has room for with {_PATTERNS} patterns: "
        f"{256 * _PATTERNS} echoes where that is 255 bytes",
    )
    size.add_argument(
        "--many",
        type=whole_number(0, _MANY_MAX),
        metavar="N",
        help="one transfer of N bytes, up to 64 MiB, through a2jEchoMany",
    )
    add_json_argument(parser, "the result")
    add_progress_argument(parser)
    add_link_arguments(parser)


@dataclasses.dataclass(slots=True)
class Result:
    """The result of the test; times in seconds, sizes in payload bytes one way."""

    what: str
    wanted: int
    sent: int = 0
    correct: int = 0
    size: int = 0
    took_s: float = 0.0
    round_trips_s: list[float] = dataclasses.field(default_factory=list)
    failures: Counter[str] = dataclasses.field(default_factory=Counter)
    code: int = OK

    def fail(self, what: str, code: int) -> None:
        """Count a failure; the first one decides how the command ends."""
        self.failures[what] += 1
        self.code = self.code or code


def run(args: argparse.Namespace) -> int:
    """Test and print; returns the exit code."""
    if args.many is not None and args.count is not None:
        raise UsageError("--count is not allowed with --many, which is one transfer")
    with connect(args) as client:
        result = _echo(client, args) if args.many is None else _transfer(client, args)
        counters = client.counters
    if args.json:
        show_json({**facts(result), "counters": dataclasses.asdict(counters)})
    else:
        for line in report(result):
            show(line)
        show(f"link: {counters_text(counters)}")
    return result.code


def payloads(args: argparse.Namespace, room: int = MAX_PAYLOAD) -> Iterator[bytes]:
    """Yield what to send, the same in every run; `room` is how long a payload may be."""
    if args.all_lengths:
        for _ in range(args.count or 1):
            for length in range(room + 1):
                yield from (pattern(kind, length) for kind in range(_PATTERNS))
    else:
        size = min(_SIZE, room) if args.size is None else args.size
        for number in range(args.count or 100):
            yield pattern(number % _PATTERNS, size)


def pattern(kind: int, length: int) -> bytes:
    """Return bytes of one kind: a special byte or the one below it; counting; random."""
    if kind < len(_FILLS):
        return bytes([_FILLS[kind]]) * length
    if kind == len(_FILLS):
        return bytes(index & 0xFF for index in range(length))
    return random.Random(length).randbytes(length)


def _echo(client: j2a.Client, args: argparse.Namespace) -> Result:
    room = _room(client)
    each = (room + 1) * _PATTERNS
    result = Result("echoes", each * (args.count or 1) if args.all_lengths else args.count or 100)
    in_a_row = 0
    start = time.perf_counter()
    try:
        with Progress("echo", enabled=not args.no_progress) as progress:
            for payload in payloads(args, room):
                sent_at = time.perf_counter()
                result.sent += 1
                try:
                    reply = client.call(GET_ECHO, payload)
                except (j2a.CallTimeout, j2a.RemoteError) as error:
                    result.fail(type(error).__name__, exit_code(error) or FAILED)
                    in_a_row += 1
                    if in_a_row == _GIVE_UP_AFTER:
                        note(f"j2a: {in_a_row} failures in a row: {error}")
                        break
                    continue
                in_a_row = 0
                result.round_trips_s.append(time.perf_counter() - sent_at)
                if reply == (ECHO, payload):
                    result.correct += 1
                    result.size += len(payload)
                else:
                    result.fail("came back different", FAILED)
                progress(result.size)
    except KeyboardInterrupt:
        result.code = INTERRUPTED
    result.took_s = time.perf_counter() - start
    return result


def _room(client: j2a.Client) -> int:
    """Return how long a payload may be; over a link that fails, as long as any may be."""
    try:
        return client.room
    except (j2a.CallTimeout, j2a.RemoteError):
        return MAX_PAYLOAD


def _transfer(client: j2a.Client, args: argparse.Namespace) -> Result:
    data = random.Random(args.many).randbytes(args.many)
    result = Result("transfers", wanted=1, sent=1)
    start = time.perf_counter()
    with Progress("echo", enabled=not args.no_progress) as progress:

        def count(done: int, total: int | None) -> None:
            result.size = done
            progress(done, total)

        try:
            client.echo_many(data, progress=count)
            result.correct = 1
        except j2a.ProtocolError as error:
            result.fail(str(error), FAILED)
        except KeyboardInterrupt:
            result.code = INTERRUPTED
    result.took_s = time.perf_counter() - start
    return result


def facts(result: Result) -> dict[str, object]:
    """Return the result for programs; the times are None when nothing came back."""
    return {
        "wanted": result.wanted,
        "sent": result.sent,
        "correct": result.correct,
        "failures": dict(result.failures),
        "payload_bytes": result.size,
        "seconds": result.took_s,
        "bytes_per_s": result.size / result.took_s,
        "round_trip_s": round_trips(result.round_trips_s) or None,
    }


def round_trips(times_s: list[float]) -> dict[str, float]:
    """Return the statistics of round trips, in seconds; empty when there are none."""
    if not times_s:
        return {}
    ordered = sorted(times_s)
    return {
        "min": ordered[0],
        "median": statistics.median(ordered),
        "mean": statistics.fmean(ordered),
        "p99": ordered[(len(ordered) - 1) * 99 // 100],
        "max": ordered[-1],
    }


def report(result: Result) -> Iterator[str]:
    """Yield the result as lines for people."""
    yield f"{result.correct} of {result.sent} {result.what} correct"
    for failure, count in result.failures.items():
        yield f"  {count} failed: {failure}"
    if result.sent < result.wanted:
        yield f"  {result.wanted - result.sent} of {result.wanted} were not sent"
    rate = size_text(result.size / result.took_s)
    yield f"{counted(result.size, 'byte')} each way in {result.took_s:.2f} s, {rate}/s"
    if result.round_trips_s:
        ms = round_trips(result.round_trips_s).items()
        yield "round trip " + ", ".join(f"{name} {1000 * t:.2f}" for name, t in ms) + " ms"
