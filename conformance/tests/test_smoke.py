"""The smoke step blames the right one: the device, the link, or the waits."""

import j2a_transports
import pytest
from j2a_conformance import HarnessError, run
from j2a_conformance.cli import main
from j2a_spec import constants as c
from j2a_transports import faults, pair

LOSES_MUCH = {"drop": 0.03, "flip": 0.03}


def behind(device, seed=2, **rates):
    """Return what opens a link to a new device, with faults."""

    def opener():
        here, there = pair()
        device(there)
        return faults.wrap(here, seed=seed, **rates)

    return opener


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_link_that_loses_too_much_is_no_fault_of_the_device(seed, reference):
    with pytest.raises(HarnessError, match="the link loses too much"):
        run(behind(reference, seed, **LOSES_MUCH), (), lossy=20)


def test_a_lossy_link_hides_no_device_that_refuses_everything(reference):
    class RefusesAll(reference):
        def request(self, seq, opcode, payload):
            self.error(seq, c.ERR_CHECKSUM)

    found = run(behind(RefusesAll, drop=0.01, flip=0.01), (), lossy=20)
    assert found.results[-1].reason.endswith("(J2A-SUM-001)")
    assert found.stopped == "smoke.answer failed, so nothing else can be judged"


def test_the_command_says_that_the_link_loses_too_much(build_firmware, capsys):
    url = f"faults:seed=2,drop=0.02,flip=0.02:exec:{build_firmware('demo')}"
    assert main(["run", url, "--lossy", "20", "--case", "frame.*"]) == 3
    assert "the link loses too much" in capsys.readouterr().err


def test_a_late_answer_is_no_noise(build_firmware, tmp_path):
    late = tmp_path / "late"
    late.write_text(f"#!/bin/sh\nsleep 2\nexec {build_firmware('demo')}\n")
    late.chmod(0o755)
    url = f"exec:{late}"
    with pytest.raises(HarnessError, match=r"^nothing answers|^answers come later"):
        run(lambda: j2a_transports.open(url), (), timeout_scale=1e-9)
