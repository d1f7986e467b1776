"""The suite passes conforming hosts, and says what it tests."""

import sys
from pathlib import Path

import pytest
from j2a_conformance import Verdict
from j2a_conformance._coverage import host_coverage
from j2a_conformance.cli import main
from j2a_conformance.device._smoke import SMOKE
from j2a_conformance.device.cases import load as load_device
from j2a_conformance.host import START, load
from j2a_conformance.host.cases import many
from j2a_spec import requirements
from j2a_spec.capabilities import LEVELS

HOSTS = Path(__file__).parents[2] / "hosts"
CASES = (START, *load())


def test_the_reference_host_conforms(host_reference, host_judged):
    run = host_judged(host_reference, timeout_scale=0.5)
    # It has no capabilities: those of the library and of its asyncio client are judged instead.
    levels = ("interface", "boot", "transducers", "clock")
    lacks = {case.ID for case in CASES if case.LEVEL in levels}
    # It repeats none beside others.
    lacks |= {f"host.seq.{name}" for name in ("skipped", "stalled-together", "stalled-twice")}
    lacks |= {"host.seq.stalled-waiting", "host.time.among-many"}
    others = {r.case: r.reason for r in run.results if r.verdict is not Verdict.OK}
    # On a busy machine calls that are made together may reach the suite one by one.
    others.pop("host.limits.out-of-order", None)
    assert set(others) == lacks - {"host.boot.others"}
    jobs = ("typed", "restarts", "transducers", "watch", "configure")
    jobs += ("clock-exchange", "clock-sync", "together", "repeat")
    unknown = {f"the host program does not know the job {job}" for job in jobs}
    assert set(others.values()) == unknown
    assert len(run.results) == len(CASES)
    assert run.conformant
    assert not run.stopped
    assert run.title == "reference"


def test_a_request_of_its_own_before_the_first_job_is_no_fault(host_reference, host_judged):
    class Chatty(host_reference):
        def connected(self):
            super().connected()
            self.call(4, b"is anybody there?", 3.0)

    run = host_judged(Chatty, ["host.start", "host.names.moved", "host.time.link-closed"])
    assert {r.case: r.reason for r in run.results if r.verdict is not Verdict.OK} == {}


@pytest.mark.exhaustive  # `make test` has the whole suite judge both anyway
@pytest.mark.parametrize("name", ["client", "aio"])
def test_our_hosts_conform(name, capsys):
    assert main(["host", "--", sys.executable, str(HOSTS / f"{name}.py")]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert next(line.split() for line in lines if line.startswith("all"))[1] == str(len(CASES))


FAR = "host.many.beyond-24-bits"


def test_a_case_on_demand_runs_only_by_its_id(capsys, monkeypatch):
    assert {case.ID for case in load(on_demand=True)} - {case.ID for case in load()} == {FAR}
    assert main(["host", "--list", "--case", "host.many.*", "J2A-MANY-021"]) == 0
    assert FAR not in capsys.readouterr().out
    monkeypatch.setattr(many, "_FAR", 7 * 300)
    command = ["--", sys.executable, str(HOSTS / "client.py")]
    assert main(["host", "-v", "--case", FAR, *command]) == 0
    assert f"ok              {FAR}" in capsys.readouterr().out


def test_every_requirement_of_a_host_has_a_case_or_an_exception():
    by = host_coverage()
    for requirement in requirements.load().values():
        if requirement.role == "device":
            assert requirement.id not in by
        else:
            has_case = not by[requirement.id].startswith(("MISSING", "no case"))
            assert has_case != bool(requirement.exception), requirement.id


def test_cases_name_requirements_that_bind_hosts():
    known = requirements.load()
    for case in CASES:
        assert case.REQUIREMENTS, case.ID
        assert case.LEVEL in LEVELS, case.ID
        for name in case.REQUIREMENTS:
            assert known[name].role in ("host", "both"), (case.ID, name)


def test_cases_have_unique_ids_and_say_what_they_do():
    ids = [case.ID for case in (*CASES, *SMOKE, *load_device())]
    assert len(set(ids)) == len(ids)
    for case in CASES:
        assert case.ID.startswith("host.")
        assert case.DESCRIPTION.endswith("."), case.ID
        assert case.EXPECTATION.endswith("."), case.ID
