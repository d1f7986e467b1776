"""Combinations of build options compile without a warning and keep the order of opcodes.

`make test` has each pair of two options, the exhaustive run every combination.
"""

import ast
import itertools
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from j2a_spec import constants as c
from j2a_spec.capabilities import CAPABILITIES
from j2a_spec.grammar import MAPPING
from j2a_spec.oracle import Frame, encode

FIRMWARE = Path(__file__).parents[1]
SWITCHES = ("MAPPING", "PROPERTIES", "SIF", "DEBUG")
COMBINATIONS = list(itertools.product((1, 0), repeat=len(SWITCHES)))
LIST = (FIRMWARE / "apps/demo/functions.def").read_text("utf-8")
USER = re.findall(r"J2A_(?:FUNCTION|CALL|MANY)\((\w+)", LIST)

# Optional parts of a port do not count: whoever ports J2A may leave them out.
OPTIONAL = re.compile(r"^#if J2A_\w+\n.*?^#endif\n", re.MULTILINE | re.DOTALL)


def options(combination):
    pairs = zip(SWITCHES, combination, strict=True)
    return " ".join(f"-DJ2A_WITH_{switch}={value}" for switch, value in pairs)


def table(combination):
    """The names in opcode order with these options."""
    on = dict(zip(SWITCHES, combination, strict=True))
    left_out = {c.GET_PROPERTIES: not on["PROPERTIES"], c.GET_DEBUG: not on["DEBUG"]}
    described = ["a2jGetInterface"] if on["MAPPING"] and on["PROPERTIES"] else []
    return [name for name in c.BUILTINS if not left_out.get(name)] + described + USER


# In these each two switches have all four settings that two can have, by one compiler or the other.
PAIRS = [(1, 1, 1, 1), (0, 0, 1, 1), (0, 1, 0, 1), (0, 1, 1, 0), (1, 0, 0, 0), (1, 1, 0, 0)]


def by_both(combination):
    """The combination by each compiler; the others are left to the exhaustive run."""
    for at, (cc, cflags) in enumerate((("gcc", "-O0"), ("clang", "-Os"))):
        tried = combination in PAIRS and PAIRS.index(combination) % 2 == at
        yield pytest.param(
            *(combination, cc, cflags),
            id=f"{options(combination)}-{cc}",
            marks=[] if tried else pytest.mark.exhaustive,
        )


def test_pairs_of_switches_have_all_settings():
    for one, other in itertools.combinations(range(len(SWITCHES)), 2):
        assert {(each[one], each[other]) for each in PAIRS} == {(0, 0), (0, 1), (1, 0), (1, 1)}
    for at, values in itertools.product(range(2), zip(*PAIRS, strict=True)):
        assert {*values[at::2]} == {0, 1}, "by each compiler"


@pytest.mark.parametrize(
    ("combination", "cc", "cflags"), [one for each in COMBINATIONS for one in by_both(each)]
)
def test_posix_options(build, ask, error, combination, cc, cflags):
    if shutil.which(cc) is None:
        pytest.skip(f"{cc} is not installed")
    # Clang warns of what it parses; file by file it compiles all of it in test_compilers.py.
    program = build(core_as_one=cc == "clang", CC=cc, CFLAGS=cflags, OPTIONS=options(combination))
    names = table(combination)
    requests = [
        Frame(c.SOF, 0, 0),
        Frame(c.SOF, 1, names.index(c.GET_ECHO), b"\x12\x7d\xed"),
        Frame(c.SOF, 2, names.index("add"), bytes((1, 0, 0, 0, 2, 0, 0, 0))),
        Frame(c.SOF, 3, names.index("sif"), b"\x07hello"),
        Frame(c.SOF, 4, len(names)),
    ]
    mapping = MAPPING.build(names)
    has_map, _, has_sif, _ = combination
    expected = [
        Frame(c.SOF, 0, 0, mapping) if has_map else error(0, c.ERR_OPCODE, c.SITE_OPCODE),
        Frame(c.SOF, 1, c.ECHO, b"\x12\x7d\xed"),
        Frame(c.SOF, 2, 0, bytes((3, 0, 0, 0))),
        *([Frame(c.SOS, 0, 7, b"hello")] if has_sif else []),
        Frame(c.SOF, 3, 0 if has_sif else c.RET_FAILED),
        error(4, c.ERR_OPCODE, c.SITE_OPCODE),
    ]
    assert ask(program, b"".join(map(encode, requests))) == expected


