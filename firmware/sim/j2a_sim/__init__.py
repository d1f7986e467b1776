"""AVR firmware without a board: a cycle-exact simulator behind the J2A transports.

In: an ELF file. Out: a J2A device on a transport. `AvrSim` runs the firmware cycle by cycle, drives
and watches its pins, and measures it; `SimLink` is a transport into it whose time is simulated;
`run` serves it on a listener in real time or faster. A chip with USB has a bus, `AvrSim.usb`; over
it go `UsbLink`, a transport like `SimLink`, `SimBackend`, for programs that use pyusb, and
`UsbipServer`, for operating systems. Needs a C compiler and simavr's library, and knows no frame of
J2A.
"""

# Where what is:
#   chip/                      C around simavr: UART, pins, USB controller and the host at its cable
#   _build, _core, _avr        compiles it; one chip: memory and time; with its wires, AvrSim
#   _elf, _pins, _records      the program; pins and ADC; what measurements return
#   _timed_link, _link         transports in simulated time: what they share, and the UART's
#   _usb/                      AvrSim.usb and what is on top of it:
#     port, bus, records       the port and its transfers; blocking calls, UsbBus; what they return
#     descriptors, link        descriptors as fields; the transport
#     driver, transfer         UsbHost: one UsbBus for several threads, and what they hand to it
#     backend                  pyusb's backend
#   _usbip/                    the USB/IP server on UsbHost
#   _runner, _pace, _command   a UART on a listener; real time; `j2a sim`

from typing import TYPE_CHECKING, Any

from j2a_sim._avr import AvrSim, chip_serial
from j2a_sim._errors import BadProgram, FirmwareStopped, SimError, ToolMissing
from j2a_sim._link import SimLink
from j2a_sim._pins import Adc, Pins
from j2a_sim._records import Counters, Edge, Interrupts, OutByte, Pulse, Span, pulses
from j2a_sim._runner import Runner, run
from j2a_sim._twi import Twi
from j2a_sim._usb.link import UsbLink
from j2a_sim._usb_bus.bus import UsbBus
from j2a_sim._usb_bus.records import (
    Completion,
    UsbCounters,
    UsbDescriptors,
    UsbError,
    UsbNoAnswer,
    UsbStall,
    UsbTimeout,
)
from j2a_sim._usbip.run import run_usbip
from j2a_sim._usbip.server import UsbipServer

if TYPE_CHECKING:
    from j2a_sim._usb.backend import SimBackend

__all__ = [
    "Adc",
    "AvrSim",
    "BadProgram",
    "Completion",
    "Counters",
    "Edge",
    "FirmwareStopped",
    "Interrupts",
    "OutByte",
    "Pins",
    "Pulse",
    "Runner",
    "SimBackend",
    "SimError",
    "SimLink",
    "Span",
    "ToolMissing",
    "Twi",
    "UsbBus",
    "UsbCounters",
    "UsbDescriptors",
    "UsbError",
    "UsbLink",
    "UsbNoAnswer",
    "UsbStall",
    "UsbTimeout",
    "UsbipServer",
    "chip_serial",
    "pulses",
    "run",
    "run_usbip",
]


def __getattr__(name: str) -> Any:
    if name == "SimBackend":
        try:
            from j2a_sim._usb.backend import SimBackend  # noqa: PLC0415 - pyusb is an extra
        except ModuleNotFoundError as error:
            raise ImportError(
                "SimBackend needs pyusb: pip install pyusb (the extra j2a[usb])"
            ) from error
        return SimBackend
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
