"""Sphinx extension: a link to a file that a page includes leads to this page.

What flows in: the source of each page. What flows out: the same, with such links changed. So pages
link to `../spec/SPEC.md`, which has something to read on GitHub too, and not to the page beside
them that only includes it. Rules: a page includes one file by its first line.
"""

import os
import re
from functools import cache
from pathlib import Path

from sphinx.application import Sphinx

INCLUDE = re.compile(r"```\{include\} (\S+)")
LINK = re.compile(r"(?<=\]\()([^)\s#:]+\.md)(?=[)#])")


@cache
def including(docs: Path) -> dict[Path, Path]:
    """Return the page of each file that a page of this folder includes by its first line."""
    pages = {}
    for page in docs.rglob("*.md"):
        if found := INCLUDE.match(page.read_text(encoding="utf-8")):
            pages[(page.parent / found[1]).resolve()] = page
    return pages


def change(app: Sphinx, name: str, source: list[str]) -> None:
    """Change the links of one page."""
    docs = Path(app.srcdir)
    folder = (docs / name).parent
    pages = including(docs)

    def changed(match: re.Match[str]) -> str:
        page = pages.get((folder / match[1]).resolve())
        return match[1] if page is None else Path(os.path.relpath(page, folder)).as_posix()

    source[0] = LINK.sub(changed, source[0])


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the extension with Sphinx."""
    app.connect("source-read", change)
    return {"parallel_read_safe": True}
