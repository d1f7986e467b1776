"""`j2a syncd` and `j2a sync` as processes: one daemon, which later ones tell and signals end."""

import contextlib
import fcntl
import json
import math
import os
import pty
import re
import select
import signal
import socket
import stat
import subprocess
import sys
import tempfile
import threading
import time
import tty
import xml.etree.ElementTree as ET
from pathlib import Path

import j2a_transports
import pytest

from j2a.cli import _setup
from j2a.demo import DemoDevice
from j2a.syncd import system
from j2a.syncd.singleton import Server, ask

from .conftest import files_of

ROOT = Path(__file__).parents[3]
WAIT_S = 300  # of a hang: beside other programs some steps took nearly 60 s


@pytest.fixture(autouse=True)
def folder(monkeypatch, tmp_path):
    """Where the daemon of the test has its socket."""
    monkeypatch.setenv("J2A_RUNTIME_DIR", str(tmp_path / "run"))
    return tmp_path / "run"


@pytest.fixture
def daemon(start, folder):
    started = start("syncd", "--no-usb", "-v")
    started.line_with("runs, socket", "err")
    return started


def test_without_a_daemon(run, folder):
    result = run("sync", "status")
    assert result.code == 3
    assert f"no daemon answers at {folder}/syncd.sock" in result.err
    assert json.loads(run("sync", "status", "--json").out)["error"]["exit_code"] == 3


def test_status_and_plot(run, daemon, tmp_path):
    status = json.loads(run("sync", "status", "--json").out)
    assert status["pid"] == daemon.process.pid
    assert status["boards"] == []
    assert "no boards" in run("sync", "status").out
    assert run("sync", "plot", "-o", tmp_path / "p.svg").code == 0
    told = json.loads(run("sync", "plot", "-o", tmp_path / "p.svg", "--json").out)
    assert told == {"file": str(tmp_path / "p.svg"), "rounds": {}}
    assert ET.parse(tmp_path / "p.svg").getroot().tag.endswith("svg")


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_signals_end_it_in_order(run, daemon, folder, number):
    daemon.process.send_signal(number)
    assert daemon.process.wait(WAIT_S) == (130 if number == signal.SIGINT else 0)
    assert run("sync", "status").code == 3
    assert not (folder / "syncd.sock").exists()


def test_a_second_one_tells_the_first_and_ends(run, daemon):
    result = run("syncd", "--no-usb")
    assert (result.code, result.err) == (0, "")
    assert f"a daemon runs already (process {daemon.process.pid})" in result.out


def test_a_second_one_tells_the_first_which_board_it_means(run, daemon, monkeypatch):
    asked = []
    answers = lambda *what: asked.append(what[1]) or ask(*what)  # noqa: E731
    monkeypatch.setattr("j2a.syncd.singleton.ask", answers)
    assert run("syncd", "-b", "3", "-d", "9").code == 0
    assert asked[-1]["only"] == [3, 9]
    told = run("syncd", "-i", "10", "--realtime").out
    assert told.rstrip().endswith("; it does not take --interval, --realtime")


@pytest.mark.parametrize("words", [["-b", "008", "-d", "019"], ["-b", "8", "-d", "19"]])
def test_numbers_of_a_board_as_udev_writes_them(run, daemon, monkeypatch, words):
    asked = []

    def answers(folder, request):
        asked.append(request["only"])
        return ask(folder, request)

    monkeypatch.setattr("j2a.syncd.singleton.ask", answers)
    assert run("syncd", "--no-usb", *words).code == 0
    assert asked == [[8, 19]]


def test_after_kill_9_the_next_one_begins(daemon, start):
    daemon.process.kill()
    daemon.process.wait(WAIT_S)
    start("syncd", "--no-usb", "-v").line_with("runs, socket", "err")


def test_many_that_begin_at_once_are_one(start, run):
    begun = [start("syncd", "--no-usb") for _ in range(4)]
    end = time.monotonic() + WAIT_S
    while sum(one.process.poll() is None for one in begun) > 1:
        assert time.monotonic() < end
        time.sleep(0.05)
    [stays] = [one for one in begun if one.process.poll() is None]
    assert {one.process.poll() for one in begun if one is not stays} == {0}
    assert json.loads(run("sync", "status", "--json").out)["pid"] == stays.process.pid


