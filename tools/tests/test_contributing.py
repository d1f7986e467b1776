"""CONTRIBUTING.md leads to files that are there."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
PATHS = sorted(
    {
        path
        for path in re.findall(r"`([\w./-]+/[\w./-]*)`", PAGE)
        if not path.startswith(("/", "build/")) and "NAME" not in path
    }
)


def test_paths_are_found():
    assert len(PATHS) > 50


@pytest.mark.parametrize("path", PATHS)
def test_a_path_exists(path):
    assert (ROOT / path).exists()
