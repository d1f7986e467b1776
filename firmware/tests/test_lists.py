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


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("lists")


@pytest.fixture
def app(folder):
    """app(functions, properties) makes the folder of an app, each time the same one."""

    def make_app(functions=GOOD, properties=SPEC):
        app = folder / "app"
        app.mkdir(exist_ok=True)
        (app / "app.c").write_text(APP)
        (app / "functions.def").write_text(functions)
        (app / "properties.def").write_text(properties)
        return app

    return make_app


@pytest.fixture
def built(app, make, folder):
    """Build an app with these lists; returns the program. What knows no list is compiled once."""

    def build(**lists):
        sources = app(**lists)
        result = make(core_as_one=True, APP_DIR=sources, OUT=folder / "out", CFLAGS="-O0")
        assert result.returncode == 0, result.stderr
        program = folder / "out/demo"
        changed = max(path.stat().st_mtime_ns for path in sources.iterdir())
        assert program.stat().st_mtime_ns > changed
        return program

    return build


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


ADD = 'J2A_FUNCTION(add, i32, (i32, a), (i32, b), "Adds.")'
POINT = "J2A_STRUCT(point, (f32, x, m), (f32, y, m))"
MODE = "J2A_ENUM(mode, u8, (off, 0), (on, 1))"
NINE = ", ".join(f"(u8, p{i})" for i in range(9))
MANY_VALUES = ", ".join(f"(v{i}, {i})" for i in range(33))
NESTED = "\n".join(
    ["J2A_STRUCT(s1, (u8, a))", *(f"J2A_STRUCT(s{i}, (s{i - 1}, a))" for i in range(2, 10))]
)
# A mistake in typed entries, and what is said of it behind "functions.def:LINE: ".
TYPED_SLIPS = [
    # the macro
    ('J2A_FUNCTIO(f, void, "x")', 1, "nor another entry; did you mean J2A_FUNCTION?"),
    ('J2A_FUNCTION f, void, "x")', 1, 'a "(" is missing behind J2A_FUNCTION'),
    ('J2A_FUNCTION(f, void, "x"', 1, 'a ")" is missing'),
    (f'J2A_FUNCTION(f, void, "x"\n{ADD}', 1, 'a ")" is missing: the next entry begins within'),
    (f"{ADD},", 1, '"," is not expected here'),
    (f"{ADD};", 1, '";" is not expected here'),
    # the name
    ('J2A_FUNCTION("f", void, "x")', 1, 'the name of a function has no quotes: "f"'),
    ('J2A_FUNCTION(, void, "x")', 1, "the name of a function is missing"),
    ('J2A_FUNCTION(f void, "x")', 1, "a comma is missing behind f"),
    ('J2A_FUNCTION(f, void, (u8 a), "x")', 1, "a comma is missing behind (u8"),
    ('J2A_FUNCTION(f, void, (u8, a b), "x")', 1, "a comma is missing behind (u8,a"),
    ('J2A_FUNCTION(f, void, "a\tb")', 1, "the text has a control character"),
    ('J2A_FUNCTION(2f, void, "x")', 1, '"2f" is no name of a function: a name has letters'),
    ('J2A_FUNCTION(my-f, void, "x")', 1, '"my-f" is no name of a function'),
    ('J2A_FUNCTION(while, void, "x")', 1, "the name of a function cannot be while, a word of C"),
    (f'J2A_FUNCTION({"f" * 33}, void, "x")', 1, "is longer than 32 characters"),
    (f"{ADD}\n\n{ADD}", 3, "the name add stands here twice: another function of line 1 has it"),
    (f"J2A_CALL(add, one)\n{ADD}", 2, "the name add stands here twice"),
    (f'J2A_BUFFER(add, bytes, 9, "x")\n{ADD}', 2, "the name add stands here twice"),
    # the text
    ("J2A_FUNCTION(f, void)", 1, "the text at the end is missing"),
    ("J2A_FUNCTION(f, void, (u8, a))", 1, "the text at the end is missing"),
    ('J2A_FUNCTION(f, void, "")', 1, "the text at the end is empty"),
    ('J2A_FUNCTION(f, void, "x", (u8, a))', 1, "the text at the end is missing"),
    ('J2A_FUNCTION(f, void, "x", "y")', 1, 'the text "x" is not at the end'),
    ('J2A_FUNCTION(f, void, (u8, a) "x")', 1, 'a comma is missing before "x"'),
    ('J2A_FUNCTION(f, void, "x\\n")', 1, "the text has a control character"),
    ('J2A_FUNCTION(f, void, "x)', 1, "a string has no end"),
    # the result
    ('J2A_FUNCTION(f, "x")', 1, "the result is missing: give a type, or void"),
    ('J2A_FUNCTION(f, , "x")', 1, "the result is missing: give a type, or void"),
    ('J2A_FUNCTION(f, int32_t, "x")', 1, "there is no type int32_t; did you mean i32?"),
    ('J2A_FUNCTION(f, (f32, f32), "x")', 1, "several results are ((f32, x), (f32, y))"),
    ('J2A_FUNCTION(f, ((u8, a), (u8, a)), "x")', 1, "the name a stands twice"),
    ('J2A_FUNCTION(f, ((text, a), (u8, b)), "x")', 1, "nothing may follow a result of any length"),
    ('J2A_FUNCTION(f, array(f64, 32), "x")', 1, "the result is longer than a payload of 255"),
    (f'J2A_FUNCTION(f, ({NINE}), "x")', 1, "a function has at most 8 results, not 9"),
    # parameters
    ('J2A_FUNCTION(f, void, (i33, a), "x")', 1, "there is no type i33; did you mean i32?"),
    ('J2A_FUNCTION(f, void, (int, a), "x")', 1, "there is no type int; did you mean i32?"),
    ('J2A_FUNCTION(f, void, (string, a), "x")', 1, "there is no type string; did you mean text?"),
    ('J2A_FUNCTION(f, void, (pont, a), "x")', 1, "there is no type pont"),
    (f'{POINT}\nJ2A_FUNCTION(f, void, (pont, a), "x")', 2, "no type pont; did you mean point?"),
    (f'J2A_FUNCTION(f, void, (point, a), "x")\n{POINT}', 1, "there is no type point"),
    ('J2A_FUNCTION(f, void, (a, u8), "x")', 1, "in (a,u8) the type comes first: (u8, a)"),
    ('J2A_FUNCTION(f, void, u8, "x")', 1, '"u8" is neither a parameter such as (i32, a) nor'),
    ('J2A_FUNCTION(f, void, (u8), "x")', 1, "(u8) is no parameter: give (type, name)"),
    ('J2A_FUNCTION(f, void, (u8, a, mV, 3), "x")', 1, "has 4 parts: give (type, name)"),
    ('J2A_FUNCTION(f, void, (u8, ), "x")', 1, "the name of a parameter is missing"),
    ('J2A_FUNCTION(f, void, (u8, 3a), "x")', 1, '"3a" is no name of a parameter'),
    ('J2A_FUNCTION(f, void, (u8, int), "x")', 1, "the name of a parameter cannot be int, a word"),
    ('J2A_FUNCTION(f, void, (u8, a), (u8, a), "x")', 1, "the name a stands twice"),
    ('J2A_FUNCTION(f, void, (u8, a) (u8, b), "x")', 1, "a comma is missing behind (u8,a)"),
    ('J2A_FUNCTION(f, void, (u8, a),, "x")', 1, "a comma is too many"),
    ('J2A_FUNCTION(f, void, (text, a), (u8, b), "x")', 1, "nothing may follow a parameter of any"),
    ('J2A_FUNCTION(f, void, (void, a), "x")', 1, "void is no type of a field"),
    (f'J2A_FUNCTION(f, void, {NINE}, "x")', 1, "a function has at most 8 parameters, not 9"),
    ('J2A_FUNCTION(f, void, (array(u16, 128), a), "x")', 1, "longer than a payload of 255 bytes"),
    # arrays and units
    ('J2A_FUNCTION(f, void, (i16[3], a), "x")', 1, "an array is array(i16, 3)"),
    ('J2A_FUNCTION(f, void, (arry(i16, 3), a), "x")', 1, "an array is array(i16, 3)"),
    ('J2A_FUNCTION(f, void, (array(i16, 0), a), "x")', 1, "the length of an array is 0"),
    ('J2A_FUNCTION(f, void, (array(i16, -1), a), "x")', 1, '"-1" is no length of an array'),
    ('J2A_FUNCTION(f, void, (array(i16, 70000), a), "x")', 1, "an array is at most 65535"),
    ('J2A_FUNCTION(f, void, (array(i16, 3, 4), a), "x")', 1, "array takes a type and a length"),
    ('J2A_FUNCTION(f, void, (array(array(u8, 3), 3), a), "x")', 1, "an array of arrays is no type"),
    ('J2A_FUNCTION(f, void, (array(text), a), "x")', 1, "text is of any length by itself"),
    ('J2A_FUNCTION(f, void, (array(i33), a), "x")', 1, "there is no type i33; did you mean i32?"),
    ('J2A_FUNCTION(f, void, (u8, a, "mV"), "x")', 1, "a unit has no quotes"),
    ('J2A_FUNCTION(f, void, (u8, a, m\u00b2), "x")', 1, "is no unit: give a symbol of UCUM"),
    ('J2A_FUNCTION(f, (u8, mV!), "x")', 1, '"mV!" is no unit'),
    # flags
    ('J2A_FUNCTION(f, void, idempotnt, "x")', 1, '"idempotnt" is neither a parameter'),
    ('J2A_FUNCTION(f, void, slow, "x")', 1, "slow takes a number of milliseconds"),
    ('J2A_FUNCTION(f, void, slow(0), "x")', 1, "slow takes 1 to 65535 milliseconds"),
    ('J2A_FUNCTION(f, void, slow(65536), "x")', 1, "slow takes 1 to 65535 milliseconds"),
    ('J2A_FUNCTION(f, void, idempotent, (u8, a), "x")', 1, "the parameter (u8,a) comes before"),
    # structures and enumerations
    ("J2A_STRUCT(point)", 1, "J2A_STRUCT takes a name and fields"),
    ('J2A_STRUCT(point, (f32, x), "x")', 1, "J2A_STRUCT has no text"),
    ("J2A_STRUCT(point, (text, x))", 1, "a structure cannot hold a field of any length"),
    ("J2A_STRUCT(point, (point, x))", 1, "there is no type point"),
    ("J2A_STRUCT(u8, (f32, x))", 1, "the name u8 is that of a type that exists"),
    (f"{POINT}\nJ2A_STRUCT(point, (f32, x))", 2, "the name point stands here twice"),
    (f"{POINT}\nJ2A_ENUM(point, u8, (off, 0))", 2, "another type of line 1 has it"),
    (NESTED, 9, "structures are nested more than 8 deep, from s9 on"),
    ("J2A_ENUM(mode, u8)", 1, "J2A_ENUM takes a name, an integer type and values"),
    ("J2A_ENUM(mode, f32, (off, 0))", 1, "an enumeration holds an integer such as u8, not f32"),
    ("J2A_ENUM(mode, u8, off)", 1, '"off" is no value: give (name, number)'),
    ("J2A_ENUM(mode, u8, (off, 256))", 1, "the number 256 of off does not fit into u8"),
    ("J2A_ENUM(mode, i8, (off, -129))", 1, "the number -129 of off does not fit into i8"),
    ("J2A_ENUM(mode, u8, (off, -1))", 1, "the number -1 of off does not fit into u8"),
    ("J2A_ENUM(mode, u64, (off, 2147483648))", 1, "does not fit into u64 and an int of C"),
    ("J2A_ENUM(mode, u8, (off, 0x1))", 1, '"0x1" is no number of a value'),
    ("J2A_ENUM(mode, u8, (off, 0), (off, 1))", 1, "the name off stands twice"),
    ("J2A_ENUM(mode, u8, (off, 0), (on, 0))", 1, "the number 0 stands twice"),
    (f"J2A_ENUM(mode, u8, {MANY_VALUES})", 1, "an enumeration has at most 32 values, not 33"),
    # SIFs and buffers
    ('J2A_SIF(tick, "x")', 1, "J2A_SIF takes a name, an opcode, fields and a text"),
    ('J2A_SIF(tick, 256, "x")', 1, "the opcode of a SIF is a number from 0 to 255"),
    ('J2A_SIF(tick, (u8, a), "x")', 1, "the opcode of a SIF is a number from 0 to 255"),
    ('J2A_SIF(a, 1, "x")\nJ2A_SIF(b, 1, "x")', 2, "the opcode 1 stands here twice"),
    ('J2A_SIF(a, 1, "x")\nJ2A_SIF(a, 2, "x")', 2, "the name a stands here twice"),
    ("J2A_SIF(tick, 1, (u8, a))", 1, "the text at the end is missing"),
    ('J2A_SIF(tick, 1, idempotent, "x")', 1, '"idempotent" is no field: give (type, name)'),
    ('J2A_BUFFER(b, bytes, "x")', 1, "J2A_BUFFER takes a name, a type, a length and a text"),
    ('J2A_BUFFER(b, bytes, 0, "x")', 1, "the length of a buffer is a number from 1 to 65535"),
    ('J2A_BUFFER(b, bytes, 65536, "x")', 1, "the length of a buffer is a number from 1"),
    ('J2A_BUFFER(b, bytes, 2*1024, "x")', 1, "the length of a buffer is a number from 1"),
    ("J2A_BUFFER(b, bytes, 9, 9)", 1, "the text at the end is missing"),
    ('J2A_BUFFER(b, bool, 9, "x")', 1, "a buffer holds bytes, text or numbers, not bool"),
    (f'{POINT}\nJ2A_BUFFER(b, point, 9, "x")', 2, "a buffer holds bytes, text or numbers"),
    ('J2A_BUFFER(b, array(u8, 9), 9, "x")', 1, "the length of a buffer is its own item"),
]


