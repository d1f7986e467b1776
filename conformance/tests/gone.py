"""Processes that should have ended."""

import time
from pathlib import Path

__all__ = ["check_gone"]


def check_gone(pid: int) -> None:
    """Wait for the end of a process; without a parent its entry stays until init looks."""
    deadline = time.monotonic() + 30
    while (state := _state_of(pid)) not in ("", "Z"):
        assert time.monotonic() < deadline, f"process {pid} is still there, {state}"
        time.sleep(0.01)


def _state_of(pid: int) -> str:
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return ""
    return stat.rpartition(")")[2].split()[0]
