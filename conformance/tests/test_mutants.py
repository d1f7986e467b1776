"""The tables of mutants are sound, cover every requirement, and are those of the kill matrix; and
the run that judges mutants is not fooled by one that survives, that is not built, or that dies.

The run over all of them is a step of its own, tools/check.sh.
"""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from j2a_conformance.cli import main as conform

from conformance.mutants import edit, kill, matrix, targets
from conformance.mutants.tables import (
    ROOT,
    TARGETS,
    Edit,
    Table,
    TableError,
    changed,
    copy,
    edit_of,
    find,
    load,
    place_of,
)

FOLDER = Path(__file__).parents[1] / "mutants"
EXAMPLE, _ = find("core-stuff-004")
QUICK, _ = find("core-disp-004")  # of a rule with one case


@pytest.fixture(scope="module")
def tables():
    return {target: load(target) for target in TARGETS}


def test_the_tables_are_those_of_the_folder(tables):
    assert {path.stem for path in FOLDER.glob("*.toml")} == set(tables)
    assert sum(len(table.mutants) for table in tables.values()) >= 60


@pytest.mark.parametrize("target", TARGETS)
def test_what_an_edit_looks_for_occurs_once(target, tables):
    for mutant in tables[target].mutants:
        before = {e.file: (ROOT / e.file).read_text("utf-8") for e in mutant.edits}
        after = dict(before)
        for change in mutant.edits:
            assert change.file.startswith(("firmware/", "j2a/")), mutant.id
            # In the sources, where readers look for it, and after the edits that come before.
            place_of(before[change.file], change, mutant.id)
            after[change.file] = changed(after[change.file], change, mutant.id)
        for file, text in after.items():
            assert text != before[file], mutant.id
            if file.endswith(".py"):
                compile(text, file, "exec")
        assert mutant.what.strip(" .") == mutant.what != "", mutant.id


@pytest.mark.parametrize("target", TARGETS)
def test_every_requirement_has_a_mutant_or_a_reason(target, tables):
    assert matrix.uncovered(tables[target]) == []
    assert all(len(entry.why) > 20 for entry in tables[target].exempt)


def test_the_kill_matrix_is_that_of_the_tables(tables):
    rows = matrix.read(matrix.MATRIX)
    exceptions = matrix.exceptions(matrix.MATRIX)
    assert {entry["target"] for entry in exceptions} <= set(tables)
    assert matrix.strangers(tables.values(), rows) == []
    for target, table in tables.items():
        assert matrix.differences(table, rows, exceptions) == []
        known = targets.cases(target)
        for mutant in table.mutants:
            kept = rows[mutant.id]
            assert matrix.killers(mutant.requirement, kept.killed_by, known) == {*kept.killed_by}
            assert {*kept.also} <= {*known}


def test_a_requirement_without_mutant_is_told(tables):
    table = tables["core"]
    without = replace(
        table, mutants=tuple(m for m in table.mutants if m.requirement != EXAMPLE.requirement)
    )
    assert matrix.uncovered(without) == [
        "core.toml: J2A-STUFF-004 has neither a mutant nor an exception"
    ]


def test_an_exception_that_is_not_in_the_matrix_is_told(tables):
    rows = matrix.read(matrix.MATRIX)
    changed = [{**entry, "why": "no reason"} for entry in matrix.exceptions(matrix.MATRIX)]
    assert matrix.differences(tables["device"], rows, changed) == [
        "device.toml: its exceptions are not so in matrix.json; run kill.py --write"
    ]


def test_the_copy_has_the_edit_and_nothing_else(tmp_path):
    assert edit.main(["core-stuff-004", str(tmp_path / "copy")]) == 0
    changed = [
        path.relative_to(tmp_path / "copy")
        for path in (tmp_path / "copy").rglob("*.[ch]")
        if path.read_bytes() != (ROOT / path.relative_to(tmp_path / "copy")).read_bytes()
    ]
    assert changed == [Path("firmware/core/j2a_rx.c")]


def test_only_a_folder_that_was_made_for_it_is_made_anew(tmp_path, capsys):
    folder = tmp_path / "copy"
    folder.mkdir()
    assert edit.main(["core-stuff-004", str(folder)]) == 0  # it was empty
    (folder / "stale").touch()
    assert edit.main(["core-stuff-004", str(folder)]) == 0
    assert not (folder / "stale").exists()
    thesis = tmp_path / "thesis.txt"
    thesis.touch()
    assert edit.main(["core-stuff-004", str(tmp_path)]) == 1
    assert thesis.exists()
    assert "is not deleted" in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [["core-stuff-999", "x"], ["nonsense", "x"], ["one"]])
