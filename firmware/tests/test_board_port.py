"""The port that the boards share (ports/common/board_port.c), on a board of which all is known.

That board has received all of its input when the program starts, and the program ends in the first
call of board_idle().
"""

import subprocess
from pathlib import Path

import pytest
from j2a_spec import constants as c
from j2a_spec.oracle import Frame, decode, encode

FIRMWARE = Path(__file__).parents[1]
BOARD = """
#include <stdio.h>
#include <stdlib.h>

#include "board.h"

static uint8_t input[4096];
static size_t next, used;

void board_init(void) {
    used = fread(input, 1, sizeof input, stdin);
}
bool board_has_byte(void) {
    static bool has;
    has = !has && next < used; /* one by one, or all would be lost together */
    return has;
}
bool board_lost(void) {
    return next == (size_t)LOST_BEFORE;
}
uint8_t board_read(void) {
    return input[next++];
}
bool board_can_write(void) {
    return true;
}
void board_write(uint8_t byte) {
    putchar(byte);
}
uint32_t board_ms(void) {
    return 0;
}
void board_idle(void) {
    exit(EXIT_SUCCESS);
}
"""
CONFIG = """
#define J2A_PORT_NAME "at-once"
#define J2A_TICKS_PER_MS 1u
#define BOARD_INTERRUPTS 0
"""
PORT = """
PORT_SOURCES := ports/common/board_port.c
PORT_RXBUF := 64
"""
ECHO = [name for name in c.BUILTINS if name != c.GET_DEBUG].index(c.GET_ECHO)  # as in that app
REQUESTS = [Frame(c.SOF, seq, ECHO, b"0123456") for seq in range(40)]


@pytest.fixture
def port(need, tmp_path):
    need("cc")
    folder = tmp_path / "port"
    folder.mkdir()
    for name, text in (("board.c", BOARD), ("j2a_port_config.h", CONFIG), ("port.mk", PORT)):
        (folder / name).write_text(text)
    return folder


@pytest.fixture
def ask(make, port, tmp_path):
    """Build the built-ins; returns what has been answered when the board is idle."""

    def run(lost_before=-1):
        options = f"-DLOST_BEFORE={lost_before}"
        variables = {"PORT_DIR": port, "APP": "builtins", "OUT": tmp_path}
        result = make(core_as_one=True, OPTIONS=options, **variables)
        assert result.returncode == 0, result.stderr
        data = b"".join(map(encode, REQUESTS))
        return decode(
            subprocess.run(
                [tmp_path / "builtins"], input=data, capture_output=True, check=True, timeout=60
            ).stdout
        )

    return run


def test_is_not_idle_while_requests_wait(ask):
    """A board may sleep when it is idle, and each request would wait for the end of a sleep."""
    assert ask() == [Frame(c.SOF, frame.seq, c.ECHO, frame.payload) for frame in REQUESTS]


def test_is_not_idle_before_a_loss_is_known(ask):
    """Until then all bytes are dropped, and a sleep would make them more."""
    answers = [Frame(c.SOF, frame.seq, c.ECHO, frame.payload) for frame in REQUESTS]
    got = ask(lost_before=2 * len(encode(REQUESTS[0])))
    assert got[:2] == answers[:2]
    # What waited in the ring was worked on before that.
    assert got[2:] == answers[-len(got[2:]) :]
    assert len(got) > len(answers) / 2


def test_refuses_a_transmit_buffer(make, port, tmp_path):
    goal = f"{tmp_path}/builtins.obj/board_port.o"  # no more of it is compiled than shows the error
    variables = {"PORT_DIR": port, "APP": "builtins", "OUT": tmp_path}
    result = make(goal, TXBUF=1, OPTIONS="-DLOST_BEFORE=-1", **variables)
    assert result.returncode != 0
    assert "has no transmit buffer, so J2A_TXBUF must be 0" in result.stderr


