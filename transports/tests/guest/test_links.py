"""One client over each link of the guest: the simulated ATmega32U4, a gadget, and RFCOMM.

What client.py asks of each of them is the same. The simulated chip is on this side, behind a
USB/IP server; all that is between it and the client is the guest's kernel.
"""

import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

pytestmark = pytest.mark.guest
CLIENT = ("python", "transports/tests/guest/client.py")
FIRMWARE = {"port": "avr-usb", "app": "demo", "MCU": "atmega32u4"}
PATIENCE_S = 840
LINKS = [
    "gadget",
    "bt",
    pytest.param("usbip", marks=pytest.mark.avr),
]


@contextmanager
def served(*elfs: Path) -> Iterator[int]:
    """Simulate boards behind a USB/IP server; yields its port."""
    command = [sys.executable, "-m", "j2a", "sim", "usb", *elfs, "--usbip", "127.0.0.1:0"]
    with subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True
    ) as server:
        try:
            assert server.stdout is not None
            yield int(server.stdout.readline().rpartition(":")[2])
        finally:
            server.terminate()
            server.communicate(timeout=60)


@pytest.fixture
def named(
    need: Callable[[str], None], build_firmware: Callable[..., Path]
) -> Iterator[Callable[[str], str]]:
    """named("usbip") returns what client.py calls that link, with what it needs on this side."""
    running = []

    def name(link: str) -> str:
        if link == "bt":
            for tool in ("btvirt", "hcitool"):
                need(tool)
        if link != "usbip":
            return link
        server = served(build_firmware(**FIRMWARE))
        running.append(server)
        return f"usbip:{server.__enter__()}"

    yield name
    for server in running:
        server.__exit__(None, None, None)


def good(output: str) -> list[str]:
    return [line.split()[1].rstrip(",") for line in output.splitlines() if "good: " in line]


@pytest.mark.exhaustive
@pytest.mark.timeout(PATIENCE_S + 60)
@pytest.mark.requirement("USB-011", "USB-012", "USB-013")
@pytest.mark.parametrize(
    "link",
    # In `make test`, test_usb.py, test_usbip.py and test_bluetooth.py have calls and ends of each.
    [
        "gadget",
        "bt",
        pytest.param("usbip", marks=pytest.mark.avr),
    ],
)
def test_calls_and_ends(guest, named, link):
    """Enumeration, strings, function map, properties, transfers, SIFs, time-outs, 2048 echoes.

    Then unplugged in mid call, plugged in again, reset, and that twice.
    """
    bus = [] if link == "bt" else ["bus"]
    done = guest(*CLIENT, named(link), *bus, "calls", "ends", timeout=PATIENCE_S)
    calls = ["function_map", "properties", "transfers", "sifs", "timeouts", "echoes"]
    twice = ["unplugged", "plugged_again"]
    ends = [*twice, "reset", *twice, "many_connections"]
    assert good(done.stdout) == ["enumeration"] * len(bus) + calls + ends


@pytest.mark.exhaustive
@pytest.mark.parametrize("link", LINKS)
def test_a_megabyte(guest, named, link):
    assert good(guest(*CLIENT, named(link), "megabyte", timeout=900).stdout) == ["megabyte"]


@pytest.mark.exhaustive
@pytest.mark.avr
@pytest.mark.requirement("USB-002", "USB-010")
def test_two_boards_by_serial_number(guest, build_firmware):
    """One of them is busy and takes no bytes; the other is not delayed by that."""
    serials = ["left", "right"]
    with served(*(build_firmware(**FIRMWARE, SERIAL=serial) for serial in serials)) as port:
        done = guest(
            "python", "transports/tests/guest/two_boards.py", str(port), *serials, timeout=840
        )
    assert done.stdout.count("good: ") == 3


@pytest.mark.exhaustive
@pytest.mark.avr
@pytest.mark.requirement("USB-002")
def test_what_programs_see(guest, build_firmware):
    """`j2a list` of a gadget and the simulated chip; a kernel driver is replaced and comes back."""
    with served(build_firmware(**FIRMWARE)) as port:
        done = guest("python", "transports/tests/guest/programs.py", str(port), timeout=900)
    assert done.stdout.count("good: ") == 2
