"""Each measure is taken or told, and undone: in a process of its own."""

import json
import os
import subprocess
import sys

import pytest

from j2a.syncd import realtime as module
from j2a.syncd.realtime import realtime

PROGRAM = """
import json, os
from pathlib import Path
from j2a.syncd.realtime import LATENCY_FILE, realtime

def state():
    status = Path("/proc/self/status").read_text()
    files = [os.readlink(f"/proc/self/fd/{n}") for n in os.listdir("/proc/self/fd")
             if os.path.exists(f"/proc/self/fd/{n}")]
    return {
        "memory": [line for line in status.splitlines() if line.startswith("VmLck")],
        "runs": [os.sched_getscheduler(0), os.sched_getparam(0).sched_priority],
        "stays": sorted(os.sched_getaffinity(0)),
        "processors": str(LATENCY_FILE) in files,
    }

before = state()
with realtime() as refused:
    inside = state()
print(json.dumps([before, inside, state(), refused]))
"""


def test_what_is_granted_holds_inside_and_is_undone():
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True, timeout=120
    )
    before, inside, after, refused = json.loads(done.stdout)
    assert after == before
    told = {text.split(" ", 1)[0] for text in refused}
    for name, value in before.items():
        if name == "stays" and len(value) == 1:
            continue
        assert (inside[name] == value) == (name in told), (name, value, inside[name], refused)


def test_what_the_system_refuses_is_told_and_the_rest_done(monkeypatch):
    order = []

    def granted():
        order.append("taken")
        return lambda: order.append("undone")

    def refused():
        raise PermissionError(1, "Operation not permitted")

    def missing():
        return os.no_such_function  # of another system

    measures = {"one": granted, "two": refused, "three": missing, "four": granted}
    monkeypatch.setattr(module, "_MEASURES", measures)
    with pytest.raises(KeyError), realtime() as told:
        assert told == ["two: Operation not permitted", f"three: {sys.platform} has no such thing"]
        raise KeyError
    assert order == ["taken", "taken", "undone", "undone"]
