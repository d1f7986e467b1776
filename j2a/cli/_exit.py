"""How a command ends.

In: what was raised. Out: an exit code.
Rules: the table `EXIT_CODES` is what `--help` and the documentation print; an error of the user,
the link or the device never shows a traceback.
"""

import contextlib
import signal
from collections.abc import Iterator
from types import FrameType
from typing import Final

import j2a_transports

import j2a

OK: Final = 0
FAILED: Final = 1
USAGE: Final = 2
LINK: Final = 3
TIMEOUT: Final = 4
REMOTE: Final = 5
INTERRUPTED: Final = 130
OUTPUT_CLOSED: Final = 141
HUNG_UP: Final = 129
TERMINATED: Final = 128 + signal.SIGTERM  # 143
_ENDING: Final = [signal.SIGTERM, *filter(None, [getattr(signal, "SIGHUP", None)])]

EXIT_CODES: Final = {
    OK: "done",
    FAILED: "the function reported failure, data came back different, clocks are off, or a "
    "recording, a table or a sink is not whole",
    USAGE: "the command line is wrong, or names what the device or this computer does not have",
    LINK: "the link could not be opened, or was lost",
    TIMEOUT: "no answer in time",
    REMOTE: "the device refused the request, or broke the protocol",
    HUNG_UP: "stopped by SIGHUP, as when its terminal is closed",
    INTERRUPTED: "stopped by Ctrl-C",
    OUTPUT_CLOSED: "the reader of the output went away, as in: j2a watch URL | head -1",
    TERMINATED: "stopped by SIGTERM",
}
_CODES: Final[tuple[tuple[type[Exception], int], ...]] = (
    (j2a.LocalError, USAGE),
    (j2a.LinkError, LINK),
    (j2a.CallTimeout, TIMEOUT),
    (j2a.FunctionFailed, FAILED),
    (j2a.J2AError, REMOTE),
    (j2a_transports.BadUrl, USAGE),
    (j2a_transports.TransportError, LINK),
    (OSError, USAGE),  # of a file, such as standard output on a full disk
)


class UsageError(Exception):
    """An argument of the command line is wrong; the text says how to write it.

    Args:
        lines: what is wrong; further lines say where there is help.
    """

    def __init__(self, *lines: str) -> None:
        super().__init__(*lines)

    def __str__(self) -> str:
        return "; ".join(self.args)


class CommandFailed(Exception):  # noqa: N818 - the name says what happened
    """A command ends without what was asked for, though no call failed.

    Args:
        message: what is missing.
        code: the exit code.
    """

    def __init__(self, message: str, code: int) -> None:
        super().__init__(message)
        self.code = code


@contextlib.contextmanager
def file_errors(failed: str) -> Iterator[None]:
    """Make an error of a file a `UsageError` that begins with what failed, as "cannot read x"."""
    try:
        yield
    except OSError as error:
        raise UsageError(f"{failed}: {error.strerror}") from None


def ending_signals() -> list[int]:
    """Return the signals beside Ctrl-C that are to end a program: `nohup` has SIGHUP ignored."""
    return [number for number in _ENDING if signal.getsignal(number) is not signal.SIG_IGN]


def end_on_signals() -> None:
    """Make SIGTERM and SIGHUP end the program as Ctrl-C does, by an exception.

    It passes every `finally`.
    """
    for number in ending_signals():
        signal.signal(number, _on_signal)


def ignore_signals() -> None:
    """Ignore SIGTERM and SIGHUP: the program ends, and they must not cut the cleaning up short."""
    for number in _ENDING:
        signal.signal(number, signal.SIG_IGN)


def _on_signal(number: int, _frame: FrameType | None) -> None:
    ignore_signals()
    raise SystemExit(128 + number)


def exit_code(error: Exception) -> int | None:
    """Return the exit code for an error, None for one that should not have happened."""
    if isinstance(error, UsageError):
        return USAGE
    if isinstance(error, CommandFailed):
        return error.code
    return next((code for kind, code in _CODES if isinstance(error, kind)), None)


def is_of_a_file(error: Exception) -> bool:
    """Tell whether the system refused a file, such as standard output on a full disk."""
    return isinstance(error, OSError) and not isinstance(error, j2a.J2AError)


def error_facts(error: Exception, code: int) -> dict[str, str | int | None]:
    """Return what `--json` tells of an error.

    Args:
        error: what was raised.
        code: the exit code.

    Returns: `type`, `message`, `exit_code` and `outcome`, which says whether the device may have
        executed the request: not_sent, maybe_executed or answered; None where that is no question.
    """
    outcome = getattr(error, "outcome", None)
    return {
        "type": type(error).__name__,
        "message": str(error),
        "outcome": None if outcome is None else outcome.name.lower(),
        "exit_code": code,
    }


def exit_codes_help() -> str:
    """Return the table of exit codes as lines for `--help`."""
    return "exit codes:\n" + "\n".join(f"  {code:>3}  {text}" for code, text in EXIT_CODES.items())
