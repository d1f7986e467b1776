"""Runs QEMU for as long as somebody is at the other end of its standard input.

In: the command line of QEMU, `python3 qemu.py qemu-system-arm -M ... -serial stdio`. Out: its own
input and output, untouched. QEMU goes on when its input ends, and so would stay behind when a host
is gone; here it ends, a moment after the last byte was taken, and without the message that it
prints when it is told to.
Rules: the input is a pipe, a socket or a terminal; no byte passes through here; when QEMU ends by
itself, its exit code is ours. Time in QEMU is that of this machine, and a device that is not run
for 10 ms takes that for a pause inside a frame: QEMU is given precedence where that is allowed.
Its threads, of which one has the bytes and one the processor, share one core of this machine: they
wake each other for each byte, and between two cores that takes longer than all their work.
"""

import array
import contextlib
import fcntl
import os
import select
import signal
import subprocess
import sys
import termios
import time
from pathlib import Path

STDIN = 0
ENDING = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
HUNG_UP_MS = 200  # how often is looked whether QEMU has ended by itself
LAST_WORDS_S = 0.1  # for the device to work on what it took last
LEFT_BEHIND_S = 2.0  # for the device to take what is left
PRECEDENCE = -10  # as nice takes it


def left() -> int:
    """Return how many bytes of the input QEMU has not taken yet."""
    count = array.array("i", [0])
    try:
        fcntl.ioctl(STDIN, termios.FIONREAD, count)
    except OSError:  # neither a pipe nor a terminal
        return 0
    return count[0]


def hung_up(qemu: "subprocess.Popen[bytes]") -> bool:
    """Wait for the end of the input, or of QEMU; return whether it was that of the input."""
    poll = select.poll()
    poll.register(STDIN, 0)  # asked for no event, it tells of a hang-up only
    while qemu.poll() is None:
        if poll.poll(HUNG_UP_MS):
            return True
    return False


def take_precedence() -> None:
    """Ask for the processor before others, which only the administrator is given.

    A device that is kept waiting for longer than the byte timeout sees a pause inside a frame.
    """
    with contextlib.suppress(OSError):
        os.nice(PRECEDENCE)
    # Where Linux shares the processor among sessions, it is a session that has precedence.
    if os.getsid(0) == os.getpid():
        with contextlib.suppress(OSError):
            Path("/proc/self/autogroup").write_text(str(PRECEDENCE))


def stay_on_one_core() -> None:
    """Run on one of the cores that are allowed; other instances probably take others."""
    if hasattr(os, "sched_setaffinity"):
        allowed = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {allowed[os.getpid() % len(allowed)]})


def main() -> int:
    """Run the command line; return the exit code."""
    if len(sys.argv) < 2:
        print("usage: qemu.py qemu-system-... OPTIONS", file=sys.stderr)
        return 2
    # Whoever ends this process ends QEMU, too, and not before it is known here.
    told_to_end: list[int] = []
    for number in ENDING:
        signal.signal(number, lambda given, _: told_to_end.append(given))
    take_precedence()
    stay_on_one_core()
    try:
        qemu = subprocess.Popen(sys.argv[1:])
    except OSError as error:
        print(f"{sys.argv[1]} cannot be run: {error}; install it, or look at PATH", file=sys.stderr)
        return 127
    try:
        for number in ENDING:  # SystemExit gets to the end of this block
            signal.signal(number, lambda *_: sys.exit(0))
        if told_to_end:
            return 0
        if not hung_up(qemu):
            return qemu.returncode if qemu.returncode >= 0 else 1
        end_s = time.monotonic() + LEFT_BEHIND_S
        while left() and time.monotonic() < end_s:
            time.sleep(0.01)
        time.sleep(LAST_WORDS_S)
        return 0
    finally:
        if qemu.poll() is None:
            os.kill(qemu.pid, signal.SIGKILL)
        qemu.wait()


if __name__ == "__main__":
    sys.exit(main())
