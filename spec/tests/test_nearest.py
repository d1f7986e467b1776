"""A name that is not known is answered with those that are near."""

import pytest
from j2a_spec.nearest import did_you_mean, nearest_or_all


@pytest.mark.parametrize(
    ("asked", "most", "question"),
    [
        ("raed", 1, "did you mean read?"),
        ("rea", 2, "did you mean rear or read?"),
        ("rea", 3, "did you mean rear, read or reset?"),
        ("zzz", 3, ""),
        ("", 3, ""),
    ],
)
def test_the_nearest_are_named(asked, most, question):
    known = ("reset", "read", "rear", "other")
    assert did_you_mean(asked, iter(known), most=most, cutoff=0.5) == question


def test_how_alike_they_must_be():
    assert not did_you_mean("period", ["perhaps"])
    assert did_you_mean("period", ["perhaps"], cutoff=0.3) == "did you mean perhaps?"


@pytest.mark.parametrize(
    ("asked", "known", "says"),
    [
        ("quat", ["quad", "log"], "did you mean quad?"),
        ("servo", ["quad", "log"], "it has: quad, log; ask"),
        ("servo", [], "it has: none; ask"),
    ],
)
def test_all_names_are_told_where_none_is_near(asked, known, says):
    assert nearest_or_all(asked, iter(known), advice="; ask") == says
