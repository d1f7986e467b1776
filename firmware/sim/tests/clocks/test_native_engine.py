"""Boards compiled for this machine: their clocks are read at the instants that were given."""

import numpy as np
from j2a_sim._clocks.frames import Bus
from j2a_sim._clocks.native import NativeBoard, build_board
from j2a_sim._clocks.truth import UNIX_US, Oscillator
from j2a_spec import usb

SECONDS = 2.0


def test_a_clock_is_read_while_its_board_waits_for_a_line_to_begin():
    """A packet within a millisecond of another one makes a board wait (J2A-CLOCK-012)."""
    rng = np.random.default_rng(1)
    bus = Bus(rng, SECONDS, Oscillator(np.zeros(4)), 0.0)
    times_s = np.arange(0.5, SECONDS - 0.1, 20e-6)
    board = NativeBoard(
        build_board("usb"),
        rng=rng,
        oscillator=Oscillator(np.full(4, 30e-6)),
        frames=bus.at_board(rng, 0.0, 0.0),
        link="usb",
        times_s=times_s,
    )
    for at_s in np.arange(0.4, SECONDS - 0.1, 0.01):
        for later_s in (0.0, 0.0003):
            frame = int(np.searchsorted(bus.starts_s, at_s)) - 1
            packet = {
                "time_us": UNIX_US + round(1e6 * bus.starts_s[frame]),
                "frame": int(bus.numbers[frame]),
            }
            board.packet(at_s + later_s, usb.sync.build(packet))
    board.run(SECONDS)
    assert board.backwards == 0
    errors_us = board.readings.clock_us.astype(np.int64) - UNIX_US - 1e6 * times_s
    assert abs(errors_us).max() < 100
    assert set(board.readings.epoch) == {1}
