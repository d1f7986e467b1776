"""The output of the commands.

What flows in: text. What flows out: the same on standard output and standard error. Rules: control
and format characters are escaped, because names, properties and reasons may come from the device; a
note that cannot be written changes no judgement.
"""

import contextlib
import os
import sys
from typing import TextIO

from j2a_spec.printable import printable

__all__ = ["drop_output", "finish_notes", "note", "prepare_output", "show"]


def show(text: object = "", *, flush: bool = False) -> None:
    """Print text of one line or several on standard output."""
    print(printable(str(text), "\n\t"), flush=flush)


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
