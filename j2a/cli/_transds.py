"""`j2a transds`: the transducers of a board, or of the transds.def of its firmware.

In: a transds.def or a board. Out: a table; or JSON, and files for ROS, C, Python, for firmware and
to read. Rule: nothing is written unless all of it can be.
"""

import argparse
import contextlib
import os
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final

from j2a_spec.printable import printable

import j2a
from j2a.cli._descriptors import aligned, transducer_facts
from j2a.cli._exit import OK, REMOTE, CommandFailed, UsageError, file_errors
from j2a.cli._files import is_output, write_files, written
from j2a.cli._link import (
    add_condition_arguments,
    add_json_argument,
    add_link_arguments,
    conditions_of,
    connect_to_source,
    is_file,
)
from j2a.cli._output import note, show, show_json
from j2a.io.transds_file import load_transds
from j2a.types.datasheet import data_sheets
from j2a.types.header import transducers_header
from j2a.types.ros import ros1_package, ros2_package
from j2a.types.stub import transducers_module
from j2a.types.transds_file import strange_keys, transds_text
from j2a.types.transducers import Descriptors, Transducer

NOTES: Final = """\
examples:
  j2a transds transds.def                              is it right?
  j2a transds serial:///dev/ttyACM0 --def transds.def  the file for a board that is there
  j2a transds transds.def --ros2 j2a_msgs --html board.html

Messages of ROS have raw values; docs/transducers.md tells what the keys mean."""
_COLUMNS: Final = ("id", "kind", "name", "channels", "type", "model", "more")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    add_json_argument(parser, "everything")
    add_link_arguments(
        parser, metavar="SOURCE", about="the URL of a device, or a transds.def of its firmware"
    )
    files = parser.add_argument_group("what to write")
    for option, metavar, what in (
        ("--ros1", "DIR", "a package of ROS 1, with DIR/msg/NAME.msg for each transducer"),
        ("--ros2", "DIR", "a package of ROS 2, with DIR/msg/Name.msg"),
        ("--def", "FILE", "a transds.def for firmware"),
        ("--c", "FILE", "a C header for host programs"),
        ("--python", "FILE", "a typed Python module for host programs"),
        ("--html", "FILE", "a data sheet of each transducer"),
    ):
        files.add_argument(
            option, type=Path, metavar=metavar, help=what, dest=f"{option.strip('-')}_path"
        )
    add_condition_arguments(parser, "transds.def")


def run(args: argparse.Namespace) -> int:
    """Read, print and write; returns the exit code."""
    others = (args.json, args.c_path, args.def_path, args.python_path, args.html_path)
    are_messages = bool(args.ros1_path or args.ros2_path) and not any(others)
    descriptors, source = read_source(args, are_boards=are_messages)
    files = _distinct(_files(args, descriptors, source), Path(args.url))
    changed = _changed_messages(files)
    if args.json:
        show_json(
            {
                "source": source,
                "types": [str(one) for one in descriptors.types],
                "transducers": [transducer_facts(one) for one in descriptors.transducers],
            }
        )
    elif not files:
        for line in table(descriptors):
            show(line)
    if not descriptors.transducers:
        note(f"j2a: {source} lists no transducers")
    for text in strange_keys(descriptors):
        note(f"j2a: {text}")
    write_files(files)
    tell = note if args.json or any(map(is_output, files)) else show
    for path in files:
        tell(f"wrote {path}")
    for path in changed:
        note(
            f"j2a: {path} was there and said something else; if it was of another board, rename "
            "one of the two transducers or choose another folder"
        )
    return OK


def read_source(args: argparse.Namespace, *, are_boards: bool = False) -> tuple[Descriptors, str]:
    """Return the descriptors of the SOURCE of the command line, and what to call it.

    Args:
        args: of the command line.
        are_boards: as of `load_transds`.

    Raises:
        UsageError: a transds.def is wrong, or SOURCE is a folder, or neither a file nor a URL.
        CommandFailed: the board describes no transducers.
        J2AError: as `j2a.connect`.
    """
    if is_file(args, "transds.def"):
        return read_transds_argument(args.url, conditions_of(args), are_boards=are_boards)
    if args.define or args.undefine:
        raise UsageError("-D and -U are for a transds.def; a board knows what it is built with")
    with connect_to_source(args) as client:
        descriptors = client.transducers.descriptors
        if descriptors is None:
            raise CommandFailed(client.transducers.why, REMOTE)
        return descriptors, args.url


def read_transds_argument(
    path: str, options: Mapping[str, str | None], *, are_boards: bool = False
) -> tuple[Descriptors, str]:
    """Return the transducers of a transds.def of the command line, and its name.

    Args: as `load_transds`.

    Raises:
        UsageError: it is wrong; the text tells file, line and column.
    """
    try:
        with file_errors(f"cannot read {path}"):
            descriptors = load_transds(
                path, options, warn=lambda text: note(f"j2a: {text}"), are_boards=are_boards
            )
        return descriptors, Path(path).name
    except j2a.SignatureError as error:
        place = f"{error.file}:{error.line}:{error.position + 1}"
        raise UsageError(f"{place}: {error.reason}") from None


def _files(
    args: argparse.Namespace, descriptors: Descriptors, source: str
) -> Iterator[tuple[Path, str]]:
    """Yield the path and the text of each file."""
    for folder, package in ((args.ros1_path, ros1_package), (args.ros2_path, ros2_package)):
        if folder is not None:
            for name, text in package(descriptors).items():
                yield folder / name, text
    if args.c_path is not None:
        yield args.c_path, transducers_header(descriptors, source, args.c_path.name)
    for path, make in (
        (args.def_path, _shown_transds_text),
        (args.python_path, transducers_module),
        (args.html_path, data_sheets),
    ):
        if path is not None:
            yield path, make(descriptors, source)


def _shown_transds_text(descriptors: Descriptors, source: str) -> str:
    """Return a transds.def whose texts for people show what is not printable: it is read again."""
    shown = (replace(one, doc=printable(one.doc)) for one in descriptors.transducers)
    return transds_text(replace(descriptors, transducers=tuple(shown)), source)


def _distinct(files: Iterator[tuple[Path, str]], source: Path) -> dict[Path, str]:
    """Return the text of each file by its path.

    Raises:
        UsageError: one would be lost, of two with one path or of what was read.
    """
    found: dict[Path, str] = {}
    real = set()
    for path, text in files:
        if (name := os.path.realpath(path)) in real:
            raise UsageError(f"{path} would be written twice; choose another name")
        with contextlib.suppress(OSError):  # neither needs to be there
            if path.samefile(source):
                raise UsageError(f"{path} is the file that is read; choose another name")
        found[path] = text
        real.add(name)
    return found


def _changed_messages(files: Mapping[Path, str]) -> list[Path]:
    """Return which messages are there already and will say something else."""
    found = []
    for path, text in files.items():
        with contextlib.suppress(OSError):  # writing tells why not
            is_message = path.suffix == ".msg" and path.is_file()
            if is_message and path.read_bytes() != written(text).encode():
                found.append(path)
    return found


def table(descriptors: Descriptors) -> Iterator[str]:
    """Yield the lines of a table of transducers."""
    yield from aligned([_COLUMNS, *map(_row, descriptors.transducers)])
    for definition in descriptors.types:
        yield str(definition)


def _row(one: Transducer) -> tuple[str, ...]:
    more = [
        f"{key} {value}".rstrip()
        for key, value in one.attributes
        if key not in ("prefix", "model") and value != "none"
    ]
    return (
        *(str(one.id), one.kind, one.name, str(one.channels), str(one.type), one.model),
        "; ".join(more),
    )
