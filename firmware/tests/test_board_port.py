"""The port that the boards share (ports/common/board_port.c), on a board of which all is known.

That board has received all of its input when the program starts, and the program ends in the first
call of board_idle().
"""

import subprocess

import pytest
from j2a_spec import constants as c
from j2a_spec.oracle import Frame, decode, encode

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
        result = make(PORT_DIR=port, APP="builtins", OUT=tmp_path, OPTIONS=options)
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
    result = make(PORT_DIR=port, APP="builtins", OUT=tmp_path, TXBUF=1, OPTIONS="-DLOST_BEFORE=-1")
    assert result.returncode != 0
    assert "has no transmit buffer, so J2A_TXBUF must be 0" in result.stderr


def test_posix_has_a_transmit_buffer_by_itself(need, make, tmp_path):
    """With the core's default for J2A_TXBUF, and replies of 64 kB at once."""
    need("cc")
    checked = "-O1 -fsanitize=address,undefined"
    result = make(PORT="posix", APP="builtins", OUT=tmp_path, TXBUF=0, CFLAGS=checked)
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
