"""A Linux computer as a USB board that knows the host's time (SyncUSB). Run it as root."""

import contextlib
import struct
import time
from typing import Annotated

import j2a_transports

import j2a

device = j2a.Device({"name": "linux board", "serial": "0001"})
clock = {"ahead_us": 0}


@device.function
def host_time() -> Annotated[j2a.u64, "us"]:
    """Return the time of the host since 1970."""
    return time.time_ns() // 1000 + clock["ahead_us"]


def on_sync(packet: bytes) -> None:
    """Compare the clocks. The packet also has the number of the frame that began."""
    host_us, _frame = struct.unpack("<QH", packet)
    clock["ahead_us"] = host_us - time.time_ns() // 1000


with contextlib.suppress(KeyboardInterrupt):  # Ctrl-C
    device.serve_forever(j2a_transports.UsbGadget(serial="0001", on_sync=on_sync))
