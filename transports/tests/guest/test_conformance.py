"""The conformance suite over the USB and the Bluetooth of the guest's kernel.

j2a-conform runs on this side, because an emulated processor takes ten times as long for what the
suite computes; a relay in the guest opens the board for each of its connections and carries bytes.
"""

import contextlib
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import j2a_transports
import pytest
from j2a_conformance.device import load
from j2a_transports import LinkClosed, Listener

from .conftest import ROOT, SCRIPT
from .relay import join
from .test_links import FIRMWARE, served

pytestmark = [pytest.mark.guest, pytest.mark.exhaustive]
PATIENCE_S = 420
PARTS = 5
LONGEST = "frame.lengths"
# Pauses of nearly 9 ms between two bytes, which become longer when the emulated processor has to
# wait for its turn. These devices are asked for them over links without such a processor.
SHORT_PAUSES = {"timing.short-pause", "timing.trickle", "timing.trickle-long", "frame.pieces"}

# Thousands of frames that try the receiver, to which it is all the same by which link they came.
OF_THE_RECEIVER = {
    "frame.interrupted-anywhere",
    "frame.sos-to-device",
    "stuff.escape-ff-anywhere",
    "timing.gives-up-long",
    "timing.pause-in-long-frame",
}


def couple(programs: Listener, relays: Listener, ready: threading.Event) -> None:
    """Join each program's connection with one of the relay, until a listener is closed."""
    with contextlib.suppress(LinkClosed):
        while True:
            relay = relays.accept(None)
            assert relay is not None
            ready.set()
            with relay:
                program = programs.accept(None)
                assert program is not None
                join(program, relay)


@contextmanager
def relayed(link: str) -> Iterator[str]:
    """Make a link of the guest a TCP server on this side; yields its URL."""
    with (
        j2a_transports.listen("tcp://127.0.0.1:0") as programs,
        j2a_transports.listen("tcp://127.0.0.1:0") as relays,
    ):
        ready = threading.Event()
        threading.Thread(target=couple, args=(programs, relays, ready), daemon=True).start()
        port = relays.url.rpartition(":")[2]
        inside = ("python", "transports/tests/guest/relay.py", link, port)
        command = [sys.executable, SCRIPT, f"--timeout={PATIENCE_S}", "--", *inside]
        with subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
        ) as guest:
            try:
                assert ready.wait(PATIENCE_S)
                yield programs.url
            finally:
                guest.terminate()
                print(guest.communicate(timeout=60)[0].decode())


def conform(url: str, *arguments: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "j2a_conformance", "run", url, *arguments],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        timeout=PATIENCE_S,
    )
    print(done.stdout, done.stderr)
    assert done.returncode == 0
    assert "is conformant" in done.stdout


def part(number: int) -> list[str]:
    """Return the ids of the cases of one of PARTS runs, none of which takes too long."""
    left_out = {LONGEST, *SHORT_PAUSES, *OF_THE_RECEIVER}
    cases = [case.ID for case in load() if case.ID not in left_out]
    return [LONGEST] if number == 0 else cases[number - 1 :: PARTS - 1]


@pytest.mark.requirement("USB-007", "USB-014", "USB-009", "USB-010")
@pytest.mark.timeout(2 * PATIENCE_S + 60)
@pytest.mark.parametrize("number", range(PARTS))
@pytest.mark.parametrize("link", ["bt", pytest.param("usbip", marks=pytest.mark.avr)])
def test_the_suite(guest, need, link, number, build_firmware):
    with contextlib.ExitStack() as stack:
        if link == "bt":
            need("btvirt")
        if link == "usbip":
            link += f":{stack.enter_context(served(build_firmware(**FIRMWARE)))}"
        # A batch of 2 KiB over RFCOMM meets a pause of a starved emulator nearly every time.
        lossy = ["--lossy", "20"] if (link, number) == ("bt", 0) else []
        conform(stack.enter_context(relayed(link)), *lossy, "--case", *part(number))
