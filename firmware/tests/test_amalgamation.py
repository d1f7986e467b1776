"""The core in two files is the core: same answers, same size, clean in C and C++."""

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import j2a_transports
import pytest
from j2a_conformance import Verdict, load, run
from j2a_spec import constants as c
from j2a_spec.capabilities import ANNOUNCED
from j2a_spec.grammar import MAPPING
from j2a_spec.oracle import Frame, encode

from tools.conformance import SWEEPS

ROOT = Path(__file__).parents[2]
FIRMWARE = ROOT / "firmware"
TOOL = ROOT / "tools" / "amalgamate.py"
WARNINGS = ["-Wall", "-Wextra", "-Wpedantic", "-Werror", "-Wundef", "-Wno-overlength-strings"]
C99 = ["-std=c99", "-Wmissing-prototypes"]
C_COMPILERS = ("gcc", "clang")
CXX_COMPILERS = ("g++", "clang++")
LISTS = """\
#include "j2a.h"
#ifdef __cplusplus
static
#else
j2a_call_fn my_add;
j2a_many_fn my_log;
#endif
uint8_t my_add(uint8_t *const length, uint8_t **const payload) {
    j2a_put_u32(*payload, j2a_get_u32(*payload) + j2a_get_u32(*payload + 4));
    *length = 4;
    return 0;
}
uint8_t my_log(bool *is_last, bool is_write, uint32_t *const offset, uint8_t *const length,
               uint8_t **const data) {
    (void)is_write;
    (void)data;
    *is_last = true;
    *offset = 77;
    *length = 0;
    return 5;
}
J2A_FUNCTIONS(
    J2A_CALL(add, my_add),
    J2A_MANY(log, my_log),
);
J2A_PROPERTIES(
    J2A_PROPERTY("name", "lists"),
    J2A_PROPERTY("j2a.rxbuf", J2A_TEXT(J2A_RXBUF))
);
int main(int argc, char **argv) {
    j2a_selftest();
    j2a_port_init(argc, argv);
    for (;;) {
        j2a_task();
        j2a_port_idle();
    }
}
"""


