"""What reports of `j2a-conform` say of boards.

What flows in: files that `j2a-conform run --json` wrote, and what a board says of itself. What
flows out: words for its badge.
Rule: a report is of a board whose properties are those of the board that was tested, all of them:
name, serial number, version, and with the capability `interface` the hash of the functions.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from j2a import LocalError

if TYPE_CHECKING:
    from j2a_conformance._model import Run

__all__ = ["read_reports", "report_of"]


def read_reports(paths: Iterable[Path]) -> list[Run]:
    """Read reports of devices, the newest one last.

    Raises:
        LocalError: a file cannot be read, or is no report of a device.
    """
    from j2a_conformance._model import HarnessError  # noqa: PLC0415 - few who view boards need it
    from j2a_conformance.reports import _json  # noqa: PLC0415

    try:
        runs = {path: _json.read(path) for path in paths}
    except HarnessError as error:
        raise LocalError(str(error)) from None
    for path, run in runs.items():
        if run.role != "device" or run.claims is None or not run.claims.properties:
            raise LocalError(f"{path} does not say which board was tested: it has no properties")
    return sorted(runs.values(), key=lambda run: run.started)


def report_of(runs: Iterable[Run], properties: Mapping[str, str]) -> dict[str, Any] | None:
    """Return what the newest report of a board says; None where there is none.

    Args:
        runs: of `read_reports`.
        properties: of the board.
    """
    found = None
    for run in runs:
        if run.claims is not None and run.claims.properties == properties:
            from j2a_conformance.reports import _badge, _summary  # noqa: PLC0415 - few need it

            text = f"{_badge.text(run)}, tested {run.started[:10]}"
            found = {"text": text, "tone": _summary.tone(run)}
    return found
