"""Where compilers are missing, tests say so and are skipped, unless they must not be."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TESTS = [
    "docs/tests/test_examples.py::test_the_first_application_works",
    "firmware/tests/test_server.py",
    "j2a/tests/cli/test_cli_process.py::test_ctrl_c_ends_a_call",
    "conformance/tests/end_to_end/test_end_to_end.py::test_calls",
    "firmware/sim/tests/test_uart.py",
]
OPTIONS = ["-p", "no:cacheprovider", "-k", "not python"]


@pytest.mark.parametrize("required", [False, True])
def test_without_compilers(tmp_path, required):
    dropped = ("J2A_REQUIRE_AVR", "CI", "PYTEST_ADDOPTS")
    environment = {name: value for name, value in os.environ.items() if name not in dropped}
    environment["PATH"] = str(tmp_path)
    environment["CI"] = "true"  # decides nothing
    if required:
        environment["J2A_REQUIRE_AVR"] = "1"
    result = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", *OPTIONS, *TESTS],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    summary = result.stdout.splitlines()[-1]
    assert "passed" not in summary, result.stdout
    if required:
        assert result.returncode == 1 and "skipped" not in summary, result.stdout
        assert "J2A_REQUIRE_AVR=1, but cc is missing: install the package" in result.stdout
    else:
        assert result.returncode == 0 and "skipped" in summary, result.stdout
        assert "avr-gcc is missing: install the package gcc-avr, and avr-libc" in result.stdout
