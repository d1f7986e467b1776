"""The guide to porting suffices: a port written from it and the template conforms in the simulator.

In: firmware/tests/naive over a copy of the template. Out: verdicts on the demo with the vectors
in it. The polled port reaches every level; the sweeps take ten times as long as all other cases.
They and what is long besides are left to the exhaustive run.
"""

import shutil
from pathlib import Path

import j2a_transports
import pytest
from j2a_conformance import Verdict, load, run
from j2a_sim import ToolMissing
from j2a_spec.capabilities import ANNOUNCED

from tools.conformance import SWEEPS

FIRMWARE = Path(__file__).parents[1]
LEFT_OUT = {  # beside the sweeps what takes half a second and more, and asks nothing of a port
    *SWEEPS,
    *("debug.nothing-pending", "interface.behind-end", "many.offsets", "many.reply-flags"),
    *("many.write-flags", "many.wrong-function", "properties.behind-end", "properties.content"),
    *("properties.direct", "seq.repeated"),
    *("debug.text", "error.opcode-out-of-range", "frame.noise", "frame.sos-to-device"),
    *("interface.chunks", "many.four-offset-bytes", "many.store", "types.values"),
}
FULL_ROOM = {"limits.room"}  # that one is for devices with less
FEWER = {"many.return-values"}  # of a function that the demo does not have


@pytest.fixture
def naive(need, make, tmp_path):
    """The demo with the vectors in it, for the naive port; returns the ELF file."""
    need("avr-gcc")
    port = tmp_path / "naive"
    shutil.copytree(FIRMWARE / "ports/template", port)
    shutil.copytree(FIRMWARE / "tests/naive", port, dirs_exist_ok=True)
    variables = {"PORT_DIR": port, "OUT": tmp_path, "OPTIONS": "-DJ2A_WITH_SELFTEST=1"}
    result = make(core_as_one=True, APP="demo", **variables)
    assert result.returncode == 0, result.stderr
    return tmp_path / "demo.elf"


@pytest.mark.avr
@pytest.mark.parametrize("left_out", [LEFT_OUT, pytest.param((), marks=pytest.mark.exhaustive)])
def test_a_port_written_from_the_guide(naive, missing, left_out):
    url = f"sim:{naive}?mcu=atmega2560"

    def connect():
        try:
            return j2a_transports.open(url)
        except j2a_transports.OpenFailed as error:
            if isinstance(error.__cause__, ToolMissing):
                missing(str(error))
            raise

    cases = [case for case in load() if case.ID not in left_out]
    found = run(connect, cases, url=url, fresh=True)
    not_reached = {level for level, reached in found.levels().items() if reached is not True}
    assert found.conformant
    assert not_reached <= ANNOUNCED or left_out  # that is not known after a part of the cases
    not_ok = {r.case: r.level for r in found.results if r.verdict is not Verdict.OK}
    assert {case for case, level in not_ok.items() if level not in ANNOUNCED} == FULL_ROOM | FEWER
