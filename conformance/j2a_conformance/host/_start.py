"""The step that every run begins with: is there a host program, and does it speak J2A at all?"""

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
    )
    LEVEL = "frame"

    def _run(self, host: Host) -> None:
        host.title = host.outcome("ready").rest


START = Start()
