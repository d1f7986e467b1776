"""Counts have the noun that belongs to them."""

import pytest
from j2a_spec.plural import counted


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((0, "byte"), "0 bytes"),
        ((1, "byte"), "1 byte"),
        ((2, "byte"), "2 bytes"),
        ((1, "batch", "batches"), "1 batch"),
        ((2, "batch", "batches"), "2 batches"),
        ((1, "SIF was", "SIFs were"), "1 SIF was"),
        ((3, "SIF was", "SIFs were"), "3 SIFs were"),
    ],
)
def test_one_is_the_singular(words, said):
    assert counted(*words) == said
