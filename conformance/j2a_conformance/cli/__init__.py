"""The command line `j2a-conform`.

What flows in: arguments. What flows out: reports, and an exit code of `_exit`. Rules: each command
is a module of its own, with `add_arguments(parser)` and `main(args)`, named in the table below and
imported when it is used; SIGTERM ends the program in order, with all that was started.
"""

import argparse
import signal
import sys
import traceback
from collections.abc import Sequence
from importlib import import_module
from types import FrameType, ModuleType
from typing import Final, NoReturn

from j2a_conformance._model import HarnessError

from ._exit import HARNESS, INTERRUPTED, UsageError
from ._output import drop_output, finish_notes, note, prepare_output

__all__ = ["main"]

_COMMANDS: Final = {
    "run": "judge a device",
    "compare": "what changed from one run to another",
    "matrix": "several runs on one page",
    "host": "judge a host",
    "selftest": "what a device's test of itself found",
    "faults": "judge a device behind a link that damages bytes",
}


_ended_by: Final[list[int]] = []
"""The signal that ended the program in place of Ctrl-C."""


class _Parser(argparse.ArgumentParser):
    """Bad arguments say nothing about a device: exit code 3, not argparse's 2."""

    def error(self, message: str) -> NoReturn:
        note(f"{self.format_usage()}{self.prog}: {message}")
        sys.exit(HARNESS)


def _module(name: str) -> ModuleType:
    return import_module(f".{name}", __name__)


def _parser(words: Sequence[str]) -> tuple[_Parser, _Parser | None]:
    """Return the parser, with the arguments of the one command that is asked for, and its own."""
    parser = _Parser(
        prog="j2a-conform",
        description="Tests devices and hosts against the specification of J2A.",
    )
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    chosen = None
    for name, text in _COMMANDS.items():
        command = commands.add_parser(name, help=text)
        if name in words[:1]:
            _module(name).add_arguments(command)
            chosen = command
    return parser, chosen


def _end(number: int, _frame: FrameType | None) -> NoReturn:
    """End like Ctrl-C does; a second signal must not cut that short."""
    signal.signal(number, signal.SIG_IGN)
    _ended_by.append(number)
    raise KeyboardInterrupt


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit code.

    Args:
        argv: the arguments; None: this is the program itself, with those of the process.
    """
    if argv is None:
        signal.signal(signal.SIGTERM, _end)
    prepare_output()
    words = sys.argv[1:] if argv is None else list(argv)
    command = args = None
    try:
        parser, command = _parser(words)
        args = parser.parse_args(words)
        status: int = _module(args.command).main(args)
        sys.stdout.flush()
        return 128 + _ended_by[0] if status == INTERRUPTED and _ended_by else status
    except UsageError as error:
        assert command is not None
        command.error(str(error))
    except HarnessError as error:
        note(f"j2a-conform: {error}")
    except KeyboardInterrupt:
        note("j2a-conform: interrupted")
        return 128 + _ended_by[0] if _ended_by else INTERRUPTED
    except BrokenPipeError:  # the reader of the output has closed it
        drop_output()
    except OSError as error:  # of standard output: a full disk, or it is closed
        drop_output()
        note(f"j2a-conform: cannot write the output: {error.strerror}")
    except Exception as error:
        verbose = getattr(args, "verbose", None)  # None: the command has no -v
        if verbose:
            traceback.print_exc()
        notes = getattr(error, "__notes__", [])  # the runner names the case
        where = f" {notes[-1]}" if notes else ""
        hint = ", -v shows more" if verbose is False else ""
        what = f"{type(error).__name__}: {error}"
        note(f"j2a-conform: a fault of the suite{where}{hint}: {what}")
        if notes:
            note("This says nothing about the testee: report it, and choose other cases by --case.")
    finally:
        finish_notes()
    return HARNESS
