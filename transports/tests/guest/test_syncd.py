"""The daemon `j2a syncd` in a Linux kernel of its own, with two simulated boards over USB/IP.

In: two ATmega32U4 with the firmware of avr-usb, here, and all else in the guest. Out: what the
guest says, and the packets that came to the endpoints SyncUSB of the boards.
Rules: nothing is said of accuracy, because the guest and the boards run as the host lets them.
"""

import time
from pathlib import Path

import pytest
from j2a_sim._usb.driver import UsbHost
from j2a_spec import constants as c
from j2a_spec import usb

from .boards import FIRMWARE, exported, nicely

pytestmark = [pytest.mark.guest, pytest.mark.avr, pytest.mark.exhaustive]

SERIALS = ("left", "right")
PATIENCE_S = 2400
FEW = 8
MARGIN_S = 60
"""The guest reads its clock from one that tells whole seconds."""


@pytest.fixture
def packets(monkeypatch):
    """What is sent to SyncUSB: for each board, the packets and the frames in which they came."""
    found = {}
    submit = UsbHost.submit

    def spy(host, transfer):
        if transfer.endpoint == c.SYNCUSB_OUT:
            found.setdefault(host.sim, []).append((bytes(transfer.data), host.sim.usb.frame))
        submit(host, transfer)

    monkeypatch.setattr(UsbHost, "submit", spy)
    return found


@pytest.mark.timeout(PATIENCE_S + 120)
@pytest.mark.requirement("SYNC-001", "SYNC-002", "SYNC-006", "SYNC-008")
def test_the_daemon_and_two_boards(guest, build_firmware, missing, packets):
    if not Path("/lib/systemd/systemd-udevd").exists():
        missing("systemd-udevd is missing: install the package udev")
    began_s = time.time()
    elfs = [build_firmware("demo", SERIAL=serial, **FIRMWARE) for serial in SERIALS]
    with exported(*elfs) as (port, sims):
        command = ("python", "-m", "transports.tests.guest.inside_syncd", str(port))
        done = nicely(guest, *command, *SERIALS, timeout=PATIENCE_S)
        print(done.stdout)
        assert [line for line in done.stdout.splitlines() if line.startswith("good: ")] == [
            "good: started by udev",
            "good: a second one notifies",
            "good: links are free",
            "good: unplugged",
            "good: plugged again",
            "good: ended by SIGTERM",
            "good: another one",
        ]
        for sim in sims:
            check_packets(packets[sim], began_s)


def check_packets(packets, began_s):
    """Each is what the thesis says, to the byte: the time in 64 bits and a frame in 16 bits."""
    assert len(packets) >= FEW
    frames = []
    for data, _ in packets:
        time_us, frame = int.from_bytes(data[:8], "little"), int.from_bytes(data[8:], "little")
        assert len(data) == c.SYNCUSB_SIZE
        assert data == usb.sync.build({"time_us": time_us, "frame": frame})
        assert began_s - MARGIN_S < time_us / 1e6 < time.time() + MARGIN_S
        assert frame < c.CLOCK_FRAME_NUMBERS
        frames.append(frame)
    assert len(set(frames)) > FEW / 2, frames
    # The number is that of a frame of this board, some frames ago, or soon if the board was late.
    half = c.CLOCK_FRAME_NUMBERS // 2
    ages = [
        (seen - frame + half) % c.CLOCK_FRAME_NUMBERS - half
        for (_, seen), frame in zip(packets, frames, strict=True)
    ]
    print("frames between a frame and its packet:", sorted(ages))
    assert sum(abs(age) < half // 2 for age in ages) > 0.75 * len(ages)
