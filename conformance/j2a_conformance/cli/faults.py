"""`j2a-conform faults`: judge a device behind a link that damages bytes.

What flows in: a URL or a testee file, kinds of fault, rates, a seed. What flows out: a report with
statistics, a vector where the device is wrong, and an exit code.
"""

import argparse
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from j2a_spec.plural import counted

from j2a_conformance._model import HarnessError
from j2a_conformance.faults import _report, _vectors
from j2a_conformance.faults._experiment import KINDS, Kind, Wrong, player_for, run, shortest
from j2a_conformance.faults._player import Player
from j2a_conformance.faults._row import Row, Setup, Side
from j2a_conformance.faults._series import Found
from j2a_conformance.faults._soak import Soak, soak

from . import _target
from ._exit import CONFORMANT, FAILED, INTERRUPTED, NOTHING, UsageError
from ._output import note, show
from ._reports import check_writable

__all__ = ["add_arguments", "kinds_of", "main"]

_SIDES: Final[dict[str, tuple[Side, ...]]] = {
    "both": ("requests", "replies"),
    "requests": ("requests",),
    "replies": ("replies",),
}
_VECTOR: Final = Path("failing-stream.json")
_OF_ROWS: Final[dict[str, Any]] = {
    "kind": ",".join(name for name in KINDS if name != "split"),
    "rate": 0.004,
    "frames": 2000,
    "seconds": math.inf,
    "payload": 32,
    "direction": "both",
    "json": None,
}
_DEFAULTS: Final[dict[str, Any]] = {**_OF_ROWS, "seed": 1, "vector": _VECTOR}
_WITHOUT_EFFECT: Final = {"soak": tuple(_OF_ROWS), "replay": tuple(_DEFAULTS)}


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    command.description = (
        "Sends echo requests through seeded faults and counts what becomes of them. A stream that "
        "the device answers wrongly is shrunk and saved. Exit code: 0 the device is right, 1 it is "
        "not, 3 harness, link or arguments wrong, 4 nothing was tested: a row had "
        "no faults, more than half of its exchanges with faults could not be judged, no batch of "
        "a soak could be compared, or no stream could be played."
    )
    command.add_argument("url", metavar="URL", help="a URL, or a testee file")
    command.add_argument(
        "--kind",
        metavar="K,K,...",
        help=f"kinds of fault, of {', '.join(KINDS)}; with a rate: flip=0.01; together: flip+drop",
    )
    command.add_argument(
        "--rate", type=float, metavar="R", help=f"faults per byte ({_OF_ROWS['rate']})"
    )
    command.add_argument("--frames", type=int, metavar="N", help="requests of each kind (2000)")
    command.add_argument("--seconds", type=float, metavar="S", help="end each kind after S seconds")
    command.add_argument("--seed", type=int, metavar="S", help="seed of the faults (1)")
    command.add_argument(
        "--payload", type=int, metavar="N", help="payload bytes of each request (32)"
    )
    command.add_argument("--direction", choices=_SIDES, help="the direction to damage (both)")
    command.add_argument("--json", type=Path, metavar="FILE", help="write a JSON report")
    command.add_argument(
        "--vector",
        type=Path,
        metavar="FILE",
        help=f"file for the bytes that the device answers wrongly ({_VECTOR})",
    )
    _target.add_arguments(command)
    mode = command.add_mutually_exclusive_group()
    mode.add_argument("--replay", type=Path, metavar="FILE", help="play the vectors of a file")
    mode.add_argument(
        "--soak", type=int, metavar="N", help="only send N damaged frames, as fast as possible"
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
    _check(args)
    kinds = kinds_of(args.kind, args.rate)
    with _target.reach(args.url, args.baud or 0) as target:
        code = _judge(target, args, kinds)
    if code == FAILED and target.url != target.link[0]:
        raise HarnessError(
            "what is wrong may be the doing of faults: in the URL, which are no part of the "
            "experiment; leave them out, --kind and --rate make faults"
        )
    return code


def _check(args: argparse.Namespace) -> None:
    for mode, names in _WITHOUT_EFFECT.items():
        for name in names if getattr(args, mode) is not None else ():
            if getattr(args, name) is not None:
                raise UsageError(f"--{name} has no effect with --{mode}")
    for path in {args.json, args.vector} - {None}:
        check_writable(path)
    if args.json and args.vector and args.json.resolve() == args.vector.resolve():
        raise UsageError("--json and --vector need a file each")
    for name, value in _DEFAULTS.items():
        if getattr(args, name) is None:
            setattr(args, name, value)
    _target.check(args)
    if not 0 <= args.payload <= 255:
        raise UsageError("--payload takes 0 to 255 bytes")
    if args.frames < 1 or (args.soak is not None and args.soak < 1):
        raise UsageError("--frames and --soak take a number above 0")
    if not args.seconds > 0:
        raise UsageError("--seconds takes a number above 0")


def _judge(target: _target.Target, args: argparse.Namespace, kinds: Sequence[Kind]) -> int:
    try:
        player = player_for(
            target.opener,
            starts=target.fresh,
            held=target.link[1].held_bytes,
            scale=args.timeout_scale,
            baud=args.baud or 0,
        )
    except Found as found:
        show(f"{target.url}: {found.reason}")
        return FAILED
    if args.replay:
        return _replay(player, args)
    if args.soak:
        return _soak(player, args)
    return _rows(player, target.url, args, kinds)


def _rows(player: Player, url: str, args: argparse.Namespace, kinds: Sequence[Kind]) -> int:
    setup = Setup(args.frames, args.seconds, args.seed, args.payload, _SIDES[args.direction])
    found = run(player, setup, kinds, url, _progress if args.verbose else lambda _: None)
    show(_report.report(found), flush=True)
    if found.wrong:
        _save(player, found.wrong, args.vector)
    if args.json:
        try:
            args.json.write_text(_report.as_json(found), "utf-8")
        except OSError as error:
            if not found.failed:
                raise HarnessError(f"cannot write the JSON report: {error}") from error
            note(f"j2a-conform: cannot write the JSON report: {error}")
    if found.interrupted:
        return INTERRUPTED
    if found.failed:
        return FAILED
    return NOTHING if found.gaps else CONFORMANT


def _progress(row: Row) -> None:
    requests, faults = counted(row.frames, "request"), counted(row.faults, "fault")
    show(f"{row.kind}: {requests}, {faults}", flush=True)


def _save(player: Player, wrong: Wrong, path: Path) -> None:
    """Save the bytes, which were shown already: where it fails, the judgement stands."""
    if not wrong.stream:
        return
    try:
        _vectors.save(path, wrong.stream, wrong.reason, player.rules)
    except HarnessError as error:
        note(f"j2a-conform: {error}")
    else:
        show(f"saved as {path}; j2a-conform faults --replay {path} URL plays it again")


def _replay(player: Player, args: argparse.Namespace) -> int:
    streams = _vectors.load(args.replay)
    failed = unplayed = 0
    for name, whole in streams.items():
        stream = player.rules.apart(whole)
        if not player.rules.is_exact(stream):
            unplayed += 1
            outcome = "not played"
        elif reason := player.fault(stream):
            failed += 1
            show(f"{name}: {reason}", flush=True)
            continue
        else:
            outcome = "right"
        if args.verbose:
            show(f"{name}: {outcome}", flush=True)
    right = len(streams) - failed - unplayed
    rest = f", {unplayed} not played: more than the device has room for" if unplayed else ""
    count = counted(len(streams), "stream is", "streams are")
    show(f"{right} of {count} answered rightly{rest}")
    if failed:
        return FAILED
    return CONFORMANT if right else NOTHING


def _soak(player: Player, args: argparse.Namespace) -> int:
    def tell(state: Soak) -> None:
        if args.verbose:
            show(state, flush=True)

    try:
        state = soak(player, args.soak, args.seed, tell)
    except Found as found:
        wrong = shortest(player, found)
        show("\n".join(_report.wrong_lines(wrong)), flush=True)
        _save(player, wrong, args.vector)
        return FAILED
    show(state)
    if state.complaint:
        show(f"the device is wrong: {state.complaint}")
        return FAILED
    if state.interrupted:
        show("INTERRUPTED")
        return INTERRUPTED
    if not state.exact:
        show("NOT TESTED: no batch could be compared, they are more than the device has room for")
        return NOTHING
    return CONFORMANT
