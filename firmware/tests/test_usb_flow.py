"""Flow control of the port avr-usb: busy devices, hosts that flood, hosts that do not read.

In: the demo, and an app that sends back what comes on SyncUSB, on the simulated chips. Out: every
frame against the one that is due, in order. All times are simulated ones.
"""

import random
from pathlib import Path

import pytest
from j2a_spec import constants as c
from j2a_spec import usb
from j2a_spec.oracle import Frame, encode

from firmware.tests.usb9 import Device
from firmware.tests.usb9.device import OPCODE

pytestmark = [pytest.mark.avr, pytest.mark.requirement("USB-010")]

CHIPS = ("atmega32u4", "atmega32u2")
SIF_PERIODIC = 0x20
SYNC_APP = Path(__file__).parent / "usb_sync"
SYNC_DELAY = len(c.BUILTINS)
SIF_SYNC = 1


@pytest.fixture(params=CHIPS)
def board(request, build):
    with Device(build(port="avr-usb", MCU=request.param), request.param) as device:
        device.to_configured()
        yield device


def calls(rng, count):
    """(request, reply): echoes of every length, with every byte, and functions that compute."""
    for seq in range(count):
        if rng.random() < 0.1:
            ms = rng.randrange(1, 40)
            yield Frame(c.SOF, seq, OPCODE["delay"], bytes((ms, 0))), Frame(c.SOF, seq, 0)
        else:
            payload = rng.randbytes(rng.randrange(256))
            yield (
                Frame(c.SOF, seq, OPCODE[c.GET_ECHO], payload),
                Frame(c.SOF, seq, c.ECHO, payload),
            )


@pytest.mark.parametrize("seed", range(3))
def test_a_host_that_floods(board, seed):
    """200 requests are handed to the host controller at once, which finds the device busy."""
    due = list(calls(random.Random(seed), 200))
    naks = board.bus.counters.naks
    board.bus.submit_out(c.USB_OUT, b"".join(encode(request) for request, _ in due))
    assert board.listen(len(due), 5000) == [reply for _, reply in due]
    assert board.bus.counters.naks > naks
    board.works()


@pytest.mark.parametrize("seed", range(3))
def test_a_host_that_reads_now_and_then(board, seed):
    rng = random.Random(seed)
    due = list(calls(rng, 60))
    board.bus.submit_out(c.USB_OUT, b"".join(encode(request) for request, _ in due))
    found = []
    for _ in range(1000):
        board.pause(rng.choice((0, 0.1, 1, 8, 30)))
        found = board.listen(len(found) + 1, rng.choice((0.1, 1)), keep=True)
        if len(found) == len(due):
            break
    assert found == [reply for _, reply in due]


def test_a_device_that_is_busy_for_long_takes_nothing_more(board):
    """A second in a function: what is not in the chip stays with the host, for as long as that."""
    requests = [Frame(c.SOF, seq, OPCODE[c.GET_ECHO], bytes(120)) for seq in range(1, 30)]
    board.send(Frame(c.SOF, 0, OPCODE["delay"], (1000).to_bytes(2, "little")))
    board.pause(1)
    board.bus.completed()
    board.bus.submit_out(c.USB_OUT, b"".join(map(encode, requests)))
    before = board.bus.counters
    board.pause(900)
    # Two banks of 64 bytes at the most.
    assert board.bus.counters.bytes_out - before.bytes_out <= 128
    found = board.listen(30, 2000)
    assert found == [
        Frame(c.SOF, 0, 0),
        *(Frame(c.SOF, r.seq, c.ECHO, r.payload) for r in requests),
    ]


def test_sifs_while_nobody_reads(board):
    """They wait, with the replies, in the order in which they were made; none is cut or doubled."""
    assert board.call("sifPeriod", b"\2\0") == Frame(c.SOF, 1, 0)
    echoes = [Frame(c.SOF, seq, OPCODE[c.GET_ECHO], bytes((seq,)) * 40) for seq in range(2, 12)]
    board.bus.submit_out(c.USB_OUT, b"".join(map(encode, echoes)))
    board.pause(500)
    board.send(Frame(c.SOF, 99, OPCODE["sifPeriod"], b"\0\0"))
    found = board.listen(10_000, 100)
    sifs = [frame for frame in found if frame.start == c.SOS]
    assert {frame.opcode for frame in sifs} == {SIF_PERIODIC}
    assert [int.from_bytes(frame.payload, "little") for frame in sifs] == list(range(len(sifs)))
    assert [frame.seq for frame in sifs] == [n % 256 for n in range(len(sifs))]
    assert len(sifs) > 1
    assert [frame for frame in found if frame.start == c.SOF] == [
        *(Frame(c.SOF, echo.seq, c.ECHO, echo.payload) for echo in echoes),
        Frame(c.SOF, 99, 0),
    ]


