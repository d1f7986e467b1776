"""How many bytes per second go through a gadget, at each speed of the bus: prints a table.

In: the file of the module dummy_hcd.  Out: a line for each speed and way of moving bytes.
Rules: run it in the guest (tools/guest.py -- python -m transports.tests.guest.gadget_speed
MODULE); time is that of the guest's clock, the processor is emulated. The controller is the
kernel's dummy_hcd, whose frames come when transfers do, not each millisecond: what is printed is
what the software on both sides can do, beside what a cable carries at full speed (19 packets of 64
bytes a millisecond).
"""

import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import j2a_transports
from j2a_transports import Transport, UsbGadget

from .gadget import PATIENCE_S, SPEEDS, board, controllers, gone

FULL_SPEED_LIMIT = 19 * 64 * 1000
SIZES = {12: 2 << 20, 480: 8 << 20, 5000: 8 << 20}


def drain(source: Transport, size: int) -> None:
    while size > 0:
        size -= len(source.read(PATIENCE_S))


def carry(source: Transport, sink: Transport, size: int) -> None:
    while size > 0:
        data = source.read(PATIENCE_S)
        sink.write(data)
        size -= len(data)


def timed(size: int, *tasks: Callable[[], None]) -> float:
    """Run all tasks at once and return the bytes per second, of one direction."""
    threads = [threading.Thread(target=task) for task in tasks]
    start = time.perf_counter()
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return size / (time.perf_counter() - start)


def measure(speed: int, size: int) -> None:
    data = bytes(size)
    with UsbGadget(serial="S") as gadget:
        device = gadget.accept(PATIENCE_S)
        assert device is not None
        found = board("S").speed
        assert found == speed, f"the bus has {found} Mbit/s"
        with device, j2a_transports.open("usb://S", write_timeout=PATIENCE_S) as host:
            device.write_timeout_s = PATIENCE_S
            ways = {
                "host to board": (lambda: host.write(data), lambda: drain(device, size)),
                "board to host": (lambda: device.write(data), lambda: drain(host, size)),
                "echo, each way": (
                    lambda: host.write(data),
                    lambda: carry(device, device, size),
                    lambda: drain(host, size),
                ),
            }
            for way, tasks in ways.items():
                rate = timed(size, *tasks)
                share = f"{rate / FULL_SPEED_LIMIT:7.1%}" if speed == 12 else ""
                print(f"{speed:5} Mbit/s  {way:14}  {rate / 1e6:7.3f} MB/s {share}", flush=True)
    gone()


def main() -> None:
    module = Path(sys.argv[1])
    for speed, parameter in SPEEDS.items():
        controllers(module, parameter)
        measure(speed, SIZES[speed])


if __name__ == "__main__":
    main()
