"""`j2a watch`: print the frames that a device sends unasked (SIFs).

In: a link. Out: a line for each SIF, and one for each gap in their numbers.
Rules: the library's thread collects, this one prints, so that a slow reader of the output loses
nothing. What `--then` names is called however the watching ends, unless the link is gone.
"""

from __future__ import annotations

import argparse
import math
import queue
import shlex
import time
from collections.abc import Sequence
from datetime import datetime

import j2a
from j2a.cli._exit import (
    FAILED,
    OK,
    TIMEOUT,
    CommandFailed,
    UsageError,
    end_on_sigterm,
    error_facts,
)
from j2a.cli._link import (
    add_json_argument,
    add_link_arguments,
    connect,
    finite_seconds,
    function_of,
    whole_number,
)
from j2a.cli._output import note, show, show_json
from j2a.cli._values import Decoder, payload_of, short_hex, text_of

NOTES = """\
examples:
  j2a watch tcp://127.0.0.1:5000 0x20 --as u32
  j2a watch tcp://127.0.0.1:5000 --call 'sifPeriod u16:100' --count 10 --json
  j2a watch tcp://127.0.0.1:5000 --call 'sifPeriod u16:100' --then 'sifPeriod u16:0'"""
_LOOK_S = 0.2
_Call = tuple[str | int, bytes]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument(
        "--call",
        action="append",
        default=[],
        metavar="'FUNCTION PAYLOAD'",
        help="call this first, to start the device sending; words as for j2a call",
    )
    parser.add_argument(
        "--then",
        action="append",
        default=[],
        metavar="'FUNCTION PAYLOAD'",
        help="call this at the end, also after Ctrl-C, to stop the device sending",
    )
    parser.add_argument("--count", type=whole_number(1), metavar="N", help="end after N SIFs")
    parser.add_argument(
        "--duration",
        type=finite_seconds,
        metavar="S",
        help="end after S seconds; with --count, fail if fewer SIFs came",
    )
    parser.add_argument(
        "--as", dest="types", type=Decoder, metavar="TYPES", help="decode payloads, as j2a call"
    )
    add_json_argument(parser, "an object for each SIF, one per line,")
    add_link_arguments(parser)
    parser.add_argument(
        "opcodes",
        metavar="OPCODE",
        nargs="*",
        default=[],
        type=whole_number(0, 255),
        help="watch only these opcodes, 0..255",
    )


def run(args: argparse.Namespace) -> int:
    """Print SIFs until the end; returns the exit code."""
    first = [_parse_call("--call", text) for text in args.call]
    last = [_parse_call("--then", text) for text in args.then]
    if last:
        end_on_sigterm()
    with connect(args) as client:
        try:
            _watch(client, first, args)
        except BaseException:  # Ctrl-C and SIGTERM too: the device shall stop sending
            if client.is_open:
                try:
                    _call_each(client, last)
                except CommandFailed as error:
                    note(f"j2a: {error}")
            raise
        _call_each(client, last)
    return OK


def _watch(client: j2a.Client, first: Sequence[_Call], args: argparse.Namespace) -> None:
    arrived: queue.SimpleQueue[tuple[float, float, j2a.Sif]] = queue.SimpleQueue()
    client.on_sif(args.opcodes or None, lambda sif: arrived.put((time.time(), client.now(), sif)))
    _call_each(client, first)
    end = math.inf if args.duration is None else client.now() + args.duration
    seen = 0
    while args.count is None or seen < args.count:
        left_s = min(_LOOK_S, end - client.now())
        try:
            at_s, came_at, sif = arrived.get(timeout=max(left_s, 0.0))
        except queue.Empty:
            if left_s <= 0:
                break
            if not client.is_open:
                client.call(0)  # raises what ended the link
            continue
        if came_at > end:  # simulated time may run faster than that of this machine
            break
        seen += 1
        _print(at_s, sif, args)
    if args.count is not None and seen < args.count:
        came = f"{seen} of {args.count} SIFs came within {args.duration:g} s"
        raise CommandFailed(came, TIMEOUT)


def _call_each(client: j2a.Client, calls: Sequence[_Call]) -> None:
    """Call one after the other.

    Raises:
        CommandFailed: one failed, so that those after it were not called.
    """
    for function, payload in calls:
        reply = client.call(function, payload)
        if not reply.ok:
            raise CommandFailed(f"{function} failed (code 0x{reply.code:02X})", FAILED)


def _parse_call(option: str, text: str) -> _Call:
    try:
        function, *words = shlex.split(text)
    except ValueError:
        raise UsageError(
            f"{option} {text!r}: write a function and its payload, "
            f"as in {option} 'sifPeriod u16:100'"
        ) from None
    return function_of(function), payload_of(words)


def _print(at_s: float, sif: j2a.Sif, args: argparse.Namespace) -> None:
    values, problem = None, None
    if args.types is not None:
        try:
            values = args.types.values(sif.payload)
        except ValueError as error:
            problem = error
            note(f"j2a: SIF {sif.seq}: {error}")
    if args.json:
        facts = {
            "time": round(at_s, 6),
            "opcode": sif.opcode,
            "seq": sif.seq,
            "missed": sif.missed,
            "payload": sif.payload.hex(),
        }
        if values is not None:
            facts["values"] = values
        if problem is not None:
            facts["error"] = error_facts(problem, FAILED)
        show_json(facts)
        return
    if sif.missed:
        show(f"              {sif.missed} SIF{'s' * (sif.missed > 1)} missed")
    clock = datetime.fromtimestamp(at_s).strftime("%H:%M:%S.%f")[:-3]
    if values is None:
        text = text_of(sif.payload)
        what = f"{short_hex(sif.payload)}{f'  {text}' if text else ''}"
    else:
        what = " ".join(map(str, values))
    show(f"{clock}  opcode {sif.opcode:>3}  seq {sif.seq:>3}  {what}".rstrip(), flush=True)
