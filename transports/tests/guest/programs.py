"""What programs see of the boards on a bus: `j2a list`, and a driver of the kernel that was first.

In: the port of a USB/IP server on the host with one board; a gadget is the other.  Out: a line for
each thing that is good; an assertion error and a bad exit code else.
"""

import contextlib
import io
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path

from attach import attach
from j2a_transports import usb_boards
from links import HOST, GadgetLink

import j2a
from j2a.cli import main as j2a_main

PATIENCE_S = 60.0
DRIVER = Path("/sys/bus/usb-serial/drivers/generic")
TERMINAL = Path("/dev/ttyUSB0")


def until(condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, condition
        time.sleep(0.02)


def printed(*arguments: str) -> str:
    """Run the program j2a in this process, which saves the time that it takes to load."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        assert j2a_main(list(arguments)) == 0
    return out.getvalue()


def listed() -> None:
    boards = {board.serial: board for board in usb_boards()}
    gadget, chip = boards.pop("G1"), boards.popitem()[1]
    facts = {one["serial_number"]: one for one in json.loads(printed("list", "--json"))}
    text = printed("list")
    print(text)
    for board, speed in ((gadget, 480), (chip, 12)):
        assert board.serial is not None
        one = facts[board.serial]
        folder = Path("/sys/bus/usb/devices") / one["port_path"]
        known = {name: (folder / name).read_text().strip() for name in ("busnum", "devnum")}
        assert one["bus"] == f"{int(known['busnum']):03}:{int(known['devnum']):03}"
        assert one["url"] == f"usb://{board.serial}"
        assert one["speed"] == speed
        assert one["usb_id"] == "6666:CAFE"
        assert (folder / "serial").read_text().strip() == board.serial
        assert (folder / "product").read_text().strip() == one["name"]
        for value in (one["url"], one["bus"], one["port_path"], f"{speed} Mbit/s"):
            assert value in text, value
    print("good: list")


def driver_of_the_kernel() -> None:
    """The kernel takes the board for a serial port; J2A takes it over, and gives it back."""
    (DRIVER / "new_id").write_text("6666 cafe ff")
    until(TERMINAL.exists)
    with j2a.connect("usb://G1", boot_time=PATIENCE_S) as board:
        # Only the link was taken: what the driver has of other boards and interfaces stays.
        taken = {path.name for path in Path("/sys/bus/usb/drivers/usbfs").glob("*:*")}
        assert len(taken) == 1, taken
        for size in (1, 63, 64, 65, 200):
            assert board.echo(bytes(size)) == bytes(size)
    (interface,) = taken
    bound = Path("/sys/bus/usb/devices") / interface / "driver"
    until(bound.exists)
    assert bound.resolve().name == "usbserial_generic", bound.resolve()
    # And once more: it is in nobody's way.
    with j2a.connect("usb://G1", boot_time=PATIENCE_S) as board:
        assert board.echo(b"again") == b"again"
    print("good: driver")


def main() -> None:
    gadget = GadgetLink()
    attach(HOST, int(sys.argv[1]), "1-1")
    try:
        until(lambda: len(usb_boards()) == 2)
        listed()
        driver_of_the_kernel()
    finally:
        gadget.close()


if __name__ == "__main__":
    main()
