"""Two boards on one bus, told apart by their serial numbers, one of which is busy.

In: the port of a USB/IP server on the host with two boards, and their serial numbers.  Out: lines
about what is good; an assertion error and a bad exit code else.
Rules: what is asked is the order of events, never a speed.
"""

import struct
import sys
import threading

import j2a_transports
from attach import attach, device
from j2a_spec.constants import SOF
from j2a_transports import usb_boards
from links import HOST

import j2a
from j2a.protocol.codec import encode
from j2a.protocol.deframer import Deframer

PATIENCE_S = 60.0
BUSY_MS = 12_000
ECHOES = 100


def main() -> None:
    port, *serials = sys.argv[1:]
    for number, serial in enumerate(serials, 1):
        attach(HOST, int(port), f"1-{number}")
        device(serial)
    assert {board.serial for board in usb_boards()} == set(serials)

    # Each name leads to its board, in any order.
    for serial in (*serials, *reversed(serials)):
        with j2a.connect(f"usb://{serial}", boot_time=PATIENCE_S) as board:
            board.write_many("store", serial.encode())
    for serial in serials:
        with j2a.connect(f"usb://6666:cafe/{serial}", boot_time=PATIENCE_S) as board:
            assert board.read_many("store") == serial.encode()
    try:
        j2a.connect("usb://")
    except j2a.OpenFailed as error:
        assert all(serial in str(error) for serial in serials), error
    else:
        raise AssertionError("one of two boards was taken")
    print("good: by serial number")

    # One function runs for long, and the host goes on sending: that board takes no more bytes.
    echo = _opcode(serials[0], "a2jEcho")
    delay = _opcode(serials[0], "delay")
    requests = [struct.pack("<H", BUSY_MS), *(bytes([number]) * 30 for number in range(2, 100))]
    frames = b"".join(
        encode(SOF, seq, delay if seq == 1 else echo, payload)
        for seq, payload in enumerate(requests, 1)
    )
    done = threading.Event()

    def write() -> None:
        busy.write(frames)
        done.set()

    with (
        j2a_transports.open(f"usb://{serials[0]}", write_timeout=PATIENCE_S) as busy,
        j2a.connect(f"usb://{serials[1]}", timeout=PATIENCE_S) as board,
    ):
        writer = threading.Thread(target=write, daemon=True)
        writer.start()
        for number in range(ECHOES):
            assert board.echo(bytes([number])) == bytes([number])
        assert not done.is_set(), "the busy board took all the bytes"
        assert busy.read(0) == b"", "the busy board has answered already"
        print("good: the other is not delayed")
        deframer, replies = Deframer(), []
        while len(replies) < len(requests):
            data = busy.read(PATIENCE_S)
            assert data, f"only {len(replies)} replies came"
            replies += deframer.feed(data)
        assert [reply.seq for reply in replies] == list(range(1, 100))
        assert [reply.payload for reply in replies] == [b"", *requests[1:]]
        writer.join(PATIENCE_S)
        assert done.is_set()
    print("good: nothing was lost")


def _opcode(serial: str, name: str) -> int:
    with j2a.connect(f"usb://{serial}", boot_time=PATIENCE_S) as board:
        return board.functions[name]


if __name__ == "__main__":
    main()
