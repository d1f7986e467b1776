"""Several runs on one page: levels and cases of each, side by side.

What flows in: runs. What flows out: HTML, see `_pages`. Rules: a case that a run does not have is
shown as "not run" where the run knows of it, else as "absent".
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from j2a_spec.capabilities import LEVELS
from j2a_spec.plural import counted
from j2a_spec.requirements import Level

from j2a_conformance._model import Run, Verdict

from ._pages import page
from ._summary import WORST_FIRST, LevelSummary, judgement, levels, name, tone
from ._views import CaseView, case_view

__all__ = ["render"]


@dataclass(frozen=True, slots=True)
class _Column:
    """A run; `cases` are those that are not ok, what needs attention first."""

    id: str
    run: Run
    name: str
    judgement: str
    judged: str
    levels: dict[Level, LevelSummary]
    cases: tuple[CaseView, ...]

    def cell(self, case: str) -> "_Cell":
        """Return what the run says of a case."""
        for view in self.cases:
            if view.result.case == case:
                return _Cell(view.result.verdict.value, view.id)
        if any(result.case == case for result in self.run.results):
            return _Cell(Verdict.OK.value)
        return _Cell("not-run" if case in self.run.not_run else "absent")


@dataclass(frozen=True, slots=True)
class _Cell:
    verdict: str
    anchor: str = ""


@dataclass(frozen=True, slots=True)
class _Row:
    case: str
    description: str
    cells: tuple[_Cell, ...]


def render(runs: Sequence[Run]) -> bytes:
    """Return the page."""
    columns = [_column(number, run) for number, run in enumerate(runs, 1)]
    return page(
        "matrix.html.j2",
        title=counted(len(runs), "run"),
        columns=columns,
        levels=[
            (level, [column.levels.get(level) for column in columns])
            for level in LEVELS
            if any(level in column.levels for column in columns)
        ],
        groups=[(level, rows) for level in LEVELS if (rows := tuple(_rows(level, columns)))],
    )


def _column(number: int, run: Run) -> _Column:
    prefix = f"run-{number}-"
    views = [
        case_view(result, prefix, linked=False)
        for result in run.results
        if result.verdict is not Verdict.OK
    ]
    views.sort(key=lambda view: WORST_FIRST.index(view.result.verdict))
    return _Column(
        id=f"run-{number}",
        run=run,
        name=name(run),
        judgement=judgement(run),
        judged=tone(run),
        levels={entry.level: entry for entry in levels(run)},
        cases=tuple(views),
    )


def _rows(level: Level, columns: Sequence[_Column]) -> Iterator[_Row]:
    """Yield a row for each case of the level that any run has."""
    cases = {
        result.case: result.description
        for column in columns
        for result in column.run.results
        if result.level == level
    }
    for case, description in cases.items():
        yield _Row(case, description, tuple(column.cell(case) for column in columns))
