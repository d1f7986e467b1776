"""An opcode is one byte: 255 functions are the most, and one more is an error in C and in C++.

Only an error reaches who builds with the IDE of Arduino, which shows no warnings of libraries.
"""

import subprocess
from pathlib import Path

import pytest

FIRMWARE = Path(__file__).parents[1]
MOST = 255
# A program without options that make errors of warnings, as an IDE compiles it.
CODE = """\
#include "j2a_table.h"

static uint8_t nothing(uint8_t *const length, uint8_t **const payload) {{
    (void)payload;
    *length = 0;
    return 0;
}}
J2A_NAMED(nothing, nothing)
J2A_TABLE_BEGIN
{entries}
J2A_TABLE_END
"""
BUILT_IN = """\
#include "j2a_table.h"
char built_in[J2A_BUILTIN_COUNT];
"""


def compiled(tmp_path: Path, compiler: str, text: str) -> subprocess.CompletedProcess[str]:
    source = tmp_path / ("table.cpp" if compiler.endswith("g++") else "table.c")
    source.write_text(text)
    return subprocess.run(
        [compiler, "-w", "-c", f"-I{FIRMWARE / 'core'}", f"-I{FIRMWARE / 'tests/naive'}", source,
         "-o", tmp_path / "table.o"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip


def built_in(tmp_path: Path) -> int:
    """Return how many functions the core has: the size of an array."""
    assert compiled(tmp_path, "gcc", BUILT_IN).returncode == 0
    listed = subprocess.run(
        ["nm", "-S", tmp_path / "table.o"], capture_output=True, text=True, check=True
    )
    (line,) = (line for line in listed.stdout.splitlines() if line.endswith(" built_in"))
    return int(line.split()[1], 16)


@pytest.mark.requirement("J2A-DISP-001")
@pytest.mark.parametrize("compiler", ["gcc", "g++", "avr-gcc", "avr-g++"])
def test_256_functions_do_not_compile(need, tmp_path: Path, compiler: str) -> None:
    need("gcc")
    need(compiler)
    count = MOST - built_in(tmp_path)
    entry = "J2A_CALL_ENTRY(nothing, nothing)\n"
    done = compiled(tmp_path, compiler, CODE.format(entries=entry * count))
    assert (done.returncode, done.stderr) == (0, "")
    done = compiled(tmp_path, compiler, CODE.format(entries=entry * (count + 1)))
    assert done.returncode != 0
    assert "j2a_functions_are_255_at_most" in done.stderr
