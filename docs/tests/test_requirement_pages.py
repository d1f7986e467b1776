"""What the pages of requirements make of texts and of mutants."""

import sys

import pytest

from docs.tests.one_page import EXTENSIONS

sys.path.insert(0, str(EXTENSIONS))

import requirement_pages


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("a_b *c* [d] <e> $f | \\g", r"a\_b \*c\* \[d] \<e> \$f \| \\g"),
        ("calls `a_b[0]` of c_d", r"calls `a_b[0]` of c\_d"),
        ("one ` and a_b", r"one ` and a\_b"),
    ],
)
def test_prose_is_no_markup_and_code_stays(text, shown):
    assert requirement_pages._text(text) == shown


def test_a_mutant_that_nothing_kills():
    mutant = {"id": "core-x", "what": "does not", "killed_by": [], "sources": []}
    assert "Does not. Killed by nothing." in "".join(requirement_pages._mutants([mutant]))
