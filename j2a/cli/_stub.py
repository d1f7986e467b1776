"""`j2a stub`: write a module for the boards of one interface.

In: a board, or the functions.def of its firmware. Out: a typed module of Python; or the same as
JSON, or as a header with opcodes, enumerations and structures for a host program in C.
"""

import argparse
import json
import zlib
from pathlib import Path
from typing import Final

from j2a_spec.plural import counted

from j2a.cli._exit import OK, UsageError, file_errors
from j2a.cli._files import write_files
from j2a.cli._info import interface_facts
from j2a.cli._link import (
    add_condition_arguments,
    add_link_arguments,
    conditions_of,
    connect_to_source,
    is_file,
)
from j2a.cli._output import show, show_text
from j2a.errors import SignatureError
from j2a.io.transds_file import read_source
from j2a.types.definition_file import interface_text, read_definition_file
from j2a.types.header import c_header
from j2a.types.model import Interface
from j2a.types.stub import python_module

NOTES: Final = """\
examples:
  j2a stub serial:///dev/ttyACM0 -o board.py
  j2a stub firmware/functions.def -o board.h
  j2a stub firmware/functions.def -D HAS_ADC=1 -o board.py

board.py has a class with a method for each function. It refuses boards with another interface.
A functions.def is read as for a build with all parts, and with transducers where a transds.def
lies beside it, so its hash is that of such a board."""
_SUFFIXES: Final = (".py", ".json", ".h")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    add_link_arguments(
        parser, metavar="SOURCE", about="the URL of a device, or the functions.def of its firmware"
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="FILE",
        help="what to write: .py, .json or .h; without it Python goes to standard output",
    )
    add_condition_arguments(parser, "functions.def")


def run(args: argparse.Namespace) -> int:
    """Read the interface, write the file; returns the exit code."""
    suffix = ".py" if args.output is None else args.output.suffix
    if suffix not in _SUFFIXES:
        raise UsageError(f"{args.output}: the name ends in {', '.join(_SUFFIXES)}")
    interface, digest, source = _interface(args)
    if suffix == ".py":
        text = python_module(interface, digest, source)
    elif suffix == ".h":
        text = c_header(interface, digest, source)
    else:
        facts = {"hash": digest, **interface_facts(interface)}
        text = json.dumps(facts, indent=2, ensure_ascii=False) + "\n"
    if args.output is None:
        show_text(text)
        return OK
    write_files({args.output: text})
    described = sum(line.signature is not None for line in interface.functions)
    functions = counted(described, "function")
    show(f"wrote {args.output}: {functions} of the interface {digest}")
    return OK


def _interface(args: argparse.Namespace) -> tuple[Interface, str, str]:
    """Return the interface, its hash and what to call its source."""
    if is_file(args, "functions.def"):
        path = Path(args.url)
        options = conditions_of(args)
        is_off = options.get("J2A_WITH_TRANSDUCERS") == "0"
        has_transducers = not is_off and path.with_name("transds.def").exists()
        try:
            with file_errors(f"cannot read {path}"):
                text = read_source(path)
            own = interface_text(text, options, has_transducers=has_transducers)
            interface = read_definition_file(text, options, has_transducers=has_transducers)
        except SignatureError as error:
            place = f"{path}:{error.line}:{error.position + 1}"
            raise UsageError(f"{place}: {error.reason}") from None
        return interface, f"{zlib.crc32(own.encode()):08x}", path.name
    if args.define or args.undefine:
        raise UsageError("-D and -U are for a functions.def; a board knows what it is built with")
    with connect_to_source(args) as client:
        if client.interface is None:
            why = client.interface_problem or "the device does not describe its functions"
            raise UsageError(f"{why}; see J2A_FUNCTION in docs/firmware.md")
        return client.interface, client.properties["j2a.interface"], args.url
