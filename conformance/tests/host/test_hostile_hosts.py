"""Hosts that report what no honest one does: that is a failure, and no fault of the suite."""

import pytest
from j2a_conformance import Verdict


@pytest.mark.parametrize("number", ["", " x", " -1", " " + "9" * 200, " \u0663"])
def test_a_number_that_is_none_is_a_failure(number, host_reference, host_judged):
    class Reports(host_reference):
        def job(self, text):
            return f"restarts{number}" if text == "restarts" else super().job(text)

    result = host_judged(Reports, ["host.boot.ends"]).results[-1]
    assert (result.case, result.verdict) == ("host.boot.ends", Verdict.FAILED)
    assert "`restarts` and a number" in result.reason
