"""The clock of the port avr-usb, which the frames of the bus lead, in the simulator.

In: the demo with J2A_WITH_SYNC, and a host that knows when each frame began, to the cycle. Out: the
time against that truth, and the answers to the request of SyncUSB. All times are simulated ones.
"""

import re
from pathlib import Path

import pytest
from j2a_spec import constants as c
from j2a_spec import usb
from j2a_spec.grammar import (
    CLOCK_ADJUST,
    CLOCK_EXCHANGE,
    CLOCK_EXCHANGED,
    CLOCK_FRAME,
    CLOCK_SEEN_FRAME,
    CLOCK_STATUS,
)

from firmware.tests.test_avr_usb_interrupts import VECTORS
from firmware.tests.usb9 import Device
from firmware.tests.usb9.device import IN, INTERFACE, OUT, VENDOR, setup

pytestmark = pytest.mark.avr

BOTH = pytest.mark.parametrize("board", ["atmega32u4", "atmega32u2"], indirect=True)
UNIX = 1_700_000_000_000_000
SYNC_INTERFACE = 1
CYCLES_PER_US = 16
OPCODE = [*c.BUILTINS, "a2jGetInterface"].index(c.GET_INTERFACE) + 1
STATUS = bytes((c.CLOCK_STATUS,))


@pytest.fixture
def board(request, build):
    mcu = getattr(request, "param", "atmega32u4")
    app = "builtins" if mcu == "atmega32u2" else "demo"  # whose clock has no room in 1 KB
    elf = build(app, "avr-usb", MCU=mcu, OPTIONS="-DJ2A_WITH_SYNC=1")
    with Device(elf, mcu) as device:
        device.to_configured()
        device.pause(50)
        yield device


def ask(board, payload, seq=1):
    from j2a_spec.oracle import Frame, encode  # noqa: PLC0415

    board.bus.submit_out(c.USB_OUT, encode(Frame(c.SOF, seq, OPCODE, payload)))
    (reply,) = board.listen(1)
    return reply.opcode, reply.payload


def status(board):
    return CLOCK_STATUS.parse(ask(board, STATUS)[1])


def seen_frame(board, nonce=0, index=SYNC_INTERFACE, length=c.SYNCUSB_SEEN_SIZE):
    request = setup(c.SYNCUSB_REQUEST_TYPE, c.SYNCUSB_SEEN, nonce, index, length)
    return board.control(request)


def sync(board, time, frame):
    packet = usb.sync.build({"time_us": time, "frame": frame})
    board.finish(board.bus.submit_out(c.SYNCUSB_OUT, packet), 100)


def truth(board):
    """Return the true time of the last start of frame, in microseconds of the simulator."""
    return board.bus.frame_start / CYCLES_PER_US


@BOTH
@pytest.mark.requirement("SYNC-008")
def test_the_request_of_syncusb_names_the_last_frame(board):
    for nonce in (0, 1, 0x1234, 0x80FF, 0xFFFF):
        first = board.bus.frame
        done = seen_frame(board, nonce)
        assert done.status == "ok"
        seen = usb.seen.parse(done.data)
        assert seen.nonce == nonce
        assert (seen.frame - first) % 2048 <= (board.bus.frame - first) % 2048
        assert seen.age_us < 1000
    for length, size in ((64, 6), (6, 6), (5, 5), (1, 1)):
        assert len(seen_frame(board, 7, length=length).data) == size


@pytest.mark.requirement("SYNC-008")
@pytest.mark.requirement("USB-006")
def test_other_requests_of_the_vendor_end_in_a_stall(board):
    for kind, request, index in (
        (IN | VENDOR | INTERFACE, 0, SYNC_INTERFACE),
        (IN | VENDOR | INTERFACE, 2, SYNC_INTERFACE),
        (IN | VENDOR | INTERFACE, c.SYNCUSB_SEEN, 0),
        (IN | VENDOR | INTERFACE, c.SYNCUSB_SEEN, 2),
        (IN | VENDOR | INTERFACE, c.SYNCUSB_SEEN, 0x101),
        (IN | VENDOR, c.SYNCUSB_SEEN, SYNC_INTERFACE),
        (OUT | VENDOR | INTERFACE, c.SYNCUSB_SEEN, SYNC_INTERFACE),
    ):
        board.refuses(kind, request, 9, index, 6 if kind & IN else 0)
    board.configure(0)
    board.refuses(c.SYNCUSB_REQUEST_TYPE, c.SYNCUSB_SEEN, 9, SYNC_INTERFACE, 6)


