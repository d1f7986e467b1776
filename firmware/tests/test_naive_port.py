"""The guide to porting suffices: a port written from it and the template conforms in the simulator.

In: firmware/tests/naive over a copy of the template. Out: verdicts on the demo with the vectors
in it. The polled port reaches every level.
"""

import shutil
from pathlib import Path

import j2a_transports
import pytest
from j2a_conformance import Verdict, load, run
from j2a_sim import ToolMissing
from j2a_spec.capabilities import ANNOUNCED

FIRMWARE = Path(__file__).parents[1]
FULL_ROOM = {"limits.room"}  # that one is for devices with less
FEWER = {"many.return-values"}  # of a function that the demo does not have


@pytest.fixture
def naive(need, make, tmp_path):
    """The demo with the vectors in it, for the naive port; returns the ELF file."""
    need("avr-gcc")
    port = tmp_path / "naive"
    shutil.copytree(FIRMWARE / "ports/template", port)
    shutil.copytree(FIRMWARE / "tests/naive", port, dirs_exist_ok=True)
    result = make(PORT_DIR=port, APP="demo", OUT=tmp_path, OPTIONS="-DJ2A_WITH_SELFTEST=1")
    assert result.returncode == 0, result.stderr
    return tmp_path / "demo.elf"


@pytest.mark.avr
def test_a_port_written_from_the_guide(naive, missing):
    url = f"sim:{naive}?mcu=atmega2560"

    def connect():
        try:
            return j2a_transports.open(url)
        except j2a_transports.OpenFailed as error:
            if isinstance(error.__cause__, ToolMissing):
                missing(str(error))
            raise

    found = run(connect, load(), url=url, fresh=True)
    not_reached = {level for level, reached in found.levels().items() if reached is not True}
    assert not_reached <= ANNOUNCED
    not_ok = {r.case: r.level for r in found.results if r.verdict is not Verdict.OK}
    assert {case for case, level in not_ok.items() if level not in ANNOUNCED} == FULL_ROOM | FEWER
