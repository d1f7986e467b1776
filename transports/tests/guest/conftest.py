"""The test guest as a fixture: `guest("command", "argument")` runs that in it."""

import importlib.util
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import NoReturn

import pytest

ROOT = Path(__file__).parents[3]
SCRIPT = ROOT / "tools/guest.py"
TOOLS = {"qemu-system-x86_64": "qemu-system-x86", "busybox": "busybox-static"}
# What jobs import. The emulated processor would take seconds to compile it, each time, because it
# cannot write to the host's files.
IMPORTED = (
    "j2a",
    "j2a_spec",
    "j2a_transports",
    "j2a_conformance",
    "construct",
    "usb",
    "pytest",
    "_pytest",
    "pluggy",
)
Guest = Callable[..., subprocess.CompletedProcess[str]]


def tool(name: str) -> ModuleType:
    """Import a script of tools/, once; they import each other by their plain names."""
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, ROOT / f"tools/{name}.py")
        assert spec and spec.loader
        sys.modules[name] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(sys.modules[name])
    return sys.modules[name]


@pytest.fixture(scope="session")
def guest(need: Callable[[str], None], missing: Callable[[str], NoReturn]) -> Guest:
    """guest(*command, timeout=900) runs a command in the guest; it has to return `code`.

    `qemu` has more arguments for QEMU.
    """
    for program in TOOLS:
        need(program)
    folders = [
        folder
        for name in IMPORTED
        if (spec := importlib.util.find_spec(name))
        for folder in spec.submodule_search_locations or ()
    ]
    subprocess.run([sys.executable, "-m", "compileall", "-q", *folders], check=False, timeout=120)

    def run(
        *command: str, timeout: int = 900, code: int = 0, qemu: str = ""
    ) -> subprocess.CompletedProcess[str]:
        done = subprocess.run(
            [sys.executable, SCRIPT, f"--timeout={timeout}", f"--qemu={qemu}", "--", *command],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=False,
        )
        if "apt-get" in done.stderr and done.returncode == 125:
            missing(f"the guest's kernel is missing: {done.stderr.strip()}")
        assert done.returncode == code, f"exit code {done.returncode}\n{done.stdout}{done.stderr}"
        return done

    return run
