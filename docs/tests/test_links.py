"""Links between the Markdown files lead to a file and a heading, also when read on GitHub."""

import re
from collections import Counter
from pathlib import Path
from urllib.parse import unquote

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted(
    path.relative_to(ROOT).as_posix()
    for pattern in ("README.md", "CONTRIBUTING.md", "spec/*.md", "docs/**/*.md")
    for path in ROOT.glob(pattern)
    if not {"_build", "requirement"} & set(path.parts)  # what a build of the documentation makes
)
FENCE = re.compile(r"^ *(`{3,}|:{3,}|~{3,}).*?^ *\1[`:~]* *$", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"\]\(<?([^)\s>]+)>?(?: +\"[^\"]*\")?\)")
CODE = re.compile(r"(`+)(?!`).*?(?<!`)\1(?!`)", re.DOTALL)
INCLUDE = "```{include}"
SCHEME = re.compile(r"[a-z]+:")


def prose(text: str) -> str:
    """Return a text without its blocks of code."""
    return FENCE.sub("", text)


def slugs(text: str) -> set[str]:
    """Return the anchors that GitHub gives the headings of a text."""
    seen: Counter[str] = Counter()
    found = set()
    for title in re.findall(r"^#{1,6} +(.+?)(?: +#+)? *$", prose(text), re.MULTILINE):
        shown = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", title)
        slug = re.sub(r"[^\w\- ]", "", shown.lower()).replace(" ", "-")
        found.add(f"{slug}-{seen[slug]}" if seen[slug] else slug)
        seen[slug] += 1
    return found


def broken(page: Path) -> list[str]:
    """Return the links of a page that lead nowhere."""
    found = []
    for link in LINK.findall(CODE.sub("", prose(page.read_text()))):
        if SCHEME.match(link):
            continue
        name, _, anchor = unquote(link).partition("#")
        target = page.parent / name if name else page
        if not target.exists() or ROOT not in target.resolve().parents:
            found.append(link)
            continue
        text = target.read_text() if target.suffix == ".md" else ""
        # GitHub shows no included file: link to that one, docs/_ext/included_pages.py leads back.
        if text.startswith(INCLUDE) or (anchor and anchor not in slugs(text)):
            found.append(link)
    return found


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_to_a_file_and_a_heading(page):
    assert broken(ROOT / page) == []
