"""A device in Python. Takes the URL to listen at, and serves until it is interrupted."""

import contextlib
import struct
import sys
from typing import Annotated

import j2a_transports

import j2a

if len(sys.argv) != 2:
    sys.exit(f"usage: python {sys.argv[0]} URL")

device = j2a.Device({"name": "thermometer", "serial": "0042"})


@device.function
def temperature() -> Annotated[j2a.f32, "Cel"]:
    """Return the temperature."""
    return 21.5


@device.many
def history(request: j2a.ManyRequest) -> j2a.ManyReply:
    """Return all temperatures so far, more than one frame holds."""
    return j2a.read_chunk(struct.pack("<200f", *range(200)), request)


with j2a_transports.listen(sys.argv[1]) as listener:
    print("listening on", listener.url, flush=True)
    with contextlib.suppress(KeyboardInterrupt):  # Ctrl-C
        device.serve_forever(listener)
