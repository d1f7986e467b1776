"""The output of the commands.

In: lines of text, values for JSON. Out: the same on standard output and standard error.
Rules: whatever is printed is escaped first (`j2a_spec.printable`), because names, properties, text
and error messages may come from the device; a note that cannot be written changes no result; JSON
has no NaN, so numbers that are not finite are the texts "NaN", "Infinity" and "-Infinity".
"""

import contextlib
import io
import json
import math
import os
import sys
from collections.abc import Iterator
from typing import TextIO

from j2a_spec.printable import printable

from j2a.cli._exit import OK, OUTPUT_CLOSED, USAGE
from j2a.cli._values import dump


@contextlib.contextmanager
def _naming_output() -> Iterator[None]:
    """Have an error of writing name what could not be written."""
    try:
        yield
    except OSError as error:
        error.filename = "standard output"
        raise


def show(line: str = "", *, flush: bool = False) -> None:
    """Print one line on standard output."""
    with _naming_output():
        print(printable(line), flush=flush)


def show_text(text: str) -> None:
    """Print text of several lines on standard output as it stands, without a final line feed."""
    with _naming_output():
        sys.stdout.write(printable(text, "\n\t"))
        sys.stdout.flush()


def show_bytes(data: bytes) -> None:
    """Put bytes on standard output as they are, or in hex where that is a terminal."""
    with _naming_output():
        if sys.stdout.isatty():
            for line in dump(data):
                print(line)
        else:
            sys.stdout.buffer.write(data)


def show_json(value: object) -> None:
    """Print a value as JSON, on one line of standard output."""
    with _naming_output():
        print(json.dumps(_finite(value), allow_nan=False), flush=True)


def note(line: str) -> None:
    """Print one line on standard error, if anybody can still read it there."""
    with contextlib.suppress(OSError):
        print(printable(line), file=sys.stderr, flush=True)


def _finite(value: object) -> object:
    if isinstance(value, float) and not math.isfinite(value):
        return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return value


def prepare_output() -> None:
    """Make standard output and standard error usable, also where they are closed.

    Python has None for a descriptor that was closed by `>&-`. Writing to what takes its place
    fails for standard output, as it should, and is forgotten for standard error.
    """
    if sys.stdout is None:
        sys.stdout = _stand_in(os.O_RDONLY)
    if sys.stderr is None:
        sys.stderr = _stand_in(os.O_WRONLY)
    if isinstance(sys.stdout, io.TextIOWrapper):
        # A device may say what the terminal has no letters for.
        sys.stdout.reconfigure(errors="backslashreplace")


def _stand_in(flags: int) -> TextIO:
    return os.fdopen(os.open(os.devnull, flags), "w", errors="backslashreplace")


def finish_output(code: int) -> int:
    """Write what is still buffered; returns the exit code, which tells when that fails."""
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        drop_output()
        code = OUTPUT_CLOSED if code == OK else code
    except OSError as error:
        drop_output()
        note(f"j2a: cannot write the output: {error.strerror}")
        code = USAGE if code == OK else code
    try:
        sys.stderr.flush()
    except OSError:
        _drop(sys.stderr)
    return code


def drop_output() -> None:
    """Forget output that cannot be written."""
    _drop(sys.stdout)


def _drop(stream: TextIO) -> None:
    # Python would try again at exit, and end with a code of its own.
    with contextlib.suppress(OSError, ValueError):  # ValueError: it has no descriptor
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, stream.fileno())
        os.close(null)