def test_a_daemon_that_does_not_answer_is_told(run, folder):
    folder.mkdir()
    with (folder / "syncd.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        result = run("syncd", "--no-usb")
    assert result.code == 3
    assert "does not answer" in result.err


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may give capabilities away")
def test_the_rights_that_the_page_gives_a_punctual_service_are_enough(need, folder):
    need("setpriv")
    text = (ROOT / "docs/syncd.md").read_text("utf-8")
    (names,) = re.findall("^CapabilityBoundingSet=(.*)$", text, re.MULTILINE)
    kept = "".join(f",+{name.removeprefix('CAP_').lower()}" for name in names.split())
    command = ["setpriv", f"--bounding-set=-all{kept}", "--inh-caps=-all", "--no-new-privs"]
    command += [sys.executable, "-m", "j2a", "syncd", "--no-usb", "--realtime", "-v"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as program:
        lines = iter(program.stderr.readline, "")
        assert any(f"runs, socket {folder}" in line for line in lines)
        status = Path(f"/proc/{program.pid}/status").read_text("utf-8")
        program.terminate()
        assert program.wait(WAIT_S) == 0
    assert re.search(r"^CapEff:\s+0+$", status, re.MULTILINE), "all given away"
    assert "\nUid:\t0" not in status


@pytest.mark.parametrize(
    "boards", [None, "left", [1], [{}], [{"board": 1, "state": None, "lost": None}]]
)
def test_a_daemon_that_tells_something_else_is_named(run, folder, boards):
    status = {"pid": 1, "uptime_s": 2, "steps": 0, "boards": boards}
    server = Server(folder, lambda _request, _is_trusted: status)
    server.start()
    try:
        result = run("sync", "status")
        as_json = run("sync", "status", "--json")
    finally:
        server.close()
    assert (result.code, result.out) == (3, "")
    assert "is it of another version" in result.err
    assert json.loads(as_json.out) == status


ROW = {"board": "left", "state": "locked", "lost": 0}
ROW |= dict.fromkeys(["offset_us", "rate_ppb", "uncertainty_us"], 1)
STATUS = {"pid": 1, "uptime_s": 2, "steps": 0, "boards": [ROW]}


@contextlib.contextmanager
def answering(folder, reply):
    """Be what answers at the socket: `reply(request)` returns an object, or text to send."""
    folder.mkdir(exist_ok=True)
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(os.fspath(folder / "syncd.sock"))
        listener.listen()

        def serve():
            with contextlib.suppress(OSError):  # it was closed
                while True:
                    connection, _ = listener.accept()
                    with connection, contextlib.suppress(OSError):
                        said = reply(json.loads(connection.recv(5000)))
                        text = said if isinstance(said, str) else json.dumps(said)
                        connection.sendall(text.encode() + b"\n")

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            yield
        finally:
            listener.shutdown(socket.SHUT_RDWR)
            thread.join(WAIT_S)


@pytest.mark.parametrize(
    "changed",
    [
        {"pid": "me"},
        {"uptime_s": None},
        {"steps": True},
        {"problem": [1]},
        {"boards": [ROW | {"board": 7}]},
        {"boards": [ROW | {"state": True}]},
        {"boards": [ROW | {"lost": "none"}]},
        {"boards": [ROW | {"problem": [1]}]},
        {"boards": [ROW | {"offset_us": 10**400}]},
        {"boards": [ROW | {"rate_ppb": math.nan}]},
        {"boards": [ROW | {"uncertainty_us": "little"}]},
        {"boards": [ROW | {"uncertainty_us": False}]},
    ],
)
def test_a_status_of_other_kinds_is_none(run, folder, changed):
    with answering(folder, lambda _request: STATUS):
        assert run("sync", "status").code == 0
    (folder / "syncd.sock").unlink()
    with answering(folder, lambda _request: STATUS | changed):
        result = run("sync", "status")
    assert (result.code, result.out) == (3, "")
    assert "is it of another version" in result.err


@pytest.mark.parametrize("boards", [[], [ROW]])
def test_the_status_tells_why_the_daemon_finds_no_boards(run, folder, boards):
    status = STATUS | {"problem": "libusb does not load", "boards": boards}
    with answering(folder, lambda _request: status):
        result = run("sync", "status")
    assert result.code == 0
    assert result.out.splitlines()[:2] == [
        "daemon 1, for 2 s, steps: 0",
        "  libusb does not load",
    ]


@pytest.mark.parametrize("words", [["status"], ["status", "--json"], ["plot", "-o", "x.svg"]])
@pytest.mark.parametrize(
    "reply", ["[]", "x", *('{"a": ' + "[" * deep + "]" * deep + "}" for deep in (500, 3000))]
)
def test_what_is_no_answer_of_a_daemon_is_named(run, folder, words, reply):
    with answering(folder, lambda _request: reply):
        result = run("sync", *words)
    assert result.code == 3
    told = json.loads(result.out)["error"]["message"] if "--json" in words else result.err
    assert "j2a syncd" in told
    assert len(told) < 500


def test_an_error_of_a_daemon_is_short(run, folder):
    with answering(folder, lambda _request: {"error": "x" * 1_000_000}):
        result = run("sync", "status")
    assert result.code == 3
    assert len(result.err) < 1000


LINE = [[1e9 + second, 1.0, 1.0, 1.0] for second in range(10)]


@pytest.mark.parametrize(
    "rounds",
    [
        [[1e9, 10**400, 0, 0]],
        [[1e9 + second, 1e200 * second**2, 0, 0] for second in range(10)],
        [[1e9, -1e308, 0, 0], [1e9 + 1, 1e308, 0, 0]],
        [[1e9 + second, math.nan, 0, 0] for second in range(10)],
        LINE * 300,
        "left",
    ],
)
def test_a_history_that_is_none_is_told(run, folder, tmp_path, rounds):
    plot = tmp_path / "p.svg"
    plot.write_text("old")
    with answering(
        folder, lambda asked: {"rounds": rounds} if "board" in asked else {"boards": ["left"]}
    ):
        result = run("sync", "plot", "-o", plot)
    assert (result.code, result.out, plot.read_text()) == (3, "", "old")
    assert "no history" in result.err
    assert "is it of another version" in result.err


@pytest.mark.parametrize("boards", [["left", 7], [f"board {number}" for number in range(257)]])
def test_boards_that_no_daemon_has_are_not_asked_for(run, folder, tmp_path, boards):
    asked = []
    with answering(folder, lambda one: asked.append(one) or {"boards": boards, "rounds": LINE}):
        result = run("sync", "plot", "-o", tmp_path / "p.svg")
    assert result.code == 3
    assert "no history" in result.err
    assert len(asked) == 1


def test_a_daemon_that_takes_long_for_each_board_is_not_awaited(run, folder, tmp_path, monkeypatch):
    monkeypatch.setattr("j2a.cli._sync._HISTORY_S", 0.3)
    asked = []

    def slow(one):
        asked.append(one)
        time.sleep(0.2)
        return {"boards": list("abcdefghijkl"), "rounds": LINE}

    with answering(folder, slow):
        result = run("sync", "plot", "-o", tmp_path / "p.svg")
    assert result.code == 4
    assert "took longer than 0.3 s" in result.err
    assert len(asked) < 5


def test_a_name_of_a_board_can_stand_in_a_plot(run, folder, tmp_path):
    name = "a\ud800\0b"
    with answering(folder, lambda asked: {"boards": [name], "rounds": LINE}):
        assert run("sync", "plot", "-o", tmp_path / "p.svg").code == 0
    texts = [one.text for one in ET.parse(tmp_path / "p.svg").iter()]
    assert r"a\ud800\x00b" in texts


@pytest.mark.parametrize("reply", [{}, {"pid": "x"}])
def test_who_else_answers_takes_no_boards(run, folder, reply):
    with answering(folder, lambda _request: reply):
        result = run("syncd", "--no-usb")
    assert (result.code, result.out) == (3, "")
    assert "is it of another version" in result.err


def test_in_the_background(run, folder):
    done = subprocess.run(
        [sys.executable, "-m", "j2a", "syncd", "--no-usb", "--daemon"], check=False, timeout=WAIT_S
    )
    assert done.returncode == 0
    end = time.monotonic() + WAIT_S
    while run("sync", "status").code != 0:
        assert time.monotonic() < end
        time.sleep(0.05)
    number = json.loads(run("sync", "status", "--json").out)["pid"]
    assert os.getsid(number) != os.getsid(0)
    os.kill(number, signal.SIGTERM)
    while run("sync", "status").code == 0:
        assert time.monotonic() < end
        time.sleep(0.05)


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["-i", "0.01"], "at least 0.05"),
        (["-i", "10.1"], "10 at most"),
        (["-i", "1e300"], "10 at most"),
        (["-i", "nan"], "nan"),
        (["-b", "-1"], "-1"),
        (["-b", "1", "-d", "0"], "from 1 to 127"),
        (["-b", "1", "-d", "128"], "from 1 to 127"),
        (["-d", "3"], "--device needs --busnum"),
        (["--user", "no-such-user"], "user"),
        (["nonsense"], "nonsense"),
    ],
)
def test_arguments_that_make_no_sense(run, words, text):
    result = run("syncd", "--no-usb", *words)
    assert result.code == 2
    assert text in result.err


