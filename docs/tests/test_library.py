"""The commands of the page about the firmware as a library do what it says, beside the clone."""

import os
import re
import subprocess
import sys
from pathlib import Path

from docs.tests.repeat import LIMIT_S, ROOT


def test_two_files(need, tmp_path):
    need("cc")
    page = (ROOT / "docs/library.md").read_text("utf-8")
    section = page[page.index("## Two files") : page.index("**A port of this repository**")]
    [commands] = re.findall(r"```sh\n(.*?)```", section, re.DOTALL)
    assert re.search(r"--out \.\./adder/", commands), "the clone itself has a folder j2a"
    result = subprocess.run(
        ["sh", "-ec", commands.replace("../adder", str(tmp_path / "adder"))],
        cwd=ROOT,
        env=os.environ | {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"},
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    assert result.stdout.endswith("\n42\n")
