"""The step that every run begins with: is there a host program, and does it speak J2A at all?

What flows in: a host that has connected. What flows out: what it says that it is. Rules: as with
devices, a silent link is a fault of the harness (`HarnessError`), bytes that are wrong are one of
the host; requests of its own before the first job are answered as a device answers them.
"""

from j2a_conformance._judge import Judged
from j2a_conformance._model import HarnessError

from ._case import HostCase
from ._host import Host

__all__ = ["START"]


class Start(HostCase):
    """Waits until the host program connects and calls the opcode 0xE0 for its first job."""

    ID = "host.start"
    EXPECTATION = "Its requests are frames like those of the oracle, one seq after the other."
    REQUIREMENTS = (
        "J2A-FRAME-001",
        "J2A-FRAME-002",
        "J2A-FRAME-004",
        "J2A-FRAME-010",
        "J2A-STUFF-001",
        "J2A-STUFF-002",
        "J2A-SUM-001",
        "J2A-SUM-002",
        "J2A-SEQ-003",
        "J2A-MANY-009",
    )
    LEVEL = "frame"

    def _run(self, host: Host) -> None:
        try:
            host.title = host.outcome("ready").rest
        except Judged as judged:
            lines, _ = host.link.evidence()
            came = any(line.kind in ("received", "sif") for line in lines)
            if came or host.link.unfinished():
                raise
            raise HarnessError(
                f"{judged.reason}. A host program connects and calls the opcode 0xE0 by itself; "
                "a slow one needs a larger --timeout-scale."
            ) from judged


START = Start()