def test_what_cannot_be_copied_is_said(arguments, capsys):
    assert edit.main(arguments) == 1
    assert "edit.py" in capsys.readouterr().err


@pytest.mark.parametrize(("name", "files"), [("nothing.py", "0"), ("port.c", "[2-9]")])
def test_a_name_that_is_not_one_file_is_refused(name, files):
    with pytest.raises(TableError, match=f"^{name} is {files} files of the targets, not one$"):
        edit_of({"file": name, "find": "a", "replace": "b"})


def test_an_edit_that_does_not_fit_is_an_error(tmp_path):
    stale = replace(EXAMPLE, edits=(Edit("firmware/core/j2a_rx.c", "no[such] %= text;", "x"),))
    with pytest.raises(TableError, match=r"core-stuff-004: .* is gone"):
        copy("core", stale, tmp_path)


def test_make_builds_a_mutant_that_the_suite_fails(make, need, tmp_path, capsys):
    need("cc")
    done = make(MUTANT="core-stuff-004", OUT=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "breaks J2A-STUFF-004" in done.stdout
    assert conform(["run", f"exec:{tmp_path}/demo", "--case", "stuff.*"]) == 1
    assert "stuff.escape-ff" in capsys.readouterr().out
    assert make(MUTANT="core-stuff-999", OUT=tmp_path).returncode != 0


@pytest.fixture
def judge(monkeypatch, tmp_path, need, capsys):
    """Run kill.py over a table of one mutant; return its exit code and what it printed."""
    need("cc")
    monkeypatch.setattr(matrix, "MATRIX", tmp_path / "matrix.json")

    def run(*edits, killed_by=(), like=EXAMPLE):
        mutant = replace(like, edits=edits)
        target = mutant.id.partition("-")[0]
        table = Table(target, (mutant,), ())
        monkeypatch.setattr(kill, "TARGETS", (target,))
        monkeypatch.setattr(kill, "load", lambda _: table)
        if killed_by:
            rows = {mutant.id: matrix.row(mutant, killed_by)}
            matrix.write([table], rows, matrix.MATRIX)
        status = kill.main(["--only", mutant.id, "-j", "1"])
        return status, capsys.readouterr().out

    return run


RX = "firmware/core/j2a_rx.c"


def test_a_mutant_that_is_noticed_is_killed(judge):
    assert judge(*QUICK.edits, like=QUICK) == (0, "1 mutants, 1 killed\n")


def test_a_mutant_that_breaks_nothing_survives(judge):
    status, printed = judge(Edit(RX, "/* The push parser.", "/* A parser."), like=QUICK)
    assert (status, printed) == (1, "core-disp-004: survives\n1 mutants, 0 killed\n")


def test_a_mutant_that_breaks_another_rule_survives(judge):
    file = "firmware/core/ext/j2a_debug.c"
    status, printed = judge(Edit(file, "code |= J2A_DEBUG_MORE;", "code |= 0;"), like=QUICK)
    assert (status, printed) == (1, "core-disp-004: survives\n1 mutants, 0 killed\n")


def test_a_mutant_that_is_not_built_is_an_error(judge):
    status, printed = judge(Edit(RX, "if (byte == 0xFF)", "if (byte == 0xFF"), like=QUICK)
    assert status == 1
    assert "it is not built" in printed
    assert "0 killed" in printed


def in_the_case(does):
    """Edit the sender of QUICK so that it does this after the first step, in the case."""
    start = "    j2a_tx_byte(start);"
    wrong = f"    static uint8_t sent;\n    if (++sent > 25)\n        {does};\n"
    return Edit("firmware/core/j2a_tx.c", start, wrong + start)


def test_a_mutant_that_dies_is_an_error(judge):
    status, printed = judge(in_the_case("*(volatile int *)1 = 0"), like=QUICK)
    assert status == 1
    assert "it died in" in printed


def test_a_mutant_that_answers_nothing_is_an_error(judge):
    status, printed = judge(Edit(RX, "rx->event = J2A_EVENT_FRAME;", ""), like=QUICK)
    assert status == 1
    assert "nothing answers" in printed


def test_a_core_that_hangs_is_an_error(judge):
    hang = "for (;;) { extern int pause(void); pause(); }"  # a loop alone would take a whole core
    status, printed = judge(in_the_case(hang), like=QUICK)
    assert status == 1
    assert "nothing answers after dispatch.reserved-values" in printed
    assert "0 killed" in printed


def test_a_host_that_sends_nothing_is_an_error(judge):
    like, _ = find("host-frame-001")
    silent = Edit("j2a/io/threads.py", "if self._written == self._queued:", "if data := b'':")
    status, printed = judge(silent, killed_by=("host.start",), like=like)
    assert status == 1
    assert "nothing came from the host" in printed
    assert "0 killed" in printed


def test_a_kill_that_does_not_come_is_a_note_when_another_comes(judge):
    status, printed = judge(*EXAMPLE.edits, killed_by=("stuff.needless", "stuff.escape-ff"))
    assert status == 0
    assert printed == (
        "note: core-stuff-004: stuff.needless kills it, says matrix.json; not seen this time\n"
        "1 mutants, 1 killed\n"
    )


def test_one_kill_is_enough(judge):
    status, printed = judge(*EXAMPLE.edits, killed_by=("stuff.escape-ff", "stuff.needless"))
    assert (status, printed) == (0, "1 mutants, 1 killed\n")


def test_all_cases_of_the_rule_are_done_when_no_known_kill_comes(judge):
    status, printed = judge(*EXAMPLE.edits, killed_by=("stuff.needless",))
    assert status == 0
    assert "stuff.needless kills it, says matrix.json; not seen this time" in printed


@pytest.mark.parametrize(("quick", "runs"), [(False, 2), (True, 3)])
def test_a_kill_may_come_late(monkeypatch, tmp_path, quick, runs):
    done = []

    def run(trial, names, heard):
        failed = [name for name in names if name == "stuff.escape-ff" and name in done]
        done.extend(names)
        return [SimpleNamespace(case=name, reason="") for name in failed]

    monkeypatch.setattr(targets._Trial, "_run", run)
    how = targets.variant("core", EXAMPLE)
    job = targets.Job(how, EXAMPLE, ("stuff.escape-ff",), quick=quick)
    assert targets._Trial(job, tmp_path).mutated(EXAMPLE) == ("stuff.escape-ff",)
    assert done.count("stuff.escape-ff") == runs


@pytest.mark.parametrize("count", ["0", "-1", "many"])
def test_a_number_of_jobs_is_at_least_1(count, capsys):
    with pytest.raises(SystemExit, match="2"):
        kill.main(["-j", count])
    assert "-j" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words",
    [["--sample", "3"], *(["--dimensions", f"--{w}"] for w in ("write", "record", "changed"))],
)
def test_options_that_say_nothing_together_are_refused(words, monkeypatch, capsys):
    monkeypatch.setattr(kill, "_judge_all", lambda *_: pytest.fail("judges"))
    with pytest.raises(SystemExit, match="2"):
        kill.main(words)
    assert "--dimensions" in capsys.readouterr().err


