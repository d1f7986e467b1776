"""Slips in functions.def, properties.def and OPTIONS: one readable message each.

In: an app with a slip. Out: what make says; and that one without builds, j2a.spec included.
"""

import re
import shutil
import subprocess
from pathlib import Path

import pytest
from j2a_spec import constants as c
from j2a_spec.grammar import PROPERTIES
from j2a_spec.oracle import Frame, encode

FIRMWARE = Path(__file__).parents[1]
APP = """#include "j2a_functions.h"
void j2a_app_task(void) {
}
""" + "".join(
    f"J2A_DECLARE_CALL({name});\n"
    f"uint8_t {name}(uint8_t *const length, uint8_t **const payload) {{\n"
    "    (void)payload;\n    *length = 0;\n    return 0;\n}\n"
    for name in ("one", "two", "three")
)
SPEC = 'J2A_PROPERTY("j2a.spec", J2A_SPEC_VERSION)\n'
NAME = 'J2A_PROPERTY("name", "x")\n'
GOOD = "J2A_CALL(one, one)\n"


@pytest.fixture
def app(tmp_path):
    """app(functions, properties) makes the folder of an app."""

    def make_app(functions=GOOD, properties=SPEC):
        folder = tmp_path / "app"
        folder.mkdir(exist_ok=True)
        (folder / "app.c").write_text(APP)
        (folder / "functions.def").write_text(functions)
        (folder / "properties.def").write_text(properties)
        return folder

    return make_app


@pytest.mark.parametrize(
    ("functions", "message"),
    [
        ("\nJ2A_CAL(one, one)\n", "functions.def:2: J2A_CAL is not J2A_CALL or J2A_MANY"),
        ('J2A_CALL("one", one)\n', "functions.def:1: a name has no quotes: J2A_CALL(add, app_add)"),
        ("J2A_CALL(on,e, one)\n", "functions.def:1: J2A_CALL takes a name and a function, such as"),
        ("J2A_CALL(one)\n", "functions.def:1: J2A_CALL takes a name and a function, such as"),
        ("J2A_CALL(o-e, one)\n", 'functions.def:1: the name "o-e" has other characters than'),
        ("J2A_CALL(, one)\n", 'functions.def:1: the name "" has other characters than'),
        ('J2A_CALL(one, "one")\n', 'functions.def:1: ""one"" is no C function'),
        ("J2A_CALL(one, one)\nJ2A_CALL(two, one\n", 'functions.def:2: a ")" is missing'),
        ("J2A_CALL one, one)\n", 'functions.def:1: a "(" is missing behind J2A_CALL'),
        ("J2A_CALL(one, one),\n", 'functions.def:1: "," is not expected here'),
        ("/* a\n\nJ2A_CALL(one, one)\n", "functions.def:1: this comment has no end"),
    ],
)
def test_slips_in_functions(app, make, tmp_path, functions, message):
    result = make(PORT="posix", APP_DIR=app(functions), OUT=tmp_path / "out")
    assert result.returncode != 0
    assert message in result.stderr
    assert len(result.stderr.splitlines()) == 1


@pytest.mark.parametrize(
    ("properties", "message"),
    [
        ('J2A_PROPERTI("a", "b")\n', "properties.def:1: J2A_PROPERTI is not J2A_PROPERTY"),
        ('J2A_PROPERTY("a")\n', "properties.def:1: J2A_PROPERTY takes a key and a value"),
        ('J2A_PROPERTY("a", "b", "c")\n', "properties.def:1: J2A_PROPERTY takes a key and a value"),
        (SPEC + 'J2A_PROPERTY("a", "b)\n', "properties.def:2: a string has no end"),
        (SPEC + 'J2A_PROPERTY("a", "b"\n', 'properties.def:2: a ")" is missing'),
    ],
)
def test_slips_in_properties(app, make, tmp_path, properties, message):
    result = make(PORT="posix", APP_DIR=app(properties=properties), OUT=tmp_path / "out")
    assert result.returncode != 0
    assert message in result.stderr
    assert len(result.stderr.splitlines()) == 1


GOOD_LISTS = [
    "",
    GOOD,
    "J2A_CALL(one, one) J2A_CALL(two, two)",
    "/* J2A_CAL(x, y) */ J2A_CALL(one,\n    one) // J2A_CALL(, ,\n",
    "#define MORE(name) \\\n    J2A_CALL(name, name)\nMORE(two)\nJ2A_CALL(three, three)\n",
    "#if J2A_WITH_SIF\nJ2A_CALL(one, one)\n#endif\n",
]


@pytest.mark.parametrize("functions", GOOD_LISTS)
def test_lists_that_c_takes_are_taken(app, make, tmp_path, functions):
    result = make(PORT="posix", APP_DIR=app(functions), OUT=tmp_path / "out")
    assert result.returncode == 0, result.stderr


