"""The JSON report: nothing is lost, the schema fits, and other files are refused with a reason.

Any run that JSON can hold gives sound reports of the other kinds, too.
"""

import json
from dataclasses import fields
from importlib.resources import files
from typing import get_args
from xml.etree import ElementTree

import jsonschema
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from j2a_conformance import Claims, Evidence, HarnessError, Result, Run, Verdict
from j2a_conformance.reports import _badge, _html, _junit, _matrix
from j2a_conformance.reports._compare import compare, report
from j2a_conformance.reports._json import parse, read, render
from j2a_spec import requirements
from j2a_spec.requirements import Level

SCHEMA = json.loads(
    files("j2a_conformance.reports").joinpath("report.schema.json").read_text("utf-8")
)
VALIDATOR = jsonschema.Draft202012Validator(SCHEMA)
TIMES = st.floats(0, 1e9)
LEVELS = st.sampled_from(get_args(Level))

evidence = st.builds(
    Evidence,
    kind=st.sampled_from(["sent", "received", "sif", "expected", "note"]),
    at_ms=TIMES,
    data=st.binary(max_size=8),
    text=st.text(max_size=8),
)
results = st.builds(
    Result,
    case=st.text(max_size=8),
    description=st.text(max_size=8),
    expectation=st.text(max_size=8),
    requirements=st.lists(st.sampled_from(list(requirements.load())), max_size=3).map(tuple),
    level=LEVELS,
    verdict=st.sampled_from(Verdict),
    reason=st.text(max_size=8),
    evidence=st.lists(evidence, max_size=3).map(tuple),
    left_out=st.integers(0),
    attempts=st.integers(1),
    repeated=st.integers(0),
    duration_s=TIMES,
)
claims = st.builds(
    Claims,
    mapped=st.booleans(),
    functions=st.lists(st.text(max_size=8), max_size=3).map(tuple),
    properties=st.dictionaries(st.text(max_size=8), st.text(max_size=8), max_size=3),
    rtt_s=TIMES,
    fresh=st.booleans(),
)
texts = st.lists(st.text(max_size=8), max_size=2).map(tuple)
runs = st.builds(
    Run,
    url=st.text(st.characters(), max_size=8),  # surrogates too: arguments can hold any byte
    started=st.datetimes().map(lambda moment: moment.isoformat() + "+00:00"),
    duration_s=TIMES,
    claims=st.none() | claims,
    results=st.lists(results, max_size=3).map(tuple),
    stopped=st.text(max_size=8),
    title=st.text(max_size=8),
    role=st.sampled_from(["device", "host"]),
    profile=st.text(max_size=8),
    stale=texts,
    asked=texts,
    lossy=st.integers(0),
    not_run=st.dictionaries(st.text(max_size=8), LEVELS, max_size=2),
    j2a_version=st.text(max_size=8),
    spec_version=st.text(max_size=8),
)


@given(runs)
def test_any_run_comes_back_and_fits_the_schema(run):
    text = render(run).decode()
    assert parse(text) == run
    VALIDATOR.validate(json.loads(text))


@given(runs)
@settings(max_examples=50)
def test_any_run_gives_sound_reports(run):
    ElementTree.fromstring(_junit.render(run))
    ElementTree.fromstring(_badge.render(run))
    for page in (_html.render(run), _matrix.render([run, run])):
        text = page.decode()
        assert text.count("<details") == text.count("</details>")
        assert text.count("<script>") == text.count("</script>") == 1
        assert "\0" not in text
    assert "no regression" in report(compare(run, run)).splitlines()[-1]


def test_a_real_run_comes_back_and_fits_the_schema(failed_run, tmp_path):
    path = tmp_path / "run.json"
    path.write_bytes(render(failed_run))
    assert read(path) == failed_run
    assert render(read(path)) == path.read_bytes()
    found = json.loads(path.read_bytes())
    VALIDATOR.validate(found)
    assert found["conformant"] is False
    assert found["levels"]["frame"] == "failed"
    sent = next(e for r in found["results"] for e in r["evidence"] if e["kind"] == "sent")
    assert bytes.fromhex(sent["data"])[0] == 0x12


