"""`j2a read`: read from a function that transfers data of any size (a2jMany).

In: a function. Out: its data, in a file or on standard output.
Rules: a file is written when all data is there, and as a whole, so that a transfer or a write that
fails leaves the old one.
"""

import argparse
import time
from pathlib import Path

from j2a_spec.plural import counted

from j2a.cli._exit import OK, REMOTE, CommandFailed, UsageError
from j2a.cli._files import write_file
from j2a.cli._link import (
    add_link_arguments,
    add_progress_argument,
    connect,
    function_of,
    telling_transducers,
    whole_number,
)
from j2a.cli._output import note, show_bytes
from j2a.cli._progress import Progress, size_text
from j2a.protocol.transfer import TooMuchError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument(
        "-o",
        "--output",
        metavar="FILE",
        default="-",
        help="output file (default or -: standard output, on a terminal in hex)",
    )
    parser.add_argument(
        "--max-bytes",
        type=whole_number(0),
        default=64 * 2**20,
        metavar="N",
        help="give up when the device sends more than this (64 MiB)",
    )
    add_progress_argument(parser)
    add_link_arguments(parser)
    parser.add_argument("function", metavar="FUNCTION", help="its name, or its opcode 0..255")


def run(args: argparse.Namespace) -> int:
    """Read, write to the file; returns the exit code."""
    target = None if args.output == "-" else Path(args.output)
    if target is not None and target.is_dir():
        raise UsageError(f"cannot write to {args.output!r}: it is a folder; name a file in it")
    if target is not None and not target.absolute().parent.is_dir():
        raise UsageError(f"cannot write to {args.output!r}: its folder does not exist")
    function = function_of(args.function)
    with connect(args) as client, telling_transducers(client, args.function):
        start = time.perf_counter()
        with Progress(f"read {args.function}", enabled=not args.no_progress) as progress:
            try:
                data = client.read_many(function, max_bytes=args.max_bytes, progress=progress)
            except TooMuchError:
                most = counted(args.max_bytes, "byte")
                raise CommandFailed(
                    f"{args.function}: the device sends more than {most}; --max-bytes takes more",
                    REMOTE,
                ) from None
        took_s = time.perf_counter() - start
    if target is None:
        show_bytes(data)
        return OK
    write_file(target, data)
    rate = size_text(len(data) / took_s)
    size = counted(len(data), "byte")
    note(f"{size} read to {args.output} in {took_s:.2f} s ({rate}/s)")
    return OK
