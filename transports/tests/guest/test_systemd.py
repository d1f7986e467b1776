"""The unit of `j2a setup syncd` in the hands of systemd."""

from pathlib import Path

import pytest

pytestmark = [pytest.mark.guest, pytest.mark.exhaustive]


def test_the_service_starts_in_its_sandbox_answers_and_ends(guest, missing):
    if not Path("/lib/systemd/systemd").exists():
        missing("systemd is missing: install the package systemd")
    lines = guest("sh", "transports/tests/guest/inside_systemd.sh", timeout=900).stdout.splitlines()
    assert {"ActiveState=active", "SubState=running", "DynamicUser=yes"} <= set(lines)
    assert any(line.startswith("status: daemon ") for line in lines)
    assert "notified: a second one" in lines
    assert {"Result=success", "ExecMainStatus=0"} <= set(lines)
    assert "gone: the folder of the socket" in lines
