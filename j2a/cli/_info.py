"""`j2a info`: what a device is and can do.

In: a link. Out: name, version, functions with opcodes, properties and the health of the link.
"""

from __future__ import annotations

import argparse
import dataclasses
import json

from j2a_spec.constants import PROP_RXBUF, PROP_SPEC

import j2a
from j2a.cli._exit import OK
from j2a.cli._link import add_json_argument, add_link_arguments, connect


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    add_json_argument(parser, "everything")
    add_link_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Ask the device and print; returns the exit code."""
    with connect(args) as client:
        functions = client.functions
        properties = client.properties
        room = client.room
        counters = client.counters
    rxbuf = properties.get(PROP_RXBUF, "")
    facts = {
        "url": args.url,
        "name": properties.get("name"),
        "spec": properties.get(PROP_SPEC, "1.0"),
        "rxbuf": int(rxbuf) if rxbuf.isascii() and rxbuf.isdecimal() else None,
        "room": room,
        "functions": functions,
        "properties": properties,
        "counters": dataclasses.asdict(counters),
    }
    if args.json:
        print(json.dumps(facts))
        return OK
    print(f"name      {facts['name'] or '(has none)'}")
    assumed = "" if PROP_SPEC in properties else "   (does not say; assumed)"
    print(f"spec      {facts['spec']}{assumed}")
    print(f"rxbuf     {f'{rxbuf} bytes' if rxbuf else '(does not say; one request at a time)'}")
    print(f"room      {room} bytes of payload in a request")
    print("functions" if functions else "functions (no map; call by opcode)")
    for name, opcode in functions.items():
        print(f"  {opcode:>3}  {name}")
    print("properties" if properties else "properties (none)")
    width = max(map(len, properties), default=0)
    for key, value in properties.items():
        print(f"  {key:<{width}}  {value}")
    print("link")
    print(f"  {counters_text(counters)}")
    return OK


def counters_text(counters: j2a.Counters) -> str:
    """Return the counters that are not 0, in words."""
    counts = dataclasses.asdict(counters)
    shown = [f"{name.replace('_', ' ')} {count}" for name, count in counts.items() if count]
    return ", ".join(shown)