def test_sifs_do_not_hinder_a_flood(board):
    """Both directions full: each SIF and each reply whole and in order."""
    assert board.call("sifPeriod", b"\1\0") == Frame(c.SOF, 1, 0)
    due = list(calls(random.Random(5), 100))
    board.bus.submit_out(c.USB_OUT, b"".join(encode(request) for request, _ in due))
    board.bus.submit_out(c.USB_OUT, encode(Frame(c.SOF, 200, OPCODE["sifPeriod"], b"\0\0")))
    found = board.listen(10_000, 1500)
    assert [f for f in found if f.start == c.SOF] == [*(r for _, r in due), Frame(c.SOF, 200, 0)]
    sifs = [int.from_bytes(f.payload, "little") for f in found if f.start == c.SOS]
    assert sifs == list(range(len(sifs)))
    assert len(sifs) > 50


@pytest.mark.requirement("USB-011")
@pytest.mark.parametrize("event", ["unplug", "reset", "configuration"])
def test_the_link_begins_anew_at_any_moment(board, event):
    """In the midst of a flood the cable is pulled, the bus reset, or the configuration set."""
    rng = random.Random(6)
    for turn in range(12):
        due = list(calls(rng, 40))
        transfer = board.bus.submit_out(c.USB_OUT, b"".join(encode(request) for request, _ in due))
        read = rng.random() < 0.7
        if read:
            found = board.listen(40, rng.uniform(0, 40), keep=True)
            assert found == [reply for _, reply in due][: len(found)]
        else:
            board.pause(rng.uniform(0, 40))
        board.sim.run(rng.randrange(5000))
        board.bus.cancel(transfer)
        board.bus.completed()
        if event == "unplug":
            board.bus.unplug()
            board.pause(rng.uniform(1, 50))
        if event == "configuration":
            board.configure()
        else:
            board.to_configured()
        # A function that computed goes on until it ends; nothing of its reply may come.
        reply = Frame(c.SOF, turn, c.ECHO, b"of the new link")
        board.send(Frame(c.SOF, turn, OPCODE[c.GET_ECHO], reply.payload))
        assert board.listen(1, 100) == [reply]
        assert board.listen(1, 5) == []


@pytest.fixture(params=CHIPS)
def sync_board(request, build):
    elf = build("usb_sync", "avr-usb", APP_DIR=str(SYNC_APP), MCU=request.param)
    with Device(elf, request.param) as device:
        device.to_configured()
        yield device


def sync_packet(number):
    """A packet with its time, in which every value of a byte comes up."""
    time_us = 1_700_000_000_000_000 + 1_000_003 * number
    return usb.sync.build({"time_us": time_us, "frame": number * 37 % 2048})


@pytest.mark.requirement("SYNC-003")
def test_sync_packets_reach_the_application_as_they_are(sync_board):
    """Each once, in order; packets of other lengths are ignored."""
    for number in range(20):
        packet = sync_packet(number)
        for wrong in (b"", packet[:1], packet[:9]):
            sync_board.finish(sync_board.bus.submit_out(c.SYNCUSB_OUT, wrong), 100)
        sync_board.finish(sync_board.bus.submit_out(c.SYNCUSB_OUT, packet), 100)
        assert sync_board.listen(1) == [Frame(c.SOS, number, SIF_SYNC, packet)]
    assert sync_board.listen(1, 10) == []


def test_sync_packets_while_bulk_traffic_runs(sync_board):
    """200 echoes in flight, and a packet of the time in each few milliseconds between them."""
    rng = random.Random(7)
    payloads = [rng.randbytes(rng.randrange(256)) for _ in range(200)]
    echoes = [Frame(c.SOF, n, OPCODE[c.GET_ECHO], data) for n, data in enumerate(payloads)]
    sync_board.bus.submit_out(c.USB_OUT, b"".join(map(encode, echoes)))
    found = []
    for number in range(30):
        sync_board.bus.submit_out(c.SYNCUSB_OUT, sync_packet(number))
        found = sync_board.listen(10_000, 4, keep=True)
    found = sync_board.listen(230, 2000, keep=True)
    assert [f for f in found if f.start == c.SOF] == [
        Frame(c.SOF, n, c.ECHO, data) for n, data in enumerate(payloads)
    ]
    assert [f for f in found if f.start == c.SOS] == [
        Frame(c.SOS, n, SIF_SYNC, sync_packet(n)) for n in range(30)
    ]


def test_sync_packets_wait_for_a_busy_application(sync_board):
    """The endpoint holds one packet, refuses the next ones, and loses none."""
    sync_board.send(Frame(c.SOF, 1, SYNC_DELAY, b"\x64\0"))
    sync_board.pause(1)
    for number in range(5):
        sync_board.bus.submit_out(c.SYNCUSB_OUT, sync_packet(number))
    assert sync_board.listen(6, 500) == [
        Frame(c.SOF, 1, 0),
        *(Frame(c.SOS, n, SIF_SYNC, sync_packet(n)) for n in range(5)),
    ]
