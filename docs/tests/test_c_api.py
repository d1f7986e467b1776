"""The reference of the C interface leaves nothing out that its headers declare."""

import re
import sys
from pathlib import Path

import pytest

from docs.tests.one_page import EXTENSIONS, build

ROOT = Path(__file__).parent.parent.parent
sys.path.insert(0, str(EXTENSIONS))

import c_api  # noqa: E402

KNOWN = {"j2a_task": "func", "j2a_link": "var", "J2A_ROOM": "macro"}
HEADER = """/* Opening. */

/* ------------------------------ SIFs of one sort ------ */

/* Two of a kind. */
void j2a_one(void);
void j2a_two(void);
"""
PAGE = (ROOT / "docs/api/firmware.md").read_text("utf-8")


@pytest.mark.parametrize("header", c_api.DOCUMENTED)
def test_each_declaration_is_documented(header: str) -> None:
    assert header in PAGE
    text = re.sub(r"/\*.*?\*/", "", (ROOT / header).read_text("utf-8"), flags=re.DOTALL)
    # Functions of j2a_numbers.h that are inline are as the two for u32, whose comments say so.
    declared = set(
        re.findall(r"^(?!J2A_INLINE)\w[\w *]*?\b((?:j2a|board|port)_\w+)\(", text, re.MULTILINE)
    )
    declared |= set(re.findall(r"^#ifndef (J2A_\w+)\n#define \1 ", text, re.MULTILINE))
    opening, parts = c_api.read(ROOT / header)
    found = {part.name: part for part in parts if isinstance(part, c_api.Entry)}
    assert opening
    assert declared
    assert declared <= set(found)
    assert all(len(entry.comment) > 20 for entry in found.values())


def test_the_page_has_the_headers_that_links_lead_to():
    assert re.findall(r"^```\{c-api\} (\S+)$", PAGE, re.MULTILINE) == list(c_api.DOCUMENTED)


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("see j2a_task() and J2A_ROOM-1", "see {c:func}`j2a_task` and {c:macro}`J2A_ROOM`-1"),
        ("sets j2a_link", "sets {c:var}`j2a_link`"),
        ("board_port.c and BOARD_MS", "`board_port.c` and `BOARD_MS`"),
        ("J2A_CALL(name, function)", "`J2A_CALL(name, function)`"),
        ("*length bytes at *is_last", "`*length` bytes at `*is_last`"),
        ("-DJ2A_WITH_SIF=0, `a_name`, core/j2a_port.h", None),
    ],
)
def test_names_in_comments_are_links_or_code(text, shown):
    assert c_api._marked(text, KNOWN) == (shown or text)


def test_what_shares_a_comment_has_it_once(tmp_path):
    (tmp_path / "x.h").write_text(HEADER)
    text, warnings = build(tmp_path, f"# A\n\n```{{c-api}} {tmp_path}/x.h\n```\n", "text")
    assert warnings == ""
    assert text.count("Two of a kind.") == 1
    assert "See j2a_one()." in text or 'See "j2a_one".' in text


def test_a_banner_keeps_its_capitals(tmp_path):
    (tmp_path / "x.h").write_text(HEADER)
    text, _ = build(tmp_path, f"# A\n\n```{{c-api}} {tmp_path}/x.h\n```\n", "text")
    assert "SIFs of one sort" in text
