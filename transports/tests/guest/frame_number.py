"""What tells the number of a USB frame without a patched kernel, and how well: in the guest.

In: controllers that QEMU emulates, each with a tablet and, but for EHCI, an audio device; the port
of a USB/IP server on the host with one board. Out: a table, and the same as JSON in the last line.
Rules: the truth is the frame counter of the controller, read from its registers, which a program on
a real computer should not do; each wait has a deadline. Time is that of an emulated processor and
of QEMU's timers: what is there at all is true of the kernel, the microseconds are not those of a
real controller.
"""

import json
import mmap
import os
import random
import statistics
import struct
import sys
import time
from collections.abc import Callable
from pathlib import Path

import usb.core
from j2a_transports import sync_ports
from j2a_transports._usb.find import libusb

from j2a.protocol.clock import BusClock, Exchange, ReferenceClock

from .attach import attach, device
from .usbfs import Completion, IsochronousOut
from .usbmon import Event, Monitor

DRIVERS = Path("/sys/bus/pci/drivers")
DEVICES = Path("/sys/bus/usb/devices")
COUNT = 400
ISO_COUNT = 100
FRAMES = 2048
TABLET, AUDIO = (0x0627, 0x0001), (0x46F4, 0x0002)
SET_IDLE_4_MS = (0x21, 0x0A, 0x0100, 0)
TIMEOUT_MS = 20_000
HOST = "10.0.2.2"
MARK = 5000
"""The start_frame that is submitted: no number of a frame."""
Readings = Callable[[], tuple[int, int]]
"""Returns the frame counter of a controller and how many microseconds a count lasts."""


def now_us() -> float:
    return time.monotonic_ns() / 1000


