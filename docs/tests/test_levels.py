"""The pages that list the levels of conformance list those of the specification."""

import re
from pathlib import Path

import pytest
from j2a_spec.capabilities import LEVELS

ROOT = Path(__file__).parents[2]
LISTS = {
    "docs/glossary.md": r"device claims to meet: (.*)\.",
    "conformance/README.md": r"only the cases of these levels: (.*) \|",
}


@pytest.mark.parametrize("page", LISTS)
def test_a_page_lists_every_level(page):
    match = re.search(LISTS[page], (ROOT / page).read_text("utf-8"))
    assert match
    assert match[1].replace("`", "").split(", ") == list(LEVELS)
