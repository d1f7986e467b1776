"""The program as a process: signals, pipes, serving, and links that break."""

import json
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from j2a.cli._exit import TERMINATED

WAIT_S = 300  # of a hang: beside other programs some steps took nearly 60 s


def test_python_m_j2a_is_the_program(run):
    for command in ([sys.executable, "-m", "j2a"], [sys.executable, "-c", _BY_NAME]):
        result = subprocess.run(
            [*command, "--help"], capture_output=True, text=True, timeout=WAIT_S, check=False
        )
        assert (result.returncode, result.stdout) == (0, run("--help").out)


_BY_NAME = """
from importlib.metadata import entry_points
(point,) = entry_points(group="console_scripts", name="j2a")
raise SystemExit(point.load()())
"""


_INTERRUPTED_IMPORT = """
import os, signal, sys
from importlib.metadata import entry_points
class Interrupt:
    def find_spec(self, name, *_):
        if name == {at!r}:
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Interrupt())
(point,) = entry_points(group="console_scripts", name={program!r})
sys.argv[1:] = ["run" if {program!r} == "j2a-conform" else "info", "--help"]
raise SystemExit(point.load()())
"""


@pytest.mark.parametrize(
    ("program", "at"),
    [
        ("j2a", "j2a"),
        ("j2a", "j2a.io.blocking"),
        ("j2a", "j2a.cli._output"),
        ("j2a", "j2a.cli._info"),
        ("j2a-conform", "j2a_conformance"),
        ("j2a-conform", "j2a_conformance.host.cases"),
        ("j2a-conform", "j2a_conformance.cli.run"),
    ],
)
@pytest.mark.parametrize("ignored", [False, True])
def test_ctrl_c_while_the_program_is_imported(program, at, ignored):
    code = _INTERRUPTED_IMPORT.format(program=program, at=at)
    ignore = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)\n" if ignored else ""
    result = subprocess.run(
        [sys.executable, "-c", ignore + code],
        capture_output=True,
        text=True,
        timeout=WAIT_S,
        check=False,
    )
    assert result.returncode == (0 if ignored else 130)
    assert bool(result.stdout) == ignored
    assert result.stderr.removeprefix("j2a-conform: interrupted\n") == ""


_HELP_OF_ALL = """
from j2a.cli import main
from j2a.cli._commands import names
for name in names():
    if main([name, "--help"]) != 0:
        raise SystemExit(name)
"""


def test_help_without_docstrings_and_assertions():
    for program in (["-c", _HELP_OF_ALL], ["-m", "j2a_conformance", "run", "--help"]):
        result = subprocess.run(
            [sys.executable, "-OO", *program],
            capture_output=True,
            text=True,
            timeout=WAIT_S,
            check=False,
        )
        assert (result.returncode, result.stderr) == (0, "")
        assert "usage: j2a" in result.stdout


def test_serve_and_call(start, run):
    server = start("serve", "--listen", "tcp://127.0.0.1:0", "-v")
    url = server.line_with("listening on ").split()[-1]
    assert run("call", url, "add", "i32:1,2", "--as", "i32").out == "3\n"
    assert "> request" in server.line_with("add", "err")
    server.process.send_signal(signal.SIGINT)
    result = server.end()
    assert result.code == 130
    assert "Traceback" not in result.err


def test_serve_ends_on_sigterm_and_removes_its_link(start, run, tmp_path):
    link = tmp_path / "board"
    server = start("serve", "--listen", f"pty:{link}")
    server.line_with("listening on ")
    assert run("props", f"serial://{link}", "name").out == "J2A demo\n"
    server.process.send_signal(signal.SIGTERM)
    assert server.end().code == TERMINATED == 143
    assert not link.is_symlink()


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)]
)
def test_a_signal_leaves_no_program_of_a_link_behind(start, tmp_path, number, code):
    never = tmp_path / "never.py"
    never.write_text(
        "import os, sys, time\nprint(os.getpid(), file=sys.stderr, flush=True)\ntime.sleep(900)\n"
    )
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)  # nohup ignores it
    try:
        program = start("info", f"exec:{sys.executable} {never}", "--boot-time", "900")
    finally:
        signal.signal(signal.SIGHUP, before)
    pid = int(program.line_with("", "err"))
    program.process.send_signal(number)
    result = program.end()
    assert (result.code, result.out) == (code, "")
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def test_serve_once(start, run):
    server = start("serve", "--once")
    url = server.line_with("listening on ").split()[-1]
    assert run("echo", url, "--count", "3").code == 0
    assert server.end().code == 0


