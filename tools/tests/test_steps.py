"""steps.sh: each step is timed, one that fails stops no other, and the end says what failed."""

import re
import shutil
import subprocess
from pathlib import Path

SCRIPT = """
. "$(dirname "$0")/steps.sh"
step idle "waits" sleep 0.2
step broken "fails" sh -c 'echo trouble >&2; exit 3'
step busy "works" sh -c 'i=0; while [ $i -lt 300000 ]; do i=$((i+1)); done; echo done'
timed behind sh -c 'exit 4' &
wait $! || echo "behind: $?"
end_steps
"""


def run(tmp_path, **environment):
    (tmp_path / "tools").mkdir()
    shutil.copy(Path(__file__).parents[1] / "steps.sh", tmp_path / "tools")
    (tmp_path / "tools/check.sh").write_text(SCRIPT)
    return subprocess.run(
        ["bash", tmp_path / "tools/check.sh"],
        env={"PATH": "/usr/bin:/bin", **environment},
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )


def test_each_step_has_its_time_and_the_most_expensive_comes_first(tmp_path):
    done = run(tmp_path)
    assert done.returncode == 1
    assert done.stderr == "trouble\n"
    assert "==> broken FAILED with status 3" in done.stdout
    assert "==> broken FAILED, the last that it said:\ntrouble\n" in done.stdout
    assert "behind: 4\n" in done.stdout
    assert re.search(
        r"^==> busy: works\ndone\n==> busy: \d+ s, \d+ s of", done.stdout, re.MULTILINE
    )
    table = re.findall(r"^(\w+) +\d+ +\d+$", done.stdout, re.MULTILINE)
    assert table[0] == "busy"
    assert {*table} == {"busy", "idle", "broken", "behind", "all"}
    assert table[-1] == "all"
    assert done.stdout.endswith("==> FAILED steps: broken\n")


def test_only_chosen_steps_run(tmp_path):
    done = run(tmp_path, CHECK="idle,others")
    assert (done.returncode, done.stderr) == (0, "")
    assert "==> idle: waits" in done.stdout
    assert "broken" not in done.stdout
