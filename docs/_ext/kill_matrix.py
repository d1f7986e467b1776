"""Sphinx directive `kill-matrix`: which mutant breaks which requirement, and which cases notice.

What flows in: conformance/mutants/matrix.json, which `kill.py --write` writes. What flows out: a
sentence with the counts, and a table with a row for each requirement. Rules: nothing is judged
here; a requirement without a mutant shows the reason that is written down for it. CI compares
mutants and exceptions with the tables and sees each mutant killed; the other cases that fail, and
all kills but one, are those of the last `--write`.
"""

import json
from collections import Counter
from pathlib import Path
from typing import Any

from docutils import nodes
from j2a_spec.requirements import Requirement, load
from requirement_ids import link, linked
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from table_nodes import row, table

MATRIX = Path(__file__).resolve().parents[2] / "conformance" / "mutants" / "matrix.json"
TARGETS = {"core": "the C core", "device": "the Python Device", "host": "the Python clients"}


class KillMatrix(SphinxDirective):
    """The directive."""

    def run(self) -> list[nodes.Node]:
        """Return the sentence and the table."""
        self.env.note_reread()
        matrix = json.loads(MATRIX.read_text("utf-8"))
        rows = [_row(requirement, matrix) for requirement in load().values()]
        widths = {"requirement": 20, "mutants and what kills": 80}
        return [nodes.paragraph("", summary(matrix)), table(widths, rows, "requirements")]


def summary(matrix: dict[str, Any]) -> str:
    """Return the counts in a sentence."""
    mutants = matrix["mutants"]
    of = Counter(mutant["id"].partition("-")[0] for mutant in mutants)
    parts = [f"{of[name]} of {title}" for name, title in TARGETS.items() if of[name]]
    killed = sum(bool(mutant["killed_by"]) for mutant in mutants)
    broken = {mutant["requirement"] for mutant in mutants}
    cases = {case for mutant in mutants for case in mutant["killed_by"]}
    return (
        f"{len(mutants)} mutants ({', '.join(parts)}) break {len(broken)} of {len(load())} "
        f"requirements. {killed} are killed, by {len(cases)} cases."
    )


def _row(requirement: Requirement, matrix: dict[str, Any]) -> nodes.row:
    found: list[nodes.Node] = []
    for mutant in matrix["mutants"]:
        if mutant["requirement"] == requirement.id:
            found += _mutant(mutant)
    for entry in matrix["exceptions"]:
        if entry["requirement"] == requirement.id:
            text = f"None of {TARGETS[entry['target']]}: {entry['why']}"
            found.append(nodes.paragraph("", "", *linked(text)))
    if requirement.exception:
        found.append(nodes.paragraph("", f"Not observable: {requirement.exception}"))
    return row([nodes.paragraph("", "", link(requirement.id))], found)


def _mutant(mutant: dict[str, Any]) -> list[nodes.Node]:
    what = nodes.paragraph(
        "", "", nodes.literal("", mutant["id"]), nodes.Text(f" {mutant['what']}")
    )
    killers = f"killed by {', '.join(mutant['killed_by']) or 'nothing'}"
    if others := len(mutant["also"]):
        killers += f"; {others} other cases fail too" if others > 1 else "; 1 other case fails too"
    return [what, nodes.paragraph("", killers, classes=["facts"])]


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive with Sphinx."""
    app.add_directive("kill-matrix", KillMatrix)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
