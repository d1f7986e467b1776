"""`j2a-conform matrix`: several runs on one page.

What flows in: reports in JSON. What flows out: a page in HTML.
"""

import argparse
from pathlib import Path

from j2a_conformance._model import HarnessError
from j2a_conformance.reports import _json

from . import _reports
from ._exit import CONFORMANT, UsageError

__all__ = ["add_arguments", "main"]


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    command.description = (
        "Makes one page of several runs. Exit code: 0 written, 3 a file is no report, or the page "
        "cannot be written or would replace one of the reports."
    )
    command.add_argument(
        "reports", nargs="+", type=Path, metavar="FILE.json", help="reports of `run --json`"
    )
    command.add_argument(
        "--html", type=Path, required=True, metavar="FILE", help="write the page here"
    )


def main(args: argparse.Namespace) -> int:
    """Carry the command out; return the exit code.

    Raises:
        HarnessError: a file is no report, a package is missing, or the page cannot be written.
        UsageError: the page would replace a report.
    """
    if args.html.resolve() in {path.resolve() for path in args.reports}:
        raise UsageError(f"the page would replace the report {args.html}; give it another name")
    _reports.check_writable(args.html)
    render = _reports.renderer("matrix", "matrix")
    runs = [_json.read(path) for path in args.reports]
    try:
        args.html.write_bytes(render(runs))
    except OSError as error:
        raise HarnessError(f"cannot write {args.html}: {error.strerror}") from error
    return CONFORMANT
