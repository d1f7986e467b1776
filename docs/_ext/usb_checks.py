"""Sphinx directive `usb-checks`: the list of checks that the USB firmware passes.

What flows in: the list in firmware/tests/usb9. What flows out: a table with a row for each check.
"""

from importlib import import_module

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from table_nodes import row, table


def rows() -> list[tuple[str, str, str]]:
    """Return name, section of the USB 2.0 specification and sentence of each check."""
    found: list[tuple[str, str, str]] = import_module("firmware.tests.usb9").rows()
    return found


class UsbChecks(SphinxDirective):
    """The directive."""

    def run(self) -> list[nodes.Node]:
        """Return the table."""
        self.env.note_reread()
        found = (
            row([nodes.paragraph("", "", nodes.literal("", name))], section, sentence)
            for name, section, sentence in rows()
        )
        return [table({"check": 30, "USB 2.0": 10, "what": 60}, found)]


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("usb-checks", UsbChecks)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