def test_serve_on_standard_streams(run):
    program = f"exec:{sys.executable} -m j2a serve --listen stdio:"
    result = run("echo", program, "--boot-time", "30", "--timeout", "30", "--count", "9", "--json")
    assert result.code == 0
    assert json.loads(result.out)["counters"]["bytes_skipped"] == 0


@pytest.mark.parametrize("attribute", ["device", "make"])
def test_serve_a_device_of_the_user(start, run, tmp_path, attribute):
    (tmp_path / "thermometer.py").write_text(
        "import j2a\n\n"
        "def make():\n"
        "    device = j2a.Device({'name': 'thermometer'})\n"
        "    device.function('celsius')(lambda payload: b'\\x15')\n"
        "    return device\n\n"
        "device = make()\n"
    )
    server = start("serve", "--device", f"thermometer:{attribute}", cwd=tmp_path)
    url = server.line_with("listening on ").split()[-1]
    assert run("call", url, "celsius", "--as", "u8").out == "21\n"


def test_ctrl_c_ends_a_call(start, firmware):
    program = start("call", firmware, "delay", "u16:60000", "--timeout", "inf", "-v")
    program.line_with("delay", "err")
    program.process.send_signal(signal.SIGINT)
    result = program.end()
    assert (result.code, result.out) == (130, "")
    assert "Traceback" not in result.err


def test_ctrl_c_ends_watching(start, demo):
    program = start("watch", demo, "--call", "sifPeriod u16:5", "--json")
    json.loads(program.line_with("{"))
    program.process.send_signal(signal.SIGINT)
    result = program.end()
    assert (result.code, result.err) == (130, "")
    assert len([json.loads(line) for line in result.out.splitlines()]) >= 1


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)], ids=["Ctrl-C", "SIGTERM"]
)
def test_watching_that_is_stopped_calls_the_last_function(start, run, demo, number, code):
    program = start("watch", demo, "--call", "sifPeriod u16:5", "--then", "sifPeriod u16:0")
    program.line_with("opcode")
    program.process.send_signal(number)
    result = program.end()
    assert (result.code, result.err) == (code, "")
    assert run("watch", demo, "--duration", "0.2").out == ""


def test_ctrl_c_ends_an_echo_with_what_it_found(start, demo):
    program = start("echo", demo, "--count", "1000000000", "-v")
    for _ in range(20):
        program.line_with("reply", "err")
    program.process.send_signal(signal.SIGINT)
    result = program.end()
    assert result.code == 130
    assert "echoes correct" in result.out
    assert "were not sent" in result.out


def test_ctrl_c_ends_a_transfer_with_what_it_found(start, demo):
    program = start("echo", demo, "--many", str(64 * 2**20), "--json", "-v")
    for _ in range(20):
        program.line_with("reply", "err")
    program.process.send_signal(signal.SIGINT)
    result = program.end()
    assert result.code == 130
    facts = json.loads(result.out)
    assert (facts["sent"], facts["correct"]) == (1, 0)
    assert 0 < facts["payload_bytes"] < 64 * 2**20


