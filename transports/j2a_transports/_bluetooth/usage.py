"""`bt:` URLs and their options.

In: nothing.  Out: `OPEN` and `LISTEN`, and the forms of addresses that URLs and options share.
"""

from __future__ import annotations

import re
from typing import Final

from j2a_transports._scheme import Option, Usage
from j2a_transports.options import choice, text, timeout

from .record import SERVICE

ADDRESS: Final = r"[0-9A-Fa-f]{2}(?::[0-9A-Fa-f]{2}){5}"
ADAPTER: Final = rf"{ADDRESS}|hci[0-9]{{1,3}}"


def _adapter(value: str) -> str:
    """the address of an adapter of this machine, or its name, such as hci0."""
    if not re.fullmatch(ADAPTER, value):
        raise ValueError
    return value


_SECURITY: Final = Option(
    "security",
    choice({"LOW": 1, "MEDIUM": 2, "HIGH": 3}),
    "what the link must have: medium is paired and encrypted, high is confirmed by a person too; "
    "Linux",
)
OPEN: Final = Usage(
    "bt://ADDRESS/CHANNEL",
    "a Bluetooth device, on the channel of its serial port",
    ("bt://00:11:22:33:44:55", "bt://00:11:22:33:44:55/1"),
    (
        Option(
            "connect_timeout",
            timeout,
            "time for all of the opening",
            # Two times what an adapter calls a device that does not answer (5.12 s).
            "10",
        ),
        Option("adapter", _adapter, "the Bluetooth controller of this machine to use"),
        Option("service", text, "name of the serial port to take, of several"),
        _SECURITY,
    ),
)
LISTEN: Final = Usage(
    "bt://ADAPTER/CHANNEL",
    "a Bluetooth serial port",
    ("bt:", "bt:///3", "bt://hci0/3"),
    (
        Option("service", text, f"the name to publish, {SERVICE} if it is not given"),
        _SECURITY,
    ),
)
