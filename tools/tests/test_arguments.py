"""Tools say in a line what is wrong with their arguments."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PYTHON = (sys.executable,)
A_FILE = str(ROOT / "README.md")


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        ((*PYTHON, "tools/amalgamate.py", "--out", A_FILE), f"{A_FILE} is no folder"),
        ((*PYTHON, "tools/arduino_library.py", "--out", A_FILE), f"{A_FILE} is no folder"),
        ((*PYTHON, "tools/arduino_build.py", "--out", A_FILE), f"{A_FILE} is no folder"),
        ((*PYTHON, "tools/arduino_build.py", "--options=-DA='1"), "-DA='1: No closing quotation"),
        ((*PYTHON, "tools/clock_figures.py", "--seeds", "0"), "--seeds is 1 or more"),
        (("sh", "tools/system.sh", "tests"), "tests: say what for: demo or test"),
    ],
)
def test_wrong(command, reason):
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].endswith(reason)