@pytest.mark.parametrize(
    ("place", "kind", "derived"),
    [
        (SCHEMA, Run, {"format", "conformant", "levels"}),
        (SCHEMA["$defs"]["result"], Result, set()),
        (SCHEMA["$defs"]["claims"], Claims, set()),
        (SCHEMA["$defs"]["evidence"], Evidence, set()),
    ],
)
def test_the_schema_has_every_field_of_the_model(place, kind, derived):
    names = {field.name for field in fields(kind)} | derived
    assert set(place["properties"]) == set(place["required"]) == names
    assert place["additionalProperties"] is False


def test_the_schema_is_one_and_has_the_levels_and_verdicts():
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    assert SCHEMA["$defs"]["level"]["enum"] == list(get_args(Level))
    verdicts = SCHEMA["$defs"]["result"]["properties"]["verdict"]["enum"]
    assert verdicts == [verdict.value for verdict in Verdict]


EXAMPLE = Run(
    url="loopback",
    started="2026-01-02T03:04:05+00:00",
    duration_s=1.0,
    claims=Claims(True, ("a2jEcho",)),
    results=(
        Result(
            "frame.layout",
            "Does.",
            "Expects.",
            ("J2A-FRAME-001",),
            "frame",
            Verdict.OK,
            evidence=(Evidence("sent", 0.5, b"\x12\x01"),),
        ),
    ),
)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda found: found.pop("format"), 'no "format"'),
        (lambda found: found.update(format="j2a-conformance/2"), "its format is"),
        (lambda found: found.pop("url"), "url is missing"),
        (lambda found: found.update(extra=1), "extra is not known"),
        (lambda found: found.update(url=1), "url is 1, it has to be a text"),
        (lambda found: found.update(duration_s="1"), "duration_s is '1', it has to be a number"),
        (lambda found: found.update(results={}), "results is {}, it has to be a list"),
        (lambda found: found.update(lossy=True), "lossy is True, it has to be a whole number"),
        (lambda found: found.update(not_run={"a": "b"}), "not_run.a is 'b', it has to be one of"),
        (lambda found: found["results"][0].pop("case"), "results[0].case is missing"),
        (
            lambda found: found["results"][0].update(verdict="fine"),
            "results[0].verdict is 'fine', it has to be one of ok, ",
        ),
        (
            lambda found: found["results"][0].update(verdict=[]),
            "results[0].verdict is [], it has to be one of ok, ",
        ),
        (
            lambda found: found["results"][0]["evidence"][0].update(data="0g"),
            "results[0].evidence[0].data is '0g', it has to be bytes in hex",
        ),
        (
            lambda found: found["results"][0]["evidence"][0].update(kind="lost"),
            "results[0].evidence[0].kind is 'lost'",
        ),
        (lambda found: found["claims"].update(fresh=0), "claims.fresh is 0, it has to be true or"),
    ],
)
def test_wrong_reports_are_refused_by_reader_and_schema(change, reason):
    found = json.loads(render(EXAMPLE))
    VALIDATOR.validate(found)
    change(found)
    assert not VALIDATOR.is_valid(found)
    with pytest.raises(HarnessError) as caught:
        parse(json.dumps(found))
    assert reason in str(caught.value)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "it is no JSON"),
        (b"{", "it is no JSON"),
        (b"[]", 'it has no "format"'),
        (b"\xff", "codec can't decode"),
        (b'{"format": NaN}', "NaN is no number"),
        (b"[" * 100_000, "nested too deeply"),
        (b'<?xml version="1.0"?><testsuites/>', "it is no JSON"),
    ],
)
def test_files_that_are_no_reports_are_named(data, reason, tmp_path):
    path = tmp_path / "other.json"
    path.write_bytes(data)
    with pytest.raises(HarnessError) as caught:
        read(path)
    assert str(caught.value).startswith(f"{path} is no report of j2a-conform: ")
    assert reason in str(caught.value)


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    with pytest.raises(HarnessError, match=r"cannot read .*missing[.]json: No such"):
        read(tmp_path / "missing.json")
