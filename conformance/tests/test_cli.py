"""The command line: exit codes, selection, reports, Ctrl-C."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import junitparser
import pytest
from j2a_conformance import load
from j2a_conformance.cli import compare, main, run
from j2a_conformance.device.cases.frame import Layout
from j2a_conformance.host.cases.seq import Late

CLIENT = [sys.executable, str(Path(__file__).parents[1] / "hosts" / "client.py")]


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
    assert (xml.tests, xml.failures, xml.errors) == (3, 1, 1)  # the run ended early, too
    failed = [case for suite in xml for case in suite if case.result]
    assert failed[0].name == "smoke.mapping"
    assert "the mapping does not end in NUL" in failed[0].result[0].message
    assert "J2A-MAP-001" in failed[0].result[0].text


def test_a_report_that_cannot_be_written(capsys):
    assert main(["run", "exec:cat", "--junit", "/does/not/exist/report.xml"]) == 3
    assert "cannot write /does/not/exist/report.xml" in capsys.readouterr().err


def test_list_shows_cases_and_coverage(capsys):
    assert main(["run", "--list", "--level", "sif"]) == 0
    out = capsys.readouterr().out
    assert "sif.counter" in out
    assert "many.flags" not in out.split("J2A-FRAME-001  ")[0]
    assert "J2A-SIF-004  host.sif." in out
    assert "MISSING" not in out


def test_smoke_cases_are_cases(capsys):
    assert main(["run", "--list", "--level", "frame"]) == 0
    assert "smoke.answer  (frame)" in capsys.readouterr().out
    assert main(["run", "exec:cat", "--case", "smoke.answer", "-v"]) == 1
    assert capsys.readouterr().out.count("ok              smoke.answer  ") == 1


def test_a_fault_of_the_suite_is_no_verdict(capsys, monkeypatch):
    def broken(*_args, **_options):
        raise ZeroDivisionError("oh")

    monkeypatch.setattr(run, "run", broken)
    assert main(["run", "exec:cat"]) == 3
    assert "Traceback" not in (err := capsys.readouterr().err)
    assert "a fault of the suite, -v shows more: ZeroDivisionError: oh" in err
    assert main(["run", "exec:cat", "-v"]) == 3
    assert "Traceback" in (err := capsys.readouterr().err)
    assert "-v shows more" not in err


def test_a_fault_of_the_suite_names_the_case_for_a_device(capsys, monkeypatch, build_firmware):
    monkeypatch.setattr(Layout, "run", _broken)
    arguments = ["run", f"exec:{build_firmware('demo')}", "--case", "frame.layout"]
    _names_the_case(arguments, "frame.layout", capsys)


def test_a_fault_of_the_suite_names_the_case_for_a_host(capsys, monkeypatch):
    monkeypatch.setattr(Late, "run", _broken)
    arguments = ["host", "--case", "host.seq.late", "--", *CLIENT]
    _names_the_case(arguments, "host.seq.late", capsys)


def _broken(*_args):
    raise ZeroDivisionError("oh")


def _names_the_case(arguments, case, capsys):
    assert main(arguments) == 3
    fault, advice = capsys.readouterr().err.splitlines()
    what = "-v shows more: ZeroDivisionError: oh"
    assert fault == f"j2a-conform: a fault of the suite in the case {case}, {what}"
    assert advice == (
        "This says nothing about the testee: report it, and choose other cases by --case."
    )


def test_a_command_without_v_does_not_speak_of_it(capsys, monkeypatch):
    def broken(_args):
        raise ZeroDivisionError("oh")

    monkeypatch.setattr(compare, "main", broken)
    assert main(["compare", "a", "b"]) == 3
    assert "a fault of the suite: ZeroDivisionError: oh" in capsys.readouterr().err


def test_junit_without_its_package_ends_before_the_run(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "junitparser", None)
    monkeypatch.delitem(sys.modules, "j2a_conformance.reports._junit", raising=False)
    assert main(["run", "exec:cat", "--junit", str(tmp_path / "report.xml")]) == 3
    captured = capsys.readouterr()
    assert "j2a[conformance]" in captured.err
    assert not captured.out


@pytest.mark.parametrize("list_", [["--list"], ["exec:cat", "-v"]])
def test_output_that_nobody_reads_is_no_verdict(list_):
    # Without junitparser, which a plain installation does not have.
    code = "import sys; sys.modules['junitparser'] = None; from j2a_conformance.cli import main"
    with subprocess.Popen(
        [sys.executable, "-c", f"{code}; sys.exit(main())", "run", *list_],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as process:
        process.stdout.close()
        err = process.stderr.read()
        assert process.wait(60) == 3, err
    assert err == b""


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


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--case", "frame.layout", "frame.layuot"], "no case matches frame.layuot; --list"),
        (["--level", "sif", "--case", "many.*"], "no case of the levels sif matches many.*"),
        (["--level", "frame", "python"], "there is no level python; the levels are frame, core"),
        (["tcp://127.0.0.1:1", "--level", "frame", "exec:cat"], "there is no level exec:cat"),
    ],
)
def test_what_chooses_nothing_is_refused(words, message, capsys):
    try:
        assert main(["run", "exec:cat", *words] if words[0][0] == "-" else ["run", *words]) == 3
    except SystemExit as error:
        assert error.code == 3
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    "words",
    [
        ["--level", "frame", "exec:cat"],
        ["--level", "frame", "core", "exec:cat", "--case", "smoke.*"],
        ["--case", "smoke.*", "exec:cat", "-v"],
        ["-v", "exec:cat", "--level", "frame"],
    ],
)
def test_the_url_may_stand_behind_the_options(words, capsys):
    assert main(["run", *words]) == 1
    assert "exec:cat" in capsys.readouterr().out


def test_a_testee_may_stand_behind_the_options(capsys):
    assert main(["run", "--level", "frame", "/does/not/exist.toml"]) == 3
    assert "/does/not/exist.toml is no testee" in capsys.readouterr().err


def test_a_signal_while_a_command_is_loaded(monkeypatch, capsys):
    def interrupt(_name):
        raise KeyboardInterrupt

    monkeypatch.setattr("j2a_conformance.cli._module", interrupt)
    assert main(["run", "exec:cat"]) == 130
    assert capsys.readouterr().err == "j2a-conform: interrupted\n"


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)], ids=["Ctrl-C", "SIGTERM"]
)
@pytest.mark.parametrize(
    "words",
    [
        ["run", "exec:{}"],
        ["run", "exec:{}", "--repeat", "3"],
        ["selftest", "exec:{}"],
        ["faults", "exec:{}"],
        ["faults", "exec:{}", "--soak", "60"],
        ["host", "tcp://127.0.0.1:0"],
        ["host", "--", "sh", "{}"],
    ],
    ids=" ".join,
)
def test_a_signal_ends_every_command_without_a_traceback(words, number, code, tmp_path):
    started, script = tmp_path / "started", tmp_path / "device"
    script.write_text(f"touch {started}; exec sleep 60\n")
    run_script = f"sh {script}" if words[1] == "exec:{}" else str(script)
    process = subprocess.Popen(
        [sys.executable, "-m", "j2a_conformance", *(word.format(run_script) for word in words)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        if "tcp:" in words[1]:
            assert "Waiting for a host" in process.stdout.readline()
        end = time.monotonic() + 60
        while "tcp:" not in words[1] and not started.exists():
            assert time.monotonic() < end and process.poll() is None
            time.sleep(0.02)
        process.send_signal(number)
        out, err = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == code, err
    assert "Traceback" not in out + err
