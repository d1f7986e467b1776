"""Listings 7.1, 7.2 and 7.4 of the thesis, as they are printed, make a device on this core."""

import shutil
import subprocess
from pathlib import Path

import pytest
from j2a_sim import AvrSim
from j2a_spec import constants as c
from j2a_spec.grammar import MAPPING, PROPERTIES
from j2a_spec.oracle import Frame, decode, encode

FIRMWARE = Path(__file__).parents[1]
LISTINGS = FIRMWARE / "tests/listings"
PRINTED = ["getTime", "setTrigger", "a2j_set_servo"]  # listing 7.2
OWN = ["servo", "table"]  # with -DOWN_TABLE
PROPERTY_VALUES = {"j2a.spec": c.SPEC_VERSION, "serial": "0x012F0B04", "MACRO": "13"}
# j2a.spec is a chunk of its own.
SECOND_CHUNK = len(f"j2a.spec\0{c.SPEC_VERSION}\0")


def read(seq, function, offset):
    return Frame(c.SOF, seq, 1, bytes((function, 0)) + offset.to_bytes(4, "little"))


# What both devices are asked first.
COMMON = [Frame(c.SOF, 0, 0), read(1, 2, 0), read(2, 2, SECOND_CHUNK), read(3, 2, 4)]


def check_common(answers, names):
    """The names and the properties."""
    assert answers[0] == Frame(c.SOF, 0, 0, MAPPING.build([*c.BUILTINS, *names]))
    first, second, part = (answer.payload for answer in answers[1:4])
    assert [chunk[:2] for chunk in (first, second, part)] == [b"\0\0", b"\0\1", b"\0\0"]
    assert int.from_bytes(second[2:6], "little") == SECOND_CHUNK == len(first[6:])
    values = {item.key: item.value for item in PROPERTIES.parse(first[6:] + second[6:])}
    assert values == PROPERTY_VALUES
    assert part[6:] == first[6 + 4 :]


# What the device of the listings as they are printed is asked: each function, and one too many.
CALLS = [
    Frame(c.SOF, 4, 7, b"\x01\x02"),
    Frame(c.SOF, 5, 8, b"\x55"),
    Frame(c.SOF, 6, 8, b"\x66"),
    Frame(c.SOF, 7, 8),
    read(8, 6, 0),
    Frame(c.SOF, 9, 9),
    Frame(c.SOF, 10, 6),
]


def check_printed(answers, error):
    check_common(answers, PRINTED)
    assert answers[4:-1] == [
        Frame(c.SOS, 0, 0x42, b"\x01\x02"),
        Frame(c.SOF, 4, 0),
        Frame(c.SOF, 5, 0, b"\x00"),
        Frame(c.SOF, 6, 0, b"\x55"),
        Frame(c.SOF, 7, 1),
        error(8, c.ERR_OPCODE, c.SITE_KIND),
        error(9, c.ERR_OPCODE, c.SITE_OPCODE),
    ]
    assert len(answers[-1].payload) == 8


@pytest.mark.parametrize("cc", ["gcc", "clang"])
def test_listings_as_printed(build, ask, error, cc):
    if shutil.which(cc) is None:
        pytest.skip(f"{cc} is not installed")
    program = build("listings", APP_DIR=str(LISTINGS), CC=cc)
    check_printed(ask(program, b"".join(map(encode, COMMON + CALLS))), error)


@pytest.mark.avr
def test_listings_as_printed_on_the_avr(build, error):
    with AvrSim(build("listings", "avr-serial", APP_DIR=str(LISTINGS))) as sim:
        sim.boot()
        sim.run(sim.cycles(0.001))
        answers = []
        for request in COMMON + CALLS:  # one by one: its receive buffer is small
            sim.uart_write(encode(request))
            sim.run(sim.cycles(0.05))
            answers += decode(sim.uart_read())
        check_printed(answers, error)


@pytest.mark.parametrize("cc", ["gcc", "clang"])
def test_table_with_both_kinds(build, ask, error, cc):
    if shutil.which(cc) is None:
        pytest.skip(f"{cc} is not installed")
    program = build("listings", APP_DIR=str(LISTINGS), CC=cc, OPTIONS="-DOWN_TABLE")
    squares = bytes(n * n % 256 for n in range(1000))
    requests = [Frame(c.SOF, 4, 7), *[read(5 + n, 7, at) for n, at in enumerate((0, 747, 996))]]
    answers = ask(program, b"".join(map(encode, COMMON + requests)))
    check_common(answers, OWN)
    assert answers[4:] == [
        error(4, c.ERR_OPCODE, c.SITE_KIND),
        *[
            Frame(c.SOF, 5 + n, 0, bytes((0, at == 996)) + at.to_bytes(4, "little") + data)
            for n, (at, data) in enumerate(
                [(0, squares[:249]), (747, squares[747:996]), (996, squares[996:])]
            )
        ],
    ]


@pytest.mark.parametrize("switch", ["MAPPING", "PROPERTIES", "SIF", "DEBUG"])
def test_options(make, tmp_path, switch):
    result = make(
        core_as_one=True,
        APP="listings",
        APP_DIR=str(LISTINGS),
        OUT=str(tmp_path),
        OPTIONS=f"-DJ2A_WITH_{switch}=0",
        CFLAGS="-O0",
    )
    # The listings' setTrigger sends a SIF, so without SIFs it cannot be built.
    assert (result.returncode == 0) is (switch != "SIF"), result.stderr


@pytest.mark.parametrize(
    ("functions", "message"),
    [
        ("FUNCMAP(f, f) STARTJT ADDJT(f) ENDJT", "negative"),
        ("FUNCMAP(a2jEcho, g) FUNCMAP(h, g)", "j2a_name_g"),
    ],
)
def test_wrong_functions_do_not_compile(functions, message):
    source = f"""
    #include "a2j.h"
    static uint8_t f(uint8_t length) {{ return length; }}
    {functions}
    """
    command = ["cc", "-std=c99", "-xc", "-fsyntax-only", "-Icore", "-Iports/posix", "-"]
    result = subprocess.run(
        command, input=source, cwd=FIRMWARE, capture_output=True, text=True, check=False
    )
    assert result.returncode != 0
    assert message in result.stderr
