"""Sphinx directive `program-help`: what a command prints for `--help`, asked at build time.

What flows in: the name of a program and the arguments before `--help`. What flows
out: the text, each line with its term and its meaning marked, so that j2a.css can put one below the
other on a narrow screen. Rules: the page cannot differ from the program.

    .. program-help:: j2a call
"""

import html
import io
import os
import re
from contextlib import redirect_stderr, redirect_stdout
from typing import Any
from unittest.mock import patch

import j2a_conformance.cli
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

import j2a.cli

PROGRAMS = {"j2a": j2a.cli.main, "j2a-conform": j2a_conformance.cli.main}
SETTINGS = {"COLUMNS": "88", "NO_COLOR": "1"}
LINE = re.compile(r"( *)(\S.*?)(?:( {2,})(\S.*))?")
CONTINUED = 6
"""Blanks at its start by which a line goes on with what the one before it says."""


def help_text(program: str, *arguments: str) -> str:
    """Return what a program of this project prints for `--help`.

    It runs within this process: some thirty interpreters would be a sixth of the whole build.

    Raises:
        ValueError: it has no such command; the text is what it says of it.
    """
    out, err = io.StringIO(), io.StringIO()
    with patch.dict(os.environ, SETTINGS), redirect_stdout(out), redirect_stderr(err):
        try:
            code: object = PROGRAMS[program]([*arguments, "--help"])
        except SystemExit as stop:
            code = stop.code
    if code:
        raise ValueError(err.getvalue())
    return out.getvalue().rstrip()


def marked_up(text: str) -> str:
    """Return a help text as HTML with the same characters, its lines and their parts marked."""
    items: list[tuple[str, str, str]] = []
    for line in text.split("\n"):
        match = LINE.fullmatch(line)
        indent, term, gap, meaning = match.groups(default="") if match else ("", "", "", "")
        if len(indent) >= CONTINUED and not meaning and items:
            start, before, said = items.pop()
            items.append((start, before, f"{said}{_gap(chr(10) + indent)}{html.escape(term)}"))
        else:
            items.append((_gap(indent), term, f"{_gap(gap)}{html.escape(meaning)}"))
    return "".join(
        f'<span class="line">{start}{html.escape(term)}{_meaning(term, said)}{_gap(chr(10))}</span>'
        for start, term, said in items
    )


def _meaning(term: str, said: str) -> str:
    is_beside = not said or term.startswith("usage:")
    return said if is_beside else f'<span class="meaning">{said}</span>'


def _gap(blanks: str) -> str:
    return f'<span class="gap">{blanks}</span>' if blanks else ""


class ProgramHelp(SphinxDirective):
    """The directive."""

    required_arguments = 1
    optional_arguments = 9

    def run(self) -> list[nodes.Node]:
        """Return the block."""
        self.env.note_reread()
        program, *arguments = self.arguments
        try:
            text = help_text(program, *arguments)
        except ValueError as error:
            raise self.error(f"{' '.join(self.arguments)}: {error}") from error
        page = f'<div class="highlight"><pre class="program-help">{marked_up(text)}</pre></div>'
        return [nodes.raw("", page, format="html")]


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive with Sphinx."""
    app.add_directive("program-help", ProgramHelp)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
