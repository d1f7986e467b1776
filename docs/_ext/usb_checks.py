"""Sphinx directive `usb-checks`: the list of checks that the USB firmware passes.

What flows in: the list in firmware/tests/usb9. What flows out: a table with a row for each check.
"""

from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

FIRMWARE_TESTS = Path(__file__).resolve().parents[2] / "firmware" / "tests"


def rows() -> list[tuple[str, str, str]]:
    """Return name, section of the USB 2.0 specification and sentence of each check."""
    found: list[tuple[str, str, str]] = import_module("firmware.tests.usb9").rows()
    return found


class UsbChecks(SphinxDirective):
    """The directive."""

    option_spec: ClassVar[dict[str, Any]] = {}

    def run(self) -> list[nodes.Node]:
        """Return the table."""
        for path in (FIRMWARE_TESTS / "usb9").glob("*.py"):
            self.env.note_dependency(str(path))
        heads = nodes.row("", *(_entry(nodes.Text(head)) for head in ("check", "USB 2.0", "what")))
        group = nodes.tgroup(
            "",
            *(nodes.colspec(colwidth=width) for width in (30, 10, 60)),
            nodes.thead("", heads),
            nodes.tbody("", *(_row(*found) for found in rows())),
            cols=3,
        )
        return [nodes.table("", group)]


def _row(name: str, section: str, sentence: str) -> nodes.row:
    return nodes.row(
        "",
        _entry(nodes.literal("", name)),
        _entry(nodes.Text(section)),
        _entry(nodes.Text(sentence)),
    )


def _entry(content: nodes.Node) -> nodes.entry:
    return nodes.entry("", nodes.paragraph("", "", content))


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive."""
    app.add_directive("usb-checks", UsbChecks)
    return {"parallel_read_safe": True}
