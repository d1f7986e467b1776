"""The arguments that every command with a device has, and the way to the device.

In: parsed arguments. Out: a connected client.
"""

import argparse
import contextlib
import inspect
import math
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final, TypeVar

import j2a_transports

import j2a
from j2a.cli._exit import UsageError
from j2a.cli._help import listen_help, open_help
from j2a.cli._trace import TracePrinter

if sys.platform != "win32":
    import termios

_Number = TypeVar("_Number", int, float)
TIMEOUT_S: Final = 1.0
_OWN: Final = frozenset(inspect.signature(j2a.connect).parameters)


def add_link_arguments(
    parser: argparse.ArgumentParser,
    *,
    metavar: str = "URL",
    about: str = "the device, such as tcp://127.0.0.1:5000",
) -> None:
    """Add the URL, or what a command takes in its place, and the options of a link.

    Args:
        parser: of the command.
        metavar: what stands for the URL in the help; it is `args.url` all the same.
        about: what the help says of it.
    """
    parser.add_argument("url", metavar=metavar, help=about)
    add_link_options(parser)


def add_link_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of a link."""
    parser.set_defaults(url_help=open_help)
    group = parser.add_argument_group("link")
    group.add_argument(
        "--timeout",
        type=seconds,
        metavar="S",
        help="time limit of a call, or of each chunk of a transfer, in seconds, or inf (1, and "
        "for a call what the device says that it may take)",
    )
    group.add_argument(
        "--boot-time",
        type=seconds,
        default=5.0,
        metavar="S",
        help="for how long to try to reach a board that may still boot, in seconds (5)",
    )
    group.add_argument(
        "--baud",
        type=whole_number(1),
        metavar="N",
        help="speed of a serial port; the same as ?baud=N in its URL",
    )
    group.add_argument(
        "-O",
        "--option",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="an option of the URL, see below; may be repeated",
    )
    add_verbose_argument(group)


def add_listen_argument(parser: argparse.ArgumentParser) -> None:
    """Add `--listen`."""
    parser.add_argument(
        "--listen",
        default="tcp://127.0.0.1:0",
        metavar="URL",
        help="where hosts connect, see below (%(default)s: any free port)",
    )
    parser.set_defaults(url_help=listen_help)


def add_verbose_argument(parser: argparse._ActionsContainer) -> None:
    """Add `-v`."""
    parser.add_argument(
        "-v",
        "--verbose",
        action="count",
        default=0,
        help="show the frames on the wire, on standard error; -vv: their bytes too",
    )


def add_json_argument(parser: argparse._ActionsContainer, what: str) -> None:
    """Add `--json`."""
    parser.add_argument(
        "--json",
        action="store_true",
        help=f"print {what} as JSON; an error is printed as JSON too",
    )


def add_condition_arguments(parser: argparse.ArgumentParser, file: str) -> None:
    """Add `-D` and `-U`, which decide the conditions of a file of macros."""
    parser.add_argument(
        "-D",
        "--define",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help=f"what a name stands for in the conditions of a {file}; without VALUE 1",
    )
    parser.add_argument(
        "-U",
        "--undefine",
        action="append",
        default=[],
        metavar="NAME",
        help="treat NAME as undefined",
    )


def conditions_of(args: argparse.Namespace) -> dict[str, str | None]:
    """Return what `-D` and `-U` say names stand for, None for nothing.

    Raises:
        UsageError: what stands there is no name of C.
    """
    for one in args.undefine:
        _check_name("-U", one, one)
    options: dict[str, str | None] = dict.fromkeys(args.undefine)
    for one in args.define:
        name, is_given, value = one.partition("=")
        _check_name("-D", name, one)
        options[name] = value if is_given else "1"
    return options


def _check_name(option: str, name: str, text: str) -> None:
    if not re.fullmatch(r"[A-Za-z_]\w*", name, re.ASCII):
        raise UsageError(f"{option} {text!r}: {name!r} is no name, as HAS_ADC is")


def add_progress_argument(parser: argparse.ArgumentParser) -> None:
    """Add `--no-progress`."""
    parser.add_argument(
        "--no-progress",
        action="store_true",
        help="draw no progress bar (the default without a terminal)",
    )


def connect(args: argparse.Namespace, url: str | None = None) -> j2a.Client:
    """Open the link that the arguments describe.

    Args:
        args: of the command line.
        url: of the device; `args.url` if it is not given.

    Raises:
        UsageError: an option is wrong.
        J2AError: as `j2a.connect`.
    """
    url = args.url if url is None else url
    options: dict[str, object] = {} if args.baud is None else {"baud": args.baud}
    for option in args.option:
        name, equals, value = option.partition("=")
        if not equals or not name:
            raise UsageError(f"-O {option}: an option is written NAME=VALUE, as in -O baud=57600")
        if name in options:
            raise UsageError(f"-O {option}: {name} is given twice")
        if name in _OWN:
            raise UsageError(f"-O {option}: {name} is no option of a URL; see --help")
        options[name] = value
    if url.endswith(".mcap") and ":" not in url:
        raise UsageError(f"{url} is a recording: j2a replay makes a board of it, and tells its URL")
    return j2a.connect(
        url,
        timeout=TIMEOUT_S if args.timeout is None else args.timeout,
        boot_time=args.boot_time,
        trace=TracePrinter(raw=args.verbose > 1) if args.verbose else None,
        **options,  # type: ignore[arg-type]  # the names of other parameters were refused
    )


@contextlib.contextmanager
def telling_transducers(client: j2a.Client, name: str) -> Iterator[None]:
    """Where a name is that of a transducer and of no function, say what it is good for.

    Args:
        client: of the board.
        name: what the command line calls a function.
    """
    try:
        yield
    except j2a.UnknownFunction:
        found = client.transducers.get(name)
        if found is None:
            raise
        if isinstance(found, j2a.Sensor):
            hint = f"a sensor and no function: j2a watch {client.url} {name} prints its samples"
        else:
            hint = "an actuator and no function: j2a view has a slider for it, and Python "
            hint += f"board.transducers[{name!r}].set()"
        raise j2a.UnknownFunction(f"{name} is {hint}") from None


def is_file(args: argparse.Namespace, name: str) -> bool:
    """Tell whether SOURCE is a file of firmware rather than the URL of a board.

    Args:
        args: of the command line.
        name: of such a file.

    Raises:
        UsageError: it is a folder.
    """
    if args.url and Path(args.url).is_dir():
        raise UsageError(f"{args.url} is a folder: name a {name} in it, or the URL of a board")
    return args.url.endswith(".def") or ("://" not in args.url and Path(args.url).is_file())


def connect_to_source(args: argparse.Namespace) -> j2a.Client:
    """Open the link to a SOURCE that is no file; raises as `connect`."""
    try:
        return connect(args)
    except j2a.BadUrl as error:
        if ":" in args.url:
            raise
        raise UsageError(f"there is no file {args.url!r}, and {error}") from None


def takes_stdio(url: str) -> bool:
    """Tell whether a link is that of standard input and output."""
    try:
        return j2a_transports.innermost(url)[1].takes_stdio
    except j2a_transports.TransportError:  # to use it will say what is wrong
        return False


def check_listen_url(url: str) -> None:
    """Refuse to speak J2A to somebody at a keyboard, who could not leave: Ctrl-C is a byte there.

    Raises:
        UsageError: it is standard input, and that is a terminal for people; a program sets its own
            to raw mode.
    """
    if not takes_stdio(url) or sys.platform == "win32":
        return
    try:
        is_typed_at = bool(termios.tcgetattr(0)[3] & termios.ICANON)
    except (termios.error, OSError):  # no terminal, or closed
        return
    if is_typed_at:
        raise UsageError(
            f"--listen {url} is a terminal here, where Ctrl-C would be one more byte; "
            "listen somewhere else, see --help, or let another program start this one by its pipes"
        )


def function_of(text: str) -> str | int:
    """Return the opcode that a text is, decimal or 0x.., or else the text, which is a name.

    Raises:
        UsageError: it begins as a number and is none, such as 010.
    """
    try:
        return int(text, 0)
    except ValueError:
        if text[:1].isdigit():
            raise UsageError(
                f"{text!r} is no opcode: write it as 10 or 0x0A, "
                "also for a function whose name begins with a digit"
            ) from None
        return text


def seconds(text: str) -> float:
    """Read a time above 0, or inf."""
    value = _read(float, text, "a number of seconds")
    if not value > 0:
        raise argparse.ArgumentTypeError(f"must be greater than 0, not {text}")
    return value


def finite_seconds(text: str) -> float:
    """Read a time above 0."""
    value = seconds(text)
    if value == math.inf:
        raise argparse.ArgumentTypeError("the time must have an end")
    return value


def finite_number(text: str) -> float:
    """Read a number, of either sign."""
    value = _read(float, text, "a number")
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text} is not finite")
    return value


def positive_number(text: str) -> float:
    """Read a number above 0."""
    value = finite_number(text)
    if value <= 0:
        raise argparse.ArgumentTypeError(f"must be greater than 0, not {text}")
    return value


def whole_number(low: int, high: float = math.inf) -> Callable[[str], int]:
    """Make a reader of whole numbers from `low` to `high`, decimal or 0x..."""

    def read(text: str) -> int:
        value = _read(lambda digits: int(digits, 0), text, "a whole number")
        if not low <= value <= high:
            limit = f"from {low} up" if high == math.inf else f"from {low} to {high}"
            raise argparse.ArgumentTypeError(f"{text} is not {limit}")
        return value

    return read


def _read(convert: Callable[[str], _Number], text: str, what: str) -> _Number:
    try:
        return convert(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not {what}") from None
