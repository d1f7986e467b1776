"""Sphinx directives `transport-urls` and `transport-options`: what the transports declare.

What flows in: the declarations of all schemes that are installed, by `j2a_transports.describe`.
What flows out: a table with a row for each scheme, and one with a row for each option of a scheme.

    .. transport-options:: bt listen
"""

from typing import Any

import j2a_transports
from docutils import nodes
from j2a_transports import COMMON_OPTIONS, Option, Scheme, Usage
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from table_nodes import row, table


def options_of(scheme: str = "", use: str = "") -> tuple[Option, ...]:
    """Return the options of a scheme for a use; without a scheme those of all schemes.

    Args:
        scheme: its name.
        use: `open` or `listen`; without it, the first of these that the scheme has.

    Raises:
        ValueError: there is no such scheme, or it has no such use.
    """
    if not scheme:
        return COMMON_OPTIONS
    declared = j2a_transports.describe(scheme)
    usages: list[Usage | None] = [
        getattr(declared, each, None) for each in ([use] if use else ["open", "listen"])
    ]
    for usage in filter(None, usages):
        return usage.options
    raise ValueError(f"{scheme} cannot {use}")


class TransportUrls(SphinxDirective):
    """The directive `transport-urls`."""

    def run(self) -> list[nodes.Node]:
        """Return the table."""
        self.env.note_reread()
        rows = [_url_row(j2a_transports.describe(name)) for name in j2a_transports.schemes()]
        return [table({"URL": 36, "opened": 24, "listening": 24, "needs": 16}, rows)]


class TransportOptions(SphinxDirective):
    """The directive `transport-options`; its arguments are those of `options_of`."""

    optional_arguments = 2

    def run(self) -> list[nodes.Node]:
        """Return the table."""
        self.env.note_reread()
        try:
            options = options_of(*self.arguments)
        except ValueError as error:
            raise self.error(str(error)) from error
        rows = [_option_row(option) for option in options]
        return [table({"option": 14, "meaning": 50, "value": 24, "default": 12}, rows)]


def _url_row(scheme: Scheme) -> nodes.row:
    usages = [usage for usage in (scheme.open, scheme.listen) if usage]
    forms = dict.fromkeys(usage.form for usage in usages)
    examples = dict.fromkeys(url for usage in usages for url in usage.examples)
    needs = [f"extra `{scheme.extra}`"] if scheme.extra else []
    return row(
        [
            _lines([f"`{form}`" for form in forms]),
            _lines([f"`{url}`" for url in examples if url not in forms]),
        ],
        [_text(scheme.open.summary if scheme.open else "")],
        [_text(scheme.listen.summary if scheme.listen else "")],
        [_text(", ".join([*needs, *filter(None, [scheme.system])]))],
    )


def _option_row(option: Option) -> nodes.row:
    default = f"`{option.default}`" if option.default else ""
    return row(
        [_text(f"`{option.name}`")],
        [_text(option.help)],
        [_text(option.takes)],
        [_text(default)],
    )


def _lines(texts: list[str]) -> nodes.line_block:
    return nodes.line_block("", *(nodes.line("", "", *_inline(text)) for text in texts))


def _text(text: str) -> nodes.paragraph:
    return nodes.paragraph("", "", *_inline(text))


def _inline(text: str) -> list[nodes.Node]:
    """Return a text as nodes; what stands in backticks is code."""
    parts = text.split("`")
    return [
        nodes.literal("", part) if at % 2 else nodes.Text(part) for at, part in enumerate(parts)
    ]


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directives with Sphinx."""
    app.add_directive("transport-urls", TransportUrls)
    app.add_directive("transport-options", TransportOptions)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
