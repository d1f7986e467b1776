"""Transducers of a board as a table and as JSON, for `j2a info` and `j2a transds`.

In: descriptors. Out: lines, and what JSON has of a transducer.
"""

from collections.abc import Iterator, Sequence
from typing import Final

from j2a_spec.printable import printable

from j2a.types.transducers import Descriptors, Transducer

_COLUMNS: Final = ("name", "kind", "type", "unit", "channels", "model", "period", "topic")
"""The most important ones come first."""
_INDENT: Final = 2
_WIDTH: Final = 80 - _INDENT


def aligned(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """Yield rows of cells as lines with the cells of a column one below the other."""
    shown = [[printable(cell) for cell in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(*shown, strict=True)]
    for row in shown:
        cells = (cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        yield "  ".join(cells).rstrip()


def overview(descriptors: Descriptors) -> list[str]:
    """Return a heading and a table of transducers, which fits into 80 columns when indented by 2.

    Columns that say nothing are left out; the heading names those that are too many.
    """
    cells = [_cells(one) for one in descriptors.transducers]
    said = [column for column in zip(_COLUMNS, *cells, strict=True) if any(column[1:])]
    lines: list[str] = []
    left_out: list[str] = []
    while not lines or (len(said) > 1 and max(map(len, lines)) > _WIDTH):
        if lines:
            left_out.insert(0, said.pop()[0])
        lines = list(aligned(list(zip(*said, strict=True))))
    more = f" (j2a transds also shows: {', '.join(left_out)})" if left_out else ""
    return [f"transducers{more}", *(" " * _INDENT + line for line in lines)]


def _cells(one: Transducer) -> tuple[str, ...]:
    return (
        *(one.name, one.kind, str(one.type).partition(" ")[0]),
        ", ".join(dict.fromkeys(filter(None, one.units.values()))),
        *(str(one.channels), one.model),
        f"{one.period_us / 1000:.12g} ms" if one.period_us else "",
        "" if one.topic == one.name else one.topic,
    )


def transducer_facts(one: Transducer) -> dict[str, object]:
    """Return what JSON has of a transducer."""
    return {
        "kind": one.kind,
        "name": one.name,
        "id": one.id,
        "channels": one.channels,
        "type": str(one.type).partition(" ")[0],
        "unit": one.unit,
        "units": one.units,
        "doc": one.doc,
        "model": one.model,
        "topic": one.topic,
        "scale": one.scale,
        "offset": one.offset,
        "accuracy": one.accuracy,
        "range": one.range,
        "na": one.na,
        "safe": one.safe,
        "period_us": one.period_us,
        "queue": one.queue,
        "enabled": one.is_enabled,
        "decimation": one.decimation,
        "threshold": one.threshold,
        "trigger": one.has_trigger,
        "watchdog_ms": one.watchdog_ms,
        "attributes": dict(one.attributes),
    }
