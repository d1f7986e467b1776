"""Tables for narrow screens: where the rows hold sentences, a cell can say which column it is of.

What flows in: the tables of a page, resolved. What flows out: the class `prose` for those with a
long row, and in each of their cells but the first the head of its column, as a paragraph `column`.
Rules: j2a.css hides these heads; on a narrow screen it shows them and puts the cells of a row below
each other. Tables of figures stay as they are, and scroll.
"""

from typing import Any

from docutils import nodes
from sphinx.application import Sphinx

LONG = 44
"""Characters in a row from which on it does not fit side by side into 390 pixels."""


def label(app: Sphinx, doctree: nodes.document, _page: str) -> None:
    """Label the cells of all tables with long rows."""
    if app.builder.format != "html":
        return
    for group in doctree.findall(nodes.tgroup):
        rows = [row for body in group.findall(nodes.tbody) for row in body.findall(nodes.row)]
        heads = [
            entry.astext()
            for head in group.findall(nodes.thead)
            for entry in head.findall(nodes.entry)
        ]
        if not any(len(row.astext()) > LONG for row in rows):
            continue
        group.parent["classes"].append("prose")
        for row in rows:
            cells = list(row.findall(nodes.entry))
            for head, entry in zip(heads[1:], cells[1:], strict=False):
                if head and entry.astext():
                    entry.insert(0, nodes.paragraph(head, head, classes=["column"]))


def setup(app: Sphinx) -> dict[str, Any]:
    """Have it done to each page."""
    app.connect("doctree-resolved", label)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
