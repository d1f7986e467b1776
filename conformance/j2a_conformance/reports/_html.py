"""The report for people with a browser: one page, failures first.

What flows in: a `Run`. What flows out: HTML, see `_pages`.
"""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, get_args

from j2a_spec import requirements
from j2a_spec.requirements import Level

from j2a_conformance._model import Run, Verdict

from . import _badge
from ._pages import data_url, page
from ._summary import WORST_FIRST, judgement, levels, name, tone
from ._views import CaseView, case_view

__all__ = ["render"]

_FIRST: Final = {
    Verdict.FAILED: "Failed",
    Verdict.KNOWN_DEVIATION: "Known deviations",
    Verdict.NON_STRICT: "Not strict",
}
"""The verdicts that have a part of their own before all others."""
_OPEN: Final = 3


@dataclass(frozen=True, slots=True)
class _Group:
    """Cases under a heading, of which the first `open` are shown at once."""

    title: str
    cases: tuple[CaseView, ...]
    verdict: str = ""
    open: int = 0


@dataclass(frozen=True, slots=True)
class _Row:
    id: str
    text: str
    cases: tuple[CaseView, ...]
    counts: tuple[tuple[str, int], ...]


def render(run: Run) -> bytes:
    """Return the page."""
    views = [case_view(result) for result in run.results]
    verdicts = Counter(result.verdict for result in run.results)
    there = [verdict for verdict in WORST_FIRST if verdicts[verdict]]
    matrix = _matrix(views, there)
    others = [view for view in views if view.result.verdict not in _FIRST]
    return page(
        "report.html.j2",
        run=run,
        name=name(run),
        judgement=judgement(run),
        judged=tone(run),
        badge=data_url(_badge.render(run)),
        badge_text=_badge.text(run),
        counts=[(verdict.value, verdicts[verdict]) for verdict in there],
        levels=levels(run),
        first=tuple(_first(views)),
        columns=[verdict.value for verdict in there],
        matrix=matrix,
        untested=len(requirements.load()) - len(matrix),
        groups=tuple(_by_level(others)),
    )


def _first(views: Iterable[CaseView]) -> Iterable[_Group]:
    for verdict, title in _FIRST.items():
        cases = tuple(view for view in views if view.result.verdict is verdict)
        if cases:
            # One fault can fail many cases, so the first is the one to begin with.
            opened = len(cases) if len(cases) <= _OPEN else 1
            yield _Group(title, cases, verdict.value, opened if verdict is Verdict.FAILED else 0)


def _by_level(views: Iterable[CaseView]) -> Iterable[_Group]:
    for level in get_args(Level):
        if cases := tuple(view for view in views if view.result.level == level):
            yield _Group(level, cases)


def _matrix(views: Iterable[CaseView], verdicts: list[Verdict]) -> list[_Row]:
    """Return a row for each requirement that a case tests."""
    tested: dict[str, list[CaseView]] = {requirement: [] for requirement in requirements.load()}
    texts: dict[str, str] = {}
    for view in views:
        for requirement, text in view.rules:
            tested.setdefault(requirement, []).append(view)
            texts[requirement] = text
    return [
        _row(requirement, texts[requirement], cases, verdicts)
        for requirement, cases in tested.items()
        if cases
    ]


def _row(requirement: str, text: str, cases: list[CaseView], verdicts: list[Verdict]) -> _Row:
    found = Counter(view.result.verdict for view in cases)
    counts = tuple((verdict.value, found[verdict]) for verdict in verdicts)
    return _Row(requirement, text, tuple(cases), counts)
