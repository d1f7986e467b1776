"""The reference of the C interface leaves nothing out that its headers declare."""

import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent.parent
sys.path.insert(0, str(ROOT / "docs/_ext"))

import c_api  # noqa: E402

PAGE = (ROOT / "docs/api/firmware.md").read_text("utf-8")


@pytest.mark.parametrize("header", c_api.DOCUMENTED)
def test_each_declaration_is_documented(header: str) -> None:
    assert header in PAGE
    text = re.sub(r"/\*.*?\*/", "", (ROOT / header).read_text("utf-8"), flags=re.DOTALL)
    declared = set(re.findall(r"^\w[\w *]*?\b((?:j2a|board|port)_\w+)\(", text, re.MULTILINE))
    declared |= set(re.findall(r"^#ifndef (J2A_\w+)\n#define \1 ", text, re.MULTILINE))
    opening, parts = c_api.read(ROOT / header)
    found = {part.name: part for part in parts if isinstance(part, c_api.Entry)}
    assert opening
    assert declared
    assert declared <= set(found)
    assert all(len(entry.comment) > 20 for entry in found.values())
