"""What tells the number of a USB frame to a program: the table of docs/syncd.md.

`pytest -s` shows it. What is there at all is judged, and no figure of time: the controllers are
emulated.
"""

import json

import pytest

from .boards import FIRMWARE, exported, nicely

pytestmark = [pytest.mark.guest, pytest.mark.avr, pytest.mark.exhaustive]

PATIENCE_S = 900
QEMU = " ".join(
    (
        "-audiodev none,id=silent",
        "-device qemu-xhci,id=x -device usb-tablet,bus=x.0",
        "-device usb-audio,audiodev=silent,bus=x.0",
        "-device usb-ehci,id=e -device usb-tablet,bus=e.0",
        "-device piix3-usb-uhci,id=u -device usb-tablet,bus=u.0,usb_version=1",
        "-device usb-audio,audiodev=silent,bus=u.0",
    )
)


@pytest.mark.timeout(PATIENCE_S + 120)
@pytest.mark.requirement("SYNC-008")
def test_who_tells_the_frame(guest, build_firmware):
    with exported(build_firmware("demo", SERIAL="FRAMES", **FIRMWARE)) as (port, _):
        command = ("python", "-m", "transports.tests.guest.frame_number", str(port))
        done = nicely(guest, *command, timeout=PATIENCE_S, qemu=QEMU)
    *table, last = done.stdout.splitlines()
    print("\n".join(table))
    rows = {(one["controller"], one["way"]): one for one in json.loads(last)}
    assert {controller for controller, _ in rows} == {"xhci", "ehci", "uhci", "vhci"}
    for controller in ("xhci", "uhci"):
        # The kernel knows the frame of an isochronous transfer, and does not hand it back.
        assert rows[controller, "usbfs, start_frame"]["number"] == "as submitted"
        assert rows[controller, "usbmon, start_frame"]["number"].startswith("0 to ")
    assert rows["vhci", "board, half round trip"]["answers"] > 100
