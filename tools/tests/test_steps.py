"""steps.sh: steps are timed, one that fails stops no other, Ctrl-C stops those beside, too."""

import os
import re
import shutil
import signal
import subprocess
import time
from pathlib import Path

SCRIPT = """
. "$(dirname "$0")/steps.sh"
begin aside "is shown later" sh -c 'until [ -e shown ]; do sleep 0.05; done; echo seen; exit 5'
begin early "ends early" true
step idle "waits" sleep 0.2
step broken "fails" sh -c 'echo trouble >&2; exit 3'
step busy "works" sh -c 'i=0; while [ $i -lt 300000 ]; do i=$((i+1)); done; echo done'
timed behind sh -c 'exit 4' &
wait $! || echo "behind: $?"
touch shown
show aside
show unknown
show early
end_steps
"""


CUT_OFF = """
. "$(dirname "$0")/steps.sh"
begin aside "goes on for ever" sh -c 'echo $$ >pid; exec sleep 600'
step long "takes long" sleep 600
"""


def script(tmp_path, text):
    (tmp_path / "tools").mkdir()
    shutil.copy(Path(__file__).parents[1] / "steps.sh", tmp_path / "tools")
    (tmp_path / "tools/check.sh").write_text(text)
    return ["bash", tmp_path / "tools/check.sh"]


def run(tmp_path, **environment):
    return subprocess.run(
        script(tmp_path, SCRIPT),
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
    assert {*table} == {"busy", "idle", "broken", "behind", "aside", "early", "all"}
    assert table[-1] == "all"
    assert done.stdout.endswith("==> FAILED steps: broken aside\n")


def test_a_step_beside_the_others_is_shown_where_it_is_waited_for(tmp_path):
    said = run(tmp_path).stdout
    shown = said.index("==> aside: is shown later\nseen\n==> aside: ")
    assert said.index("==> idle") < said.index("behind: 4") < shown
    assert "==> aside FAILED with status 5\n" in said
    assert "==> early: ends early\n==> early: 0 s" in said
    assert "unknown" not in said


def test_only_chosen_steps_run(tmp_path):
    done = run(tmp_path, CHECK="idle,others")
    assert (done.returncode, done.stderr) == (0, "")
    assert "==> idle: waits" in done.stdout
    assert "broken" not in done.stdout


def test_the_end_of_the_whole_ends_what_runs_beside(tmp_path):
    check = subprocess.Popen(
        script(tmp_path, CUT_OFF), env={"PATH": "/usr/bin:/bin"}, start_new_session=True
    )
    pid = tmp_path / "pid"
    while not (pid.exists() and pid.read_text().endswith("\n")):
        time.sleep(0.05)
    aside = int(pid.read_text())
    os.killpg(check.pid, signal.SIGINT)  # as Ctrl-C does; `aside` is in another group
    check.wait(60)
    for _ in range(600):
        if not _lives(aside):
            return
        time.sleep(0.05)
    raise AssertionError("it goes on")


def _lives(pid):
    try:
        return "(sleep) Z" not in Path(f"/proc/{pid}/stat").read_text()
    except (FileNotFoundError, ProcessLookupError):
        return False
