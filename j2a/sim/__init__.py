"""AVR firmware without a board: a cycle-exact simulator behind the J2A transports.

In: an ELF file. Out: a J2A device on a transport. `AvrSim` runs the firmware cycle by cycle, drives
and watches its pins, and measures it; `SimLink` is a transport into it whose time is simulated;
`run` serves it on a listener in real time or faster. Needs a C compiler and simavr's library, and
nothing of J2A.
"""

from j2a.sim._avr import AvrSim
from j2a.sim._errors import BadProgram, FirmwareStopped, SimError, ToolMissing
from j2a.sim._link import SimLink
from j2a.sim._pins import Adc, Pins
from j2a.sim._records import Counters, Edge, Interrupts, OutByte, Pulse, Span, pulses
from j2a.sim._runner import Runner, run

__all__ = [
    "Adc",
    "AvrSim",
    "BadProgram",
    "Counters",
    "Edge",
    "FirmwareStopped",
    "Interrupts",
    "OutByte",
    "Pins",
    "Pulse",
    "Runner",
    "SimError",
    "SimLink",
    "Span",
    "ToolMissing",
    "pulses",
    "run",
]
