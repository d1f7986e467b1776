"""Generated mutants: those that break a rule under a condition, and the mechanical ones.

The runs over them are commands, `kill.py --dimensions` and `random_mutants.py`.
"""

import re
from collections import Counter
from functools import cache
from pathlib import Path
from textwrap import dedent

import pytest
from j2a_spec import requirements

from conformance.mutants import dimensional, edit, kill, matrix, mechanical, random_mutants, targets
from conformance.mutants.tables import ROOT, TARGETS, TableError, changed

FOLDER = Path(__file__).parents[1] / "mutants"
KINDS = ("operator", "constant", "negation", "statement", "return", "arguments")
ROLES = {"core": "device", "device": "device", "host": "host"}


@pytest.fixture(scope="module")
def generated():
    return {target: dimensional.generate(target) for target in TARGETS}


@pytest.fixture(scope="module")
def mechanically():
    return cache(random_mutants.generate)


@pytest.mark.parametrize("target", TARGETS)
def test_every_product_is_a_mutant_of_a_rule_that_cases_name(target, generated):
    known, cases, shapes = requirements.load(), targets.cases(target), set()
    for mutant in generated[target]:
        assert known[mutant.requirement].role in ("both", ROLES[target]), mutant.id
        assert matrix.killers(mutant.requirement, cases, cases), mutant.id
        after = {change.file: (ROOT / change.file).read_text("utf-8") for change in mutant.edits}
        for change in mutant.edits:
            assert "GUARD" not in change.replace, mutant.id
            after[change.file] = changed(after[change.file], change, mutant.id)
        shape = re.sub(r"-[0-9a-f]{1,3}$", "", mutant.id)  # which differ by a number alone
        for file, text in () if shape in shapes else after.items():
            if file.endswith(".py"):
                compile(text, file, "exec")
        shapes.add(shape)


def test_the_dimensions_are_all_used(generated):
    ids = [mutant.id for mutants in generated.values() for mutant in mutants]
    assert len(ids) == len(set(ids)) > 3000
    used = {name.partition("@")[2] for name in ids}
    assert used >= {
        *(f"above-{value}" for value in dimensional.ABOVE),
        *(f"length-{value}" for value in dimensional.EXACT),
        *(f"time-{count}" for count in dimensional.COUNTS),
        *("first", "middle", "last", "behind-127", "after-an-error", "in-pieces"),
        *("with-requests-queued", "sifs-length", "errors-seq", "writes", "seq-ed"),
    }


def test_a_sample_is_the_same_each_time_and_spread_over_the_sites(generated):
    mutants = generated["core"]
    chosen = dimensional.sample(mutants, 40, seed=3)
    assert chosen == dimensional.sample(dimensional.generate("core"), 40, seed=3)
    assert chosen != dimensional.sample(mutants, 40, seed=4)
    assert max(Counter(mutant.id.partition("@")[0] for mutant in chosen).values()) == 1


def test_a_copy_has_the_condition(tmp_path):
    assert edit.main(["core-sum-003@above-64", str(tmp_path / "copy")]) == 0
    text = (tmp_path / "copy/firmware/core/j2a_rx.c").read_text("utf-8")
    assert "byte != rx->checksum && !(rx->length > 64)" in text


def test_a_site_without_a_condition_is_refused(tmp_path, monkeypatch):
    (tmp_path / "dimensions").mkdir()
    (tmp_path / "dimensions/core.toml").write_text(
        dedent("""\
            [state]
            edits = []
            [[site]]
            id = "core-sum-003"
            what = "takes anything"
            file = "firmware/core/j2a_rx.c"
            find = "if (byte != rx->checksum) {"
            replace = "if (false) {"
            """),
        "utf-8",
    )
    monkeypatch.setattr(dimensional, "FOLDER", tmp_path)
    with pytest.raises(TableError, match="no edit holds GUARD"):
        dimensional.generate("core")


