"""The self-test runs before the port is set up: a clock that is not yet there is not read.

A port whose clock divides by what its set-up measures, or lies in a part of the chip that is still
in reset, as that of an RP2040, would stop there.
"""

import subprocess
from pathlib import Path

import pytest

FIRMWARE = Path(__file__).parents[1]
APP = FIRMWARE / "apps/builtins"
# A port of a board: what it does before board_init() is told.
BOARD = """\
#include <stdio.h>
#include "board.h"
#include "j2a.h"

static bool is_set_up;

static void touch(const char *what) {
    if (!is_set_up)
        puts(what);
}
void board_init(void) { is_set_up = true; }
bool board_has_byte(void) { touch("board_has_byte"); return false; }
bool board_lost(void) { touch("board_lost"); return false; }
uint8_t board_read(void) { touch("board_read"); return 0; }
bool board_can_write(void) { touch("board_can_write"); return true; }
void board_write(uint8_t byte) { (void)byte; touch("board_write"); }
uint32_t board_ms(void) { touch("board_ms"); return 0; }
void board_idle(void) { touch("board_idle"); }
void j2a_app_task(void) {}

int main(void) {
    j2a_selftest();
    j2a_port_init(0, 0);
    j2a_task();
    puts("set up");
    return 0;
}
"""


@pytest.mark.parametrize("sync", [0, 1])
def test_the_selftest_calls_nothing_of_a_board(need, sync: int, tmp_path: Path) -> None:
    need("gcc")
    source, program = tmp_path / "board.c", tmp_path / "board"
    source.write_text(BOARD)
    core, common = FIRMWARE / "core", FIRMWARE / "ports/common"
    subprocess.run(
        ["gcc", "-std=c99", "-O1", "-Wall", "-Wextra", "-Wno-overlength-strings", "-Werror",
         f"-I{core}", f"-I{common}", f"-I{FIRMWARE / 'tests/naive'}", f"-I{APP}",
         "-DJ2A_WITH_SELFTEST=1", f"-DJ2A_WITH_SYNC={sync}", *sorted(core.rglob("*.c")),
         common / "board_port.c", source, "-o", program],
        check=True,
    )  # fmt: skip
    done = subprocess.run([program], capture_output=True, text=True, check=True)
    assert done.stdout == "set up\n"
