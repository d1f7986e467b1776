"""What goes wrong in the simulator, as types: a tool missing, a bad program, a stopped firmware."""

from __future__ import annotations


class SimError(Exception):
    """The simulation cannot be set up or go on; the text says what to do."""


class ToolMissing(SimError):  # noqa: N818 - the name says what happened
    """The C compiler, simavr's headers or its library are not installed."""


class BadProgram(SimError):  # noqa: N818
    """The ELF file is missing, not for AVR, damaged, or not for this MCU."""


class FirmwareStopped(SimError):  # noqa: N818
    """The firmware can go no further: illegal instruction, crash, or sleep without interrupts.

    Args:
        reason: what happened, with simavr's own words where it had any.
        cycle: the cycle at which the core stopped.
        pc: the byte address in flash of the program counter.
    """

    def __init__(self, reason: str, cycle: int, pc: int) -> None:
        super().__init__(f"{reason} (cycle {cycle}, pc 0x{pc:04x})")
        self.reason, self.cycle, self.pc = reason, cycle, pc