def test_builtins_on_posix(build, ask):
    program = build("builtins")
    builtins = [name for name in c.BUILTINS if name != c.GET_DEBUG]
    expected = Frame(c.SOF, 9, 0, MAPPING.build(builtins))
    assert ask(program, encode(Frame(c.SOF, 9, 0))) == [expected]


@pytest.mark.parametrize("has_map", [1, 0])
def test_functions_of_kind_many_have_no_opcode_without_a2jmany(build, ask, error, has_map):
    """Nobody may call one the way a request calls the other kind: its arguments are others."""
    program = build(OPTIONS=f"-DJ2A_WITH_MANY=0 -DJ2A_WITH_MAPPING={has_map}")
    names = [name for name in c.BUILTINS if name not in c.WITH_MANY]
    names += [name for name in USER if name != "store"]
    requests = [
        Frame(c.SOF, 0, 0),
        Frame(c.SOF, 1, names.index("add"), bytes((1, 0, 0, 0, 2, 0, 0, 0))),
        Frame(c.SOF, 2, names.index("ret"), b"\x07hello"),
        Frame(c.SOF, 3, names.index("overruns")),
        Frame(c.SOF, 4, len(names)),
    ]
    mapping = MAPPING.build(names)
    expected = [
        Frame(c.SOF, 0, 0, mapping) if has_map else error(0, c.ERR_OPCODE, c.SITE_OPCODE),
        Frame(c.SOF, 1, 0, bytes((3, 0, 0, 0))),
        Frame(c.SOF, 2, 7),
        Frame(c.SOF, 3, 0, bytes(2)),
        error(4, c.ERR_OPCODE, c.SITE_OPCODE),
    ]
    assert ask(program, b"".join(map(encode, requests))) == expected


@pytest.mark.avr
@pytest.mark.parametrize(
    "settings",
    [
        {"OPTIONS": options((0, 0, 0, 0))},
        {"OPTIONS": options((1, 0, 1, 0))},
        {"OPTIONS": options((0, 1, 0, 1)), "CFLAGS": "-O2"},
        {"BAUD": "250000", "RXBUF": "255"},
        {"BAUD": "2400", "RXBUF": "1"},
    ],
    ids=str,
)
def test_avr_options(build, settings):
    assert build(port="avr-serial", core_as_one=False, **settings).exists()


@pytest.mark.avr
@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"BAUD": "230400"}, "off by more than"),
        ({"BAUD": "600"}, "must be 2400..F_CPU / 16"),
        ({"BAUD": "2000000"}, "must be 2400..F_CPU / 16"),
        ({"RXBUF": "256"}, "must be 1..255"),
        ({"TXBUF": "1"}, "J2A_TXBUF must be 0"),
        ({"OPTIONS": "-DJ2A_PAUSE_MS=20"}, "must be 9..19"),
    ],
    ids=str,
)
def test_avr_refuses(avr, make, tmp_path, settings, message):
    goal = f"{tmp_path}/demo.obj/port.o"  # no more of it is compiled than shows the error
    result = make(goal, PORT="avr-serial", OUT=str(tmp_path), **settings)
    assert result.returncode != 0
    assert message in result.stderr


def app(folder, functions="", properties=""):
    folder.mkdir()
    (folder / "app.c").write_text(
        '#include "j2a_functions.h"\nvoid j2a_app_task(void) {\n}\n'
        "uint8_t f(uint8_t *const length, uint8_t **const payload) {\n"
        "    (void)payload;\n    return *length;\n}\n"
    )
    (folder / "functions.def").write_text(functions)
    (folder / "properties.def").write_text(properties)
    return folder


def test_map_too_long_for_a_frame(make, tmp_path):
    room = c.MAX_PAYLOAD - len(MAPPING.build(c.BUILTINS)) - 1
    folder = app(tmp_path / "app")
    for name, fits in (("n" * room, True), ("n" * (room + 1), False)):
        (folder / "functions.def").write_text(f"J2A_CALL({name}, f)\n")
        goal = f"{tmp_path}/long.obj/j2a_table.o"  # which shows it
        result = make(goal, APP="long", APP_DIR=str(folder), OUT=str(tmp_path), CFLAGS="-O0")
        assert (result.returncode == 0) is fits
        assert fits or "j2a_names_longer_than_a_payload" in result.stderr


