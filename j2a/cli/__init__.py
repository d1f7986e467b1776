"""The command line `j2a`.

In: the arguments of the program. Out: its exit code; see `j2a.cli._exit`.
Rules: each command is a module of its own that is imported when it is used; results go to standard
output, everything else to standard error; nothing here knows more of J2A than the library tells.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections.abc import Sequence
from difflib import get_close_matches
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final, NoReturn

from j2a.cli._exit import (
    EXIT_CODES,
    INTERRUPTED,
    OUTPUT_CLOSED,
    USAGE,
    UsageError,
    error_facts,
    exit_code,
    exit_codes_help,
    is_of_a_file,
)
from j2a.cli._output import drop_output, finish_output, note, prepare_output, show, show_json

if TYPE_CHECKING:
    from _typeshed import SupportsWrite

__all__ = ["EXIT_CODES", "main"]

_COMMANDS: Final = {
    "list": "USB boards and serial ports of this computer",
    "setup": "prepare this computer for USB boards: a rule for udev",
    "info": "what a device is and can do",
    "call": "call a function",
    "read": "read from a function that transfers data of any size (a2jMany)",
    "write": "write to a function that transfers data of any size (a2jMany)",
    "props": "the properties of a device, or one of them",
    "echo": "test a link: send bytes there and back, verify and time them",
    "watch": "print the frames that a device sends unasked (SIFs)",
    "debug": "print the debug text of a device",
    "serve": "be a device: the demo, or one written in Python",
    "sim": "run firmware for an AVR in the simulator, by its UART or USB",
}
_URLS: Final = """\
a device is named by its URL:
  usb://                              the USB board, if there is one; j2a list shows all
  serial:///dev/ttyACM0?baud=115200   a serial port
  bt://00:11:22:33:44:55              a Bluetooth device
  tcp://127.0.0.1:5000                a TCP connection
  exec:./firmware                     a program, by its standard input and output
  pty:./firmware                      a program, on a pseudo terminal"""


class _Parser(argparse.ArgumentParser):
    """Says how to get help when it refuses."""

    def error(self, message: str) -> NoReturn:
        """Refuse the arguments."""
        raise UsageError(message, f"try: {self.prog} --help")

    def print_help(self, file: SupportsWrite[str] | None = None) -> None:
        """Print the help; argparse itself would not tell when that fails."""
        print(self.format_help(), end="", file=file)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program.

    Args:
        argv: the arguments without the program's name; those of the process if not given.

    Returns: the exit code, one of `EXIT_CODES`.
    """
    prepare_output()
    words = sys.argv[1:] if argv is None else list(argv)
    try:
        code = _run(words)
    except SystemExit as stop:  # of argparse, after --help; or of SIGTERM
        code = stop.code if isinstance(stop.code, int) else USAGE
    except KeyboardInterrupt:
        code = INTERRUPTED
    except BrokenPipeError:
        drop_output()
        code = OUTPUT_CLOSED
    except Exception as error:
        known = exit_code(error)
        if known is None:
            raise
        if is_of_a_file(error):
            drop_output()
        code = known
        _report(error, code, as_json="--json" in words)
    return finish_output(code)


def _report(error: Exception, code: int, *, as_json: bool) -> None:
    first, *more = error.args if isinstance(error, UsageError) else [str(error)]
    if isinstance(error, OSError) and is_of_a_file(error):
        first = ": ".join(str(part) for part in (error.filename, error.strerror) if part)
    note(f"j2a: {first}")
    for line in more:
        note(str(line))
    if as_json:
        with contextlib.suppress(OSError):
            show_json({"error": error_facts(error, code)})


def _run(argv: list[str]) -> int:
    name = argv[0] if argv else "--help"
    if name in _COMMANDS:
        command: Any = import_module(f"j2a.cli._{name}")
        what = _COMMANDS[name]
        parser = _Parser(
            prog=f"j2a {name}",
            description=what[0].upper() + what[1:],
            epilog=f"{getattr(command, 'NOTES', '')}\n\n{exit_codes_help()}".strip(),
            formatter_class=argparse.RawDescriptionHelpFormatter,
            allow_abbrev=False,
        )
        command.add_arguments(parser)
        # Options may stand between the words of a payload, which only the second way takes.
        parse = parser.parse_args if name == "sim" else parser.parse_intermixed_args
        code: int = command.run(parse(argv[1:]))
        return code
    if name in ("-h", "--help", "help"):
        for line in _help().splitlines():
            show(line)
        return 0 if argv else USAGE
    if name in ("-V", "--version"):
        from importlib.metadata import version  # noqa: PLC0415 - slow to load, rarely used

        show(f"j2a {version('j2a')}")
        return 0
    if name.startswith("-"):
        raise UsageError(f"{name!r} comes after a command, as in: j2a info URL {name}")
    near = get_close_matches(name, _COMMANDS, n=1)
    hint = f"did you mean {near[0]}?" if near else f"commands are: {', '.join(_COMMANDS)}"
    raise UsageError(f"there is no command {name!r}; {hint}")


def _help() -> str:
    commands = "\n".join(f"  {name:<6} {what}" for name, what in _COMMANDS.items())
    return (
        "usage: j2a COMMAND ...      (j2a COMMAND --help says more; j2a --version)\n\n"
        "Calls functions of microcontrollers, over any byte stream.\n\n"
        f"commands:\n{commands}\n\n{_URLS}\n\n{exit_codes_help()}"
    )
