"""What compilers make of it: gcc and clang, -O0 to -O3 and -Os, every warning an error.

Compiling is half of it: each image then runs the golden vectors of the specification through its
own parser and sender, which is where an optimiser that was led astray would show.
"""

from collections.abc import Callable
from pathlib import Path

import pytest

from j2a import connect

LEVELS = ("-O0", "-O1", "-O2", "-O3", "-Os")
# Beyond those of the Makefile: what a user's project may switch on.
STRICT = (
    "-Wconversion -Wsign-conversion -Wshadow -Wcast-qual -Wstrict-prototypes -Wwrite-strings -Wvla"
)


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("cc", ["gcc", "clang"])
def test_every_level_passes_the_golden_vectors(
    build: Callable[..., Path], cc: str, level: str
) -> None:
    program = build("selftest", CC=cc, CFLAGS=f"{level} {STRICT}")
    with connect(f"exec:{program}") as board:
        result = board.properties["j2a.selftest"]
    assert result.startswith("ok 299/299 "), result


@pytest.mark.parametrize("level", LEVELS)
def test_every_level_compiles_for_the_avr(build: Callable[..., Path], level: str) -> None:
    assert build("demo", port="avr-serial", CFLAGS=f"{level} -Wconversion -Wshadow").is_file()