@pytest.mark.parametrize("words", [["plot"], ["status", "-o", "x.svg"]])
def test_sync_needs_a_file_for_plots_only(run, words):
    assert run("sync", *words).code == 2


@pytest.mark.parametrize(
    ("words", "option"),
    [
        (["--actuator", "lamp"], "--actuator"),
        (["--sensor", "edge"], "--sensor"),
        (["--count", "3"], "--count"),
        (["--delay", "3"], "--delay"),
        (["--bound", "3"], "--bound"),
        (["--no-discipline"], "--no-discipline"),
    ],
)
@pytest.mark.parametrize("what", [["status"], ["plot", "-o", "x.svg"]])
def test_an_option_of_verify_is_not_taken_and_forgotten(run, what, words, option):
    result = run("sync", *what, *words)
    assert result.code == 2
    assert f"{what[0]} takes no {option}, only verify does" in result.err


def test_a_plot_that_cannot_be_written(run, daemon, tmp_path):
    result = run("sync", "plot", "-o", tmp_path / "no" / "p.svg")
    assert result.code == 2
    assert "cannot write" in result.err


def test_a_plot_that_cannot_be_finished_leaves_the_old_one(run, daemon, tmp_path):
    plot = tmp_path / "p.svg"
    plot.write_text("old")
    with files_of(100):
        result = run("sync", "plot", "-o", plot)
    assert (result.code, plot.read_text()) == (2, "old")
    assert f"cannot write {plot}: File too large" in result.err
    assert not list(tmp_path.glob("*.part"))


