"""`j2a debug`: print the debug text of a device.

In: a link. Out: the text as the firmware wrote it, control characters escaped; `[...]` stands where
text was lost.
"""

import argparse

from j2a.cli._exit import OK
from j2a.cli._link import add_link_arguments, connect, finite_seconds
from j2a.cli._output import show_text


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("-f", "--follow", action="store_true", help="keep printing until Ctrl-C")
    parser.add_argument(
        "--every",
        type=finite_seconds,
        default=0.2,
        metavar="S",
        help="with --follow: how often to ask the device, in seconds (0.2)",
    )
    add_link_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Print the text that waits; returns the exit code."""
    with connect(args) as client:
        held = ""
        while True:
            text = held + client.read_debug()
            # CR LF is one line end, also where the firmware has not written all of it yet.
            held = "\r" if args.follow and text.endswith("\r") else ""
            show_text(text.removesuffix(held).replace("\r\n", "\n"))
            if not args.follow:
                return OK
            client.clock._pause(args.every)
