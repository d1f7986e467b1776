"""Typed functions of C++: what J2A_FUNCTION of a list deduces, by its bytes and by its description.

In: tests/deduced/app.cpp with the core in two files, as a user compiles them. Out: replies byte by
byte, the interface, and what the compilers say of mistakes.
"""

import struct
import subprocess
from functools import cache
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from j2a_spec import constants as c
from j2a_spec.oracle import Frame, encode

FIRMWARE = Path(__file__).parents[1]
ROOT = FIRMWARE.parent
APP = FIRMWARE / "tests/deduced/app.cpp"
TEXT = (FIRMWARE / "tests/deduced/interface.txt").read_text("utf-8")
NAMES = [line.replace("(", " ").split()[0] for line in TEXT.partition("\n\n")[2].splitlines()]
OPCODE = {name: opcode for opcode, name in enumerate(NAMES)}
ROOM = c.MAX_PAYLOAD - c.MANY_HEADER
WARNINGS = ["-Wall", "-Wextra", "-Wundef", "-Werror"]
SANITIZED = ["-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
EIGHT = struct.pack("<?bHiQfdB", True, -128, 65535, -(2**31), 2**64 - 1, 1.5, -1e300, 255)


@pytest.fixture(scope="module")
def two_files(tmp_path_factory, tool):
    out = tmp_path_factory.mktemp("deduced")
    tool("amalgamate.py", "--out", out, "--port", "posix")
    return out


@pytest.fixture(scope="module")
def core(two_files, tmp_path_factory):
    """Compile the core as C with these flags, each once; returns the objects."""

    @cache
    def compiled(*flags):
        out = tmp_path_factory.mktemp("core")
        for name in ("j2a", "port"):
            command = ["gcc", "-std=gnu99", *flags, "-c", two_files / f"{name}.c"]
            subprocess.run([*command, "-o", out / f"{name}.o"], check=True, capture_output=True)
        return [out / "j2a.o", out / "port.o"]

    return compiled


@pytest.fixture(scope="module")
def compile_app(two_files, core):
    """Compile the app as C++ with the core; returns what the compiler of the app said."""

    def compiled(out, compiler="g++", standard="c++11", options=("-O1",)):
        flags = ["-DJ2A_RXBUF=255", "-DJ2A_TXBUF=0", f"-I{two_files}", *options]
        if "-DJ2A_WITH_INTERFACE=0" not in options:
            flags.append("-DJ2A_WITH_INTERFACE=1")
        command = [compiler, f"-std={standard}", *WARNINGS, *flags, APP, *core(*flags)]
        return subprocess.run(
            [*command, "-o", out / "app"], capture_output=True, text=True, check=False
        )

    return compiled


@pytest.fixture(scope="module")
def program(compile_app, tmp_path_factory, need):
    need("g++")
    out = tmp_path_factory.mktemp("app")
    result = compile_app(out, options=SANITIZED)
    assert result.returncode == 0, result.stderr
    return out / "app"


@pytest.fixture
def call(program, ask):
    """Send requests, given as (function, payload); returns all frames."""

    def run(*requests):
        frames = [Frame(c.SOF, i % 256, OPCODE[n], data) for i, (n, data) in enumerate(requests)]
        return ask(program, b"".join(map(encode, frames)))

    return run


def test_interface_is_what_the_functions_are(program, ask):
    requests = [
        bytes([OPCODE["a2jGetInterface"], 0]) + struct.pack("<I", i * ROOM) for i in range(10)
    ]
    frames = ask(program, b"".join(encode(Frame(c.SOF, 0, 1, request)) for request in requests))
    assert b"".join(frame.payload[c.MANY_HEADER :] for frame in frames).decode() == TEXT


# Function, request, reply.
CALLS = [
    ("bools", b"\0", b"\0"),
    ("bools", b"\1", b"\1"),
    ("bools", b"\x80", b"\1"),
    ("u8s", b"\xfe", b"\xfe"),
    ("u16s", b"\x01\xf2", b"\x01\xf2"),
    ("u32s", b"\x01\x02\x03\xf4", b"\x01\x02\x03\xf4"),
    ("u64s", bytes(range(0xF1, 0xF9)), bytes(range(0xF1, 0xF9))),
    ("i8s", b"\x80", b"\x80"),
    ("i16s", b"\x01\x80", b"\x01\x80"),
    ("i32s", b"\x01\x02\x03\x84", b"\x01\x02\x03\x84"),
    ("i64s", bytes(range(0xF1, 0xF9)), bytes(range(0xF1, 0xF9))),
    ("f32s", struct.pack("<f", -1.5e30), struct.pack("<f", -1.5e30)),
    ("f64s", struct.pack("<d", 1e-300), struct.pack("<d", 1e-300)),
    ("modes", b"\1", b"\1"),
    ("levels", struct.pack("<h", -300), struct.pack("<h", -300)),
    ("doors", b"\2", b"\1"),
    ("texts", b"", b""),
    ("texts", b"h\xc3\xa9llo", b"h\xc3\xa9llo"),
    ("texts", b"x" * 254, b"x" * 254),
    ("missing", b"\0", b""),
    ("missing", b"\1", b"x"),
    ("missing", b"\xfe", b"x" * 254),
    ("divide", struct.pack("<ii", -9, 2), struct.pack("<i", -4)),
    ("split", struct.pack("<i", -2), struct.pack("<Bi?", 254, -1, True)),
    ("greet", struct.pack("<BH", 2, 1) + b"Bob", b"BobBob"),
    ("greet", struct.pack("<BH", 1, 1), b""),
    ("greet", struct.pack("<BH", 1, 1) + b"y" * 249, b"y" * 249),
    ("greet", struct.pack("<BH", 1, 0) + b"y" * 252, b""),
    ("eight", EIGHT, EIGHT),
]


def test_values_go_there_and_back(call):
    replies = call(*[(name, request) for name, request, _ in CALLS])
    expected = [Frame(c.SOF, i, 0, reply) for i, (_, _, reply) in enumerate(CALLS)]
    assert replies == expected


@given(st.data())
def test_any_bytes_of_a_number_come_back(call, data):
    sizes = {"u8s": 1, "i16s": 2, "u32s": 4, "i32s": 4, "u64s": 8, "i64s": 8, "levels": 2}
    name = data.draw(st.sampled_from(sorted(sizes)))
    value = data.draw(st.binary(min_size=sizes[name], max_size=sizes[name]))
    assert call((name, value)) == [Frame(c.SOF, 0, 0, value)]


def test_results_by_reference_and_arrays(call):
    values = struct.pack("<3h", -1, 2, 30000)
    first, second = call(("reverse", values), ("reverse", values))
    assert first.payload == struct.pack("<3hB", 30000, 2, -1, 1)
    assert second.payload == struct.pack("<3hB", 30000, 2, -1, 2)


def test_wrong_lengths_are_refused_and_nothing_is_executed(call):
    fixed = {"reverse": 6, "nothing": 0, "eight": len(EIGHT), "split": 4, "greet": None}
    requests = [("nothing", b"x" * n) for n in (1, 2, 255)]
    for name, size in fixed.items():
        lengths = (0, 1, 2) if size is None else (0, 1, size - 1, size + 1, 255)
        requests += [(name, bytes(n)) for n in lengths if n != size and n >= 0]
    requests += [("texts", b"x" * 255), ("count", b"")]
    *refused, count = call(*requests)
    assert [(frame.opcode, frame.payload) for frame in refused] == [(0xFF, b"")] * len(refused)
    assert (count.opcode, count.payload) == (0, b"\0")


def test_failures_have_their_code_and_no_results(call):
    requests = [("divide", struct.pack("<ii", 1, 0)), ("missing", b"\xff")]
    requests += [("refuse", bytes([code])) for code in (0, 1, 0xEF, 0xF0, 0xFF)]
    requests += [("divide", struct.pack("<ii", 6, 3))]
    *failed, last = call(*requests)
    assert [frame.opcode for frame in failed] == [7, 0xFF, 0xFF, 1, 0xEF, 0xFF, 0xFF]
    assert {frame.payload for frame in failed} == {b""}
    assert (last.opcode, last.payload) == (0, struct.pack("<i", 2))


def test_results_that_are_not_set_are_zero(call):
    replies = call(("eight", EIGHT), ("untouched", b"\xff" * 4), ("reverse", bytes(6)))
    assert replies[1].payload == bytes(4 + 6)


def test_sifs_carry_their_fields(call):
    frames = call(("send", struct.pack("<IhBB", 2**32 - 2, -5, 8, 9)))
    assert frames == [
        Frame(c.SOS, 0, 32, struct.pack("<Ih", 2**32 - 2, -5)),
        Frame(c.SOS, 1, 255, b"\x08\x09"),
        Frame(c.SOS, 2, 7, b""),
        Frame(c.SOF, 0, 0, b""),
    ]


def test_memory_is_written_and_read(call):
    def many(name, offset, data=None, flags=0):
        flags |= 0 if data is None else c.FLAG_WRITE
        head = bytes([OPCODE[name], flags]) + struct.pack("<I", offset)
        return ("a2jMany", head + (data or b""))

    words = struct.pack("<200h", *range(-100, 100))
    replies = call(
        many("memory", 0, b"a" * 249),
        many("memory", 249, b"b" * 51, c.FLAG_LAST),
        many("memory", 249, b"c" * 52),
        many("memory", 0),
        many("memory", 249),
        many("curve", 0, words[:249]),
        many("curve", 249, words[249:], c.FLAG_LAST),
        many("curve", 249),
    )
    assert [reply.payload[0] for reply in replies] == [0, 0, 0xFF, 0, 0, 0, 0, 0]
    assert replies[3].payload[c.MANY_HEADER :] == b"a" * 249
    assert replies[4].payload[1:2] == bytes([c.FLAG_LAST])
    assert replies[4].payload[c.MANY_HEADER :] == b"b" * 51
    assert replies[7].payload[c.MANY_HEADER :] == words[249:]


OPTIONS = [
    ("g++", "c++11", "-DJ2A_WITH_INTERFACE=0"),
    ("g++", "c++11", "-DJ2A_WITH_INTERFACE=0 -DJ2A_WITH_MAPPING=0"),
    ("g++", "c++11", "-DJ2A_WITH_INTERFACE=0 -DJ2A_WITH_MANY=0"),
    pytest.param("g++", "c++17", "", marks=pytest.mark.exhaustive),  # between two others
    ("g++", "c++20", ""),
    ("clang++", "c++11", ""),
    ("clang++", "c++20", ""),
]


@pytest.mark.parametrize(("compiler", "standard", "options"), OPTIONS)
def test_compilers_and_options(compile_app, tmp_path, need, compiler, standard, options):
    need(compiler)
    level = "-O1" if compiler == "g++" else "-O0"  # Clang warns of what it parses, at any level
    result = compile_app(tmp_path, compiler, standard, [level, *options.split()])
    assert result.returncode == 0, result.stderr


MISTAKES = [
    ("int f(int a) { return a; }", 'J2A_FUNCTION(f, "Doc.")', "f: as many names as parameters"),
    (
        "int f(int a) { return a; }",
        'J2A_FUNCTION(f, "a b: Doc.")',
        "f: as many names as parameters",
    ),
    ("int f() { return 0; }", 'J2A_FUNCTION(f, "Note: doc.")', "f: as many names as parameters"),
    (
        "int f(int a, int b) { return a + b; }",
        'J2A_FUNCTION(f, "a a: Doc.")',
        "f: two parameters have the same name",
    ),
    ("int f(int a) { return a; }", 'J2A_FUNCTION(f, "2a: Doc.")', "f: a name is letters"),
    ("int f(int a) { return a; }", 'J2A_FUNCTION(f, "a-b: Doc.")', "f: a name is letters"),
    ("int f(int a) { return a; }", f'J2A_FUNCTION(f, "{"a" * 33}: Doc.")', "f: a name is letters"),
    ("int f(int a) { return a; }", 'J2A_FUNCTION(f, "a.b: Doc.")', "f: a name is letters"),
    (
        "int f(int a) { return a; }",
        f'J2A_FUNCTION(f, "a({"m" * 33}): Doc.")',
        "f: a name is letters",
    ),
    (
        "int f(int a, int b, int c) { return a + b + c; }",
        'J2A_FUNCTION(f, "a b b: Doc.")',
        "f: two parameters have the same name",
    ),
    ("int f(int a) { return a; }", 'J2A_FUNCTION(f, "a(): Doc.")', "f: a name is letters"),
    ("int f() { return 0; }", 'J2A_FUNCTION(f, "Doc\\x7f.")', "f: a text is one line"),
    ("int f(int a) { return a; }", 'J2A_FUNCTION(f, "a(m s): Doc.")', "f: a name is letters"),
    ("int f(int a) { return a; }", 'J2A_FUNCTION(f, "a(m: Doc.")', "f: a name is letters"),
    ("int f(int a) { return a; }", 'J2A_FUNCTION(f, "a(m)s: Doc.")', "f: a name is letters"),
    ("int f(int a) { return a; }", 'J2A_FUNCTION(f, "a !slow(0): Doc.")', "f: flags are"),
    ("int f(int a) { return a; }", 'J2A_FUNCTION(f, "a !slow(65536): Doc.")', "f: flags are"),
    ("int f(int a) { return a; }", 'J2A_FUNCTION(f, "a !fast: Doc.")', "f: flags are"),
    (
        "int f() { return 0; }",
        'J2A_FUNCTION(f, "!slow(1) !slow(2) !slow(3): Doc.")',
        "f: flags are",
    ),
    ("void f(int a) { (void)a; }", 'J2A_FUNCTION(f, "a -> mV: Doc.")', "f: behind -> comes"),
    ("int f(int a) { return a; }", 'J2A_FUNCTION(f, "a ->: Doc.")', "f: behind -> comes"),
    ("int f(int a) { return a; }", 'J2A_FUNCTION(f, "a ->mV: Doc.")', "f: behind -> comes"),
    ("int f(int a) { return a; }", 'J2A_FUNCTION(f, "a: One\\ntwo.")', "f: a text is one line"),
    ("void *f() { return 0; }", 'J2A_FUNCTION(f, "Doc.")', "J2A cannot send this type"),
    ("void f(int *a) { *a = 1; }", 'J2A_FUNCTION(f, "a: Doc.")', "J2A cannot send this type"),
    (
        "struct S { int a; }; void f(S s) { (void)s; }",
        'J2A_FUNCTION(f, "s: Doc.")',
        "J2A cannot send this type",
    ),
    ("int f(int &a) { return a; }", 'J2A_FUNCTION(f, "a: Doc.")', "not both"),
    (
        "void f(const char *a, int b) { (void)a, (void)b; }",
        'J2A_FUNCTION(f, "a b: Doc.")',
        "a text is the last",
    ),
    (
        "void f(const uint64_t (&a)[32]) { (void)a; }",
        'J2A_FUNCTION(f, "a: Doc.")',
        "longer than",
    ),
    ("int f;", 'J2A_FUNCTION(f, "Doc.")', "this is no plain function"),
    ("int f() { return 0; }", "J2A_CALL(f, f)", "j2a_needs_a_call"),
    ("int f() { return 0; }", 'J2A_FUNCTION(f, ""), J2A_FUNCTION(f, "")', "j2a_name_f"),
    ("int f;", 'J2A_BUFFER(f, "Doc.")', "this is no array"),
    ("void *f[2];", 'J2A_BUFFER(f, "Doc.")', "J2A cannot send this type"),
    ("bool f[2];", 'J2A_BUFFER(f, "Doc.")', "J2A_BUFFER: no bool"),
    ("int f;", 'J2A_SIF(f, "Doc.")', "this is no j2a::sif"),
    ("j2a::sif<1, int> f;", 'J2A_SIF(f, "Doc.")', "f: as many names as parameters"),
    ("j2a::sif<1> f, g;", 'J2A_SIF(f, ""), J2A_SIF(g, "")', "duplicate case value"),
    ("int f() { return 0; }", f'J2A_FUNCTION(f, "{"x" * 500}")', "f: a text is shorter than 500"),
    ("j2a::sif<300> f;", 'J2A_SIF(f, "")', "an opcode is 0 to 255"),
    ("j2a::sif<1> f;", 'J2A_SIF(f, "!idempotent: Doc.")', "f: a SIF has no flags"),
    (
        f"j2a::sif<1> {'f' * 33};",
        f'J2A_SIF({"f" * 33}, "Doc.")',
        "the name of a SIF has at most 32",
    ),
    ("j2a::sif<1, const char *> f;", 'J2A_SIF(f, "a: Doc.")', "fields are numbers"),
]


@pytest.mark.parametrize(
    ("compiler", "before", "item", "message"),
    [
        # What is told is the header's; of what the other compiler makes of it, one in four is seen.
        pytest.param(
            compiler, *mistake, marks=pytest.mark.exhaustive if at % 4 and compiler != "g++" else []
        )
        for compiler in ("g++", "clang++")
        for at, mistake in enumerate(MISTAKES)
    ],
)
def test_mistakes_are_told(two_files, tmp_path, need, compiler, before, item, message):
    need(compiler)
    source = tmp_path / "app.cpp"
    source.write_text(f'#include "j2a.h"\n{before}\nJ2A_FUNCTIONS({item});\nJ2A_PROPERTIES();\n')
    command = [compiler, "-std=c++11", "-DJ2A_RXBUF=255", "-DJ2A_TXBUF=0", f"-I{two_files}"]
    command += ["-DJ2A_WITH_INTERFACE=1", "-fsyntax-only", str(source)]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode != 0
    assert message in result.stderr, result.stderr


@pytest.mark.parametrize("compiler", ["g++", "clang++"])
def test_text_may_have_499_bytes(two_files, tmp_path, need, compiler):
    need(compiler)
    source = tmp_path / "app.cpp"
    source.write_text(
        f'#include "j2a.h"\nint f(int a) {{ return a; }}\n'
        f'J2A_FUNCTIONS(J2A_FUNCTION(f, "a:{"x" * 497}"));\nJ2A_PROPERTIES();\n'
    )
    command = [compiler, "-std=c++11", "-DJ2A_RXBUF=255", "-DJ2A_TXBUF=0", f"-I{two_files}"]
    command += ["-DJ2A_WITH_INTERFACE=1", "-fsyntax-only", str(source)]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr


@pytest.mark.parametrize(
    "properties",
    [
        'J2A_PROPERTY("a", "1"), J2A_PROPERTY("b", "2"), J2A_PROPERTY("a", "3")',
        'J2A_PROPERTY("a", "1"), J2A_PROPERTY("b", "2"), J2A_PROPERTY("b", "3")',
        'J2A_PROPERTY("j2a.spec", "1.1")',
        'J2A_PROPERTY("a", "1"), J2A_PROPERTY("j2a.interface", "0")',
        'J2A_PROPERTY("j2a.room", "128"), J2A_PROPERTY("a", "1")',
        'J2A_PROPERTY("j2a.selftest", "ok")',
    ],
)
@pytest.mark.parametrize("compiler", ["g++", "clang++"])
def test_a_key_that_comes_twice_is_told(two_files, tmp_path, need, compiler, properties):
    need(compiler)
    source = tmp_path / "app.cpp"
    source.write_text(f'#include "j2a.h"\nJ2A_FUNCTIONS();\nJ2A_PROPERTIES({properties});\n')
    command = [compiler, "-std=c++11", "-DJ2A_RXBUF=255", "-DJ2A_TXBUF=0", f"-I{two_files}"]
    result = subprocess.run(
        [*command, "-fsyntax-only", str(source)], capture_output=True, text=True, check=False
    )
    assert result.returncode != 0
    assert "a key comes twice" in result.stderr