def test_the_lists_of_all_apps_are_taken():
    lists = [path for path in FIRMWARE.parent.rglob("*.def") if "build" not in path.parts]
    lists = [path for path in lists if path.name in {"functions.def", "properties.def"}]
    assert len(lists) > 20
    for path in lists:
        done = subprocess.run(
            ["awk", "-f", FIRMWARE / "core/lists.awk", path],
            capture_output=True,
            text=True,
            check=False,
        )
        assert (done.returncode, done.stdout, done.stderr) == (0, "", ""), path


@pytest.mark.parametrize(
    "properties",
    ["", NAME, SPEC + NAME, NAME + SPEC, f"// {SPEC}", f'/* "j2a.spec" comes by itself */\n{NAME}'],
)
def test_each_device_has_j2a_spec_once(app, make, ask, tmp_path, properties):
    result = make(PORT="posix", APP_DIR=app(properties=properties), OUT=tmp_path / "out")
    assert result.returncode == 0, result.stderr
    read = Frame(c.SOF, 0, 1, bytes([c.BUILTINS.index(c.GET_PROPERTIES), 0, 0, 0, 0, 0]))
    (reply,) = ask(tmp_path / "out/demo", encode(read))
    found = PROPERTIES.parse(reply.payload[c.MANY_HEADER :])
    keys = [str(pair.key) for pair in found]
    assert keys.count("j2a.spec") == 1
    assert keys.count("name") == properties.count("name")


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("-DJ2A_WITH_DEBG=0", "there is no option J2A_WITH_DEBG, the nearest is J2A_WITH_DEBUG"),
        ("-DJ2A_RXBUFF=9", "there is no option J2A_RXBUFF, the nearest is J2A_RXBUF"),
        ("-Dj2a_with_sif=0", "there is no option j2a_with_sif, the nearest is J2A_WITH_SIF"),
        ("J2A_WITH_SIF=0", "J2A_WITH_SIF=0 has no -D: give -DNAME=value"),
        ("-D J2A_WITH_SIF=0", "J2A_WITH_SIF=0 has no -D: give -DNAME=value, without a blank"),
        ("-DJ2A_WITH_SIF=0 -DJ2A_PAUS_MS=9", "J2A_PAUS_MS, the nearest is J2A_PAUSE_MS"),
    ],
)
def test_misspelt_options(make, tmp_path, option, message):
    result = make(PORT="posix", OPTIONS=option, OUT=tmp_path)
    assert result.returncode != 0
    assert message in result.stderr
    assert len(result.stderr.splitlines()) == 1


def test_every_option_of_the_core_is_known(make, tmp_path):
    text = (FIRMWARE / "core/j2a_options.h").read_text()
    names = [name for name in re.findall(r"#ifndef (J2A_\w+)", text) if not name.endswith("_H")]
    assert len(names) > 10
    options = " ".join(f"-D{name}=1" for name in names)
    result = make("-n", PORT="posix", OPTIONS=f"{options} -DMY_OWN=1", OUT=tmp_path)
    assert "there is no option" not in result.stderr


TRACE = """#include <stdint.h>
#include <stdio.h>
static uint32_t value;
static uint32_t *at(uint32_t address) {
    printf("%08x ", (unsigned)address);
    return &value;
}
#include "cortex_m.h"
int main(void) {
    for (uint32_t i = 0; i < 240; i++) {
        cortex_m_enable(i);
        printf("%08x\\n", (unsigned)value);
    }
    return 0;
}
"""


def test_every_interrupt_of_a_cortex_m_is_switched_on_in_its_register(tmp_path):
    """By a trace of the registers: QEMU's chips have few interrupts."""
    if shutil.which("gcc") is None:
        pytest.skip("gcc is not installed")
    header = (FIRMWARE / "ports/common/cortex_m.h").read_text()
    traced = re.sub(r"(#define CORTEX_M_REG\(address\)).*", r"\1 (*at(address))", header)
    assert traced != header
    (tmp_path / "cortex_m.h").write_text(traced)
    (tmp_path / "trace.c").write_text(TRACE)
    subprocess.run(["gcc", "-o", tmp_path / "trace", tmp_path / "trace.c"], check=True)
    done = subprocess.run([tmp_path / "trace"], capture_output=True, text=True, check=True)
    expected = [f"{0xE000E100 + 4 * (i // 32):08x} {1 << i % 32:08x}" for i in range(240)]
    assert done.stdout.splitlines() == expected


def test_the_template_has_as_many_functions_as_the_documents_say():
    functions = re.findall(
        r"^\w+ board_\w+\(", (FIRMWARE / "ports/template/board.c").read_text(), re.M
    )
    words = {8: "eight", 9: "nine"}
    root = FIRMWARE.parent
    told = [root / "README.md", root / "docs/porting.md", root / "docs/library.md"]
    for path in [*told, root / "docs/in-your-firmware.md", FIRMWARE / "README.md"]:
        found = re.findall(r"(\w+)(?: small| short)? functions", path.read_text())
        assert words[len(functions)] in found, path
        assert not set(found) & (set(words.values()) - {words[len(functions)]}), path