@pytest.mark.parametrize("mapping", [0, 1])
def test_more_functions_than_a_device_can_count(make, tmp_path, mapping):
    # Without the map its place is reserved; with it, a2jGetInterface is there, too.
    room = 255 - len(c.BUILTINS) - mapping
    for count in (room, room + 1):
        functions = "".join(f"J2A_CALL(f{i}, f{i})\n" for i in range(count))
        folder = app(tmp_path / f"app{count}", functions)
        goal = f"{tmp_path}/many{count}.obj/j2a_table.o"
        options = f"-DJ2A_WITH_MAPPING={mapping} -DJ2A_WITH_INTERFACE={mapping} -Wno-error=overflow"
        result = make(
            goal, APP=f"many{count}", APP_DIR=str(folder), OUT=str(tmp_path), OPTIONS=options
        )
        assert (result.returncode == 0) is (count == room), result.stderr
        assert count == room or "j2a_functions_are_more_than_255" in result.stderr


@pytest.mark.parametrize(
    ("functions", "properties", "message"),
    [
        ("J2A_CALL(, f)", "", 'the name "" has other characters'),
        ("J2A_CALL(twice, f)\nJ2A_CALL(twice, g)", "", "the name twice stands here twice"),
        ("J2A_CALL(a2jEcho, f)", "", "j2a_name_a2jEcho"),
        ("", 'J2A_PROPERTY("", "value")', "j2a_property_is_empty"),
        ("", 'J2A_PROPERTY("key", "")', "j2a_property_is_empty"),
    ],
)
def test_empty_or_repeated_names_do_not_compile(make, tmp_path, functions, properties, message):
    folder = app(tmp_path / "app", functions + "\n", properties + "\n")
    goal = f"{tmp_path}/names.obj/j2a_table.o"  # no more of it is compiled than shows the error
    result = make(goal, APP="names", APP_DIR=str(folder), OUT=str(tmp_path))
    assert result.returncode != 0
    assert message in result.stderr


@pytest.mark.parametrize(
    ("parts", "fits"),
    [("", True)]
    + [(part, False) for part in ("INTERFACE", "INTERFACE BOOT", "TRANSDUCERS", "SYNC")],
)
def test_tokens_beside_those_of_the_core_do_not_compile(make, tmp_path, parts, fits):
    folder = app(tmp_path / "app", properties='J2A_PROPERTY("j2a.caps", "acme.turbo")\n')
    options = " ".join(f"-DJ2A_WITH_{part}=1" for part in parts.split())
    goal = f"{tmp_path}/tokens.obj/j2a_table.o"
    result = make(goal, APP="tokens", APP_DIR=str(folder), OUT=str(tmp_path), OPTIONS=options)
    assert (result.returncode == 0) is fits, result.stderr
    assert fits or "j2a_caps_is_there_already" in result.stderr


ANNOUNCED = {part.id for part in CAPABILITIES.values() if part.token}


@pytest.mark.parametrize(
    "built",
    [
        built
        for count in range(len(ANNOUNCED) + 1)
        for built in itertools.combinations(sorted(ANNOUNCED), count)
        if all(ANNOUNCED & set(CAPABILITIES[part].needs) <= set(built) for part in built)
    ],
    ids="-".join,
)
def test_tokens_of_each_combination_of_parts(need, built):
    """J2A-CAP-001: one space between two, whichever parts are built in."""
    need("gcc")
    options = [f"-D{CAPABILITIES[part].option}={int(part in built)}" for part in ANNOUNCED]
    folders = [FIRMWARE / "core", FIRMWARE / "ports/posix"]
    done = subprocess.run(
        ["gcc", "-E", "-P", *options, *(f"-I{folder}" for folder in folders), "-"],
        input='#include "j2a_table.h"\nJ2A_PROPERTY_CAPS ""',
        capture_output=True,
        text=True,
        check=True,
    )
    value = ast.literal_eval(done.stdout.splitlines()[-1])
    key, tokens, *rest = value.split("\0") if value else ("j2a.caps", "", "")
    announced = sorted(tokens.split(" ")) if value else []
    assert (key, announced, rest) == (
        "j2a.caps",
        sorted(CAPABILITIES[part].token for part in built),
        [""],
    )


def test_function_of_the_wrong_kind_does_not_compile(make, tmp_path):
    folder = app(tmp_path / "wrong.app", "J2A_MANY(f, f)\n")
    goals = [f"{tmp_path}/wrong.obj/{name}.o" for name in ("j2a_table", "app")]
    result = make(*goals, APP="wrong", APP_DIR=str(folder), OUT=str(tmp_path))
    assert result.returncode != 0
    assert "conflicting types" in result.stderr


