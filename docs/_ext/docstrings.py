"""Sphinx extension: reads the docstrings of this project as they are meant.

What flows in: docstrings before and after napoleon. What flows out: the same texts, in which
napoleon finds the sections that are written on one line (`Returns: the reply.`), and takes no words
before a colon for the type of an attribute. What stands in backticks becomes a link where it names
something of the reference, and else code; `j2a.Trace` keeps its name in lists of arguments.
"""

import re
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.typing import stringify_annotation

import j2a

ATTRIBUTES = {"attribute", "data", "property"}
TRACE = stringify_annotation(j2a.Trace, "fully-qualified")
ONE_LINE = re.compile(r"(Returns|Raises|Args and raises): (\S.*)")


def sections(lines: list[str]) -> list[str]:
    """Return a docstring whose one-line sections stand as napoleon wants them.

    `Returns:` becomes a section. What follows `Raises:` on its own line refers to another function
    in prose, so it stays prose, one paragraph with the lines that belong to it.
    """
    found: list[str] = []
    head = ""
    for line in lines:
        match = ONE_LINE.match(line)
        if match:
            head = match[1]
            if head == "Returns":
                found += ["Returns:", f"    {match[2]}"]
            else:
                found += ["", f"**{head}** {match[2]}"]
        elif head and head != "Returns" and line.startswith(" "):
            found[-1] += f" {line.strip()}"
        else:
            head = ""
            found.append(line)
    return found


class Hooks:
    """What happens before and after napoleon to each docstring."""

    def __init__(self, app: Sphinx) -> None:
        self._kept: list[str] = []
        app.connect("autodoc-process-docstring", self._before, priority=100)
        app.connect("autodoc-process-docstring", self._after, priority=900)

    def _before(self, *event: Any) -> None:
        lines: list[str] = event[-1]
        lines[:] = sections(lines)
        self._kept = list(lines)

    def _after(self, *event: Any) -> None:
        if event[1] in ATTRIBUTES:
            event[-1][:] = self._kept


def name_trace(app: Sphinx, *_event: Any) -> None:
    """Put the name of the alias where autodoc has written what it stands for."""
    for hints in app.env.current_document.autodoc_annotations.values():
        for argument, hint in hints.items():
            hints[argument] = hint.replace(TRACE, "j2a.Trace")


def as_code(_app: Sphinx, _env: Any, node: Any, shown: nodes.Element) -> nodes.Element | None:
    """Return code for backticks that name nothing; explicit roles are still warned about."""
    return nodes.literal(text=shown.astext()) if node["reftype"] == "obj" else None


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the hooks."""
    Hooks(app)
    app.connect("object-description-transform", name_trace, priority=100)
    app.connect("missing-reference", as_code)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
