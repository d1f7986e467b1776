"""What the table of mutants says of one."""

import sys

import pytest

from docs.tests.one_page import EXTENSIONS

sys.path.insert(0, str(EXTENSIONS))

import kill_matrix


@pytest.mark.parametrize(
    ("killed_by", "also", "said"),
    [
        ([], [], "killed by nothing"),
        (["a", "b"], ["c"], "killed by a, b; 1 other case fails too"),
        (["a"], ["c", "d"], "killed by a; 2 other cases fail too"),
    ],
)
def test_the_cases_that_fail(killed_by, also, said):
    mutant = {"id": "core-x", "what": "does not", "killed_by": killed_by, "also": also}
    _, killers = kill_matrix._mutant(mutant)
    assert killers.astext() == said
