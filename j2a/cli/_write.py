"""`j2a write`: write to a function that transfers data of any size (a2jMany).

In: a function, and the data as words, a file or standard input. Out: how much was written.
"""

import argparse
import time

from j2a_spec.constants import MANY_DATA
from j2a_spec.plural import counted

from j2a.cli._exit import FAILED, OK, CommandFailed
from j2a.cli._link import (
    add_link_arguments,
    add_progress_argument,
    connect,
    function_of,
    telling_transducers,
)
from j2a.cli._output import note
from j2a.cli._progress import Progress, size_text
from j2a.cli._values import PAYLOAD_HELP, payload_of

NOTES = f"""\
{PAYLOAD_HELP.replace("payload words", "data words")}

examples:
  j2a write tcp://127.0.0.1:5000 store @photo.jpg --verify
  dmesg | j2a write tcp://127.0.0.1:5000 store -"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("--verify", action="store_true", help="read the data back and compare it")
    add_progress_argument(parser)
    add_link_arguments(parser)
    parser.add_argument("function", metavar="FUNCTION", help="its name, or its opcode 0..255")
    parser.add_argument("data", metavar="DATA", nargs="+", help="@FILE, - or words; see below")


def run(args: argparse.Namespace) -> int:
    """Write, perhaps verify; returns the exit code."""
    data = payload_of(args.data)
    function = function_of(args.function)
    with connect(args) as client, telling_transducers(client, args.function):
        start = time.perf_counter()
        with Progress(f"write {args.function}", enabled=not args.no_progress) as progress:
            client.write_many(function, data, progress=progress)
        took_s = time.perf_counter() - start
        rate = size_text(len(data) / took_s)
        size = counted(len(data), "byte")
        note(f"{size} written to {args.function} in {took_s:.2f} s ({rate}/s)")
        if not args.verify:
            return OK
        with Progress(f"verify {args.function}", enabled=not args.no_progress) as progress:
            found = client.read_many(
                function,
                # What is longer is wrong, and a little more shows that it is.
                max_bytes=len(data) + MANY_DATA,
                progress=lambda done, _: progress(done, len(data)),
            )
    if found != data:
        pairs = zip(found, data, strict=False)
        differing = (index for index, (a, b) in enumerate(pairs) if a != b)
        where = next(differing, min(len(found), len(data)))
        raise CommandFailed(f"what was read back differs from byte {where} on", FAILED)
    note("verified")
    return OK
