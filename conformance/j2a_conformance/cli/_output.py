"""The output of the commands.

What flows in: text. What flows out: the same on standard output and standard error. Rules: control
and format characters are escaped, because names, properties and reasons may come from the device; a
note that cannot be written changes no judgement.
"""

import contextlib
import io
import os
import sys
from typing import TextIO

from j2a_spec.printable import printable

__all__ = ["drop_output", "finish_notes", "note", "prepare_output", "show", "show_progress"]


def show(text: object = "", *, flush: bool = False) -> None:
    """Print text of one line or several on standard output."""
    print(printable(str(text), "\n\t"), flush=flush)


def show_progress(text: object, *, must_end: bool) -> None:
    """Print a line at once while a run goes on.

    Args:
        text: the line.
        must_end: the run has a purpose beside its output, so that one that cannot be written does
            not end it; what is shown at its end cannot be written either, and is the error then.
    """
    try:
        show(text, flush=True)
    except OSError:
        if not must_end:
            raise


def note(text: str) -> None:
    """Print text on standard error, if anybody can still read it there."""
    with contextlib.suppress(OSError):
        print(printable(text, "\n\t"), file=sys.stderr, flush=True)


def prepare_output() -> None:
    """Give standard output and standard error a place, also where `>&-` has closed them.

    Writing to what takes the place of standard output fails, as it should.
    """
    if sys.stdout is None:
        sys.stdout = os.fdopen(os.open(os.devnull, os.O_RDONLY), "w")
    if sys.stderr is None:
        sys.stderr = os.fdopen(os.open(os.devnull, os.O_WRONLY), "w")
    # A property of the device may be Greek where the terminal, or a file on Windows, is Latin.
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def finish_notes() -> None:
    """Write what is still buffered of standard error, or forget it."""
    try:
        sys.stderr.flush()
    except OSError:
        _drop(sys.stderr)


def drop_output() -> None:
    """Forget output that cannot be written."""
    _drop(sys.stdout)


def _drop(stream: TextIO) -> None:
    # Python would try again at exit, and end with a code of its own.
    with contextlib.suppress(OSError, ValueError):  # ValueError: it has no descriptor
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, stream.fileno())
        os.close(null)