def test_a_reader_of_the_output_that_goes_away(demo):
    with subprocess.Popen(
        [sys.executable, "-m", "j2a", "watch", demo, "--call", "sifPeriod u16:1"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as program:
        assert b"opcode" in program.stdout.readline()
        program.stdout.close()
        assert program.stderr.read() == b""
        assert program.wait(WAIT_S) == 141


def test_output_that_cannot_be_written_at_the_end(demo):
    reader, writer = os.pipe()
    os.close(reader)
    try:
        result = subprocess.run(
            [sys.executable, "-m", "j2a", "info", demo],
            stdout=writer,
            stderr=subprocess.PIPE,
            timeout=WAIT_S,
            check=False,
        )
    finally:
        os.close(writer)
    assert (result.returncode, result.stderr) == (141, b"")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full")
def test_output_to_a_full_disk(demo):
    with Path("/dev/full").open("wb") as full:
        result = subprocess.run(
            [sys.executable, "-m", "j2a", "info", demo],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            timeout=WAIT_S,
            check=False,
        )
    assert result.returncode == 2
    assert result.stderr.startswith("j2a: ") and result.stderr.count("\n") == 1


def test_letters_that_the_terminal_does_not_have(demo):
    result = subprocess.run(
        [sys.executable, "-m", "j2a", "call", demo, "a2jEcho", "str:\u00e9"],
        env={**os.environ, "PYTHONIOENCODING": "ascii"},
        capture_output=True,
        text=True,
        timeout=WAIT_S,
        check=False,
    )
    assert (result.returncode, result.stderr) == (0, "")
    assert result.stdout.endswith('payload  c3 a9  "\\xe9"\n')


def test_a_device_that_is_killed_during_a_call(start):
    server = start("serve")
    url = server.line_with("listening on ").split()[-1]
    program = start("call", url, "delay", "u16:60000", "--timeout", "inf", "-v")
    program.line_with("delay", "err")
    server.process.kill()
    result = program.end()
    assert (result.code, result.out) == (3, "")
    assert f"{url} is lost" in result.err.splitlines()[-1]


def test_a_device_that_goes_away_while_watched(start):
    server = start("serve")
    url = server.line_with("listening on ").split()[-1]
    program = start("watch", url, "--call", "sifPeriod u16:5")
    program.line_with("opcode")
    server.process.kill()
    result = program.end()
    assert result.code == 3
    assert "is lost" in result.err


@pytest.mark.parametrize(("options", "has_bar"), [([], True), (["--no-progress"], False)])
def test_progress_bar_on_a_real_terminal(start, tmp_path, options, has_bar):
    # At this pace the transfer takes longer than the moment that the bar waits.
    (tmp_path / "slow.py").write_text(
        "import time, j2a\n\n"
        "device = j2a.Device()\n\n"
        "@device.many\n"
        "def slow(request):\n"
        "    time.sleep(0.02)\n"
        "    return j2a.ManyReply()\n"
    )
    server = start("serve", "--device", "slow:device", cwd=tmp_path)
    url = server.line_with("listening on ").split()[-1]
    (tmp_path / "data").write_bytes(bytes(10_000))
    command = [sys.executable, "-m", "j2a", "write", url, "slow", f"@{tmp_path / 'data'}"]
    master, slave = os.openpty()
    shown = bytearray()

    def collect():
        try:
            while piece := os.read(master, 4096):
                shown.extend(piece)
        except OSError:
            pass  # how Linux says that the terminal has no user any more

    reader = threading.Thread(target=collect)
    reader.start()
    try:
        result = subprocess.run(
            [*command, "--timeout=30", *options],
            stdout=subprocess.PIPE,
            stderr=slave,
            timeout=WAIT_S,
            check=False,
        )
    finally:
        os.close(slave)
        reader.join(WAIT_S)
        os.close(master)
    assert (result.returncode, result.stdout) == (0, b"")
    assert (b"\rwrite slow  [#" in shown) == has_bar
    assert b"10000 bytes written to slow" in shown


def test_a_signal_to_a_program_that_is_ending_anyway():
    """What is left to do then, such as to remove a folder, is done, and nothing is printed."""
    program = """
import atexit, os, signal, sys
from j2a.cli import main

def end():
    os.kill(os.getpid(), signal.SIGTERM)
    print("done")

atexit.register(end)
sys.argv[1:] = ["--version"]
sys.exit(main())
"""
    done = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        timeout=WAIT_S,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.endswith("\ndone\n")
