"""Sphinx directive `program-help`: what a command prints for `--help`, asked at build time.

What flows in: a module that runs with `python -m` and the arguments before `--help`. What flows
out: a literal block that starts with the command. Rules: the page cannot differ from the program.

    .. program-help:: j2a call
"""

import os
import subprocess
import sys
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

MODULES = {"j2a": "j2a", "j2a-conform": "j2a_conformance"}
COLUMNS = 88


def help_text(program: str, *arguments: str) -> str:
    """Return what a program of this project prints for `--help`.

    Raises:
        CalledProcessError: it has no such command.
    """
    return subprocess.run(
        [sys.executable, "-m", MODULES[program], *arguments, "--help"],
        check=True,
        capture_output=True,
        text=True,
        env=os.environ | {"COLUMNS": str(COLUMNS), "NO_COLOR": "1"},
    ).stdout.rstrip()


class ProgramHelp(SphinxDirective):
    """The directive."""

    required_arguments = 1
    optional_arguments = 9

    def run(self) -> list[nodes.Node]:
        """Return the block."""
        program, *arguments = self.arguments
        try:
            text = help_text(program, *arguments)
        except subprocess.CalledProcessError as error:
            raise self.error(f"{' '.join(self.arguments)}: {error.stderr}") from error
        return [nodes.literal_block(text, text, language="text")]


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive with Sphinx."""
    app.add_directive("program-help", ProgramHelp)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
