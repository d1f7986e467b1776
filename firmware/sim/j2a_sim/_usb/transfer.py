"""One transfer on the simulated bus, and the standard requests that a host has to know of.

In: what is to be sent or read. Out: what became of it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

# bRequest of standard requests, USB 2.0 table 9-4.
CLEAR_FEATURE: Final = 1
SET_ADDRESS: Final = 5
GET_DESCRIPTOR: Final = 6
SET_CONFIGURATION: Final = 9
SET_INTERFACE: Final = 11


@dataclass(eq=False, slots=True)
class Transfer:
    """One transfer, and what became of it.

    Attributes:
        endpoint: its address, with bit 7 towards the host; 0 for a control transfer.
        data: what goes to the device.
        length: how many bytes may come from the device.
        setup: the 8 bytes of a control transfer.
        zero_packet: whether a packet of no bytes follows when the last one is full.
        timeout_s: simulated seconds after which it is given up; None: never.
        on_done: called when it is done, by the thread that runs the simulator; must not wait.
        status: "" while it is under way, then "ok", "stall", "no_answer", "overflow", "cancelled",
            "timeout", "invalid", "unplugged", or "stopped" (so is the firmware).
        received: what has come from the device.
        transferred: bytes that went either way.
        number: the bus's id of it.
        deadline: the cycle at which it is given up.
        fate: the status that it gets when it is cancelled.
    """

    endpoint: int
    data: bytes = b""
    length: int = 0
    setup: bytes = b""
    zero_packet: bool = False
    timeout_s: float | None = None
    on_done: Callable[[Transfer], None] | None = None
    status: str = ""
    received: bytes = b""
    transferred: int = 0
    number: int = -1
    deadline: float = float("inf")
    fate: str = ""
