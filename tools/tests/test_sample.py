"""Of a test that is `sampled(n)`, conftest.py leaves one in n of its parameters to `make test`."""

from pathlib import Path
from types import SimpleNamespace

import pytest

CONFTEST = Path(__file__).parents[2] / "conftest.py"


class Item(SimpleNamespace):
    def __init__(self, nodeid, n=0):
        marks = {"sampled": pytest.mark.sampled(n).mark} if n else {}
        super().__init__(nodeid=nodeid, path=Path(nodeid.partition("::")[0]), marks=marks)

    def get_closest_marker(self, name):
        return self.marks.get(name)

    def add_marker(self, mark):
        self.marks[mark if isinstance(mark, str) else mark.name] = mark


def test_the_first_and_every_nth_behind_it_are_the_sample(pytestconfig):
    plugins = pytestconfig.pluginmanager.get_plugins()
    conftest = next(one for one in plugins if getattr(one, "__file__", "") == str(CONFTEST))
    items = [
        *(Item(f"a/test_b.py::test_c[{value}]", 3) for value in "0123456"),
        Item("a/test_b.py::test_d[0]", 3),
        Item("a/test_b.py::test_e"),
    ]
    conftest.pytest_collection_modifyitems(items)
    left_out = [item.nodeid[-2] for item in items if "exhaustive" in item.marks]
    assert left_out == ["1", "2", "4", "5"]
