"""All that a package offers has an entry in the reference."""

import importlib
import re
from pathlib import Path

import pytest
from sphinx.pycode import ModuleAnalyzer

PAGES = "".join(page.read_text() for page in (Path(__file__).parents[1] / "api").glob("*.md"))
DIRECTIVE = re.compile(r"^\.\. (?:py:)?(\w+):: (\S+)((?:\n {3}.*)*)", re.MULTILINE)


def described(package: str) -> set[str]:
    """Return the names of a package that have an entry, as Sphinx finds them."""
    found: set[str] = set()
    module = ""
    for kind, name, options in DIRECTIVE.findall(PAGES):
        if kind in ("automodule", "currentmodule"):
            module = name
            members = re.search(r":members:((?:.|\n)*?)(?=\n {3}:|\Z)", options)
            if kind == "automodule" and name == package and members:
                exported = importlib.import_module(name).__all__
                chosen = re.findall(r"\w+", members[1]) or exported
                found.update(one for one in chosen if is_member(name, one))
        elif kind == "data":  # not of autodoc: the module comes before the name, whatever that is
            found.update([name] if module == package else [])
        elif name.startswith(f"{package}."):
            found.add(name.removeprefix(f"{package}."))
        elif module == package:
            found.add(name)
    return found


def is_member(module: str, name: str) -> bool:
    """Tell whether autodoc takes this for a member: it can be called, or a docstring follows it."""
    documented = ModuleAnalyzer.for_module(module).find_attr_docs()
    return callable(getattr(importlib.import_module(module), name)) or ("", name) in documented


@pytest.mark.parametrize(
    "package",
    [
        "j2a",
        "j2a.cli.plugin",
        "j2a.recording",
        "j2a.replay",
        "j2a.virtual",
        "j2a_bridge",
        "j2a_conformance",
        "j2a_conformance.host",
        "j2a_sim",
        "j2a_spec",
        "j2a_transports",
    ],
)
def test_all_that_a_package_offers_has_an_entry(package):
    assert sorted(set(importlib.import_module(package).__all__) - described(package)) == []
