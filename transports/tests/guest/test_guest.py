"""tools/guest.py: a command in a Linux kernel of its own, and what comes back."""

import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from .conftest import ROOT, SCRIPT

pytestmark = pytest.mark.guest
# What it can load is there.
LOADED = """
set -e
test -e /dev/vhci                                  # Bluetooth controllers
test -e /sys/devices/platform/vhci_hcd.0/attach    # devices of USB/IP servers
test -e /sys/class/udc/dummy_udc.0                 # a gadget with its own host controller
test -d /sys/kernel/config/usb_gadget
grep -q '^usb_f_fs ' /proc/modules
test -e /sys/bus/usb-serial/drivers/generic
exec "$@"
"""
# Echoes a line of the host, at the address that stands for it.
JOB = """
import os, pathlib, socket, sys
port, outside = sys.argv[1:]
with socket.create_connection(("10.0.2.2", int(port)), 30) as link:
    link.sendall(link.recv(100).upper())
for folder in ("/tmp", "/run", "/dev/shm"):
    pathlib.Path(folder, "written").write_text("x")
for folder in (".", "/etc"):
    try:
        pathlib.Path(folder, "written").write_text("x")
    except OSError as error:
        print(error.strerror)
assert pathlib.Path("pyproject.toml").read_text() == pathlib.Path(outside).read_text()
assert sys.executable.startswith(os.getcwd())
print(os.uname().release != pathlib.Path("/proc/sys/kernel/osrelease").read_text())
os.write(1, b"no line end: \\xc3\\xa4")
sys.exit(7)
"""


@pytest.mark.exhaustive
def test_a_command_has_all_modules_and_sees_the_host_and_its_code_comes_back(guest):
    """All in one boot, which takes as long as all the rest of this file."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(90)
        answers = []

        def serve():
            with server.accept()[0] as link:
                link.sendall(b"hello")
                answers.append(link.recv(100))

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        port = server.getsockname()[1]
        job = ("python", "-c", JOB, str(port), str(ROOT / "pyproject.toml"))
        done = guest("sh", "-c", LOADED, "sh", *job, code=7)
        thread.join(30)
    assert answers == [b"HELLO"]
    lines = done.stdout.splitlines()
    assert lines == ["Read-only file system"] * 2 + ["True", "no line end: ä"]
    assert done.stderr == ""
    assert not (ROOT / "written").exists()


@pytest.mark.exhaustive
def test_a_job_that_does_not_end_is_ended(guest):
    done = guest("sh", "-c", "echo begun; sleep 1000", timeout=15, code=124)
    assert done.stdout == "begun\n"
    assert "guest: no end after 15 s: killed" in done.stderr


@pytest.mark.exhaustive
def test_a_kernel_that_dies_is_told(guest):
    done = guest("sh", "-c", "echo c >/proc/sysrq-trigger", code=125)
    assert "QEMU has ended early" in done.stderr
    assert "sysrq triggered crash" in done.stderr


def _is_qemu(pid):
    try:
        return Path(f"/proc/{pid}/comm").read_text().startswith("qemu")
    except OSError:  # it has ended
        return False


def test_a_qemu_that_is_killed_is_no_time_out(guest):
    """As the kernel does when memory runs out."""
    command = [sys.executable, SCRIPT, "--timeout=60", "--", "sleep", "60"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as started:
        children = Path(f"/proc/{started.pid}/task/{started.pid}/children")
        deadline = time.monotonic() + 300
        # Where the kernel is not there yet, others of its children fetch it before.
        while not (qemu := [one for one in children.read_text().split() if _is_qemu(one)]):
            assert time.monotonic() < deadline
            time.sleep(0.05)
        os.kill(int(qemu[0]), signal.SIGKILL)
        assert b"QEMU has ended early, exit code -9" in started.communicate(timeout=30)[1]
        assert started.returncode == 125


@pytest.mark.exhaustive
def test_a_repository_below_tmp_is_there(guest, tmp_path):
    (tmp_path / "tools").mkdir()
    for path in SCRIPT.parent.glob("guest*"):
        if path.is_file():
            shutil.copy(path, tmp_path / "tools")
    (tmp_path / "mark").write_text("here\n")
    done = subprocess.run(
        [sys.executable, tmp_path / "tools/guest.py", "--", "sh", "-c", "pwd; cat mark; ls /tmp"],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split()[:2] == [str(tmp_path), "here"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_a_signal_ends_qemu_too(guest, number):
    killed_with_its_qemu(number, os.environ)


def test_a_kill_before_qemu_has_begun_ends_it_too(guest, tmp_path):
    """Before `setpriv` has asked the kernel for that."""
    slow = tmp_path / "setpriv"
    slow.write_text(f'#!/bin/sh\nsleep 1\nexec {shutil.which("setpriv")} "$@"\n')
    slow.chmod(0o755)
    killed_with_its_qemu(signal.SIGKILL, {**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}"})


def killed_with_its_qemu(number, environment):
    started = subprocess.Popen(
        [sys.executable, SCRIPT, "--", "sleep", "1000"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=environment,
    )
    try:
        deadline = time.monotonic() + 60
        children = Path(f"/proc/{started.pid}/task/{started.pid}/children")
        while not (child := children.read_text().split()):
            assert time.monotonic() < deadline
            time.sleep(0.05)
        started.send_signal(number)
        assert started.wait(30) == (-number if number == signal.SIGKILL else 128 + number)
        assert started.stderr.read() == b""
        while Path(f"/proc/{child[0]}").exists():
            assert time.monotonic() < deadline
            time.sleep(0.05)
    finally:
        started.kill()
        started.communicate()
