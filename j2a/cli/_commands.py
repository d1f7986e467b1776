"""Which module is which command of `j2a`.

In: the name of a command. Out: its module.
Rules: a module is imported when its command is used, those of other packages also for the list of
commands. They come from the entry-point group `j2a.commands` (name = command, object = a module
with `SUMMARY`, `add_arguments(parser)` and `run(args)`, which returns the exit code; `NOTES` is
printed below its help). The commands of this package cannot be taken over.
"""

import argparse
from collections.abc import Mapping
from importlib import import_module
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, Protocol, cast

from j2a.cli._exit import UsageError
from j2a.errors import LocalError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

ENTRY_POINT_GROUP: Final = "j2a.commands"
BUILT_IN: Final[Mapping[str, str]] = MappingProxyType(
    {
        "list": "list the USB boards and serial ports of this computer",
        "setup": "prepare this computer for USB boards: a rule for udev, and syncd",
        "info": "show what a device is and can do",
        "call": "call a function",
        "read": "read from a function that transfers data of any size (a2jMany)",
        "write": "write to a function that transfers data of any size (a2jMany)",
        "props": "show the properties of a device, or one of them",
        "echo": "test a link: send bytes there and back, verify and time them",
        "watch": "print the frames that a device sends unasked (SIFs)",
        "clock": "compare the clocks of boards with that of this computer, or keep them right",
        "record": "write what the sensors of boards measure into a file",
        "replay": "serve the board of a recording",
        "export": "write the samples of a recording as tables",
        "debug": "print the debug text of a device",
        "transds": "show the sensors and actuators of a board, or of a transds.def",
        "stub": "write a typed Python module for the functions of a board",
        "syncd": "give the boards of this computer one time, as a daemon",
        "sync": "show the state of syncd, plot it, or verify two clocks",
        "completion": "print a script that lets bash, zsh or fish complete j2a",
        "serve": "act as a device: the demo, one written in Python, or virtual sensors",
    }
)


class Command(Protocol):
    """The interface of a command module."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Add the arguments of the command to a parser."""

    def run(self, args: argparse.Namespace) -> int:
        """Run the command; returns the exit code."""


def names() -> tuple[str, ...]:
    """Return the names of all commands, those of other packages last."""
    return (*BUILT_IN, *_others())


def summaries() -> dict[str, str]:
    """Return what each command does, in a few words."""
    found = dict(BUILT_IN)
    for name, point in _others().items():
        try:
            found[name] = point.load().SUMMARY
        except Exception as error:  # of another package: the other commands work without it
            found[name] = f"(does not load: {type(error).__name__}: {error})"
    return found


def load(name: str) -> tuple[Command, str] | None:
    """Import the command of that name; return it and its summary, or None if there is none.

    Raises:
        UsageError: it belongs to another package and cannot be imported.
    """
    if name in BUILT_IN:
        return cast(Command, import_module(f"j2a.cli._{name}")), BUILT_IN[name]
    point = _others().get(name)
    if point is None:
        return None
    try:
        module = point.load()
        return module, module.SUMMARY
    except LocalError as error:  # says what to install
        raise UsageError(f"the command {name!r} does not load: {error}") from None
    except Exception as error:
        package = point.dist.name if point.dist else point.value
        raise UsageError(
            f"the command {name!r} does not load: {type(error).__name__}: {error}",
            f"install the package {package} again, or remove it",
        ) from error


def _others() -> "dict[str, EntryPoint]":
    from importlib.metadata import entry_points  # noqa: PLC0415 - slow to load

    found = {point.name: point for point in entry_points(group=ENTRY_POINT_GROUP)}
    return {name: found[name] for name in sorted(found.keys() - BUILT_IN.keys())}
