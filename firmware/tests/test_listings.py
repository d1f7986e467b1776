"""A device written with the thesis' own macros (listings 7.1, 7.2 and 7.4) on this core."""

import shutil
import subprocess
from pathlib import Path

import pytest
from j2a_spec import constants as c
from j2a_spec.grammar import MAPPING, PROPERTIES
from j2a_spec.oracle import Frame, encode

FIRMWARE = Path(__file__).parents[1]
LISTINGS = FIRMWARE / "tests/listings"
NAMES = [*c.BUILTINS, "getTime", "setTrigger", "a2j_set_servo", "table"]


@pytest.mark.parametrize("cc", ["gcc", "clang"])
@pytest.mark.parametrize("options", ["", "-DAS_IN_THE_TEXT"])
def test_device_of_the_listings(build, ask, error, cc, options):
    if shutil.which(cc) is None:
        pytest.skip(f"{cc} is not installed")
    program = build("listings", APP_DIR=str(LISTINGS), CC=cc, OPTIONS=options)
    squares = bytes(n * n % 256 for n in range(1000))
    header = [bytes((9, 0)) + offset.to_bytes(4, "little") for offset in (0, 747, 996)]
    requests = [
        Frame(c.SOF, 0, 0),
        Frame(c.SOF, 1, 1, bytes((2, 0, 0, 0, 0, 0))),
        Frame(c.SOF, 2, 7, b"\x01\x02"),
        Frame(c.SOF, 3, 8, b"\x55"),
        Frame(c.SOF, 4, 8, b"\x66"),
        Frame(c.SOF, 5, 8),
        Frame(c.SOF, 6, 9),
        *[Frame(c.SOF, 7 + n, 1, payload) for n, payload in enumerate(header)],
        Frame(c.SOF, 10, 1, bytes((6, 0, 0, 0, 0, 0))),
        Frame(c.SOF, 11, 10),
        Frame(c.SOF, 12, 6),
    ]
    answers = ask(program, b"".join(map(encode, requests)))
    assert answers[0] == Frame(c.SOF, 0, 0, MAPPING.build(NAMES))
    assert answers[1].payload[:6] == bytes((0, c.FLAG_LAST, 0, 0, 0, 0))
    values = {item.key: item.value for item in PROPERTIES.parse(answers[1].payload[6:])}
    assert values == {"j2a.spec": c.SPEC_VERSION, "serial": "0x012F0B04", "MACRO": "13"}
    assert answers[2:-1] == [
        Frame(c.SOS, 0, 0x42, b"\x01\x02"),
        Frame(c.SOF, 2, 0),
        Frame(c.SOF, 3, 0, b"\x00"),
        Frame(c.SOF, 4, 0, b"\x55"),
        Frame(c.SOF, 5, 1),
        error(6, c.ERR_OPCODE, c.SITE_KIND),
        Frame(c.SOF, 7, 0, b"\0\0" + header[0][2:] + squares[:249]),
        Frame(c.SOF, 8, 0, b"\0\0" + header[1][2:] + squares[747:996]),
        Frame(c.SOF, 9, 0, b"\0\1" + header[2][2:] + squares[996:]),
        error(10, c.ERR_OPCODE, c.SITE_KIND),
        error(11, c.ERR_OPCODE, c.SITE_OPCODE),
    ]
    assert len(answers[-1].payload) == 8


@pytest.mark.parametrize("switch", ["MAPPING", "PROPERTIES", "SIF", "DEBUG"])
def test_options(make, tmp_path, switch):
    result = make(
        APP="listings",
        APP_DIR=str(LISTINGS),
        OUT=str(tmp_path),
        OPTIONS=f"-DJ2A_WITH_{switch}=0",
    )
    # The listings' setTrigger sends a SIF, so without SIFs it cannot be built.
    assert (result.returncode == 0) is (switch != "SIF"), result.stderr


def test_function_of_no_kind_does_not_compile():
    source = """
    #include "a2j.h"
    static uint8_t f(uint8_t length) { return length; }
    FUNCMAP(f, f)
    STARTJT
    ADDJT(f)
    ENDJT
    """
    command = ["cc", "-std=c99", "-xc", "-fsyntax-only", "-Icore", "-Iports/posix", "-"]
    result = subprocess.run(
        command, input=source, cwd=FIRMWARE, capture_output=True, text=True, check=False
    )
    assert result.returncode != 0
    assert "negative" in result.stderr


@pytest.mark.avr
def test_compiles_for_avr(build):
    assert build("listings", "avr-serial", APP_DIR=str(LISTINGS)).exists()