def awk(folder, functions):
    path = folder / "functions.def"
    path.write_text(f"{functions}\n", "utf-8")
    return subprocess.run(
        ["awk", "-f", FIRMWARE / "core/lists.awk", path],
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.parametrize(("functions", "line", "message"), TYPED_SLIPS)
def test_slips_in_typed_entries(tmp_path, functions, line, message):
    """One message, with the line; make prints it as it prints those above."""
    result = awk(tmp_path, functions)
    assert (result.returncode, result.stderr) == (1, "")
    assert result.stdout.startswith(f"functions.def:{line}: ")
    assert message in result.stdout
    assert len(result.stdout.splitlines()) == 1


def test_make_prints_a_slip_in_typed_entries(app, make, tmp_path):
    result = make(PORT="posix", APP_DIR=app('J2A_FUNCTION(f, int, "x")\n'), OUT=tmp_path / "out")
    assert result.returncode != 0
    assert "functions.def:1: there is no type int; did you mean i32?" in result.stderr
    assert len(result.stderr.splitlines()) == 1


GOOD_TYPED = [
    ADD,
    f"{POINT}\n{MODE}\nJ2A_STRUCT(both, (point, p), (array(mode, 3), m))",
    'J2A_FUNCTION(f,\n    i32, // sum\n    (i32, a),\n (i32, b), /* b */ "A, (b) \\"c\\".")',
    'J2A_FUNCTION(f, i32, (i32, a, m/s2), (i32, b, %), idempotent, slow(65535), "J2A_CALL(a")',
    '#define N 4\nJ2A_FUNCTION(f, void, (array(i16, N), a), "x")\nJ2A_BUFFER(b, (i16, mV), N, "x")',
    '#if J2A_WITH_SIF\nJ2A_SIF(a, 1, "x")\n#else\nJ2A_SIF(a, 1, "x")\n#endif',
]


@pytest.mark.parametrize("functions", GOOD_TYPED)
def test_typed_lists_without_a_slip_are_taken(tmp_path, functions):
    result = awk(tmp_path, functions)
    assert (result.returncode, result.stdout, result.stderr) == (0, "", "")


@pytest.mark.parametrize(
    ("properties", "message"),
    [
        ('J2A_PROPERTI("a", "b")\n', "properties.def:1: J2A_PROPERTI is not J2A_PROPERTY"),
        ('J2A_PROPERTY("a")\n', "properties.def:1: J2A_PROPERTY takes a key and a value"),
        ('J2A_PROPERTY("a", "b", "c")\n', "properties.def:1: J2A_PROPERTY takes a key and a value"),
        (
            NAME + 'J2A_PROPERTY("j2a.room", "128")\n',
            'properties.def:2: "j2a.room" is there already',
        ),
        ('J2A_PROPERTY("j2a.selftest", "ok")\n', '"j2a.selftest" is there already'),
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
def test_lists_that_c_takes_are_taken(built, functions):
    assert built(functions=functions).is_file()


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
    # One way to compile the core behind the other.
    [SPEC + NAME, NAME + SPEC, "", NAME, f"// {SPEC}", f'/* "j2a.spec" comes by itself */\n{NAME}'],
)
def test_each_device_has_j2a_spec_once(built, ask, properties):
    read = Frame(c.SOF, 0, 1, bytes([c.BUILTINS.index(c.GET_PROPERTIES), 0, 0, 0, 0, 0]))
    (reply,) = ask(built(properties=properties), encode(read))
    found = PROPERTIES.parse(reply.payload[c.MANY_HEADER :])
    keys = [str(pair.key) for pair in found]
    assert keys.count("j2a.spec") == 1
    assert keys.count("name") == properties.count("name")


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("-DJ2A_WITH_DEBG=0", "there is no option J2A_WITH_DEBG; did you mean J2A_WITH_DEBUG?"),
        ("-DJ2A_RXBUFF=9", "there is no option J2A_RXBUFF; did you mean J2A_RXBUF?"),
        ("-Dj2a_with_sif=0", "there is no option j2a_with_sif; did you mean J2A_WITH_SIF?"),
        ("J2A_WITH_SIF=0", "J2A_WITH_SIF=0 has no -D: give -DNAME=value"),
        ("-D J2A_WITH_SIF=0", "J2A_WITH_SIF=0 has no -D: give -DNAME=value, without a blank"),
        ("-DJ2A_WITH_SIF=0 -DJ2A_PAUS_MS=9", "J2A_PAUS_MS; did you mean J2A_PAUSE_MS?"),
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
