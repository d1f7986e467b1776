"""Punctuality for the daemon: what the thesis calls realtimeify (section 6.2.1).

In: nothing. Out: a process whose pages stay in memory, which runs before others, on one processor
that does not sleep deeply. Rules: each measure that the system refuses is told and left out; all
of them are undone at the end.
"""

import contextlib
import ctypes
import errno
import os
import struct
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

__all__ = ["realtime"]

PRIORITY: Final = 50
"""Of SCHED_FIFO: above interrupt threads of the kernel nothing of ours is needed."""
LATENCY_FILE: Final = Path("/dev/cpu_dma_latency")
_MCL_CURRENT_FUTURE: Final = 1 | 2


@contextlib.contextmanager
def realtime() -> Iterator[list[str]]:
    """Ask for punctuality for the calling thread and those that it starts.

    Yields: what the system refused, one text each; empty where it granted everything.
    """
    refused: list[str] = []
    with contextlib.ExitStack() as undo:
        for name, measure in _MEASURES.items():
            try:
                undo.callback(measure())
            except OSError as error:
                refused.append(f"{name}: {error.strerror or error}")
            except AttributeError:
                refused.append(f"{name}: {sys.platform} has no such thing")
        yield refused


def _lock_memory() -> Callable[[], object]:
    import resource  # noqa: PLC0415 - not on every system

    # With a limit, what is allocated later fails: a thread, say.
    before = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    without = (resource.RLIM_INFINITY, resource.RLIM_INFINITY)
    try:
        resource.setrlimit(resource.RLIMIT_MEMLOCK, without)
    except ValueError as error:
        raise PermissionError(errno.EPERM, "the limit of locked memory cannot be raised") from error
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_MCL_CURRENT_FUTURE) != 0:
        number = ctypes.get_errno()
        resource.setrlimit(resource.RLIMIT_MEMLOCK, before)
        raise OSError(number, os.strerror(number))

    def undo() -> None:
        libc.munlockall()
        resource.setrlimit(resource.RLIMIT_MEMLOCK, before)

    return undo


def _run_first() -> Callable[[], object]:
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    return lambda: os.sched_setscheduler(0, policy, parameters)


def _stay_on_one_processor() -> Callable[[], object]:
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(allowed)})  # interrupts are served by the first one as a rule
    return lambda: os.sched_setaffinity(0, allowed)


def _sleep_lightly() -> Callable[[], object]:
    file = os.open(LATENCY_FILE, os.O_WRONLY | os.O_CLOEXEC)
    try:
        os.write(file, struct.pack("=i", 0))
    except BaseException:
        os.close(file)
        raise
    return lambda: os.close(file)  # the system sleeps as before once the file is closed


_MEASURES: Final[dict[str, Callable[[], Callable[[], object]]]] = {
    "memory stays in place (mlockall)": _lock_memory,
    "runs before other programs (SCHED_FIFO)": _run_first,
    "stays on one processor": _stay_on_one_processor,
    f"processors do not sleep deeply ({LATENCY_FILE})": _sleep_lightly,
}
