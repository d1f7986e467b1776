"""Nothing but the drivers themselves lists the URL schemes: lists come from what they declare."""

import ast
import re
from pathlib import Path

import j2a_transports
import pytest
from j2a_transports import _registry

ROOT = Path(__file__).parents[2]
PACKAGE = Path(j2a_transports.__file__).parent
# A name with a colon is a URL; `faults:...:tcp://...` is one, too.
URL = re.compile(rf"(?<![\w:.])({'|'.join(_registry._DRIVERS)}):(?=[/\w.\"'`?]|\s|$)")
NAMES = {name + end for name in _registry._DRIVERS for end in ("", ":", "://")}


def drivers():
    """Return the modules of drivers, and the folders of those that have several."""
    for module in _registry._DRIVERS.values():
        first, *others = module.lstrip(".").split(".")
        yield PACKAGE / (first if others else f"{first}.py")


def sources():
    """Return the modules that use transports and are none."""
    own = set(drivers())
    for folder in (
        PACKAGE,
        ROOT / "j2a",
        ROOT / "conformance/j2a_conformance",
        ROOT / "firmware/sim/j2a_sim",
    ):
        for path in sorted(folder.rglob("*.py")):
            # The links of the clock bench are models, not transports.
            is_bench = "_clocks" in path.parts
            if (
                not own & {path, *path.parents}
                and "tests" not in path.relative_to(ROOT).parts
                and not is_bench
            ):
                yield path


@pytest.fixture(scope="module")
def parsed():
    """The path and the syntax tree of each source."""
    return [(str(path.relative_to(ROOT)), ast.parse(path.read_text())) for path in sources()]


def lists(tree):
    """Return the line and the schemes of each string or collection that names several of ours."""
    for node in ast.walk(tree):
        found = set()
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            found = set(URL.findall(node.value))
        elif isinstance(node, ast.Tuple | ast.List | ast.Set | ast.Dict):
            elements = node.keys if isinstance(node, ast.Dict) else node.elts
            values = {one.value for one in elements if isinstance(one, ast.Constant)}
            found = {value.partition(":")[0] for value in values if value in NAMES}
        if len(found) > 1:
            yield node.lineno, sorted(found)


def comparisons(tree):
    """Return the line of each question whether a URL begins or ends with a scheme of ours."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            values = [one.value for one in node.args if isinstance(one, ast.Constant)]
            is_asked = node.func.attr in ("startswith", "endswith")
            if is_asked and any(str(value).rstrip(":/") + ":" in NAMES for value in values):
                yield node.lineno


def test_no_module_lists_the_schemes_by_hand(parsed):
    found = [(path, schemes) for path, tree in parsed for _, schemes in lists(tree)]
    # The one table: which module has which scheme.
    table = str((PACKAGE / "_registry.py").relative_to(ROOT))
    assert found == [(table, sorted(_registry._DRIVERS))]


def test_no_module_asks_for_a_scheme_by_name(parsed):
    assert [path for path, tree in parsed if any(comparisons(tree))] == []


def test_questions_for_a_scheme_are_found():
    text = 'a.startswith("exec:"), b.endswith("stdio:"), c.startswith("x")'
    assert len(list(comparisons(ast.parse(text)))) == 2


@pytest.mark.parametrize(
    "text",
    [
        '_FRESH = ("exec:", "pty:")',
        'DRIVERS = {"usb": 1, "tcp": 2}',
        'HELP = "where: tcp://HOST:PORT, pty:, stdio: or another"',
        'def f():\n    """Open `tcp://127.0.0.1:5000` or `exec:./fw`."""',
        'HELP = f"""\n  usb://   a board\n  exec:./fw  a program\n{1}"""',
    ],
)
def test_lists_by_hand_are_found(text):
    assert len(list(lists(ast.parse(text)))) == 1


def test_an_example_is_no_list():
    text = '"""As `tcp://127.0.0.1:5000`."""\nKINDS = ["serial", "name"]\nX = "usb: a, and exec"'
    assert list(lists(ast.parse(text))) == []
