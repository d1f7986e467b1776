"""Two Bluetooth controllers for jobs in the test guest, and BlueZ with its service discovery.

In: the guest's kernel with its Bluetooth modules, and the programs of BlueZ.  Out: controllers that
are up and reach each other by radio waves that exist in one process only (btvirt).
Rules: what is started ends with its block; everything is written below /run.
"""

import contextlib
import fcntl
import socket
import struct
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from j2a_transports._bluetooth import sockets

HCIDEVUP, HCIDEVDOWN, HCIDEVRESET, HCISETSCAN = 0x400448C9, 0x400448CA, 0x400448CB, 0x400448DD
HCIGETDEVINFO = 0x800448D3
PAGE_AND_INQUIRY_SCAN = 3
PAGE_SCAN_FLAG = 1 << 3
PATIENCE_S = 60.0


def until(condition: Callable[[], object], what: str) -> None:
    """Wait until something is so."""
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, f"not in {PATIENCE_S} s: {what}"
        time.sleep(0.02)


@contextlib.contextmanager
def program(*command: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run a program for as long as the block lasts; what it says goes to a file in /run."""
    with Path(f"/run/{Path(command[0]).name}.log").open("wb") as log:
        running = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT
        )
    try:
        yield running
    finally:
        running.terminate()
        running.wait()


def control(request: int, index: int, option: int | None = None) -> None:
    """Tell the kernel to switch a controller up, down, or what it answers to (as root)."""
    argument = index if option is None else struct.pack("=HxxI", index, option)
    with socket.socket(31, socket.SOCK_RAW, 1) as sock:
        fcntl.ioctl(sock, request, argument)


def up(index: int) -> None:
    """Switch a controller on, and let others find and connect it."""
    # A new one is up for its first two seconds, and this keeps it so.
    with contextlib.suppress(BlockingIOError):
        control(HCIDEVUP, index)
    control(HCISETSCAN, index, PAGE_AND_INQUIRY_SCAN)


def down(index: int) -> None:
    """Switch a controller off, as an unplugged one or one out of power."""
    control(HCIDEVDOWN, index)


def answers(index: int) -> bool:
    """Whether a controller answers those that want to connect."""
    info = bytearray(struct.pack("=H", index) + bytes(254))
    with socket.socket(31, socket.SOCK_RAW, 1) as sock:
        fcntl.ioctl(sock, HCIGETDEVINFO, info)
    return bool(struct.unpack_from("=I", info, 16)[0] & PAGE_SCAN_FLAG)


@contextlib.contextmanager
def controllers() -> Iterator[list[str]]:
    """Make two controllers, hci0 and hci1, both up; yields their addresses."""
    with program("btvirt", "-l2"):
        until(lambda: len(sockets.adapters()) == 2, "two controllers")
        for index in (0, 1):
            up(index)
        yield [adapter.address for adapter in sockets.adapters()]


@contextlib.contextmanager
def bluez() -> Iterator[None]:
    """Run BlueZ with its local socket for service records, on a message bus of its own."""
    Path("/run/dbus").mkdir(exist_ok=True)
    bus = "unix:path=/run/dbus/system_bus_socket"
    with (
        program("dbus-daemon", "--system", "--nofork", "--nopidfile", f"--address={bus}"),
        contextlib.ExitStack() as stack,
    ):
        until(lambda: Path("/run/dbus/system_bus_socket").exists(), "the message bus")
        stack.enter_context(program("/usr/libexec/bluetooth/bluetoothd", "--nodetach", "--compat"))
        until(lambda: Path("/run/sdp").exists(), "bluetoothd")
        # At its start BlueZ takes that away, as the last thing that it does to a controller.
        until(lambda: not answers(0) and not answers(1), "controllers in the hands of BlueZ")
        for index in (0, 1):
            up(index)
        yield


@contextlib.contextmanager
def agent() -> Iterator[None]:
    """Confirm every pairing that needs no number to be compared."""
    with subprocess.Popen(
        ["bluetoothctl", "--agent", "NoInputNoOutput"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        bufsize=0,
    ) as running:
        assert running.stdin is not None
        assert running.stdout is not None
        said = b""
        for word, answer in ((b"", b"Agent registered"), (b"default-agent\n", b"successful")):
            running.stdin.write(word)
            while answer not in said:
                more = running.stdout.read(4096)
                assert more, said
                said += more
        try:
            yield
        finally:
            running.terminate()
