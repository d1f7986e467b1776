"""Reports on the command line: all from one run, none lost for another, faults found at once."""

import json
import sys
from xml.etree import ElementTree

import junitparser
import pytest
from j2a_conformance.cli import main, run
from j2a_conformance.reports import _badge
from j2a_conformance.reports._json import read, render

KINDS = ("junit", "json", "html", "badge")


def options(folder, *kinds):
    return [word for kind in kinds for word in (f"--{kind}", str(folder / kind))]


def test_all_reports_are_of_one_run(tmp_path, capsys):
    assert main(["run", "exec:cat", *options(tmp_path, *KINDS)]) == 1
    found = read(tmp_path / "json")
    assert [result.verdict.value for result in found.results] == ["ok", "failed"]
    assert found.not_run
    reason = found.results[-1].reason
    assert reason in capsys.readouterr().out
    assert reason in (tmp_path / "html").read_text("utf-8")
    assert junitparser.JUnitXml.fromfile(str(tmp_path / "junit")).failures == 1
    badge = ElementTree.parse(tmp_path / "badge").getroot()
    assert badge[0].text == _badge.text(found)


@pytest.mark.parametrize("kind", ["junit", "json", "html"])
def test_a_report_that_fails_costs_no_other(kind, tmp_path, capsys, monkeypatch):
    def broken(_run):
        raise ZeroDivisionError("oh")

    monkeypatch.setattr(f"j2a_conformance.reports._{kind}.render", broken)
    assert main(["run", "exec:cat", *options(tmp_path, *KINDS)]) == 3
    captured = capsys.readouterr()
    assert f"a fault of --{kind}: ZeroDivisionError: oh" in captured.err
    assert "NOT conformant" in captured.out
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted({*KINDS} - {kind})


@pytest.fixture
def no_run(monkeypatch):
    def begun(*_args, **_options):
        raise AssertionError("the run has begun")

    monkeypatch.setattr(run, "run", begun)


@pytest.mark.usefixtures("no_run")
@pytest.mark.parametrize("kind", KINDS)
def test_a_file_that_cannot_be_written_is_found_before_the_run(kind, tmp_path, capsys):
    for path in (tmp_path / "none" / "file", tmp_path):
        assert main(["run", "exec:cat", f"--{kind}", str(path)]) == 3
        assert f"cannot write {path}: " in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("no_run")
@pytest.mark.parametrize(("kind", "package"), [("junit", "junitparser"), ("html", "jinja2")])
def test_a_package_that_is_missing_is_found_before_the_run(kind, package, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, package, None)
    for module in ("_junit", "_html", "_pages"):
        monkeypatch.delitem(sys.modules, f"j2a_conformance.reports.{module}", raising=False)
    assert main(["run", "exec:cat", f"--{kind}", "report"]) == 3
    assert "install j2a[conformance]" in capsys.readouterr().err


@pytest.mark.usefixtures("no_run")
def test_two_reports_in_one_file_are_refused(tmp_path, capsys):
    with pytest.raises(SystemExit) as caught:
        main(["run", "exec:cat", "--json", str(tmp_path / "a"), "--html", str(tmp_path / "a")])
    assert caught.value.code == 3
    assert "a file of its own" in capsys.readouterr().err


def test_a_file_that_was_there_is_replaced_only_by_a_report(tmp_path, capsys):
    path = tmp_path / "report.json"
    path.write_text("old")
    assert main(["run", "exec:/does/not/exist", "--json", str(path)]) == 3
    assert path.read_text() == "old"
    assert main(["run", "exec:cat", "--json", str(path)]) == 1
    assert json.loads(path.read_text())["format"]


def test_the_matrix_command(failed_run, good_run, tmp_path, capsys):
    for name, found in (("good", good_run), ("bad", failed_run)):
        (tmp_path / name).write_bytes(render(found))
    page = tmp_path / "matrix.html"
    names = [str(tmp_path / name) for name in ("good", "bad")]
    assert main(["matrix", *names, "--html", str(page)]) == 0
    text = page.read_text("utf-8")
    assert "2 runs" in text
    assert 'href="#run-2-case-frame.interrupted"' in text
    assert 'id="run-2-case-frame.interrupted"' in text
    assert main(["matrix", str(page), "--html", str(tmp_path / "other.html")]) == 3
    assert f"{page} is no report of j2a-conform" in capsys.readouterr().err
    assert not (tmp_path / "other.html").exists()


def test_the_matrix_command_replaces_no_report(good_run, tmp_path, capsys):
    report, link = tmp_path / "a.json", tmp_path / "link.html"
    report.write_bytes(render(good_run))
    link.symlink_to(report)
    for page in (report, tmp_path / ".." / tmp_path.name / "a.json", link):
        with pytest.raises(SystemExit) as caught:
            main(["matrix", str(report), "--html", str(page)])
        assert caught.value.code == 3
        assert "would replace the report" in capsys.readouterr().err
    assert report.read_bytes() == render(good_run)


def test_a_matrix_that_cannot_be_written_is_found_before_the_reports_are_read(tmp_path, capsys):
    for page in (tmp_path, tmp_path / "none" / "page.html"):
        assert main(["matrix", str(tmp_path / "none.json"), "--html", str(page)]) == 3
        assert f"cannot write {page}" in capsys.readouterr().err
