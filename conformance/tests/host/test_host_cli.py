"""The command line for hosts: programs that misbehave, a host that is waited for, Ctrl-C."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import junitparser
import pytest
from j2a_conformance.cli import main
from j2a_conformance.reports import _json

# A host program that connects and does what the text says.
CONNECTS = """
import socket, sys, time
_, host, port = sys.argv[-1].split(":")
s = socket.create_connection((host[2:], int(port)))
"""
CLIENT = [sys.executable, str(Path(__file__).parents[2] / "hosts" / "client.py")]


def program(code: str) -> list[str]:
    return ["--", sys.executable, "-c", CONNECTS + code]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "a host is needed"),
        (["--", "/does/not/exist"], "cannot start"),
        (["--", sys.executable, "-c", "print('oh'); raise SystemExit(7)"], "exit code 7:\noh"),
        (["--timeout-scale", "0.02", "--", "sh", "-c", "sleep 60"], "no host connected within"),
        (["--wait", "0.1", "tcp://127.0.0.1:0"], "no host connected within 0.1 s"),
        (["tcp://127.0.0.1:99999"], "port"),
        (["pty:/tmp/x"], "at tcp:// only"),
        (["--case", "no.such.case", "x"], "no case matches"),
        (["--timeout-scale", "0", "x"], "--timeout-scale"),
        (["--wait", "0", "x"], "--wait"),
        (["--junit", "/does/not/exist/x.xml", "--", "true"], "cannot write"),
    ],
)
def test_harness_errors_exit_with_3(arguments, message, capsys):
    try:
        status = main(["host", *arguments])
    except SystemExit as error:
        status = error.code
    assert status == 3
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("code", "reason"),
    [
        ("s.send(b'GET / HTTP/1.0\\r\\n'); time.sleep(60)", "16 bytes outside a frame"),
        ("s.send(b'\\x12\\x00\\xe0'); time.sleep(60)", "12 00 e0 has no end"),
    ],
)
def test_programs_that_speak_no_j2a_fail(code, reason, capsys):
    began_s = time.monotonic()
    assert main(["host", "--timeout-scale", "0.05", *program(code)]) == 1
    assert time.monotonic() - began_s < 30
    out = capsys.readouterr().out
    assert reason in out
    assert "host.start failed, so nothing else can be judged" in out
    assert "The host is NOT conformant" in out


@pytest.mark.parametrize(
    ("code", "reason"),
    [
        ("time.sleep(60)", "nothing came from the host"),
        ("s.close(); time.sleep(60)", "the host closed the link"),
        ("raise SystemExit('oh no')", "exit code 1:\noh no"),
        ("[s.send(s.recv(100) or b'\\x12') for _ in range(99)]", "nothing came"),
    ],
)
def test_of_programs_that_send_nothing_nothing_is_said(code, reason, capsys):
    assert main(["host", "--timeout-scale", "0.05", *program(code)]) == 3
    assert reason in capsys.readouterr().err


def test_a_program_that_ends_after_each_failure_is_started_anew(host_reference, host_judged):
    class Fragile(host_reference):
        def sif(self, seq, opcode, payload):
            raise RuntimeError("no SIFs, please")

    cases = ["host.sif.any-time", "host.sif.burst", "host.many.write"]
    run = host_judged(Fragile, cases)
    assert [result.verdict.value for result in run.results] == ["ok", "ok", "failed", "failed"]
    assert "no SIFs, please" in run.results[-1].reason


def test_a_program_that_lacks_a_kind_of_job_is_no_failure(host_reference, host_judged):
    class Simple(host_reference):
        def job(self, text):
            return super().job(text) if text.startswith(("call", "bye")) else "unsupported"

    run = host_judged(Simple)
    verdicts = {result.case: result.verdict.value for result in run.results}
    assert set(verdicts.values()) == {"ok", "unimplemented"}
    assert verdicts["host.sif.burst"] == verdicts["host.many.write"] == "unimplemented"
    assert verdicts["host.seq.late"] == verdicts["host.received.codes"] == "ok"
    assert run.conformant


def test_nothing_to_test_exits_with_4(tmp_path, capsys):
    # The smallest host program there is: it does no job at all but the calls for the next one.
    host = tmp_path / "host.py"
    host.write_text(
        "import sys, j2a\n"
        "board = j2a.connect(sys.argv[-1])\n"
        "job = board.call(0xE0, b'ready').payload\n"
        "while job != b'bye':\n"
        "    job = board.call(0xE0, b'unsupported').payload\n"
    )
    command = ["host", "--case", "host.sif.missing", "--", sys.executable, str(host)]
    assert main(command) == 4
    assert "does not know the job sifs" in capsys.readouterr().out


def test_reports(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(Path(CLIENT[1]).parents[2])
    kinds = ("json", "junit", "html", "badge")
    options = [f"--{kind}={tmp_path / kind}" for kind in kinds]
    assert main(["host", "--case", "host.error.*", "-v", *options, "--", *CLIENT]) == 0
    out = capsys.readouterr().out
    assert ["ok", "host.error.payloads"] in [line.split()[:2] for line in out.splitlines()]
    assert "The host is conformant" in out
    run = _json.read(tmp_path / "json")
    python = Path(sys.executable)
    inside = python.is_relative_to(Path.cwd())
    shown = (
        f"{python.relative_to(Path.cwd()) if inside else python.name} conformance/hosts/client.py"
    )
    assert (run.role, run.title, run.url) == ("host", "j2a.Client", shown)
    assert {"host.start", "host.error.early"} <= {result.case for result in run.results}
    assert "host.sif.burst" in run.not_run
    assert junitparser.JUnitXml.fromfile(str(tmp_path / "junit")).tests == len(run.results)
    assert b"host.error.early" in (tmp_path / "html").read_bytes()
    assert b"<svg" in (tmp_path / "badge").read_bytes()


def test_list_shows_cases_and_coverage(capsys):
    assert main(["host", "--list", "--level", "sif"]) == 0
    out = capsys.readouterr().out
    assert "host.sif.missing  (sif)" in out
    assert "J2A-SEQ-003  host.start" in out
    assert "J2A-TIME-005  no case: " in out
    assert "J2A-SEQ-001" not in out


def run_suite(*arguments):
    return subprocess.Popen(
        [sys.executable, "-m", "j2a_conformance", "host", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def test_a_host_that_somebody_starts_by_hand():
    with run_suite("--case", "host.names.*", "--", "tcp://127.0.0.1:0") as suite:
        url = suite.stdout.readline().split()[-1]
        host = subprocess.run([*CLIENT, url], timeout=60, check=False)
        out, err = suite.communicate(timeout=60)
    assert suite.returncode == 0, out + err
    assert host.returncode == 0
    assert "The host is conformant" in out


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_suite_the_program_and_what_that_started(number, tmp_path, gone):
    pid_file = tmp_path / "pid"
    code = (
        "import pathlib, subprocess\n"
        "child = subprocess.Popen(['sleep', '60'])\n"
        f"pathlib.Path({str(pid_file)!r}).write_text(str(child.pid))\n"
        "child.wait()"
    )
    with run_suite("-v", "--timeout-scale", "10", *program(code)) as suite:
        try:
            while not (pid_file.exists() and pid_file.read_text()):
                time.sleep(0.02)
            suite.send_signal(number)
            out, err = suite.communicate(timeout=200)
        finally:
            suite.kill()
    assert suite.returncode == 128 + number, err
    assert "Traceback" not in out + err
    gone(int(pid_file.read_text()))


def test_what_a_program_left_behind_is_ended(tmp_path, gone):
    pid_file = tmp_path / "pid"
    code = f"sleep 311 & echo $! > {pid_file}; exit 0"
    assert main(["host", "--", "sh", "-c", code]) == 3
    gone(int(pid_file.read_text()))