def test_a_dimensional_mutant_that_survives_is_told(monkeypatch, capsys):
    monkeypatch.setattr(
        kill, "_judge_all", lambda *_: kill.Found({"core-sum-003@above-64": targets.Outcome()})
    )
    assert kill.main(["--dimensions", "--only", "core-sum-003@above-64"]) == 1
    assert "core-sum-003@above-64: survives: takes a request" in capsys.readouterr().out


@pytest.mark.parametrize("target", ["core", "device", "library"])
def test_mechanical_mutants_of_every_kind_are_found(target, mechanically):
    found = mechanically(target)
    assert len(found) > 500
    assert {mutant.rule for mutant in found} == {*KINDS}
    assert found == random_mutants.generate(target)


def test_the_changes_of_c_are_those_of_its_functions():
    source = dedent("""\
        enum { A_NAME, OTHER };
        #define LIMIT(x) ((x) > 3)
        static int limit(uint8_t *p, int n) {
            if (n < 2) /* 1 + 1 */
                return 0;
            take(p, n);
            return n;
        }
        """)
    changed = {
        (source[c.start : c.end], c.text, c.rule, c.function) for c in mechanical.of_c(source)
    }
    assert changed == {
        ("(n < 2)", "(!(n < 2))", "negation", "limit"),
        ("<", "<=", "operator", "limit"),
        ("<", ">=", "operator", "limit"),
        ("2", "3", "constant", "limit"),
        ("2", "1", "constant", "limit"),
        ("return 0", "return 1", "return", "limit"),
        ("0", "1", "constant", "limit"),
        ("take(p, n)", "", "statement", "limit"),
        ("p, n", "n, p", "arguments", "limit"),
        ("return n", "return 0", "return", "limit"),
        ("return n", "return 1", "return", "limit"),
    }


def test_the_changes_of_python_leave_messages_and_types_alone():
    source = dedent('''\
        def limit(number: int = 1) -> int:
            """Return 1 + 1."""
            if number < 2:
                raise ValueError(f"{number + 1}")
            _logger.info("%d", 3)
            return min(number, 4)
        ''')
    changed = {(source[c.start : c.end], c.text, c.rule) for c in mechanical.of_python(source)}
    assert changed == {
        ("1", "2", "constant"),
        ("1", "0", "constant"),
        ("<", "<=", "operator"),
        ("<", ">=", "operator"),
        ("number < 2", "not (number < 2)", "negation"),
        ("2", "3", "constant"),
        ("2", "1", "constant"),
        ('raise ValueError(f"{number + 1}")', "pass", "statement"),
        ("min(number, 4)", "None", "return"),
        ("number, 4", "4, number", "arguments"),
        ("4", "5", "constant"),
        ("4", "3", "constant"),
    }


def test_a_mechanical_mutant_keeps_its_id_when_lines_move():
    path = ROOT / "j2a/protocol/server.py"
    source = path.read_text("utf-8")
    moved = f"# A line more.\n\n{source}"
    names = [
        [random_mutants._named("j2a/protocol/server.py", text, change).id for change in changes]
        for text, changes in (
            (source, mechanical.of_python(source)),
            (moved, mechanical.of_python(moved)),
        )
    ]
    assert names[0] == names[1]


def test_each_entry_of_the_equivalents_is_of_use(mechanically):
    used: dict[str, bool] = {}
    for target in ("core", "device", "library"):
        found = mechanically(target)
        for entry in random_mutants._equivalents(target):
            assert len(entry["why"]) > 20
            use = any(random_mutants._why_equivalent(mutant, [entry]) for mutant in found)
            used[str(entry)] = used.get(str(entry), False) or use  # of "*" one target is enough
    assert [entry for entry, use in used.items() if not use] == []


def test_code_that_does_not_change_is_no_mutant():
    before = 'def f(n: int) -> int:\n    """Text."""\n    return n + 1\n'
    assert random_mutants._code(before) == random_mutants._code("\n" + before)
    assert random_mutants._code(before) != random_mutants._code(before.replace("+", "-"))
