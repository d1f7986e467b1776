"""What changed between two runs, and the exit code that says so."""

from dataclasses import replace

import pytest
from j2a_conformance import Claims, Result, Run, Verdict
from j2a_conformance.cli import main
from j2a_conformance.reports._compare import compare, report
from j2a_conformance.reports._json import render


def result(case, verdict=Verdict.OK, reason=""):
    return Result(case, "", "", (), "frame", verdict, reason)


def run_of(*results, claims=None, **options):
    return Run("loopback", "2026-01-02T03:04:05+00:00", 1.0, claims, results, **options)


RANKS = [
    {Verdict.OK, Verdict.INFORMATIONAL},
    {Verdict.UNIMPLEMENTED},
    {Verdict.NON_STRICT},
    {Verdict.KNOWN_DEVIATION},
    {Verdict.FAILED},
]


@pytest.mark.parametrize("before", Verdict)
@pytest.mark.parametrize("after", Verdict)
def test_a_worse_verdict_is_a_regression(before, after):
    found = compare(run_of(result("a", before)), run_of(result("a", after)))
    old, new = (next(i for i, r in enumerate(RANKS) if v in r) for v in (before, after))
    assert len(found.regressions) == (new > old)
    assert len(found.changes) == (before is not after)


@pytest.fixture
def files(tmp_path):
    def write(*runs):
        paths = [tmp_path / f"{index}.json" for index, _ in enumerate(runs)]
        for path, run in zip(paths, runs, strict=True):
            path.write_bytes(render(run))
        return [str(path) for path in paths]

    return write


def test_the_text_names_all_that_changed_regressions_first(files, capsys):
    before = run_of(
        result("same"),
        result("fixed", Verdict.FAILED, "it was"),
        result("broken"),
        result("other", Verdict.FAILED, "one reason"),
        result("left"),
        result("removed"),
        claims=Claims(True, ("a2jEcho", "add"), {"name": "x", "old": "1"}),
    )
    after = run_of(
        result("same"),
        result("fixed"),
        result("broken", Verdict.FAILED, "no answer"),
        result("other", Verdict.FAILED, "another"),
        result("added", Verdict.UNIMPLEMENTED, "no function"),
        claims=Claims(True, ("a2jEcho", "sub"), {"name": "y", "new": "2"}),
        profile="legacy-2014",
        not_run={"left": "frame"},
    )
    assert main(["compare", *files(before, after)]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines == [
        "before  x, 2026-01-02T03:04:05+00:00: not conformant: 2 of 6 cases failed",
        "after   y, 2026-01-02T03:04:05+00:00: not conformant: 2 of 5 cases failed",
        "profile: strict -> legacy-2014",
        "",
        "WORSE (1)",
        "  broken  ok -> failed: no answer",
        "",
        "better (1)",
        "  fixed  failed -> ok",
        "",
        "different (1)",
        "  other  still failed: another",
        "",
        "new (1)",
        "  added  unimplemented: no function",
        "",
        "not run (1)",
        "  left  was ok",
        "",
        "gone (1)",
        "  removed  was ok",
        "",
        "claims (5)",
        "  function sub is new",
        "  function add is gone",
        "  property name: 'x' -> 'y'",
        "  property old: '1' -> none",
        "  property new: none -> '2'",
        "",
        "4 cases compared: 1 regression.",
    ]


def test_levels_that_are_won_and_lost(capsys):
    good, bad = run_of(result("a")), run_of(result("a", Verdict.FAILED))
    assert "  frame  reached -> failed" in report(compare(good, bad))
    assert "  frame  failed -> reached" in report(compare(bad, good))
    assert "levels" not in report(compare(good, good))


@pytest.mark.parametrize(
    ("before", "after", "text"),
    [
        (None, Claims(True, ()), "could not be read before"),
        (Claims(True, ()), None, "could not be read this time"),
        (Claims(True, ()), Claims(False, ()), "the mapping is gone"),
        (Claims(True, ("a", "b")), Claims(True, ("b", "a")), "the functions are in another order"),
    ],
)
def test_claims(before, after, text):
    runs = [run_of(result("a"), claims=claims) for claims in (before, after)]
    assert text in report(compare(*runs))
    assert text not in report(compare(runs[0], runs[0]))


def test_no_change(files, capsys):
    run = run_of(result("a"), result("b", Verdict.FAILED, "reason"))
    assert main(["compare", *files(run, run)]) == 0
    assert capsys.readouterr().out.endswith("\n2 cases compared: no regression.\n")


def test_a_run_that_ended_early_proves_nothing(files, capsys):
    before = run_of(result("a"), result("b"))
    after = run_of(result("a"), stopped="interrupted", not_run={"b": "frame"})
    assert main(["compare", *files(before, after)]) == 3
    assert "ended early: interrupted; 1 case unjudged." in capsys.readouterr().out
    # What was not asked for is no loss.
    assert main(["compare", *files(before, replace(after, stopped=""))]) == 0


def test_nothing_in_common(files):
    assert main(["compare", *files(run_of(result("a")), run_of(result("b")))]) == 4


@pytest.mark.parametrize("first", ["smoke.answer", "host.start"])
def test_what_every_run_begins_with_is_nothing_in_common(first, files, capsys):
    before = run_of(result(first), result("a"))
    after = run_of(result(first), result("b"))
    assert main(["compare", *files(before, after)]) == 4
    assert "no case in common beside those that every run begins with" in capsys.readouterr().out
    # It is compared all the same, and a run that ended early is one.
    worse = run_of(result(first, Verdict.FAILED, "reason"), not_run={"a": "frame"})
    assert main(["compare", *files(before, worse)]) == 1
    early = run_of(result(first), stopped="interrupted", not_run={"a": "frame"})
    assert main(["compare", *files(before, early)]) == 3
    assert main(["compare", *files(before, replace(before, results=before.results[::-1]))]) == 0
    assert capsys.readouterr().out.endswith("\n1 case compared: no regression.\n")


def test_heads_that_differ():
    one = run_of(result("a"))
    other = replace(one, url="tcp://x", profile="old", lossy=100, role="host", spec_version="2")
    lines = report(compare(one, replace(other, j2a_version="3"))).splitlines()
    assert lines[2:8] == [
        "role: device -> host",
        "link: loopback -> tcp://x",
        "profile: strict -> old",
        "attempts on a lossy link: 0 -> 100",
        f"J2A: {one.j2a_version} -> 3",
        f"specification: {one.spec_version} -> 2",
    ]


def test_files_that_are_no_reports(files, tmp_path, capsys):
    good = files(run_of(result("a")))[0]
    other = tmp_path / "other.txt"
    other.write_text("no JSON")
    for arguments in ([good, str(other)], [str(other), good], [good, str(tmp_path / "none")]):
        assert main(["compare", *arguments]) == 3
        assert arguments[0 if arguments[1] == good else 1] in capsys.readouterr().err
