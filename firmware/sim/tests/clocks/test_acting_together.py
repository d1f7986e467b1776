"""Four boards on one USB, disciplined by the daemon, act at one time."""

import struct

import numpy as np
import pytest
from j2a_sim._clocks.avr import AvrBoard
from j2a_sim._clocks.frames import Bus, hub_delay_s
from j2a_sim._clocks.native import make
from j2a_sim._clocks.settings import Settings
from j2a_sim._clocks.truth import UNIX_US, HostClock, crystal, temperature
from j2a_sim._clocks.usb_host import UsbHost
from j2a_spec import constants as c

from j2a.events import Frame as WireFrame
from j2a.protocol.codec import encode
from j2a.protocol.deframer import Deframer

pytestmark = [pytest.mark.avr, pytest.mark.slow]

SETTLED_S, SECONDS = 10.0, 12.0
LIMIT_US = 3.0


SEEDS = [1, *(pytest.param(seed, marks=pytest.mark.exhaustive) for seed in range(2, 21))]


@pytest.fixture(params=SEEDS)
def seeds(request):
    """Where the randomness of crystals and bus, of the host's clock and of the host comes from."""
    return np.random.SeedSequence(request.param).spawn(3)


@pytest.fixture
def boards(need, tmp_path, seeds):
    need("avr-gcc")
    make(
        tmp_path,
        *("PORT=avr-usb", "MCU=atmega32u4", "APP=clock_edges", "APP_DIR=tests/clock_edges"),
        "OPTIONS=-DJ2A_WITH_SYNC=1",
    )
    rng = np.random.default_rng(seeds[0])
    bus = Bus(rng, SECONDS, crystal(rng, SECONDS, 100))
    made = [
        AvrBoard(
            tmp_path / "clock_edges.elf",
            rng=rng,
            oscillator=crystal(rng, SECONDS, 100, temperature(rng, SECONDS)),
            frames=bus.at_board(rng, hub_delay_s(rng), 0.001),
            link="usb",
            times_s=np.zeros(0),
            number=number,
        )
        for number in range(1, 5)
    ]
    for board in made:
        board.sim.pins.watch("PB0", "PB1")
    yield made
    for board in made:
        board.sim.close()


def call(board, at_s, opcode, payload):
    answer = board.call(at_s, encode(c.SOF, 9, opcode, payload))
    assert answer is not None
    replies = [one for one in Deframer().feed(answer[0]) if isinstance(one, WireFrame)]
    return next(one for one in replies if one.start == c.SOF and one.seq == 9)


def edges_s(board, pin):
    return [board.true_s(edge.cycle) for edge in board.sim.pins.edges(pin)]


def test_edges_of_four_disciplined_boards_are_within_three_microseconds(boards, seeds):
    settings = Settings(boards=4, seconds=SETTLED_S, engine="avr")
    clock = HostClock(np.random.default_rng(seeds[1]), SECONDS)
    UsbHost(settings, np.random.default_rng(seeds[2]), clock, boards).run()
    names = call(boards[0], SETTLED_S, 0, b"").payload.rstrip(b"\0").split(b"\0")
    opcode = names.index(b"a2jTransd")
    spreads = []
    for number in range(4):
        now_s = SETTLED_S + 0.1 + 0.4 * number
        due = UNIX_US + round(float(clock.unix_us(now_s + 0.2)))
        pin = struct.pack("<BBBQB", 0, c.TRANSD_SET, 0, due, number % 2 == 0)
        strobe = struct.pack("<BBQ", 1, c.TRANSD_TRIGGER, due + 50_000)
        for i, board in enumerate(boards):
            assert call(board, now_s + 0.02 * i, opcode, pin).opcode == 0
            assert call(board, now_s + 0.02 * i + 0.01, opcode, strobe).opcode == 0
            board.run(now_s + 0.35)
            board.take()  # the sample of the strobe
        for name, after_s in (("PB0", 0.2), ("PB1", 0.25)):
            found = [edges_s(board, name) for board in boards]
            assert all(len(edges) == 1 for edges in found)
            times_s = [edges[0] for edges in found]
            assert all(abs(time_s - now_s - after_s) < 0.0005 for time_s in times_s)
            spread_us = 1e6 * (max(times_s) - min(times_s))
            spreads.append(spread_us)
    print("differences of edges, us:", [round(us, 2) for us in spreads])
    assert max(spreads) < LIMIT_US
