"""Lists of known deviations: what they excuse, when they are out of date, and mistakes in them."""

import pytest
from j2a_conformance import HarnessError, Verdict
from j2a_conformance.device._deviations import Rules, parse, profile, profiles, read
from j2a_conformance.device._testee import load_testee
from j2a_conformance.reports._console import report
from j2a_spec import constants as c

GOOD = {"case": "mapping.names", "reason": "not printable", "why": "names with spaces"}
CASES = ["frame.noise-behind", "mapping.names"]


def rules(**changes):
    return Rules(known=parse([GOOD | changes], "here"))


@pytest.fixture
def spaced(reference):
    class Spaced(reference):
        def mapping(self):
            return super().mapping().replace(b"getTime\0", b"get Time\0")

    return Spaced


def test_a_known_deviation_is_no_failure(spaced, judged):
    run = judged(spaced, CASES, rules=rules())
    result = run.results[-1]
    assert (result.case, result.verdict) == ("mapping.names", Verdict.KNOWN_DEVIATION)
    assert result.reason == "names with spaces"
    assert "the name b'get Time' is empty or not printable" in result.evidence[-1].text
    assert run.conformant
    assert run.stale == ()
    assert run.levels()["mapping"] is False
    assert "The device is conformant but for known deviations" in report(run)
    assert "known-deviation: mapping.names: names with spaces" in report(run)


def test_a_deviation_that_is_gone_is_stale(reference, judged):
    run = judged(reference, CASES, rules=rules())
    assert run.conformant
    assert len(run.stale) == 1
    assert "mapping.names (names with spaces) is gone: the case is ok" in run.stale[0]
    assert f"STALE: {run.stale[0]}" in report(run)


def test_a_deviation_that_fails_differently_is_a_failure(spaced, judged):
    run = judged(spaced, CASES, rules=rules(reason="appear twice"))
    assert run.results[-1].verdict is Verdict.FAILED
    assert run.results[-1].reason.endswith("; known is another failure: names with spaces")
    assert run.stale == ()


@pytest.mark.parametrize(
    ("case", "words"),
    [
        ("limits.overrun", "informational, nothing was lost"),
        ("mapping.names", "unimplemented, the function map is not built in"),
    ],
)
def test_a_deviation_that_is_not_judged_is_stale(case, words, reference, judged):
    class WithoutMapping(reference):
        names = ("", *reference.names[1:])

        def name_of(self, opcode):
            return super().name_of(opcode) or None

    device = reference if case == "limits.overrun" else WithoutMapping
    run = judged(device, [case], rules=rules(case=case))
    assert words in run.stale[0]


def test_what_the_user_left_out_is_not_stale(reference, judged):
    assert judged(reference, ["mapping.content"], rules=rules()).stale == ()


def test_what_the_run_left_out_is_stale(reference, judged):
    class Broken(reference):
        def do_a2jEcho(self, payload):  # noqa: N802
            return c.ECHO, payload[:254]

    cases = ["frame.layout", "mapping.names"]
    run = judged(Broken, cases, rules=rules(), stop_on_failure=True)
    assert "the case was not run" in run.stale[0]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("deviation = 1", "double brackets"),
        ("[[deviations]]\ncase = 'mapping.names'", "deviations"),
        ("[[deviation]]\ncase = 'mapping.names'\nreason = 'x'", "`why`"),
        ("[[deviation]]\ncase = 'mapping.names'\nreason = 'x'\nwhy = ''", "not empty"),
        ("[[deviation]]\ncase = []\nreason = 'x'\nwhy = 'y'", "not empty"),
        ("[[deviation]]\ncase = 'mapping.names'\nreason = 'x'\nwhy = 'y'\nwhen = 'z'", "when"),
        ("[[deviation]]\ncase = 'mapping.nmaes'\nreason = 'x'\nwhy = 'y'", "no case mapping.nmaes"),
        (
            "[[deviation]]\ncase = 'mapping.names'\nreason = '('\nwhy = 'y'",
            "reason of mapping.names",
        ),
        ("[[deviation]]\ncase = ['sif.start', 'sif.start']\nreason = 'x'\nwhy = 'y'", "twice"),
        ("[[deviation]", "list.toml"),
    ],
)
def test_mistakes_in_a_list_are_named(text, words, tmp_path):
    path = tmp_path / "list.toml"
    path.write_text(text)
    with pytest.raises(HarnessError, match=r"list\.toml") as error:
        read(path)
    assert words in str(error.value)


def test_a_list_that_is_not_there(tmp_path):
    with pytest.raises(HarnessError, match=r"none\.toml"):
        read(tmp_path / "none.toml")


def test_a_testee_brings_its_list(tmp_path):
    path = tmp_path / "conformance" / "testees" / "mine.toml"
    path.parent.mkdir(parents=True)
    table = "\n".join(f"{key} = '{value}'" for key, value in GOOD.items())
    path.write_text(f"title = 'mine'\nurl = 'exec:true'\n\n[[deviation]]\n{table}\n")
    assert [entry.case for entry in load_testee(path).deviations] == ["mapping.names"]
    path.write_text(path.read_text().replace("why", "because"))
    with pytest.raises(HarnessError, match=r"mine.toml.*`why`"):
        load_testee(path)


def test_profiles():
    assert profiles() == ("strict", "legacy-2014")
    assert profile("strict") == ()
    assert profile("legacy-2014")
