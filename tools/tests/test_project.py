"""The files that set the project up hold what they promise."""

import re
import subprocess
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
PINS = re.findall(r"^(\S+)==(\S+)((?:.|\n {4})*)", (ROOT / "constraints.txt").read_text(), re.M)


def normal(name):
    return re.sub(r"[-_.]+", "-", name).lower()


def test_every_pin_has_hashes_and_nothing_else_stands_in_the_file():
    text = (ROOT / "constraints.txt").read_text()
    assert len(PINS) == len(re.findall(r"^\S", text, re.M)) > 50
    for name, version, rest in PINS:
        assert re.search(r"--hash=sha256:[0-9a-f]{64}\b", rest), (name, version)


def test_the_pins_name_no_index_and_no_address():
    text = (ROOT / "constraints.txt").read_text()
    assert "://" not in text
    assert not re.search(r"^\s*(-i|--index|--extra|--find|-f)\b", text, re.M)


def test_every_dependency_is_pinned():
    extras = PROJECT["optional-dependencies"]
    wanted = [*PROJECT["dependencies"], *(one for many in extras.values() for one in many)]
    names = {normal(re.match(r"[\w.-]+", one)[0]) for one in wanted} - {"j2a"}
    assert names <= {normal(name) for name, *_ in PINS}


def test_the_changelog_has_the_version():
    assert f"\n## [{PROJECT['version']}] - " in (ROOT / "CHANGELOG.md").read_text()


@pytest.mark.parametrize("script", [".ci/run", *sorted(p.name for p in ROOT.glob("tools/*.sh"))])
def test_scripts_have_no_syntax_error(script):
    path = ROOT / script if "/" in script else ROOT / "tools" / script
    shell = "bash" if "bash" in path.read_text().splitlines()[0] else "sh"
    subprocess.run([shell, "-n", path], check=True, timeout=60)


def test_every_system_package_says_who_needs_it_and_how_it_is_found():
    lines = (ROOT / "tools/apt-packages.txt").read_text().splitlines()
    rows = [line.split() for line in lines if line and not line.startswith("#")]
    assert rows
    for row in rows:
        assert len(row) == 3, row
        assert row[1] in {"demo", "test"}, row


def test_pages_that_sources_name_exist():
    kinds = (".py", ".c", ".h", ".toml", ".sh", ".mk")
    listed = subprocess.run(
        ["git", "ls-files"], cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout
    sources = [ROOT / name for name in listed.splitlines() if name.endswith(kinds)]
    named = {
        (page, path.name)
        for path in sources
        for page in re.findall(r"\bdocs/[a-z0-9/-]+\.md\b", path.read_text("utf-8", "ignore"))
    }
    assert len(named) > 5
    assert not [(page, name) for page, name in sorted(named) if not (ROOT / page).exists()]