def test_a_folder_that_cannot_be_made(run, monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("J2A_RUNTIME_DIR", str(tmp_path / "file"))
    result = run("syncd", "--no-usb")
    assert result.code == 2
    assert "cannot make the socket" in result.err


WITHOUT_ROOT = """
import os, sys, threading
from j2a.cli import _syncd, main
from j2a.syncd import url_boards

known = set()
_syncd._user = lambda name: _syncd._User(os.getuid(), os.getgid())
_syncd._become = lambda user: known.update(sys.modules)  # from here on nothing can be imported
os.geteuid = lambda: 0
code = main(sys.argv[1:])
print(*sorted(sys.modules.keys() - known))
sys.exit(code)
"""


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may give its rights away")
def test_nothing_is_imported_when_root_has_given_its_rights_away(run):
    """The user that it becomes may be unable to read Python's files."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    with j2a_transports.listen("tcp://127.0.0.1:0") as listener, DemoDevice(clock=0) as board:
        thread = threading.Thread(target=board.serve_forever, args=(listener,))
        thread.start()
        named = listener.url.replace("127.0.0.1", "localhost")  # read by the codec idna
        process = subprocess.Popen(
            [sys.executable, "-c", WITHOUT_ROOT, "syncd", "--no-usb", named],
            stdout=subprocess.PIPE,
            text=True,
        )
        try:
            end = time.monotonic() + WAIT_S
            while "locked" not in run("sync", "status").out:
                assert process.poll() is None
                assert time.monotonic() < end
                time.sleep(0.05)
            run("syncd", "--no-usb", f"serial://{os.ttyname(slave)}")
            assert select.select([master], [], [], WAIT_S)[0]  # the port is open
            process.send_signal(signal.SIGTERM)
            out, _ = process.communicate(timeout=WAIT_S)
        finally:
            process.kill()
            os.close(master)
            os.close(slave)
            board.stop()
            thread.join(WAIT_S)
    assert (process.returncode, out) == (0, "\n")


def test_setup_writes_rule_wrapper_and_unit(run, monkeypatch, tmp_path):
    for name in ("RULE_PLACE", "WRAPPER_PLACE", "UNIT_PLACE"):
        monkeypatch.setattr(system, name, tmp_path / getattr(system, name).name)
    monkeypatch.setattr(_setup, "PLACE", tmp_path / "70-j2a.rules")
    monkeypatch.setattr(_setup, "SYSTEMD", tmp_path / "none")
    monkeypatch.setattr("sys.argv", ["/usr/bin/true"])
    monkeypatch.setenv("PATH", str(tmp_path))
    result = run("setup", "syncd")
    assert result.code == 0
    wrapper = tmp_path / system.WRAPPER_PLACE.name
    assert stat.S_IMODE(wrapper.stat().st_mode) == 0o755
    assert f'RUN+="{wrapper}"' in (tmp_path / system.RULE_PLACE.name).read_text()
    unit = (tmp_path / system.UNIT_PLACE.name).read_text()
    assert "ExecStart=/usr/bin/true syncd\n" in unit
    assert subprocess.run(["/bin/sh", "-n", wrapper], check=False, timeout=WAIT_S).returncode == 0
    printed = run("setup", "syncd", "--print").out
    assert unit in printed


def test_setup_of_a_program_whose_path_cannot_stand_in_a_unit(run, monkeypatch, tmp_path):
    strange = tmp_path / "a b"
    strange.mkdir()
    (strange / "j2a").write_text("#!/bin/sh\n")
    (strange / "j2a").chmod(0o755)
    monkeypatch.setattr("sys.argv", [str(strange / "j2a")])
    result = run("setup", "syncd", "--print")
    assert result.code == 2
    assert "cannot stand in a unit" in result.err


def test_the_unit_is_one_that_systemd_understands(need, tmp_path):
    need("systemd-analyze")
    unit = tmp_path / system.UNIT_PLACE.name
    files = system.system_files("/bin/true", "root")
    unit.write_text(next(one.text for one in files if one.place.name == unit.name))
    command = ["systemd-analyze", "verify", "--man=no", str(unit)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=WAIT_S)
    assert (done.returncode, done.stderr, done.stdout) == (0, "", "")
    unit.write_text(unit.read_text().replace("UMask", "UMasc"))
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=WAIT_S)
    assert "UMasc" in done.stderr


@pytest.fixture
def open_folder():
    """A folder that everybody may read; those above that of tmp_path belong to one user."""
    with tempfile.TemporaryDirectory(dir="/tmp") as folder:
        Path(folder).chmod(0o755)
        yield Path(folder)


def test_what_keeps_the_user_of_the_service_out_is_named(run, monkeypatch, open_folder):
    program = open_folder / "closed" / "bin" / "j2a"
    program.parent.mkdir(parents=True)
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    assert system.closed_part([program]) is None
    (open_folder / "closed").chmod(0o750)
    assert system.closed_part([Path("/"), program]) == open_folder / "closed"
    (open_folder / "link").symlink_to(program)
    assert system.closed_part([open_folder / "link"]) == open_folder / "closed"
    (open_folder / "closed").chmod(0o755)
    program.chmod(0o751)
    assert system.closed_part([open_folder / "link"]) == program
    for name in ("RULE_PLACE", "WRAPPER_PLACE", "UNIT_PLACE"):
        monkeypatch.setattr(system, name, open_folder / getattr(system, name).name)
    monkeypatch.setattr(_setup, "PLACE", open_folder / "70-j2a.rules")
    monkeypatch.setattr(_setup, "SYSTEMD", open_folder)
    monkeypatch.setattr("sys.argv", [str(program)])
    monkeypatch.setenv("PATH", str(open_folder))
    result = run("setup", "syncd")
    assert result.code == 0
    assert f"may not go through {program}, so it will not start" in result.err