def test_other_options_rebuild_and_the_same_do_not(make, tmp_path):
    def built(**variables):
        assert make(core_as_one=True, OUT=str(tmp_path), CFLAGS="-O0", **variables).returncode == 0
        program = tmp_path / "demo"
        return program.stat().st_mtime_ns

    first = built()
    assert built() == first
    other = built(OPTIONS="-DJ2A_WITH_DEBUG=0")
    assert other != first
    assert built(OPTIONS="-DJ2A_WITH_DEBUG=0") == other


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("PORT", "vax"),
        ("APP", "nosuch"),
        ("APP", ""),
        ("OUT", ""),
        ("BAUD", "abc"),
        ("BAUD", ""),
        ("BAUD", "0"),
        ("RXBUF", "0"),
        ("TXBUF", "-1"),
        ("TXBUF", ""),
        ("TXBUF", "00"),
        ("BAUD", "9600 8"),
        ("LINKS", "01"),
        ("ROOM", "123456789"),
        ("OUT", "a folder"),
        ("APP_DIR", "an app"),
        ("PORT_DIR", "a port"),
        ("FREQ", ""),
        ("MCU", ""),
    ],
)
def test_wrong_variables_are_refused_in_one_line(make, tmp_path, name, value):
    result = make(**{"OUT": str(tmp_path), name: value})
    assert result.returncode != 0
    assert len(result.stderr.splitlines()) == 1
    assert name in result.stderr


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("J2A_WITH_MAPPING=on", "is not defined"),
        ("J2A_DEBUGBUF=0", "must be 1..32767"),
        ("J2A_DEBUGBUF=70000", "must be 1..32767"),
    ],
)
def test_wrong_options_do_not_compile(make, tmp_path, option, message):
    result = make(OUT=str(tmp_path), CC="gcc", OPTIONS=f"-D{option}")
    assert result.returncode != 0
    assert message in result.stderr


@pytest.mark.parametrize("path", sorted(FIRMWARE.glob("ports/*/port.c")), ids=lambda p: p.parts[-2])
def test_ports_are_small(path):
    assert len(OPTIONAL.sub("", path.read_text()).splitlines()) < 150


@pytest.mark.parametrize(
    "module", ["budget.measure", "fuzz.fuzz", "proof.prove", "targets.compile"]
)
def test_targets_run_the_module_that_verifies(make, module):
    result = make("-n", module.split(".")[0])
    assert result.returncode == 0, result.stderr
    assert f"-m firmware.verify.{module}" in result.stdout


def test_mutant_of_a_port_and_an_app_in_other_folders(make, tmp_path):
    port, out = tmp_path / "port", tmp_path / "out"
    shutil.copytree(FIRMWARE / "ports/posix", port)
    folder = app(tmp_path / "other", "J2A_CALL(f, f)\n")
    result = make(
        MUTANT="core-stuff-004",
        PORT_DIR=os.path.relpath(port, FIRMWARE),
        APP="other",
        APP_DIR=os.path.relpath(folder, FIRMWARE),
        OUT=os.path.relpath(out, FIRMWARE),
    )
    assert result.returncode == 0, result.stderr
    assert (out / "other").exists()


def test_a_mutant_is_built_where_the_path_of_the_project_has_a_blank(need, tmp_path):
    need("make")
    root = tmp_path / "a project"
    ignored = shutil.ignore_patterns("build", "node_modules", "__pycache__", "corpus", "tests")
    for name in ("firmware", "conformance/mutants", "spec"):
        shutil.copytree(FIRMWARE.parent / name, root / name, ignore=ignored)
    command = ["make", "-s", "-C", root / "firmware", f"PYTHON={sys.executable}", "APP=builtins"]
    result = subprocess.run(
        [*command, "MUTANT=core-stuff-004", "CFLAGS=-O0"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    assert (root / "firmware/build/mutants/core-stuff-004/posix/builtins").is_file()


def test_mutants_of_python_are_refused(make, tmp_path):
    result = make(MUTANT="device-stuff-004", OUT=tmp_path)
    assert result.returncode != 0
    assert "device-stuff-004: not a mutant of the C core" in result.stderr
    assert len(result.stderr.splitlines()) == 1


def test_each_optional_part_is_a_file_of_its_own():
    there = {path.stem: path.read_text() for path in FIRMWARE.glob("core/ext/*.c")}
    # What the clock does on ports with USB frames is a file of its own.
    assert set(there) == {f"j2a_{part.id}" for part in CAPABILITIES.values()} | {"j2a_clock_frames"}
    for part in CAPABILITIES.values():
        assert f"\n#if {part.option}\n" in there[f"j2a_{part.id}"]
