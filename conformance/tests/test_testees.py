"""Testees, and builds that no testee is, conform; tools/conformance.py runs all testees."""

import shutil
import subprocess
from pathlib import Path

import j2a_transports
import junitparser
import pytest
from j2a_conformance import Verdict, load, run
from j2a_conformance.cli import main
from j2a_conformance.device._testee import load_testee
from j2a_conformance.reports import _json
from j2a_spec.capabilities import ANNOUNCED, CAPABILITIES

from tools.conformance import SWEEPS

FOLDER = Path(__file__).parents[1] / "testees"
NOTHING_LOST = {"limits.overrun"}
NO_SELF_TEST = {"properties.selftest"}  # such a build is for bringing a port up
NO_BOOT = {f"boot.{name}" for name in ("first", "payload", "once", "reserved")}
# Levels of parts that a build has only where it asks for them; all but those of the demo.
LEFT_OUT = {part.level for part in CAPABILITIES.values() if part.default == 0} & ANNOUNCED
NOT_OURS = NO_SELF_TEST | NO_BOOT
NOT_OURS |= {case.ID for case in load() if case.LEVEL in LEFT_OUT - {"interface", "boot"}}
# For devices with less room, or one more function.
NOT_OURS |= {"limits.room", "many.return-values"}


@pytest.fixture
def started(need):
    """Start a testee by its name, once what it needs is known to be there."""

    def start(name):
        testee = load_testee(FOLDER / f"{name}.toml")
        for program in testee.needs:
            need(program)
        return testee.started()

    return start


@pytest.mark.parametrize("left_out", [SWEEPS, pytest.param((), marks=pytest.mark.exhaustive)])
def test_by_the_command_line(tmp_path, capsys, left_out):
    """Every level is reached with every case only, as tools/conformance.py runs this testee."""
    cases = [case.ID for case in load() if case.ID not in left_out]
    kinds = ("junit", "json", "html", "badge")
    reports = [word for kind in kinds for word in (f"--{kind}", str(tmp_path / kind))]
    status = main(["run", str(FOLDER / "posix.toml"), *reports, "-v", "--case", *cases])
    assert status == 0, capsys.readouterr().out
    assert ("all levels" in (tmp_path / "badge").read_text("utf-8")) == (not left_out)
    assert _json.read(tmp_path / "json").url == "exec:{root}/firmware/build/posix/demo"
    assert (tmp_path / "html").stat().st_size < 2_000_000
    xml = junitparser.JUnitXml.fromfile(str(tmp_path / "junit"))
    assert (xml.tests, xml.failures, xml.errors) == (len(cases) + 3, 0, 0)
    not_ours = NOT_OURS - {*left_out}
    assert xml.skipped == len(not_ours)
    assert {case.name for suite in xml for case in suite if case.result} == not_ours


def test_without_application_only_its_functions_are_missed(started):
    with started("builtins") as url:
        found = run(lambda: j2a_transports.open(url), fast(), url=url, fresh=True)
    assert found.conformant
    assert {r.case for r in found.with_verdict(Verdict.INFORMATIONAL)} == NOTHING_LOST
    unimplemented = found.with_verdict(Verdict.UNIMPLEMENTED)
    assert len(unimplemented) >= 10
    assert all(r.reason.startswith("the device ") for r in unimplemented)


@pytest.mark.parametrize(
    "options",
    [
        "-DJ2A_WITH_MAPPING=0",
        "-DJ2A_WITH_MAPPING=0 -DJ2A_WITH_PROPERTIES=0",
        "-DJ2A_WITH_MAPPING=0 -DJ2A_WITH_DEBUG=0",
        "-DJ2A_WITH_DEBUG=0 -DJ2A_WITH_PROPERTIES=0",
        "-DJ2A_ROOM=32 -DJ2A_WITH_MAPPING=0",
        "-DJ2A_ROOM=32 -DJ2A_WITH_MAPPING=0 -DJ2A_WITH_MANY=0",
    ],
)
def test_with_parts_built_out(options, tmp_path):
    posix = load_testee(FOLDER / "posix.toml")
    testee = type(posix)(
        title=options,
        # What is built in is asked, not what the optimizer makes of it.
        build=(*posix.build, f"OPTIONS={options}", "CFLAGS=-O0", f"OUT={tmp_path}"),
        url=f"exec:{tmp_path}/demo",
        root=posix.root,
    )
    with testee.started() as url:
        found = run(lambda: j2a_transports.open(url), fast(), url=url, fresh=True)
    assert found.conformant, [(r.case, r.reason) for r in found.with_verdict(Verdict.FAILED)]
    assert found.claims is not None
    assert found.claims.mapped == ("MAPPING" not in options)
    has_many = "MANY" not in options
    has_properties = has_many and "PROPERTIES" not in options
    assert ("a2jMany" in found.claims.functions) == has_many
    assert ("a2jGetProperties" in found.claims.functions) == has_properties
    assert ("a2jDebug" in found.claims.functions) == ("DEBUG" not in options)
    many = [r.verdict for r in found.results if r.level == "many"]
    assert (Verdict.OK in many) == has_many
    assert (set(many) == {Verdict.UNIMPLEMENTED}) == (not has_many)


def fast():
    """Every case that may depend on what is built in, and waits for no time to pass."""
    others = ("frame", "timing")
    return [c for c in load() if c.LEVEL not in others and not c.ID.startswith("scenario")]


@pytest.mark.parametrize("places", [1, 32])
def test_a_finding_of_the_sanitizers_fails(places, tmp_path, need):
    """The sanitized build ends at undefined behaviour that no answer shows."""
    need("gcc")
    root = FOLDER.parents[1]
    build = list(load_testee(FOLDER / "posix-sanitized.toml").build)
    for part in ("core", "apps", "ports"):
        shutil.copytree(root / "firmware" / part, tmp_path / "firmware" / part)
    shutil.copy(root / "firmware" / "Makefile", tmp_path / "firmware")
    source = tmp_path / "firmware/core/j2a_rx.c"
    text = source.read_text("utf-8")
    shift = f"{{ volatile int n = {places}; n = 1 << n; }} rx->payload[count] ="
    changed = text.replace("rx->payload[count] =", shift)
    assert changed != text
    source.write_text(changed, "utf-8")
    build[build.index("firmware")] = str(tmp_path / "firmware")
    subprocess.run(build, check=True, cwd=root)
    url = f"exec:{tmp_path}/firmware/build/posix-sanitized/demo"
    cases = [case for case in load() if case.ID == "frame.largest"]
    found = run(lambda: j2a_transports.open(url), cases, timeout_scale=0.2)
    assert found.conformant is (places == 1), found.results
