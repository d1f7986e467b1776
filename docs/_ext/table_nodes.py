"""Tables of docutils, for the directives of this folder."""

from collections.abc import Iterable

from docutils import nodes


def table(widths: dict[str, int], rows: Iterable[nodes.row], *classes: str) -> nodes.table:
    """Return a table.

    Args:
        widths: the head of each column, with its share of the width.
        rows: those of the body, made by `row`.
        classes: those of the table.
    """
    group = nodes.tgroup(
        "",
        *(nodes.colspec(colwidth=width) for width in widths.values()),
        nodes.thead("", row(*widths)),
        nodes.tbody("", *rows),
        cols=len(widths),
    )
    return nodes.table("", group, classes=list(classes))


def row(*cells: str | Iterable[nodes.Node]) -> nodes.row:
    """Return a row; a cell is a text, or nodes such as paragraphs."""
    contents = ([nodes.paragraph("", cell)] if isinstance(cell, str) else cell for cell in cells)
    return nodes.row("", *(nodes.entry("", *content) for content in contents))
