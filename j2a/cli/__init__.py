"""The command line `j2a`.

In: the arguments of the program. Out: its exit code; see `j2a.cli._exit`.
Rules: each command is a module of its own that is imported when it is used; results go to standard
output, everything else to standard error; nothing here knows more of J2A than the library tells.
"""

import argparse
import contextlib
import re
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final, NoReturn

from j2a_spec.nearest import did_you_mean

from j2a.cli import _commands
from j2a.cli._exit import (
    EXIT_CODES,
    INTERRUPTED,
    OUTPUT_CLOSED,
    USAGE,
    UsageError,
    end_on_signals,
    error_facts,
    exit_code,
    exit_codes_help,
    ignore_signals,
    is_of_a_file,
)
from j2a.cli._help import Formatter, fitted, url_list
from j2a.cli._output import (
    drop_output,
    finish_output,
    note,
    prepare_output,
    show,
    show_json,
    show_text,
)

if TYPE_CHECKING:
    from _typeshed import SupportsWrite

__all__ = ["EXIT_CODES", "main"]


_LIKE_AN_OPTION: Final = re.compile(r"unrecognized arguments: (?:.* )?(-[^-\s]\S*).*", re.DOTALL)


class _Parser(argparse.ArgumentParser):
    """Says how to get help when it refuses; ends the help with the URLs of the command, if any."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        # As of Python 3.14: of older ones -1e5 and -1,2 are options, though -1.5 is a value.
        self._negative_number_matcher = re.compile(r"-\.?\d")

    def error(self, message: str) -> NoReturn:
        """Refuse the arguments."""
        if match := re.fullmatch(r"argument .*?(--[\w-]+): expected one argument", message):
            message += f"; one that begins with - is written as in {match[1]}=-1"
        if self._takes_values and (match := _LIKE_AN_OPTION.fullmatch(message)):
            message += f"; a value that begins with - stands behind --, as in: -- {match[1]}"
        raise UsageError(message, f"try: {self.prog} --help")

    @property
    def _takes_values(self) -> bool:
        return any(one.metavar in ("VALUE", "DATA") for one in self._actions)

    def _get_values(self, action: argparse.Action, arg_strings: list[str]) -> Any:
        # Of --size=-- older versions of Python make an empty list, of which no command knows.
        if action.option_strings and arg_strings == ["--"]:
            raise argparse.ArgumentError(action, "expected one argument")
        return super()._get_values(action, arg_strings)

    def format_help(self) -> str:
        """Return the help; the default `url_help`, a function, gives the part about URLs."""
        url_help = self.get_default("url_help")
        return super().format_help() + (f"\n{fitted(url_help())}\n" if url_help else "")

    def print_help(self, _file: "SupportsWrite[str] | None" = None) -> None:
        """Print the help on standard output; argparse itself would not tell when that fails."""
        show_text(self.format_help())


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program.

    Args:
        argv: the arguments without the program's name; None: this is the program itself, with
            those of the process.

    Returns: the exit code, one of `EXIT_CODES`.
    """
    if argv is None:
        end_on_signals()  # now, as each command has something to leave: a link, a file, a program
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
    code = finish_output(code)
    if argv is None:
        ignore_signals()
    return code


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
    found = None if name.startswith("-") else _commands.load(name)
    if found is not None:
        return _run_command(name, *found, argv[1:])
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
    names = _commands.names()
    hint = did_you_mean(name, names) or f"commands are: {', '.join(names)}"
    raise UsageError(f"there is no command {name!r}; {hint}")


def _run_command(name: str, command: _commands.Command, summary: str, argv: list[str]) -> int:
    parser = _Parser(
        prog=f"j2a {name}",
        description=summary[0].upper() + summary[1:],
        epilog=f"{getattr(command, 'NOTES', '')}\n\n{exit_codes_help()}".strip(),
        formatter_class=Formatter,
        allow_abbrev=False,
    )
    command.add_arguments(parser)
    # Options may stand between the words of a payload, which only the second way takes; but it
    # takes no commands of a command, which those of other packages may have.
    own = name in _commands.BUILT_IN
    return command.run((parser.parse_intermixed_args if own else parser.parse_args)(argv))


def _help() -> str:
    summaries = _commands.summaries()
    width = max(map(len, summaries))
    commands = "\n".join(f"  {name:<{width}}  {what}" for name, what in summaries.items())
    return fitted(
        "usage: j2a COMMAND ...      (j2a COMMAND --help says more; j2a --version)\n\n"
        "Calls functions of microcontrollers, over any byte stream.\n\n"
        f"commands:\n{commands}\n\n{url_list()}\n\n{exit_codes_help()}"
    )
