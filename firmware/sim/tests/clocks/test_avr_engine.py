"""Boards in simavr: what the bench reads from memory is what the firmware says of itself."""

import numpy as np
import pytest
from j2a_sim._clocks.avr import AvrBoard, build_firmware
from j2a_sim._clocks.frames import Bus
from j2a_sim._clocks.host import clock_opcode
from j2a_sim._clocks.truth import UNIX_US, Oscillator
from j2a_spec.constants import SOF

from j2a.events import Frame as WireFrame
from j2a.protocol.clock import Adjust, Frame, pack_exchange, unpack_exchange, unpack_status
from j2a.protocol.codec import encode
from j2a.protocol.deframer import Deframer

STATUS = bytes((1,))
UNKNOWN = 0xFFFFFFFF

pytestmark = pytest.mark.avr


class Called:
    """A board that is 40 ppm fast, and calls of its clock."""

    def __init__(self, need, link="serial", lost=()):
        need("avr-gcc")
        rng = np.random.default_rng(4)
        frames = None
        if link == "usb":
            frames = Bus(rng, 12.0, Oscillator(np.full(10, 30e-6)), 0.0).at_board(rng, 50e-9, 0.0)
            frames.lost[list(lost)] = True
        self.frames = frames
        self.board = AvrBoard(
            build_firmware(link),
            rng=rng,
            oscillator=Oscillator(np.full(10, 40e-6)),
            frames=frames,
            link=link,
            times_s=np.zeros(0),
        )
        self.now_s = 1.0
        self.opcode, _ = clock_opcode(self.board, self.now_s)

    def call(self, payload):
        self.now_s += 0.0137
        answer = self.board.call(self.now_s, encode(SOF, 1, self.opcode, payload))
        assert answer is not None
        (reply,) = Deframer().feed(answer[0])
        assert isinstance(reply, WireFrame) and reply.opcode == 0
        return reply.payload

    def status(self):
        """What the firmware says, and what is read of that instant."""
        told = unpack_status(self.call(STATUS))
        memory = self.board.memory
        cycle = memory.cycle(told.local_us)
        assert memory.local_us(cycle) == told.local_us
        assert cycle < self.board.sim.cycle
        uncertainty = UNKNOWN if told.uncertainty_us is None else told.uncertainty_us
        said = (told.time_us, told.state, told.epoch, uncertainty)
        return told, said, memory.read(cycle)


def test_the_clock_of_a_free_board_is_its_counter(need):
    board = Called(need)
    told, said, read = board.status()
    assert said == read == (told.local_us, 0, 0, UNKNOWN)
    exact_s = board.board.true_s(board.board.memory.cycle(told.local_us))
    assert abs(exact_s - board.now_s) < 0.005


def test_the_clock_is_read_as_the_firmware_says_it(need):
    board = Called(need)
    told, *_ = board.status()
    adjust = Adjust(True, told.local_us, UNIX_US, -40_000, 25, 300)
    board.call(adjust.pack())
    for _ in range(10):
        _, said, read = board.status()
        assert said == read and said[1:3] == (1, 1)
    for ahead in (400, -700, 3):  # slews of some 0.1 s and more
        told, *_ = board.status()
        board.call(Adjust(False, told.local_us, told.time_us + ahead, 55_000, 30, 0).pack())
        for _ in range(25):
            _, said, read = board.status()
            assert said[2:3] == read[2:3]
            assert abs(said[0] - read[0]) <= 1 and abs(said[3] - read[3]) <= 1
            assert said[1] == read[1]


def test_a_board_on_a_usb_tells_in_which_frame_a_request_came(need):
    board, late_us = Called(need, "usb"), []
    for _ in range(20):
        exchange = unpack_exchange(board.call(pack_exchange(5)), 5, 0.0, 1e6)
        came_s = board.board.true_s(board.board.memory.cycle(exchange.received_us))
        at = int(np.searchsorted(board.frames.starts_s, came_s - 5e-6)) - 1
        assert exchange.frame == board.frames.numbers[at]
        age_us = 1e6 * (came_s - board.frames.starts_s[at])
        late_us.append(age_us - exchange.age_us)
    # Its interrupt is late, and seldom waits for another one, or for the look at an endpoint.
    assert min(late_us) > -1 and max(late_us) < 20
    assert sum(late < 9 for late in late_us) >= 18


def test_frames_set_the_clock_of_the_real_firmware(need):
    board = Called(need, "usb", lost=range(2000, 2020))
    for _ in range(12):
        at = int(np.searchsorted(board.frames.starts_s, board.now_s)) - 1
        time_us = UNIX_US + round(1e6 * board.frames.starts_s[at])
        board.call(Frame(time_us, int(board.frames.numbers[at]), 9).pack())
        board.now_s += 0.4
    board.now_s += 2.0
    for _ in range(20):
        told, said, read = board.status()
        assert said == read and told.epoch == 1
        exact_s = board.board.true_s(board.board.memory.cycle(told.local_us))
        # The interrupt sees the start 6 us late: 35 bit times, and the way to the counter.
        assert -8 < told.time_us - UNIX_US - 1e6 * exact_s < -3
