"""Sphinx extension: requirement ids are links, wherever they are written.

What flows in: the doctree of each page. What flows out: the paragraph of SPEC.md that starts with
an id in bold is a target; the same id anywhere else, in prose or in a docstring, links to it; an id
that does not exist is a warning. The directive `requirements-table` lists all of them with the
cases that prove them, and `conformance-cases` lists the cases. The comment `<!-- figure: NAME -->`
in a Markdown file draws that packet figure, in the place of a table that follows it directly.
"""

import re
from collections.abc import Iterator
from itertools import chain
from typing import Any, ClassVar

from docutils import nodes
from docutils.parsers.rst import directives
from j2a_conformance import coverage
from j2a_conformance import load as load_cases
from j2a_conformance._case import BaseCase
from j2a_conformance._coverage import host_coverage
from j2a_conformance.host import START
from j2a_conformance.host import load as load_host_cases
from j2a_spec.requirements import load
from packet_figure import figure
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.transforms import SphinxTransform
from sphinx.util.docutils import SphinxDirective
from table_nodes import row, table

ID = re.compile(r"\bJ2A-[A-Z]+-\d{3}\b")
FIGURE = re.compile(r"<!-- figure: (\S+) -->")
KEPT = (nodes.strong, nodes.reference, addnodes.pending_xref, nodes.literal_block, nodes.title)
WIDTHS = {"id": 20, "requirement": 80}


def link(name: str) -> addnodes.pending_xref:
    """Return a link to the requirement `name`."""
    reference = addnodes.pending_xref(
        "", refdomain="std", reftype="req", reftarget=name, refexplicit=False, refwarn=True
    )
    reference += nodes.literal("", name, classes=["requirement"])
    return reference


def linked(text: str) -> Iterator[nodes.Node]:
    """Yield the text with each requirement id in it replaced by a link."""
    end = 0
    for match in ID.finditer(text):
        if match.start() > end:
            yield nodes.Text(text[end : match.start()])
        yield link(match[0])
        end = match.end()
    if end < len(text):
        yield nodes.Text(text[end:])


class Targets(SphinxTransform):
    """Makes targets of the normative paragraphs and links of all other ids."""

    default_priority = 400

    def apply(self, **_kwargs: Any) -> None:
        """Change the doctree of the page in place."""
        for paragraph in list(self.document.findall(nodes.paragraph)):
            first = next((child for child in paragraph.children if child.astext()), None)
            if isinstance(first, nodes.strong) and ID.fullmatch(first.astext()):
                self._target(paragraph, first.astext())
        for text in list(self.document.findall(nodes.Text)):
            place = text.parent if isinstance(text.parent, nodes.literal) else text
            if ID.search(text) and not isinstance(place.parent, KEPT):
                place.parent.replace(place, list(linked(text)))

    def _target(self, paragraph: nodes.paragraph, name: str) -> None:
        anchor = name.lower()
        paragraph["ids"].append(anchor)
        paragraph["classes"].append("requirement")
        self.document.note_explicit_target(paragraph, paragraph)
        self.env.domains.standard_domain.note_object("req", name, anchor, location=paragraph)


class Figures(SphinxTransform):
    """Draws the packet figures that comments in Markdown files ask for."""

    default_priority = 390

    def apply(self, **_kwargs: Any) -> None:
        """Change the doctree of the page in place."""
        comments = [*self.document.findall(nodes.raw), *self.document.findall(nodes.comment)]
        for comment in comments:
            match = FIGURE.search(comment.rawsource or comment.astext())
            if match:
                self.env.note_reread()
                parent = comment.parent
                after = parent.index(comment) + 1
                if after < len(parent) and isinstance(parent[after], nodes.table):
                    del parent[after]
                parent.replace(comment, figure(match[1], start=match[1] == "packet"))


class RequirementsTable(SphinxDirective):
    """The directive `requirements-table`: every requirement with its level, role and source."""

    def run(self) -> list[nodes.Node]:
        """Return the table, level after level in the order in which they first appear."""
        self.env.note_reread()
        cases, hosts = coverage(), host_coverage()
        levels: dict[str, list[nodes.row]] = {}
        for r in load().values():
            facts = f"Level {r.level}, binds {r.role}, from {r.source}. {_proof(cases[r.id])}"
            if r.role == "both":
                facts += f" For hosts: {hosts[r.id]}."
            more = nodes.paragraph("", "", nodes.Text(f"{facts} "), _page(r.id), classes=["facts"])
            levels.setdefault(r.level, []).append(row([_line(r.id)], [_line(r.text), more]))
        return [table(WIDTHS, chain.from_iterable(levels.values()), "requirements")]


def _page(name: str) -> addnodes.pending_xref:
    """Return a link to the page of a requirement, see requirement_pages.py."""
    page = addnodes.pending_xref(
        "", refdomain="std", reftype="doc", reftarget=f"/spec/requirement/{name}", refexplicit=True
    )
    page += nodes.inline("", "Vectors, cases, mutants, source, results")
    return page


def _proof(cases: str) -> str:
    return (
        cases.replace("no case", "No case", 1)
        if cases.startswith("no case: ")
        else f"Cases: {cases}."
    )


class ConformanceCases(SphinxDirective):
    """The directive `conformance-cases`: every case with what it does, expects and proves.

    With the option `hosts` the cases are those for hosts.
    """

    option_spec: ClassVar[dict[str, Any]] = {"hosts": directives.flag}

    def run(self) -> list[nodes.Node]:
        """Return a definition list."""
        self.env.note_reread()
        hosts = "hosts" in self.options
        cases: tuple[BaseCase, ...] = (
            (START, *load_host_cases(on_demand=True)) if hosts else load_cases()
        )
        return [nodes.definition_list("", *map(_case, cases))]


def _case(case: BaseCase) -> nodes.definition_list_item:
    term = nodes.term("", "", nodes.literal("", case.ID), nodes.Text(f" ({case.LEVEL})"))
    proves = f"Proves {', '.join(case.REQUIREMENTS)}"
    texts = (case.DESCRIPTION, f"Expected: {case.EXPECTATION}", proves)
    return nodes.definition_list_item("", term, nodes.definition("", *map(_line, texts)))


def _line(text: str) -> nodes.paragraph:
    return nodes.paragraph("", "", *linked(text))


def setup(app: Sphinx) -> dict[str, Any]:
    """Register object type, transforms and directive with Sphinx."""
    app.add_object_type("req", "req", objname="requirement")
    app.add_transform(Figures)
    app.add_transform(Targets)
    app.add_directive("requirements-table", RequirementsTable)
    app.add_directive("conformance-cases", ConformanceCases)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
