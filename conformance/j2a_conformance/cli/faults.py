"""`j2a-conform faults`: judge a device behind a link that damages bytes.

What flows in: a URL or a testee file, kinds of fault, rates, a seed. What flows out: a report with
statistics, a vector where the device is wrong, and an exit code.
"""

import argparse
import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import j2a_transports

from j2a_conformance._model import HarnessError
from j2a_conformance._testee import load_testee
from j2a_conformance.faults import _report, _vectors
from j2a_conformance.faults._experiment import KINDS, Kind, Wrong, player_for, run, shortest
from j2a_conformance.faults._player import STARTING, Player
from j2a_conformance.faults._row import Row, Setup, Side
from j2a_conformance.faults._series import Found
from j2a_conformance.faults._soak import Soak, soak

from ._exit import CONFORMANT, FAILED, UsageError

__all__ = ["add_arguments", "kinds_of", "main"]

_RATE = 0.004
_PIPE = 4096  # bytes that a pipe holds at least
_SIDES: dict[str, tuple[Side, ...]] = {
    "both": ("requests", "replies"),
    "requests": ("requests",),
    "replies": ("replies",),
}


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    command.description = (
        "Sends echo requests through seeded faults and counts what becomes of them. A stream that "
        "the device answers wrongly is shrunk and saved. Exit code: 0 the device is right, 1 it is "
        "not, 3 harness, link or arguments wrong."
    )
    command.add_argument("url", metavar="URL", help="a URL, or a testee file")
    command.add_argument(
        "--kind",
        default=",".join(name for name in KINDS if name != "split"),
        metavar="K,K,...",
        help=f"kinds of fault, of {', '.join(KINDS)}; with a rate: flip=0.01; together: flip+drop",
    )
    command.add_argument(
        "--rate", type=float, default=_RATE, metavar="R", help=f"faults per byte ({_RATE})"
    )
    command.add_argument(
        "--frames", type=int, default=2000, metavar="N", help="requests of each kind (2000)"
    )
    command.add_argument(
        "--seconds", type=float, default=math.inf, metavar="S", help="end each kind after so long"
    )
    command.add_argument("--seed", type=int, default=1, metavar="S", help="of the faults (1)")
    command.add_argument(
        "--payload", type=int, default=32, metavar="N", help="payload bytes of each request (32)"
    )
    command.add_argument("--direction", choices=_SIDES, default="both", help="which is damaged")
    command.add_argument("--json", type=Path, metavar="FILE", help="write a JSON report")
    command.add_argument(
        "--vector",
        type=Path,
        default=Path("failing-stream.json"),
        metavar="FILE",
        help="where bytes that the device answers wrongly are saved (failing-stream.json)",
    )
    command.add_argument(
        "--timeout-scale", type=float, default=1.0, metavar="X", help="multiply every wait"
    )
    mode = command.add_mutually_exclusive_group()
    mode.add_argument("--replay", type=Path, metavar="FILE", help="play the vectors of a file")
    mode.add_argument(
        "--soak", type=int, metavar="N", help="only pour N damaged frames in, as fast as it goes"
    )
    command.add_argument("-v", "--verbose", action="store_true", help="show progress")


def kinds_of(text: str, rate: float) -> list[Kind]:
    """Return the rows that `--kind` asks for.

    Raises:
        UsageError: a kind or a rate that does not exist.
    """
    found = []
    for item in text.split(","):
        names, _, own = item.partition("=")
        kinds = tuple(names.split("+"))
        if unknown := set(kinds) - set(KINDS):
            raise UsageError(f"--kind {unknown.pop()}: there is {', '.join(KINDS)}")
        try:
            value = float(own) if own else rate
        except ValueError as error:
            raise UsageError(f"--kind {item}: the rate is no number") from error
        if not 0 < value <= 0.5:
            raise UsageError(f"a rate of {value:g} per byte: it must be above 0 and at most 0.5")
        found.append(Kind(kinds, value))
    return found


def main(args: argparse.Namespace) -> int:
    """Carry the command out; return the exit code.

    Raises:
        HarnessError: nothing can be said about the device.
    """
    kinds = kinds_of(args.kind, args.rate)
    _check(args)
    with _started(args.url) as (url, starts):
        try:
            player = player_for(
                lambda: j2a_transports.open(url),
                starts=starts,
                held=_PIPE if url.startswith("exec:") else 0,
                scale=args.timeout_scale,
            )
        except Found as found:
            print(f"{url}: {found.reason}")
            return FAILED
        if args.replay:
            return _replay(player, args.replay)
        if args.soak:
            return _soak(player, args)
        setup = Setup(args.frames, args.seconds, args.seed, args.payload, _SIDES[args.direction])
        found_all = run(player, setup, kinds, url, _progress if args.verbose else lambda _: None)
        print(_report.report(found_all), flush=True)
        if found_all.wrong:
            _save(player, found_all.wrong, args.vector)
        if args.json:
            try:
                args.json.write_text(_report.as_json(found_all), "utf-8")
            except OSError as error:
                raise HarnessError(f"cannot write the JSON report: {error}") from error
    return CONFORMANT if found_all.passed else FAILED


def _check(args: argparse.Namespace) -> None:
    if not 0 <= args.payload <= 255:
        raise UsageError("--payload takes 0 to 255 bytes")
    if args.frames < 1 or (args.soak is not None and args.soak < 1):
        raise UsageError("--frames and --soak take a number above 0")
    if not args.seconds > 0:
        raise UsageError("--seconds takes a number above 0")
    if not 0 < args.timeout_scale < 1000:
        raise UsageError("--timeout-scale takes a number above 0 and below 1000")


@contextmanager
def _started(text: str) -> Iterator[tuple[str, bool]]:
    """Yield the URL of the device, and whether opening it starts the device."""
    if not text.endswith(".toml"):
        yield text, text.startswith(STARTING)
        return
    testee = load_testee(Path(text))
    with testee.started() as url:
        yield url, url.startswith(STARTING)


def _progress(row: Row) -> None:
    print(f"{row.kind}: {row.frames} requests, {row.faults} faults", flush=True)


def _save(player: Player, wrong: Wrong, path: Path) -> None:
    if wrong.stream:
        _vectors.save(path, wrong.stream, wrong.reason, player.rules)
        print(f"saved as {path}; j2a-conform faults --replay {path} URL plays it again")


def _replay(player: Player, path: Path) -> int:
    failed = 0
    streams = _vectors.load(path)
    for name, stream in streams.items():
        if reason := player.fault(stream):
            failed += 1
            print(f"{name}: {reason}")
    print(f"{len(streams) - failed} of {len(streams)} streams are answered rightly")
    return FAILED if failed else CONFORMANT


def _soak(player: Player, args: argparse.Namespace) -> int:
    def show(state: Soak) -> None:
        if args.verbose:
            print(state, flush=True)

    try:
        print(soak(player, args.soak, args.seed, show))
    except Found as found:
        wrong = shortest(player, found)
        print("\n".join(_report.wrong_lines(wrong)))
        _save(player, wrong, args.vector)
        return FAILED
    return CONFORMANT
