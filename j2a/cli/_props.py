"""`j2a props`: the properties of a device, or one of them.

In: a link. Out: keys and values; for one key its value alone.
"""

import argparse

from j2a_spec.nearest import nearest_or_all

from j2a.cli._exit import OK, UsageError
from j2a.cli._info import columns
from j2a.cli._link import add_json_argument, add_link_arguments, connect
from j2a.cli._output import show, show_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    add_json_argument(parser, "an object of keys and values, or the value,")
    add_link_arguments(parser)
    parser.add_argument("key", metavar="KEY", nargs="?", help="print only the value of this key")


def run(args: argparse.Namespace) -> int:
    """Ask the device and print; returns the exit code."""
    with connect(args) as client:
        properties = client.properties
    if args.key is not None:
        if args.key not in properties:
            hint = nearest_or_all(args.key, properties) if properties else "it has none"
            raise UsageError(f"the device has no property {args.key!r}; {hint}")
        (show_json if args.json else show)(properties[args.key])
        return OK
    if args.json:
        show_json(properties)
        return OK
    for line in columns(properties):
        show(line)
    return OK
