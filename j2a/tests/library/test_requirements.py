"""Each requirement that binds hosts alone has a test of the library that names it."""

import re
from pathlib import Path

from j2a_spec.requirements import load

MARK = re.compile(r"@pytest\.mark\.requirement\(([^)]*)\)")


def marked() -> set[str]:
    """Return the ids that the marks of the library's tests name."""
    files = Path(__file__).parents[1].rglob("test_*.py")
    texts = (path.read_text("utf-8") for path in files)
    marks = (ids for text in texts for ids in MARK.findall(text))
    return {name for ids in marks for name in re.findall(r'"([^"]*)"', ids)}


def test_each_requirement_of_hosts_has_a_test():
    due = {r.id for r in load().values() if r.role == "host" and not r.exception}
    assert due
    assert due - marked() == set()


def test_marks_name_requirements():
    links = {name for name in marked() if name.startswith(("USB-", "SYNC-", "SPP-"))}
    assert marked() - links - set(load()) == set()  # tools/tests/test_links.py has those
