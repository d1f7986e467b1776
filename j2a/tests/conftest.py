"""Readable assertions in what the tests share, and strict types."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

pytest.register_assert_rewrite(
    "j2a.tests.library.support", "j2a.tests.library.virtual", "j2a.tests.library.wire"
)


@pytest.fixture(scope="session")
def strict_errors(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., list[str]]:
    """strict_errors(folder, "module.py") is what mypy has to say of modules of a folder.

    What they import takes most of the time: it is looked at once, for all workers of pytest-xdist.
    """
    pytest.importorskip("mypy")
    base = tmp_path_factory.getbasetemp()
    cache = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "mypy"

    def check(folder: Path, *modules: str) -> list[str]:
        done = subprocess.run(
            [sys.executable, "-m", "mypy", "--strict", f"--cache-dir={cache}", *modules],
            cwd=folder,
            capture_output=True,
            text=True,
            check=False,
            env={"PATH": "", "MYPYPATH": str(folder)},
        )
        errors = [line for line in done.stdout.splitlines() if ": error:" in line]
        assert done.returncode == bool(errors), done.stdout + done.stderr
        return errors

    return check
