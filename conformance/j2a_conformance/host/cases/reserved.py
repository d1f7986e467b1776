"""Reserved codes among calls that wait together (J2A-ERR-011)."""

from typing import Final

from j2a_conformance._judge import fail, inform
from j2a_conformance.host._case import HostCase
from j2a_conformance.host._device import ROOMY
from j2a_conformance.host._host import Host

from .limits import serve, together

_RESERVED: Final = (0xF1, *range(0xF5, 0xFF))


class ReservedAmong(HostCase):
    """Answers the later one of two calls that wait by each reserved code, and then once more."""

    ID = "host.error.reserved-among"
    EXPECTATION = "The call has failed: what comes behind the reserved code is no result of it."
    REQUIREMENTS = ("J2A-ERR-011",)
    LEVEL = "core"
    DEVICE = ROOMY

    def _run(self, host: Host) -> None:
        for code in _RESERVED:
            together(host, "01", "02")
            requests = host.waiting(2)
            if len(requests) < 2:
                host.reply(requests[0], 1, requests[0].payload)
                serve(host, 1, host.device.rxbuf)
                host.outcome("reply 1 01 ; reply 1 02")
                inform("the host makes one call at a time")
            first, second = requests
            host.send(second.reply(code, b"") + second.reply(1, second.payload))
            host.reply(first, 1, first.payload)
            parts = host.outcomes(2, wait_ms=host.limit_ms)
            part = parts[second.payload == b"\x02"]
            if part.word != "failed":
                fail(f"`{part.whole}` was reported behind the code 0x{code:02X}")
