"""The files that a run leaves: options, and writing them.

What flows in: arguments, and the `Run`. What flows out: files. Rules: what can be known before the
run is: that a package is missing, or that a file cannot be written; and after the run a report that
fails does not keep the others from being written.
"""

import argparse
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any, Final

from j2a_conformance._model import HarnessError, Run

from ._exit import UsageError

__all__ = ["Reports", "add_arguments"]

Render = Callable[[Any], bytes]

_REPORTS: Final = {
    "junit": "a report for build servers, as JUnit XML",
    "json": "all of the run, as JSON; `compare` and `matrix` read it",
    "html": "a page for browsers, in one file",
    "badge": "a badge with the levels that are reached, as SVG",
}


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Declare an option for each kind of report."""
    for name, text in _REPORTS.items():
        command.add_argument(f"--{name}", type=Path, metavar="FILE", help=f"write {text}")


class Reports:
    """The reports that are asked for.

    Args:
        args: arguments, among them those of `add_arguments`.

    Raises:
        HarnessError: a package is missing, or a file cannot be written.
        UsageError: two reports would be written into the same file.
    """

    def __init__(self, args: argparse.Namespace) -> None:
        asked = {name: getattr(args, name) for name in _REPORTS if getattr(args, name)}
        if len({path.resolve() for path in asked.values()}) < len(asked):
            raise UsageError("each report needs a file of its own")
        self._asked = [(name, path, renderer(name, f"--{name}")) for name, path in asked.items()]
        for path in asked.values():
            check_writable(path)

    @property
    def is_asked(self) -> bool:
        """There is a report to write."""
        return bool(self._asked)

    def write(self, run: Run) -> None:
        """Write each report.

        Raises:
            HarnessError: some could not be written; the message says which and why.
        """
        faults = []
        for name, path, render in self._asked:
            try:
                path.write_bytes(render(run))
            except OSError as error:
                faults.append(f"cannot write {path}: {error.strerror}")
            except Exception as error:  # a fault of one report must not cost the others
                faults.append(f"a fault of --{name}: {type(error).__name__}: {error}")
        if faults:
            raise HarnessError("; ".join(faults))


def renderer(name: str, what: str) -> Render:
    """Return `render` of the module `_name`.

    Raises:
        HarnessError: a package is missing that `what` needs.
    """
    try:
        render: Render = import_module(f"j2a_conformance.reports._{name}").render
    except ModuleNotFoundError as error:
        raise HarnessError(f"{what}: {error}; install j2a[conformance]") from error
    return render


def check_writable(path: Path) -> None:
    """Find out now whether the file can be written; it is left as it was.

    Raises:
        HarnessError: it cannot.
    """
    there = path.exists()
    if there and not path.is_file() and not path.is_dir():
        return  # a pipe or a terminal: opening one can wait, or take what is meant for the report
    try:
        path.open("ab").close()
        if not there:
            path.unlink()
    except OSError as error:
        raise HarnessError(f"cannot write {path}: {error.strerror}") from error
