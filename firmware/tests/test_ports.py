"""What each port must be: small, on its own, and known to the suite."""

import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent.parent
PORTS = sorted(
    path.parent
    for path in (ROOT / "firmware/ports").glob("*/port.mk")
    if path.parent.name != "template"
)
LIMIT = 150


def code_lines(source: str) -> int:
    """Lines that are neither empty nor comment."""
    without = re.sub(
        r"/\*.*?\*/", lambda match: "\n" * match[0].count("\n"), source, flags=re.DOTALL
    )
    lines = (line.strip() for line in without.splitlines())
    return sum(1 for line in lines if line and not line.startswith(("//", "#include")))


@pytest.mark.parametrize("port", PORTS, ids=lambda port: port.name)
def test_a_port_is_small(port: Path) -> None:
    sources = {path.name: path.read_text("utf-8") for path in port.glob("*.[chS]")}
    assert sources
    for name, text in sources.items():
        assert len(text.splitlines()) < LIMIT, name
    in_all = sum(code_lines(text) for name, text in sources.items() if not name.endswith(".h"))
    assert in_all < LIMIT


@pytest.mark.parametrize("port", PORTS, ids=lambda port: port.name)
def test_a_port_is_run_by_the_suite(port: Path) -> None:
    testees = [
        tomllib.loads(path.read_text("utf-8")) for path in ROOT.glob("conformance/testees/*.toml")
    ]
    builds = [" ".join(testee.get("build", [])) for testee in testees]
    assert any(f"PORT={port.name} " in f"{build} " for build in builds)


@pytest.mark.parametrize("port", PORTS, ids=lambda port: port.name)
def test_nothing_else_knows_the_port(port: Path) -> None:
    """Adding a port touches its own folder and one testee file, so nothing shared may name it."""
    shared = [
        ROOT / "firmware/Makefile",
        *ROOT.glob("firmware/core/*"),
        *ROOT.glob("firmware/apps/main.c"),
    ]
    shared += [path for path in ROOT.glob("firmware/ports/common/*") if path.suffix in {".c", ".h"}]
    for path in shared:
        text = path.read_text("utf-8")
        assert f"ports/{port.name}" not in text, path
        assert f"PORT),{port.name}" not in text, path