def amalgamate(out, *arguments):
    command = [sys.executable, TOOL, "--out", out, *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def compile_(*command, cwd=None):
    words = [str(word) for word in command]
    return subprocess.run(words, capture_output=True, text=True, check=False, cwd=cwd)


def compiled(*command, cwd=None):
    result = compile_(*command, cwd=cwd)
    assert result.returncode == 0, result.stderr
    return result


@pytest.fixture(scope="module")
def two_files(tmp_path_factory):
    """j2a.h, j2a.c and the posix port."""
    out = tmp_path_factory.mktemp("amalgamation")
    result = amalgamate(out, "--port", "posix")
    assert result.returncode == 0, result.stderr
    return out


def with_one_header(text):
    return text.replace('"j2a_functions.h"', '"j2a.h"')


APART = ("transds.h", "j2a_transds_list.h")  # for apps with a transds.def


def test_same_bytes_each_time_and_nothing_left_out(two_files, tmp_path):
    assert amalgamate(tmp_path, "--port", "posix").returncode == 0
    written = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert written == {path.name: path.read_bytes() for path in two_files.iterdir()}
    assert set(written) == {
        *("j2a.h", "j2a.c", "port.c", "j2a_port_config.h", "port.mk"),
        *("crystal.c", "crystal.h", "kept_file.c"),
        *APART,
    }
    everything = (two_files / "j2a.h").read_text() + (two_files / "j2a.c").read_text()
    for path in sorted((FIRMWARE / "core").rglob("*.[ch]")):
        count = everything.count(f"/* ---- {path.relative_to(FIRMWARE)} -")
        assert count == (path.name not in {"a2j.h", *APART}), path.name
    assert (ROOT / "LICENSE").read_text().splitlines()[2] in everything
    assert str(ROOT) not in everything


def test_wrong_arguments_are_refused(tmp_path):
    for arguments, message in (
        (("--port", "vax"), "there is no such port, but"),
        (("--name", "a/b"), "without folder and ending"),
    ):
        result = amalgamate(tmp_path / "out", *arguments)
        assert result.returncode == 2
        assert message in result.stderr
    assert not (tmp_path / "out").exists()


def test_buffers_of_each_port_are_told(tmp_path):
    page = (ROOT / "docs/library.md").read_text()
    for path in FIRMWARE.glob("ports/*/port.mk"):
        assert amalgamate(tmp_path / path.parent.name, "--port", path.parent.name).returncode == 0
        if path.parent.name == "template":
            continue
        (row,) = re.findall(rf"^\| {path.parent.name} \| (\d+).*\| (\d+|none)", page, re.M)
        numbers = dict(re.findall(r"^PORT_([RT]XBUF) := (\d+)$", path.read_text(), re.M))
        assert row == (numbers["RXBUF"], numbers.get("TXBUF", "none"))


@pytest.mark.parametrize("cc", C_COMPILERS)
@pytest.mark.parametrize(
    "options",
    [
        ["-DJ2A_WITH_SELFTEST=1"],
        ["-DJ2A_LINKS=3", "-DJ2A_PORT_LINKS=3", "-DJ2A_ROOM=32", "-DJ2A_WITH_CLOCK=0"],
        ["-DJ2A_WITH_MANY=0", "-DJ2A_WITH_MAPPING=0", "-DJ2A_WITH_SIF=0", "-DJ2A_WITH_DEBUG=0"],
    ],
    ids=" ".join,
)
def test_c_without_a_warning(need, two_files, tmp_path, cc, options):
    need(cc)
    compiled(
        *(cc, *C99, *WARNINGS, "-DJ2A_TICKS_PER_MS=1u", *options),
        *("-c", two_files / "j2a.c", "-o", tmp_path / "j2a.o"),
    )


@pytest.mark.parametrize(
    ("compiler", "standard"),
    [
        *((cc, "c99") for cc in C_COMPILERS),
        *((cxx, f"c++{year}") for cxx in CXX_COMPILERS for year in (11, 20)),
    ],
)
def test_lists_in_c_and_cpp(need, two_files, tmp_path, ask, compiler, standard):
    need(compiler)
    is_c = standard == "c99"
    app = tmp_path / ("app.c" if is_c else "app.cpp")
    app.write_text(LISTS)
    flags = ["-O1", *WARNINGS, f"-I{two_files}", "-DJ2A_RXBUF=300", "-DJ2A_TXBUF=300"]
    flags += ["-DJ2A_WITH_SELFTEST=1"] if compiler == "gcc" else []
    extra = ["-Wmissing-prototypes"] if is_c else []
    compiled(compiler, f"-std={standard}", *flags, *extra, "-c", app, "-o", tmp_path / "app.o")
    program = tmp_path / "program"
    compiled(
        "cc", *flags, two_files / "j2a.c", two_files / "port.c", tmp_path / "app.o", "-o", program
    )
    names = [*c.BUILTINS, "add", "log"]
    many = names.index(c.MANY)
    properties = names.index(c.GET_PROPERTIES)
    listed = b"".join(
        word.encode() + b"\0"
        for word in ("j2a.spec", c.SPEC_VERSION, "name", "lists", "j2a.rxbuf", "300")
    )
    if compiler == "gcc":
        listed += b"j2a.selftest\0ok 319/319 c1536e61\0"
    requests = [
        Frame(c.SOF, 0, 0),
        Frame(c.SOF, 1, names.index("add"), bytes((1, 0, 0, 0, 2, 0, 0, 0))),
        Frame(c.SOF, 2, many, bytes((names.index("log"), 0, 0, 0, 0, 0))),
        Frame(c.SOF, 3, many, bytes((properties, 0, 0, 0, 0, 0))),
    ]
    assert ask(program, b"".join(map(encode, requests))) == [
        Frame(c.SOF, 0, 0, MAPPING.build(names)),
        Frame(c.SOF, 1, 0, bytes((3, 0, 0, 0))),
        Frame(c.SOF, 2, 0, bytes((5, c.FLAG_LAST, 77, 0, 0, 0))),
        Frame(c.SOF, 3, 0, bytes((0, c.FLAG_LAST, 0, 0, 0, 0)) + listed),
    ]


@pytest.mark.parametrize(
    ("compiler", "standard"),
    [("gcc", "c99"), ("g++", "c++11"), ("clang", "c99"), ("clang++", "c++11")],
)
def test_without_many_its_functions_have_no_opcode(
    need, two_files, tmp_path, ask, compiler, standard
):
    need(compiler)
    app = tmp_path / ("app.c" if standard == "c99" else "app.cpp")
    # The name of 180 bytes would leave the others no room, if it counted.
    text = LISTS.replace("J2A_CALL(add,", f"J2A_MANY({'n' * 180}, my_log), J2A_CALL(add,")
    # A static one must not count as unused.
    text = text.replace("j2a_many_fn my_log;\n", "").replace(
        "uint8_t my_log", "static uint8_t my_log"
    )
    app.write_text(text)
    flags = ["-O1", *WARNINGS, f"-I{two_files}", "-DJ2A_WITH_MANY=0"]
    compiled(compiler, f"-std={standard}", *flags, "-c", app, "-o", tmp_path / "app.o")
    program = tmp_path / "program"
    compiled(
        "cc", *flags, two_files / "j2a.c", two_files / "port.c", tmp_path / "app.o", "-o", program
    )
    names = [*(name for name in c.BUILTINS if name not in c.WITH_MANY), "add"]
    assert "my_log" not in compiled("nm", program).stdout
    requests = [
        Frame(c.SOF, 0, 0),
        Frame(c.SOF, 1, names.index("add"), bytes((1, 0, 0, 0, 2, 0, 0, 0))),
        Frame(c.SOF, 2, len(names)),
    ]
    assert ask(program, b"".join(map(encode, requests))) == [
        Frame(c.SOF, 0, 0, MAPPING.build(names)),
        Frame(c.SOF, 1, 0, bytes((3, 0, 0, 0))),
        Frame(c.SOF, 2, c.ERR_OPCODE, bytes((c.SITE_OPCODE, 0))),
    ]


@pytest.mark.parametrize(
    ("functions", "properties", "message"),
    [
        ("J2A_CALL(add, my_log)", "", ("conflicting types", "j2a_needs_a_call")),
        ("J2A_MANY(add, my_add)", "", ("conflicting types", "j2a_needs_a_many")),
        ("J2A_CALL(, my_add)", "", ("j2a_name_is_empty",) * 2),
        ("J2A_CALL(a2jEcho, my_add)", "", ("j2a_name_a2jEcho",) * 2),
        (f"J2A_CALL({'n' * 187}, my_add)", "", ("j2a_names_longer_than_a_payload",) * 2),
        ("", 'J2A_PROPERTY("", "value")', ("j2a_property_is_empty",) * 2),
        ("", 'J2A_PROPERTY("key", "")', ("j2a_property_is_empty",) * 2),
    ],
)
def test_wrong_lists_do_not_compile(need, two_files, tmp_path, functions, properties, message):
    head, _, tail = LISTS.partition("J2A_FUNCTIONS(")
    tail = tail[tail.index("int main") :]
    text = f"{head}J2A_FUNCTIONS({functions});\nJ2A_PROPERTIES({properties});\n{tail}"
    for compiler, name, expected in zip(("gcc", "g++"), ("a.c", "a.cpp"), message, strict=True):
        need(compiler)
        (tmp_path / name).write_text(text)
        result = compile_(compiler, f"-I{two_files}", "-c", tmp_path / name, "-o", tmp_path / "a.o")
        assert result.returncode != 0
        assert expected in result.stderr


def test_as_many_items_as_promised(need, two_files, tmp_path, ask):
    need("cc")
    properties = [f'J2A_PROPERTY("k{i}", "{i}")' for i in range(64)]
    text = LISTS[: LISTS.index("J2A_PROPERTIES(")] + "J2A_PROPERTIES(%s);\n"
    text += LISTS[LISTS.index("int main") :]
    app = tmp_path / "app.c"
    command = ("cc", "-O1", "-DJ2A_TXBUF=300", f"-I{two_files}", app)
    command += (two_files / "j2a.c", two_files / "port.c", "-o", tmp_path / "app")
    app.write_text(text % ", ".join(properties))
    compiled(*command)
    index = c.BUILTINS.index(c.GET_PROPERTIES)
    request = Frame(c.SOF, 1, c.BUILTINS.index(c.MANY), bytes((index, 0, 0, 1, 0, 0)))
    listed = b"j2a.spec\0" + c.SPEC_VERSION.encode() + b"\0"
    listed += b"".join(b"k%d\0%d\0" % (i, i) for i in range(64))
    reply = bytes((0, c.FLAG_LAST, 0, 1, 0, 0)) + listed[256:]
    assert ask(tmp_path / "app", encode(request)) == [Frame(c.SOF, 1, 0, reply)]
    app.write_text(text % ", ".join([*properties, 'J2A_PROPERTY("last", "1")']))
    assert compile_(*command).returncode != 0


@pytest.mark.parametrize("left_out", [SWEEPS, pytest.param((), marks=pytest.mark.exhaustive)])
def test_demo_with_def_files_is_conformant(need, two_files, tmp_path, left_out):
    """Without the sweeps, which testees of the same sources have."""
    need("cc")
    for path in (FIRMWARE / "apps/demo").iterdir():
        (tmp_path / path.name).write_text(with_one_header(path.read_text()))
    (tmp_path / "main.c").write_text((FIRMWARE / "apps/main.c").read_text())
    program = tmp_path / "demo"
    compiled(
        *("cc", *C99, *WARNINGS, "-O2", "-DJ2A_DEF_FILES=1", f"-I{two_files}", f"-I{tmp_path}"),
        *("-DJ2A_RXBUF=4096", "-DJ2A_TXBUF=4096", "-DJ2A_DEBUGBUF=1024"),
        *("-DDEMO_STORE_BYTES=2097152", tmp_path / "app.c", tmp_path / "main.c"),
        *(two_files / "j2a.c", two_files / "port.c", "-o", program),
    )
    levels = {"timing", *ANNOUNCED}
    cases = [
        case
        for case in load()
        if case.LEVEL not in levels and not case.ID.startswith("scenario")
        if case.ID not in left_out
    ]
    url = f"exec:{program}"
    found = run(lambda: j2a_transports.open(url), cases, url=url)
    failed = [(r.case, r.reason) for r in found.with_verdict(Verdict.FAILED)]
    assert found.conformant, failed
    seen = {r.case: r.verdict for r in found.results if r.verdict is not Verdict.OK}
    assert set(seen) <= {
        *("limits.overrun", "limits.cut-frame", "limits.room", "properties.selftest"),
        "many.return-values",  # of a function that the demo does not have
    }


def words(make, port, out):
    """How the Makefile compiles and links the builtins for a port, as words without the files."""
    lines = make("-n", "-B", PORT=port, APP="builtins", OUT=out).stdout.splitlines()
    compiles = next(line for line in lines if " -c -o " in line and line.endswith("/j2a_rx.c"))
    links = next(line for line in lines if f" -o {out}/builtins.elf " in line)
    drop = ("-Icore", "-Iports/", "-MMD", "-MP")
    compile_words = shlex.split(compiles[: compiles.index(" -c -o ")])
    link_words = shlex.split(links[: links.index(f" -o {out}/")])
    return [word for word in compile_words if not word.startswith(drop)], link_words


def size(tool, image):
    """Bytes of flash and of RAM."""
    text, data, bss = map(int, compiled(tool, image).stdout.splitlines()[1].split()[:3])
    return text + data, data + bss


# Without link-time optimisation (Cortex-M) the compiler sees more at once in one file.
@pytest.mark.avr
@pytest.mark.parametrize(
    ("port", "prefix", "smaller"), [("avr-serial", "avr-", 8), ("cortex-m", "arm-none-eabi-", 110)]
)
def test_other_chips_and_their_size(need, make, tmp_path, port, prefix, smaller):
    need(f"{prefix}gcc")
    out = tmp_path / "split"
    assert make(PORT=port, APP="builtins", OUT=out).returncode == 0
    split = size(f"{prefix}size", out / "builtins.elf")
    compile_words, link_words = words(make, port, out)
    folder = tmp_path / "one"
    assert amalgamate(folder, "--port", port).returncode == 0
    for path in (FIRMWARE / "apps/main.c", FIRMWARE / "apps/builtins/app.c"):
        shutil.copy(path, folder)
    compile_words += [f"-I{folder}", "-DJ2A_DEF_FILES=1"]
    objects = []
    for path in sorted([*folder.glob("*.c"), *folder.glob("*.S")]):
        objects.append(folder / f"{path.name}.o")
        compiled(*compile_words, "-c", path, "-o", objects[-1], cwd=FIRMWARE)
    image = folder / "builtins.elf"
    compiled(*link_words, *objects, "-o", image, cwd=FIRMWARE)
    one = size(f"{prefix}size", image)
    assert split[0] - smaller <= one[0] <= split[0] + 8
    assert abs(one[1] - split[1]) <= 8
