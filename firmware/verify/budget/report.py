"""Tables of what was measured and of what has changed, for a terminal or as Markdown.

In: results, limits, changes. Out: text. Rule: the same figures give the same text.
"""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from firmware.verify.budget.builds import METRICS, Build
from firmware.verify.budget.snapshot import Change, Result

__all__ = ["TABLE", "changed", "document", "tables"]

TABLE = Path(__file__).with_name("table.md")
_SIZES = ("flash", "ram", "stack", "bound", "total")
_FOOTPRINT = ("flash", "ram")
_SPEEDS = tuple(metric for metric in METRICS if metric not in _SIZES)
_GROUPS = (
    ("Bytes", "size", _SIZES),
    ("Bytes of the core alone, without port and library", "core", _SIZES),
    ("Cycles", "cycles", _SPEEDS),
    ("Instructions", "counts", _SPEEDS),
)


def _text(value: float | None) -> str:
    return "" if value is None else f"{round(value, 1):.1f}".removesuffix(".0")


def _grid(rows: Sequence[Sequence[str]], markdown: bool) -> str:
    """Rows, of which the first is the heading; all columns but the first two hold numbers."""
    if markdown:
        heading, *body = rows
        rule = ["---" if column < 2 else "--:" for column in range(len(heading))]
        return "\n".join(f"| {' | '.join(row)} |" for row in (heading, rule, *body))
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    lines = []
    for row in rows:
        cells = [
            cell.ljust(width) if column < 2 else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append("  ".join(cells).rstrip())
    return "\n".join(lines)


def tables(builds: Iterable[Build], results: Mapping[str, Result], markdown: bool = False) -> str:
    """All figures; behind a slash the limit, where there is one."""
    chosen = [build for build in builds if build.name in results]
    parts = []
    for title, kind, metrics in _GROUPS:
        group = [build for build in chosen if kind in build.measure]
        shown = [
            metric
            for metric in metrics
            if any(metric in results[build.name].figures for build in group)
        ]
        if not shown:
            continue
        rows = [["build", "what", *(METRICS[metric].title for metric in shown)]]
        for build in group:
            cells = [build.name, build.note]
            for metric in shown:
                text = _text(results[build.name].figures.get(metric))
                limit = build.limit.get(metric)
                cells.append(text if limit is None else f"{text} / {_text(limit)}")
            rows.append(cells)
        parts.append(_part(title, rows, markdown))
        if kind == "size" and len(more := _footprints(chosen, results)) > 1:
            parts.append(_part("Bytes of one transducer, without its driver", more, markdown))
    return "\n\n".join(parts)


def _part(title: str, rows: Sequence[Sequence[str]], markdown: bool) -> str:
    heading = f"**{title}**" if markdown else title
    return f"{heading}\n\n{_grid(rows, markdown)}"


def _footprints(chosen: Sequence[Build], results: Mapping[str, Result]) -> list[list[str]]:
    """What builds take beyond those that lack a transducer of theirs."""
    rows = [["build", "what", *(METRICS[metric].title for metric in _FOOTPRINT)]]
    for build in chosen:
        if build.beside in results:
            own, less = results[build.name].figures, results[build.beside].figures
            differences = [_text(own[metric] - less[metric]) for metric in _FOOTPRINT]
            rows.append([build.name, build.note, *differences])
    return rows


def document(builds: Iterable[Build], results: Mapping[str, Result]) -> str:
    """The committed table.md."""
    compilers = sorted({result.compiler for result in results.values()})
    return (
        "<!-- Made by `python -m firmware.verify.budget.measure --write`. Do not edit. -->\n\n"
        f"{tables(builds, results, markdown=True)}\n\n"
        "Behind a slash stands the limit. Compiled by\n\n"
        + "".join(f"- {compiler}\n" for compiler in compilers)
    )


def changed(found: Sequence[Change], builds: Iterable[Build], markdown: bool = False) -> str:
    """What a change costs, one figure a line."""
    if not found:
        return "No figure has changed."
    limits = {
        (build.name, metric): limit for build in builds for metric, limit in build.limit.items()
    }
    rows = [["build", "figure", "old", "new", "change", "limit"]]
    for change in found:
        if change.old is None or change.new is None:
            difference = "new" if change.old is None else "gone"
        else:
            difference = (
                f"{'+' if change.new > change.old else '-'}{_text(abs(change.new - change.old))}"
            )
        rows.append(
            [
                change.build,
                METRICS[change.metric].title,
                _text(change.old),
                _text(change.new),
                difference,
                _text(limits.get((change.build, change.metric))),
            ]
        )
    return _grid(rows, markdown)
