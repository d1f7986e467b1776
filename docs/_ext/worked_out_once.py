"""Sphinx extension: works out once what is the same on many pages, a quarter of a build else.

What flows in: the table of contents that the theme asks for on each page, and the words of each
page. What flows out: the same. Rules: only pages that stand in no table of contents share one, each
folder its own, because only there no entry is marked as the current one.
"""

from functools import cache
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.search.en import SearchEnglish


class English(SearchEnglish):
    """The language of the search; it works out the stem of a word once, not on each page anew."""

    def __init__(self, options: dict[str, str]) -> None:
        super().__init__(options)
        self.stem = cache(super().stem)  # type: ignore[method-assign]


class Contents:
    """The tables of contents of pages that stand in none, by folder and options."""

    def __init__(self) -> None:
        self._known: dict[tuple[object, ...], str] = {}

    def share(
        self, app: Sphinx, page: str, _template: str, context: dict[str, Any], _tree: nodes.Node
    ) -> None:
        """Put a function that remembers in the place of the one that makes the table."""
        make = context["toctree"]

        def remembered(**options: Any) -> str:
            key = (page.rpartition("/")[0], *sorted(options.items()))
            if key not in self._known:
                self._known[key] = make(**options)
            return self._known[key]

        if "orphan" in app.env.metadata.get(page, ()):
            context["toctree"] = remembered


def setup(app: Sphinx) -> dict[str, Any]:
    """Register both, the tables of contents before the theme asks for them."""
    app.add_search_language(English)
    app.connect("html-page-context", Contents().share, priority=100)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
