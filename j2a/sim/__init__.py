"""AVR firmware without a board: a cycle-exact simulator behind the J2A transports.

In: an ELF file. Out: a J2A device on a transport. `AvrSim` runs the firmware cycle by cycle and
measures it; `SimLink` is a transport into it whose time is simulated; `run` serves it on a
listener in real time or faster. Needs a C compiler and simavr's library, and nothing of J2A.
"""

from j2a.sim._avr import AvrSim, Counters, OutByte, Span
from j2a.sim._errors import BadProgram, FirmwareStopped, SimError, ToolMissing
from j2a.sim._link import SimLink
from j2a.sim._runner import Runner, run

__all__ = [
    "AvrSim",
    "BadProgram",
    "Counters",
    "FirmwareStopped",
    "OutByte",
    "Runner",
    "SimError",
    "SimLink",
    "Span",
    "ToolMissing",
    "run",
]