@pytest.mark.requirement("SYNC-008")
def test_the_age_is_that_of_the_request(board):
    """It takes as long as the bus says, to some microseconds of control transfer."""
    for _ in range(20):
        before = board.sim.cycle
        done = seen_frame(board)
        seen = usb.seen.parse(done.data)
        began = board.bus.frame_start - ((board.bus.frame - seen.frame) % 2048) * 16000
        assert before - began - 200 * CYCLES_PER_US <= seen.age_us * CYCLES_PER_US
        assert seen.age_us * CYCLES_PER_US <= board.sim.cycle - began
        board.pause(0.3)


@pytest.mark.requirement("SYNC-006")
def test_packets_lead_the_time(board):
    zero = truth(board)
    for _ in range(8):
        sync(board, UNIX + round(truth(board) - zero), board.bus.frame % 1024)
        board.pause(300)
    found = status(board)
    assert (found.epoch, found.uncertainty) == (1, c.CLOCK_UNKNOWN)
    assert found.state in (c.CLOCK_SETTLING, c.CLOCK_LOCKED)
    code, payload = ask(board, CLOCK_EXCHANGE.build({"nonce": 1}))
    assert code == 0
    reply, seen = CLOCK_EXCHANGED.parse(payload), CLOCK_SEEN_FRAME.parse(payload[14:])
    began = truth(board) - ((board.bus.frame - seen.frame) % 2048) * 1000
    expected = UNIX + began - zero + seen.age + (found.local - reply.received)
    assert abs(found.time - expected) < 12  # the chip has a start 3 us late, then the interrupt


@pytest.mark.requirement("SYNC-006")
def test_packets_have_the_uncertainty_of_frame(board):
    time = UNIX + 5
    request = CLOCK_FRAME.build({"time": time, "frame": board.bus.frame, "uncertainty": 12})
    assert CLOCK_STATUS.parse(ask(board, request)[1]).uncertainty == 13
    board.pause(20)
    sync(board, time + 20_000, (board.bus.frame) % 2048)
    assert status(board).uncertainty < 2000
    adjust = {"mode": 1, "local": 0, "time": UNIX, "rate": 0, "uncertainty": 5, "wander": 0}
    assert ask(board, CLOCK_ADJUST.build(adjust))[0] == 0
    sync(board, status(board).time, board.bus.frame)
    assert status(board).uncertainty == c.CLOCK_UNKNOWN


@pytest.mark.requirement("SYNC-006")
def test_packets_that_frame_would_refuse_are_ignored(board):
    for time, frame in ((2**63, 5), (UNIX, 2048), (UNIX, 0xFFFF)):
        packet = time.to_bytes(8, "little") + frame.to_bytes(2, "little")
        board.finish(board.bus.submit_out(c.SYNCUSB_OUT, packet), 100)
        board.pause(5)
        assert status(board).state == c.CLOCK_FREE


@pytest.mark.requirement("SYNC-009")
def test_a_suspend_and_a_reset_do_not_stop_the_time(board):
    sync(board, UNIX, board.bus.frame)
    board.pause(1100)
    sync(board, UNIX + 1_100_000, board.bus.frame)
    board.pause(100)
    before, at = status(board), board.sim.cycle
    board.to_configured()
    board.pause(200)
    after = status(board)
    passed = (board.sim.cycle - at) / CYCLES_PER_US
    assert after.epoch == before.epoch
    assert abs(after.time - before.time - passed) < passed * 0.002 + 3000


@BOTH
def test_its_interrupts_take_as_long_as_the_readme_says(board):
    """The longest ones: the application must expect them at any time."""
    text = (Path(__file__).parents[1] / "README.md").read_text("utf-8")
    (start,) = re.findall(r"each millisecond, of up to (\d+)\s+cycles", text)
    (request,) = re.findall(r"the request of SyncUSB, which takes up to (\d+)", text)
    usb_gen, usb_com = VECTORS[board.sim.mcu]
    board.sim.clear_interrupts()
    for turn in range(100):
        if turn % 10 == 0:
            sync(board, UNIX + 3000 * turn, board.bus.frame % 2048)
        assert seen_frame(board, nonce=turn * 655).status == "ok"
        board.pause(3.1)  # over several overflows of the timer, and at each phase of the frame
    started, asked = board.sim.interrupts(usb_gen), board.sim.interrupts(usb_com)
    assert started.count >= 300
    assert 0.95 * int(start) < started.longest_cycles <= int(start)
    assert 0.95 * int(request) < asked.longest_cycles <= int(request)