class Controller:
    """A controller and the registers by which it tells its frame.

    Args:
        driver: of the kernel.
    """

    def __init__(self, driver: str) -> None:
        self.name = driver.partition("_")[0].partition("-")[0]
        (self.folder,) = (DRIVERS / driver).glob("0000:*")
        self.buses = [int(one.read_text()) for one in self.folder.glob("usb*/busnum")]
        self.reading = getattr(self, f"_{self.name}")()
        self._began_us = self.error_us = 0.0

    def _uhci(self) -> Readings:
        ports = os.open(self.folder / "resource4", os.O_RDONLY)
        return lambda: (struct.unpack("<H", os.pread(ports, 2, 6))[0] % FRAMES, 1000)

    def _memory(self) -> mmap.mmap:
        file = os.open(self.folder / "resource0", os.O_RDWR)
        return mmap.mmap(file, 4096 * max(1, os.fstat(file).st_size // 4096))

    def _ehci(self) -> Readings:
        memory = self._memory()
        at = memory[0] + 0x0C
        return lambda: (struct.unpack_from("<I", memory, at)[0] % (8 * FRAMES), 125)

    def _xhci(self) -> Readings:
        memory = self._memory()
        (at,) = struct.unpack_from("<I", memory, 0x18)
        at &= ~31
        return lambda: (struct.unpack_from("<I", memory, at)[0] % (8 * FRAMES), 125)

    def find_frames(self) -> bool:
        """Find when frame 0 began; returns whether the counter is as steady as a clock.

        Emulators may let it stand and jump, and then no instant fits all readings.
        """
        low, high = float("-inf"), float("inf")
        first_us = now_us()
        whole_us = FRAMES * 1000
        for _ in range(COUNT):
            before_us = now_us()
            count, step_us = self.reading()
            after_us = now_us()
            # The first reading says which multiple of 2048 frames is meant.
            passed_us = before_us - first_us
            turns = round((passed_us - count * step_us) / whole_us) if low > float("-inf") else 0
            if low == float("-inf"):
                first_us = before_us - count * step_us
            at_us = count * step_us + turns * whole_us
            low = max(low, before_us - at_us - step_us)
            high = min(high, after_us - at_us)
            time.sleep(0.0007)
        self._began_us = (low + high) / 2
        self.error_us = (high - low) / 2
        return low <= high

    def frame_at(self, at_us: float) -> float:
        """Return the frame, and how much of it is over, at a time."""
        return (at_us - self._began_us) / 1000

    def ahead_us(self, event: Event) -> float:
        """Return how long before the start of its frame a transfer had ended, modulo 2048 ms."""
        passed = self.frame_at(event.at_us) - event.start_frame
        return -1000 * ((passed + FRAMES / 2) % FRAMES - FRAMES / 2)


def on_bus(controller: Controller, ids: tuple[int, int]) -> usb.core.Device | None:
    """Return a device on this controller."""
    found = usb.core.find(find_all=True, backend=libusb(), idVendor=ids[0], idProduct=ids[1])
    return next((one for one in found if one.bus in controller.buses), None)


def spread(values: list[float]) -> dict[str, float]:
    """Return the median and the middle 90 % of values."""
    ordered = sorted(values)
    low, high = ordered[len(ordered) // 20], ordered[-1 - len(ordered) // 20]
    return {
        "median_us": round(statistics.median(ordered), 1),
        "spread_us": round(high - low, 1),
        "range_us": round(ordered[-1] - ordered[0], 1),
    }


def phases(controller: Controller, times_us: list[float]) -> dict[str, float]:
    """Return how long after the start of a frame times were."""
    parts = [1000 * (controller.frame_at(one) % 1) for one in times_us]
    # Times around a start of frame are near each other.
    middle = statistics.median(parts)
    return spread([(part - middle + 500) % 1000 - 500 + middle for part in parts])


def control(tablet: usb.core.Device) -> list[float]:
    """Ask for a status: half of the time that it takes bounds what a board could tell."""
    halves = []
    for _ in range(COUNT):
        before_us = now_us()
        tablet.ctrl_transfer(0x80, 0, 0, 0, 2, TIMEOUT_MS)
        halves.append((now_us() - before_us) / 2)
    return halves


def interrupts(tablet: usb.core.Device) -> list[float]:
    """Let the tablet report each 4 ms; returns when a program had the reports."""
    tablet.ctrl_transfer(*SET_IDLE_4_MS, None, TIMEOUT_MS)
    times = []
    for _ in range(COUNT):
        tablet.read(0x81, 8, TIMEOUT_MS)
        times.append(now_us())
    return times


def measure(controller: Controller) -> list[dict[str, object]]:
    """Try all ways on one controller; returns a row for each."""
    rows: list[dict[str, object]] = []

    def row(way: str, number: str, **figures: object) -> None:
        rows.append({"controller": controller.name, "way": way, "number": number, **figures})

    tablet = on_bus(controller, TABLET)
    assert tablet is not None, controller.name
    halves = control(tablet)
    row(
        "half a control request",
        "by the board",
        least_us=round(min(halves), 1),
        **spread(halves),
    )
    is_steady = controller.find_frames()
    row(
        "register (the truth)",
        "yes" if is_steady else "not steady",
        range_us=round(2 * controller.error_us, 1),
    )
    with Monitor(tablet.bus) as monitor:
        times = interrupts(tablet)
        events = [one for one in monitor.events() if one.is_completion and one.endpoint == 0x81]
    assert len(events) == COUNT, len(events)
    noted = [one.at_us for one in events]
    for way, at_us in (("interrupt, by the program", times), ("interrupt, by usbmon", noted)):
        row(way, "phase only", **(phases(controller, at_us) if is_steady else {}))
    late = [user_us - at_us for user_us, at_us in zip(times, noted, strict=True)]
    row("program after usbmon", "-", least_us=round(min(late), 1), **spread(late))

    audio = on_bus(controller, AUDIO)
    if audio is None:
        return rows
    is_steady = controller.find_frames()
    with Monitor(audio.bus) as monitor, IsochronousOut(audio.bus, audio.address) as stream:
        done: list[Completion] = [stream.send(MARK + number) for number in range(ISO_COUNT)]
        events = [one for one in monitor.events() if one.is_completion and one.is_isochronous]
    is_kept = all(one.start_frame == MARK + number for number, one in enumerate(done))
    row("usbfs, start_frame", "as submitted" if is_kept else "yes")
    assert len(events) == ISO_COUNT, len(events)
    ahead = [controller.ahead_us(one) for one in events]
    most = max(one.start_frame for one in events)
    row("usbmon, start_frame", f"0 to {most}", **(spread(ahead) if is_steady else {}))
    return rows


def ask_board(port: int) -> list[dict[str, object]]:
    """Let a board of a USB/IP server tell frames; returns a row."""
    attach(HOST, port, "1-1")
    device("FRAMES")
    (sync,) = sync_ports()
    sync.open()
    clock = BusClock(ReferenceClock())
    halves = []
    for _ in range(COUNT):
        sent_us = now_us()
        seen = sync.frame(random.randrange(1 << 16))
        came_us = now_us()
        if seen is not None:
            halves.append((came_us - sent_us) / 2)
            clock.add(Exchange(sent_us, came_us, 0, frame=seen.frame, age_us=seen.age_us))
    sync.close()
    estimator = clock.estimator
    assert halves
    least_us = round(min(halves), 1)
    return [
        {
            "controller": "vhci",
            "way": "board, half round trip",
            "number": "0 to 2047",
            "answers": len(halves),
            "taken": estimator.taken,
            "least_us": least_us,
            **spread(halves),
        }
    ]


def main() -> None:
    """Measure, and print."""
    rows = []
    for driver in ("xhci_hcd", "ehci-pci", "uhci_hcd"):
        rows += measure(Controller(driver))
    rows += ask_board(int(sys.argv[1]))
    names = ("least_us", "median_us", "spread_us", "range_us")
    print(f"{'':4} {'':24} {'frame number':20} {'least':>8} {'median':>9} {'90 %':>8} {'all':>9}")
    for one in rows:
        figures = " ".join(f"{one.get(name, '-'):>9}" for name in names)
        print(f"{one['controller']:4} {one['way']:24} {one['number']:20} {figures}")
    print(json.dumps(rows))


if __name__ == "__main__":
    main()