def test_a_mutant_that_the_target_leaves_out_is_said(capsys):
    assert kill.main(["--only", "core-stuff-004", "--target", "host"]) == 1
    assert "--target leaves out core-stuff-004" in capsys.readouterr().err
    assert kill.main(["--only", "core-stuff-999"]) == 1
    assert "no such mutant: core-stuff-999" in capsys.readouterr().err


def test_nothing_to_judge_is_a_failure(monkeypatch, capsys):
    monkeypatch.setattr(kill, "TARGETS", ("core",))
    monkeypatch.setattr(kill, "load", lambda target: Table(target, (), ()))
    assert kill.main([]) == 1
    assert "0 mutants, 0 killed" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("how", "claims"),
    [
        (targets.Variant("core", "posix", "demo"), True),
        (targets.Variant("device"), True),
        (targets.Variant("core", "posix", "builtins"), False),
        (targets.Variant("core", "posix", "demo", "-DJ2A_WITH_SIF=0"), False),
        (targets.Variant("device", options="room=64"), False),
    ],
)
def test_a_name_that_a_mutant_lost_excuses_no_case(monkeypatch, tmp_path, how, claims):
    asked = {}
    monkeypatch.setattr(targets, "run", lambda *_args, **options: asked.update(options))
    monkeypatch.setattr(targets, "_device", lambda *_args: ("exec:nothing", 1.0))
    targets._Trial(targets.Job(how, None, ()), tmp_path)._suite((), targets._Heard())
    assert ("sif" in asked["claimed"]) == claims
