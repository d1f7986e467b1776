"""Programs of their own, for what happens at the end of one.

In: Python code.  Out: how the program ended and what it said.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path


def run_program(code: str, *options: str) -> tuple[int, str, str]:
    """Run code with these options of Python; returns exit code, output and errors."""
    done = subprocess.run(
        [sys.executable, *options, "-c", code],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])},
    )
    return done.returncode, done.stdout, done.stderr
