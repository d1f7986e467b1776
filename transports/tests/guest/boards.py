"""Simulated boards of this process, whose frames a guest takes for those of a clock.

In: firmware. Out: the simulators, and the port of the USB/IP server that exports them.
Rules: frames have to be 1 ms of real time apart, so boards make up for delays of a busy computer,
and the emulated guest, which takes all the time that it gets, is nicer than they are.
"""

import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from j2a_sim import AvrSim, UsbipServer, _pace

MCU = "atmega32u4"
FIRMWARE = {"port": "avr-usb", "MCU": MCU, "OPTIONS": "-DJ2A_WITH_SYNC=1"}
MAX_LAG_S = 5.0
NICENESS = 5
END_S = 60


@contextmanager
def exported(*elfs: Path) -> Iterator[tuple[int, list[AvrSim]]]:
    """Export boards; yields the port of the server, and the boards."""
    with ExitStack() as stack:
        patch = stack.enter_context(pytest.MonkeyPatch.context())
        patch.setattr(_pace, "MAX_LAG_S", MAX_LAG_S)
        sims = [stack.enter_context(AvrSim(elf, MCU)) for elf in elfs]
        server = UsbipServer(sims, port=0)
        stop = threading.Event()
        thread = threading.Thread(target=server.serve, args=[stop])
        thread.start()
        try:
            yield server.port, sims
        finally:
            stop.set()
            thread.join(END_S)
            assert not thread.is_alive()


def nicely(guest: Callable[..., Any], *command: str, **options: Any) -> Any:
    """Run a command in the guest, whose processes yield to the threads of this one."""

    def be_nice() -> None:  # of this thread, and of the processes that it starts
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICENESS)

    with ThreadPoolExecutor(1, initializer=be_nice) as pool:
        return pool.submit(guest, *command, **options).result()
