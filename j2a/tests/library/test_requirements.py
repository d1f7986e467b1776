"""Each requirement that binds hosts alone has a test here that names it."""

import re
from pathlib import Path

from j2a_spec.requirements import load

MARK = re.compile(r"@pytest\.mark\.requirement\(([^)]*)\)")


def marked() -> set[str]:
    """Return the ids that the marks in this folder name."""
    texts = (path.read_text("utf-8") for path in Path(__file__).parent.glob("test_*.py"))
    marks = (ids for text in texts for ids in MARK.findall(text))
    return {name for ids in marks for name in re.findall(r'"([^"]*)"', ids)}


def test_each_requirement_of_hosts_has_a_test():
    due = {r.id for r in load().values() if r.role == "host" and not r.exception}
    assert due
    assert due - marked() == set()


def test_marks_name_requirements():
    assert marked() - set(load()) == set()