def test_posix_has_a_transmit_buffer_by_itself(need, make, tmp_path):
    """With the core's default for J2A_TXBUF, and replies of 64 kB at once."""
    need("cc")
    checked = "-O1 -fsanitize=address,undefined"
    result = make(core_as_one=True, APP="builtins", OUT=tmp_path, TXBUF=0, CFLAGS=checked)
    assert result.returncode == 0, result.stderr
    requests = [Frame(c.SOF, seq, ECHO, bytes(255)) for seq in range(256)]
    source = tmp_path / "bytes"
    source.write_bytes(b"".join(map(encode, requests)))
    with source.open("rb") as stdin:
        result = subprocess.run(
            [tmp_path / "builtins"], stdin=stdin, capture_output=True, check=False, timeout=60
        )
    assert (result.returncode, result.stderr) == (0, b"")
    assert decode(result.stdout) == [Frame(c.SOF, r.seq, c.ECHO, r.payload) for r in requests]


CLOCK = """
#include <stdio.h>
#include "board.h"

static uint64_t now_ms;
static uint32_t moves_ms; /* by which time passes behind a look, and then an interrupt looks, too */
static uint64_t seen_us;
static bool is_inside;
static unsigned polls;

void board_init(void) {
}
bool board_has_byte(void) {
    static bool is_polled;
    if (is_polled) {
        polls++;
        return false;
    }
    if (is_inside)
        return false;
    is_polled = is_inside = true;
    (void)j2a_port_time_us(); /* an interrupt, while the main loop looks for a byte */
    is_polled = is_inside = false;
    return false;
}
bool board_lost(void) {
    return false;
}
uint8_t board_read(void) {
    return 0;
}
bool board_can_write(void) {
    return true;
}
void board_write(uint8_t byte) {
    (void)byte;
}
void board_idle(void) {
}
void j2a_rx_lost(void) {
}

uint32_t board_ms(void) {
    const uint32_t before_ms = (uint32_t)now_ms;
    if (moves_ms != 0 && !is_inside) {
        is_inside = true;
        now_ms += moves_ms;
        seen_us = j2a_port_time_us();
        is_inside = false;
    }
    return before_ms;
}

static void look(uint64_t at_ms, uint32_t then_ms) {
    uint64_t first_us;
    now_ms = at_ms;
    moves_ms = then_ms;
    first_us = j2a_port_time_us();
    if (first_us != at_ms * 1000)
        printf("%llu ms: %llu us\\n", (unsigned long long)at_ms, (unsigned long long)first_us);
    if (then_ms != 0 && seen_us != now_ms * 1000)
        printf("interrupt at %llu ms: %llu us\\n", (unsigned long long)now_ms,
               (unsigned long long)seen_us);
}

int main(void) {
    uint64_t at_ms;
    for (at_ms = 0; at_ms < 1200ull << 32; at_ms += 1ull << 30) {
        if (at_ms != 0)
            look(at_ms - 1, 1);
        look(at_ms, 0);
        look(at_ms, 1000);
        look(at_ms + 1000, 0);
    }
    printf("%u polls in a poll\\n", polls);
    return 0;
}
"""


def test_its_time_may_be_asked_for_in_an_interrupt(need, tmp_path):
    """The core says so to drivers, whose interrupts give values (j2a_port.h)."""
    need("cc")
    (tmp_path / "clock.c").write_text(CLOCK)
    (tmp_path / "j2a_port_config.h").write_text(CONFIG)
    common = FIRMWARE / "ports/common"
    subprocess.run(
        ["cc", "-std=c99", "-Wall", "-Wextra", "-Werror", "-fsanitize=undefined",
         f"-I{tmp_path}", f"-I{common}", f"-I{FIRMWARE / 'core'}", tmp_path / "clock.c",
         common / "board_port.c", "-o", tmp_path / "clock"],
        check=True,
    )  # fmt: skip
    done = subprocess.run(
        [tmp_path / "clock"], capture_output=True, text=True, check=False, timeout=60
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "0 polls in a poll\n", "")
