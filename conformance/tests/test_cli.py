"""The command line: exit codes, selection, reports, Ctrl-C."""

import signal
import subprocess
import sys
import time

import junitparser
import pytest
from j2a_conformance import load
from j2a_conformance.cli import main


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["run"],
        ["run", "nonsense:"],
        ["run", "exec:/does/not/exist"],
        ["run", "exec:true"],
        ["run", "exec:sleep 60", "--timeout-scale", "0.02"],
        ["run", "exec:yes", "--timeout-scale", "0.02"],
        ["run", "exec:true", "--level", "none"],
        ["run", "exec:true", "--case", "no.such.case"],
        ["run", "exec:true", "--timeout-scale", "0"],
        ["run", "/does/not/exist.toml"],
    ],
)
def test_harness_errors_exit_with_3(arguments, capsys):
    try:
        status = main(arguments)
    except SystemExit as error:
        status = error.code
    assert status == 3
    assert "j2a-conform" in capsys.readouterr().err


def test_a_device_that_sends_the_requests_back_fails(tmp_path, capsys):
    report = tmp_path / "report.xml"
    assert main(["run", "exec:cat", "--junit", str(report), "-v"]) == 1
    out = capsys.readouterr().out
    assert "NOT conformant" in out
    assert "the mapping does not end in NUL" in out
    assert "J2A-MAP-001  a2jGetMapping MUST return 0x00" in out
    assert "-> 12 | 02 | 00 | 00 | 68   SOF seq=0x02 opcode=0x00 length=0x00 checksum right" in out
    xml = junitparser.JUnitXml.fromfile(str(report))
    assert (xml.tests, xml.failures) == (2, 1)
    failed = [case for suite in xml for case in suite if case.result]
    assert failed[0].name == "smoke.mapping"
    assert "the mapping does not end in NUL" in failed[0].result[0].message
    assert "J2A-MAP-001" in failed[0].result[0].text


def test_a_report_that_cannot_be_written(capsys):
    assert main(["run", "exec:cat", "--junit", "/does/not/exist/report.xml"]) == 3
    assert "JUnit" in capsys.readouterr().err


def test_list_shows_cases_and_coverage(capsys):
    assert main(["run", "--list", "--level", "sif"]) == 0
    out = capsys.readouterr().out
    assert "sif.counter" in out
    assert "many.flags" not in out.split("J2A-FRAME-001  ")[0]
    assert "J2A-SIF-004  host suite" in out
    assert "MISSING" not in out


@pytest.mark.parametrize("pattern", ["many.*", "J2A-MANY-007", "many.offsets"])
def test_selection(pattern, capsys):
    main(["run", "--list", "--case", pattern])
    listed = capsys.readouterr().out.split("\n\n")[0]
    cases = [line.split()[0] for line in listed.splitlines() if not line.startswith(" ")]
    assert cases
    assert len(cases) < len(load())
    for case in load():
        if pattern == "J2A-MANY-007":
            assert (case.ID in cases) == (pattern in case.REQUIREMENTS)


def test_ctrl_c_ends_without_a_traceback():
    process = subprocess.Popen(
        [sys.executable, "-m", "j2a_conformance", "run", "exec:sleep 60"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        time.sleep(1.5)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 3, err
    assert "Traceback" not in out + err
