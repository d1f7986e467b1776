"""The types that ctypes passes are those of the C headers, and these are those of the functions."""

import ctypes
import re
import shutil
from pathlib import Path

import j2a_sim
import pytest
from j2a_sim import SimError, _build
from j2a_sim._prototypes import PrototypeError, parse

PACKAGE = Path(j2a_sim.__file__).parent
DECLARED = {
    name: types
    for header in _build._HEADERS
    for name, types in parse((PACKAGE / "chip" / header).read_text("utf-8")).items()
}
BOARD = parse((PACKAGE / "_clocks/board/board.h").read_text("utf-8"))


def test_types_of_the_headers():
    pointer, number, text = ctypes.c_void_p, ctypes.c_int, ctypes.c_char_p
    u8, u32, u64 = ctypes.c_uint8, ctypes.c_uint32, ctypes.c_uint64
    assert DECLARED["sim_new"] == (
        pointer,
        [
            *(text, u32, ctypes.c_char, ctypes.c_double),
            *(text, u32, u32, text, text, ctypes.c_size_t),
        ],
    )
    assert DECLARED["sim_free"] == (None, [pointer])
    assert DECLARED["sim_data"] == (pointer, [pointer])
    assert DECLARED["sim_log"] == (text, [pointer])
    assert DECLARED["sim_take_out"] == (
        None,
        [pointer, u32, ctypes.POINTER(u8), ctypes.POINTER(u64)],
    )
    assert DECLARED["usb_host_submit"] == (
        number,
        [pointer, number, number, number, ctypes.c_uint, text, text, u32, number],
    )


def test_all_that_python_calls_is_declared():
    """ctypes would take an int for every result and argument of another function."""
    sources = "\n".join(path.read_text("utf-8") for path in PACKAGE.rglob("*.py"))
    called = set(re.findall(r"(?:\b|_)lib\.(\w+)\(", sources))
    assert {"sim_new", "usb_host_submit", "board_run", "board_start"} <= called
    assert called <= DECLARED.keys() | BOARD.keys()


@pytest.mark.avr
@pytest.mark.parametrize(
    ("header", "declared", "changed"),
    [
        ("simavr_shim.h", "uint64_t sim_cycle(const sim_t *)", "uint32_t sim_cycle(const sim_t *)"),
        (
            "simavr_shim.h",
            "uint64_t cycle, int pin, int level",
            "int pin, uint64_t cycle, int level",
        ),
        ("simavr_shim.h", "sim_pin(const sim_t *, char port", "sim_pin(const sim_t *"),
        (
            "usb_host.h",
            "usb_host_cancel(usb_host_t *, int id",
            "usb_host_cancel(usb_host_t *, char id",
        ),
    ],
    ids=["result", "order", "count", "type"],
)
def test_a_header_that_differs_does_not_compile(monkeypatch, tmp_path, header, declared, changed):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    chip = tmp_path / "chip"
    # The headers, and the source that defines what is declared.
    others = {path.name for path in _build._CHIP.glob("*.c")} - {Path(header).stem + ".c"}
    shutil.copytree(_build._CHIP, chip, ignore=shutil.ignore_patterns(*others))
    text = (chip / header).read_text("utf-8")
    assert text.count(declared) == 1
    (chip / header).write_text(text.replace(declared, changed), "utf-8")
    monkeypatch.setattr(_build, "_CHIP", chip)
    with pytest.raises(SimError, match="conflicting types"):
        _build.build()


def test_what_is_no_function_is_left_out():
    header = """
        #include <stdint.h> /* int f(void); */
        #define TWO_LINES int \\
            g(void);
        enum { A, B };
        typedef struct { int (*call)(void *); struct { int x; } inner; } sim_t;
        void h(void);
    """
    assert parse(header) == {"h": (None, [])}


@pytest.mark.parametrize(
    ("declaration", "message"),
    [
        ("int f(long x);", "no counterpart in ctypes here: long"),
        ("int f(int **x);", "no argument of a type that is known: int \\*\\*x"),
        ("int f(int x[2]);", "no argument of a type that is known"),
        ("uint16_t f(void);", "no counterpart in ctypes here: uint16_t"),
        ("int f(other_t *x);", "no counterpart in ctypes here: other_t \\*"),
        ("int f(sim_t x);", "no counterpart in ctypes here: sim_t"),
        ("int f(int (*call)(int));", "no prototype of a function"),
        ("extern int x;", "no prototype of a function: extern int x"),
    ],
)
def test_what_is_not_understood_is_an_error(declaration, message):
    with pytest.raises(PrototypeError, match=message):
        parse(declaration)
