"""`j2a info`: shows what a device is and can do.

In: a link. Out: name, version, functions with opcodes and signatures, SIFs, transducers, types,
properties and the health of the link; without the properties when they cannot be read.
"""

import argparse
import dataclasses
from collections.abc import Iterator, Mapping
from typing import Final

from j2a_spec.constants import CLOCK, PROP_RXBUF, PROP_SPEC
from j2a_spec.plural import counted
from j2a_spec.printable import printable

import j2a
from j2a.cli._clock import offset_text, time_text
from j2a.cli._descriptors import overview, transducer_facts
from j2a.cli._exit import OK, REMOTE, error_facts, exit_code
from j2a.cli._link import add_json_argument, add_link_arguments, connect
from j2a.cli._output import note, show, show_json
from j2a.io.clock_base import ClockReading
from j2a.types.model import Interface
from j2a.types.transducers import Descriptors

MAX_DIGITS: Final = 10
_ROUNDS: Final = 3
WIDEST_KEY: Final = 40  # a longer key moves only its own value to the right


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    add_json_argument(parser, "everything")
    add_link_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Ask the device and print; returns the exit code."""
    with connect(args) as client:
        functions, no_map = client.functions, client.map_problem
        interface, problem = client.interface, client.interface_problem
        descriptors = client.transducers.descriptors
        transducers_problem = client.transducers_problem
        properties: dict[str, str] = {}
        room, clock, unreadable = None, None, None
        try:
            properties = client.properties
            room = client.room
            clock = _clock(client)
        except j2a.J2AError as error:
            unreadable = error
        counters = client.counters
    code = OK if unreadable is None else exit_code(unreadable) or REMOTE
    facts = {
        "url": args.url,
        "name": properties.get("name"),
        "spec": None if unreadable else properties.get(PROP_SPEC, "1.0"),
        "rxbuf": _number(properties.get(PROP_RXBUF, "")),
        "room": room,
        "functions": {name: int(opcode) for name, opcode in functions.items()},
        "interface": interface and interface_facts(interface),
        "transducers": descriptors and [transducer_facts(one) for one in descriptors.transducers],
        "transducer_types": descriptors and [str(one) for one in descriptors.types],
        "clock": clock and dataclasses.asdict(clock),
        "properties": None if unreadable else properties,
        "counters": dataclasses.asdict(counters),
    }
    if unreadable is not None:
        facts["error"] = error_facts(unreadable, code)
    if problem:
        facts["interface_problem"] = problem
    if transducers_problem:
        facts["transducers_problem"] = transducers_problem
    if args.json:
        show_json(facts)
    else:
        _print_head(facts, PROP_SPEC in properties)
        if clock is not None:
            show(f"clock     {_clock_text(clock)}")
        show("functions" if functions else f"functions (none: {no_map}; call by opcode)")
        for function in functions.values():
            show(f"  {function.opcode:>3}  {function.__doc__}")
        for line in _descriptions(interface, descriptors):
            show(line)
        reason = "(none)" if functions else "(not known without a map)"
        if unreadable:
            reason = "(unreadable)"
        show("properties" if properties else f"properties {reason}")
        for line in columns(properties):
            show(f"  {line}")
        show("link")
        show(f"  {counters_text(counters)}")
    if problem:
        note(f"j2a: the interface of the device is not used: {problem}")
    if transducers_problem:
        note(f"j2a: the transducers of the device are not used: {transducers_problem}")
    if unreadable is not None:
        note(f"j2a: the properties are unreadable: {unreadable}")
    return code


def _clock(client: j2a.Client) -> ClockReading | None:
    """Return what the clock of the device is like; None without one that a host can set."""
    if CLOCK not in client.functions:
        return None
    try:
        return client.clock.measure(_ROUNDS)
    except j2a.J2AError as error:
        note(f"j2a: the clock of the device tells nothing: {error}")
        return None


def _clock_text(clock: ClockReading) -> str:
    text = f"{clock.state}, {offset_text(clock.offset_us)}"
    if clock.epoch:
        text += f", epoch {clock.epoch}"
    return f"{text} from this computer (+-{time_text(clock.uncertainty_us)})"


def _descriptions(interface: Interface | None, descriptors: Descriptors | None) -> Iterator[str]:
    """Yield the SIFs, the transducers and the types that a device describes, as lines."""
    types: list[object] = []
    if interface is not None:
        types += interface.types
        if interface.sifs:
            yield "SIFs"
            yield from (f"  {str(sif).removeprefix('sif ')}" for sif in interface.sifs)
    if descriptors is not None:
        types += [one for one in descriptors.types if one not in types]
        if descriptors.transducers:
            yield from overview(descriptors)
    if types:
        yield "types"
        yield from (f"  {one}" for one in types)


def interface_facts(interface: Interface) -> dict[str, object]:
    """Return what a device describes, as JSON."""
    return {
        "functions": [
            {
                "name": one.name,
                "opcode": opcode,
                "signature": None if one.signature is None else str(one.signature),
                "many": one.is_many,
                "content": None if one.content is None else str(one.content),
                "idempotent": one.idempotent,
                "slow_ms": one.slow_ms,
                "doc": one.doc,
            }
            for opcode, one in enumerate(interface.functions)
        ],
        "sifs": [
            {
                "name": one.name,
                "opcode": one.opcode,
                "fields": [str(field) for field in one.fields],
                "doc": one.doc,
            }
            for one in interface.sifs
        ],
        "types": [str(one) for one in interface.types],
    }


def _print_head(facts: dict[str, object], says_spec: bool) -> None:
    if facts["properties"] is None:
        return  # all of it comes from the properties
    assumed = "" if says_spec else "   (does not say; assumed)"
    rxbuf = facts["rxbuf"]
    show(f"name      {facts['name'] or '(has none)'}")
    show(f"spec      {facts['spec']}{assumed}")
    says = counted(rxbuf, "byte") if rxbuf else "(does not say; one request at a time)"
    show(f"rxbuf     {says}")
    show(f"room      {counted(facts['room'], 'byte')} of payload in a request")


def _number(text: str) -> int | None:
    """Return what a property says in decimal; None where it says nothing of use (J2A-LIMIT-009)."""
    is_number = text.isascii() and text.isdecimal() and len(text) <= MAX_DIGITS
    return int(text) if is_number else None


def columns(properties: Mapping[str, str]) -> Iterator[str]:
    """Yield properties as lines, with the values one below the other."""
    shown = [(printable(key), value) for key, value in properties.items()]
    width = min(max((len(key) for key, _ in shown), default=0), WIDEST_KEY)
    for key, value in shown:
        yield f"{key:<{width}}  {value}"


def counters_text(counters: j2a.Counters) -> str:
    """Return the counters that are not 0, in words."""
    counts = dataclasses.asdict(counters)
    shown = [f"{name.replace('_', ' ')} {count}" for name, count in counts.items() if count]
    return ", ".join(shown)
