"""`j2a syncd` with two boards of a USB/IP server: run in the guest by test_syncd.py.

In: the port of the server on the host, and the serial numbers of its boards. Out: a line for each
thing that is so; an assertion error and a bad exit code else.
Rules: udev starts the first daemon, by the files that `j2a setup syncd` installs; each wait has a
deadline, and no figure of time is judged.
"""

import contextlib
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import j2a
from j2a.syncd.singleton import NotRunning, ask, folders
from j2a.syncd.system import WRAPPER_PLACE

from .attach import Refused, attach, detach, device, wait_gone

HOST = "10.0.2.2"
PATIENCE_S = 600.0
NOBODY = 65534
INTERVAL = "0.05"
STATUS = {"command": "status"}


def until(condition: Callable[[], Any], what: str) -> Any:
    """Wait for what other processes do; returns what the condition does."""
    end = time.monotonic() + PATIENCE_S
    while not (found := condition()):
        assert time.monotonic() < end, f"{what}: {status()}, processes {daemons()}"
        time.sleep(0.1)
    return found


def status() -> dict[str, Any]:
    """Return the status of the daemon, an empty one where none runs."""
    (folder,) = folders()
    with contextlib.suppress(NotRunning):
        return ask(folder, STATUS)
    return {"pid": None, "boards": []}


def fed(*serials: str) -> bool:
    """Whether these boards, and no others, are there, and each has got a packet.

    The frames of a simulated board may come in bursts, so a board may have to wait in between.
    """
    boards = status()["boards"]
    return {one["board"] for one in boards if one["packets"] and one["tells_frames"]} == set(
        serials
    ) and len(boards) == len(serials)


def daemons() -> list[int]:
    """Return the processes that run syncd."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            words = (folder / "cmdline").read_bytes().split(b"\0")
            if b"syncd" in words and any(word.endswith(b"/j2a") for word in words):
                found.append(int(folder.name))
    return found


def writable_etc() -> None:
    """Lay a copy over /etc, whose files belong to the host and are read-only here."""
    for words in (["cp", "-a", "/etc", "/run/etc"], ["mount", "--bind", "/run/etc", "/etc"]):
        subprocess.run(["busybox", *words], check=True)


def start_udev() -> None:
    """Install both rules as a user does, and start udev."""
    for part in ("udev", "syncd"):
        subprocess.run(["j2a", "setup", part], check=True, stdout=subprocess.DEVNULL)
    # As a user may; frames of simulated boards are even enough for moments only.
    text = WRAPPER_PLACE.read_text("utf-8")
    assert text.endswith("syncd --daemon --interval 1\n"), text
    WRAPPER_PLACE.write_text(text.replace("--interval 1", f"--interval {INTERVAL}"), "utf-8")
    subprocess.run(["/lib/systemd/systemd-udevd", "--daemon", "--resolve-names=early"], check=True)


def owner(pid: int) -> tuple[int, set[int]]:
    """Return the user of a process, and its groups."""
    text = Path(f"/proc/{pid}/status").read_text("utf-8")
    fields = dict(line.split(":", 1) for line in text.splitlines())
    return int(fields["Uid"].split()[1]), set(map(int, fields["Groups"].split()))


def second_instance(pid: int) -> None:
    """Another daemon tells the first one, and ends."""
    done = subprocess.run(["j2a", "syncd"], check=True, capture_output=True, text=True)
    assert re.search(rf"runs already \(process {pid}\) and looks for boards", done.stdout), done
    assert until(lambda: daemons() == [pid], f"one daemon, not {daemons()}")
    assert status()["pid"] == pid


def clocks(*serials: str) -> None:
    """Programs have the links meanwhile, and see clocks that were set."""
    for serial in serials:
        with j2a.connect(f"usb://{serial}", timeout=30, boot_time=60) as board:
            assert board.echo(b"beside") == b"beside"
            state = until(lambda board=board: board.clock.status(), "status")
            assert state.epoch > 0, state
            assert state.state.name != "FREE", state


def ended(pid: int) -> None:
    """SIGTERM ends a daemon; the next one may begin."""
    # One that udev has just started would take its place.
    settle = ["udevadm", "settle", f"--timeout={PATIENCE_S:.0f}"]
    subprocess.run(settle, check=True, env={**os.environ, "SYSTEMD_IGNORE_CHROOT": "1"})
    until(lambda: daemons() == [pid], "one daemon")
    os.kill(pid, signal.SIGTERM)
    until(lambda: not daemons(), f"{pid} has ended")
    assert status()["pid"] is None


def main() -> None:
    """Run the daemon through its life."""
    port, *serials = sys.argv[1:]
    one, other = serials
    writable_etc()
    start_udev()
    assert not daemons()
    hub_ports = {
        serial: attach(HOST, int(port), f"1-{number}") for number, serial in enumerate(serials, 1)
    }
    until(lambda: fed(*serials), "both boards get the time")
    pid = status()["pid"]
    user, groups = owner(pid)
    assert user == NOBODY, user
    assert len(groups) == 1, groups
    # The rule has started syncd once for each board.
    until(lambda: daemons() == [pid], "one daemon")
    print("good: started by udev", flush=True)

    second_instance(pid)
    print("good: a second one notifies", flush=True)
    clocks(*serials)
    print("good: links are free", flush=True)

    folder = device(one)
    detach(hub_ports[one])
    wait_gone(folder)
    until(lambda: fed(other), "the other board alone")
    print("good: unplugged", flush=True)
    until(lambda: attached(port, hub_ports, one), "attached again")
    until(lambda: fed(*serials), "both again")
    assert status()["pid"] == pid
    print("good: plugged again", flush=True)

    ended(pid)
    print("good: ended by SIGTERM", flush=True)
    with subprocess.Popen(["j2a", "syncd", "--interval", INTERVAL, "-v"]) as daemon:
        until(lambda: fed(*serials), "a daemon in the foreground")
        daemon.send_signal(signal.SIGTERM)
        assert daemon.wait(60) == 0, daemon.returncode
    assert not daemons()
    print("good: another one", flush=True)


def attached(port: str, hub_ports: dict[str, int], serial: str) -> bool:
    """Attach the first board again, as soon as the server sees that it was let go."""
    try:
        hub_ports[serial] = attach(HOST, int(port), "1-1")
    except Refused:
        return False
    return True


if __name__ == "__main__":
    main()
