"""The suite passes a conforming device, and says what it tests."""

import pytest
from j2a_conformance import Verdict, coverage, load
from j2a_conformance.device._smoke import SMOKE
from j2a_conformance.reports._console import report
from j2a_spec import requirements
from j2a_spec.capabilities import ANNOUNCED, LEVELS

from tools.conformance import SWEEPS


@pytest.mark.parametrize("left_out", [SWEEPS, pytest.param((), marks=pytest.mark.exhaustive)])
def test_the_reference_device_conforms(left_out, reference, judged):
    run = judged(reference, {case.ID for case in load()} - {*left_out})
    assert run.conformant
    assert not run.stopped
    results = [r for r in run.results if r.level not in ANNOUNCED]
    assert {r.case: r.reason for r in results if r.verdict is not Verdict.OK} == {
        "limits.cut-frame": "nothing was lost: device or link held the request",
        "limits.overrun": "nothing was lost: device or link held all requests back",
        "limits.room": "the device has room for every payload",
        "many.return-values": "the device has no function retMany",
        "properties.selftest": "the device has no property j2a.selftest",
    }
    assert "not seen on this link: limits.cut-frame, limits.overrun;" in report(run)


def test_every_requirement_has_a_case_or_an_exception():
    by = coverage()
    for requirement in requirements.load().values():
        has_case = not by[requirement.id].startswith(("MISSING", "no case"))
        assert has_case != bool(requirement.exception), requirement.id


def test_cases_name_requirements_that_exist_and_bind_devices():
    known = requirements.load()
    for case in (*SMOKE, *load()):
        assert case.REQUIREMENTS, case.ID
        assert case.LEVEL in LEVELS, case.ID
        for name in case.REQUIREMENTS:
            assert known[name].role in ("device", "both"), (case.ID, name)


def test_cases_have_unique_ids_and_say_what_they_do():
    cases = (*SMOKE, *load())
    assert len({case.ID for case in cases}) == len(cases)
    for case in cases:
        assert case.DESCRIPTION.endswith("."), case.ID
        assert case.EXPECTATION.endswith("."), case.ID
