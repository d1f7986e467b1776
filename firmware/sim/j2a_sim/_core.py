"""The core of a simulated AVR: its program, its memory, its time.

In: an ELF file, cycles to run. Out: what memory holds; an error when the firmware cannot go on.
Rules: simulated time passes only in the run methods; a lock keeps calls from several threads apart.
"""

from __future__ import annotations

import contextlib
import ctypes
import re
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Self

from j2a_sim import _build
from j2a_sim._elf import Program, read_program
from j2a_sim._errors import BadProgram, FirmwareStopped, SimError
from j2a_sim._options import FREQUENCY_MAX_HZ

_PAINT = 0xC5  # what the shim fills the RAM above the static data with at each reset
_CRASHES_SIMAVR = {"atmega16m1"}  # avr_init() of simavr 1.6 ends the process
# 8 KiB of flash, and the jumps and vectors of the larger chips of their family.
_LARGER = {"atmega8u2": 16 << 10, "at90usb82": 16 << 10}
_CRASH = "avr_sadly_crashed"  # simavr's last words, after those that tell the cause
_COLOURS = re.compile(r"\x1b\[[0-9;]*m")


class AvrCore:
    """What AvrSim is made of, without the world around the chip; see there.

    Args:
        elf: path of the firmware.
        mcu: its name.
        frequency_hz: the clock.
        uart: the UART that is connected; None: the first.
        host_bit: cycles of a bit of the UART's host; 0: as the firmware's.
        serial: the 10 bytes of the chip's serial number.

    Attributes:
        program: what the ELF file holds.
        mcu, frequency_hz: as given.
    """

    def __init__(  # noqa: PLR0917 - all that the C function is told
        self,
        elf: Path | str,
        mcu: str,
        frequency_hz: int,
        uart: str | None,
        host_bit: float,
        serial: bytes,
    ) -> None:
        if not 1 <= frequency_hz <= FREQUENCY_MAX_HZ:
            raise SimError(f"frequency {frequency_hz} Hz is out of range 1..{FREQUENCY_MAX_HZ}")
        if mcu in _CRASHES_SIMAVR:
            raise SimError(f"simavr 1.6 cannot run an {mcu}")
        self.program: Program = read_program(elf)
        self.mcu, self.frequency_hz = mcu, frequency_hz
        self._lib = _build.library()
        self._lock = threading.RLock()
        flash = self.program.flash
        error = ctypes.create_string_buffer(512)
        self._sim: int | None = self._lib.sim_new(
            mcu.encode(),
            frequency_hz,
            uart.encode() if uart else b"\0",
            host_bit,
            flash,
            len(flash),
            self.program.ram_end,
            serial,
            error,
            len(error),
        )
        if not self._sim:
            text = error.value.decode("utf-8", "replace").strip()
            kind = BadProgram if "needs" in text else SimError
            port = f", UART {uart}" if uart else ""
            raise kind(f"{self.program.path} on {mcu}{port}: {text}")
        # Read in place: links look at both many times for each millisecond that passes.
        self._cycle = ctypes.c_uint64.from_address(self._lib.sim_cycle_place(self._sim))
        self._out_count = ctypes.c_uint32.from_address(self._lib.sim_out_count_place(self._sim))
        self._woken = ctypes.c_uint32.from_address(self._lib.sim_woken_place(self._sim))
        flash_size = int(self._lib.sim_flash_size(self._sim))
        if not self.program.suits(max(flash_size, _LARGER.get(mcu, 0))):
            self.close()
            raise BadProgram(
                f"{self.program.path} is built for avr{self.program.family}, and {mcu} is none: "
                f"name the MCU that it was built for, or build it with -mmcu={mcu}"
            )

    def close(self) -> None:
        """Free the simulator; nothing else may be called afterwards. Idempotent."""
        with self._lock:
            if self._sim:
                # What is read in place must not be read from memory that is free.
                del self._cycle, self._out_count, self._woken
                self._lib.sim_free(self._sim)
            self._sim = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __del__(self) -> None:
        if getattr(self, "_sim", None):
            self.close()

    @property
    def _handle(self) -> int:
        if self._sim is None:
            raise SimError("the simulator is closed")
        return self._sim

    # -- time ---------------------------------------------------------------------------------

    @property
    def cycle(self) -> int:
        """Cycles since the start (a reset does not set it back)."""
        try:
            return self._cycle.value
        except AttributeError:
            raise SimError("the simulator is closed") from None

    @property
    def time_s(self) -> float:
        """Simulated seconds since the start."""
        return self.cycle / self.frequency_hz

    def cycles(self, seconds: float) -> int:
        """Seconds of simulated time as whole cycles (rounded up)."""
        return -int(-seconds * self.frequency_hz // 1)

    def run(self, cycles: int, *, wakeable: bool = False) -> int:
        """Run for a number of cycles.

        Args:
            cycles: how many; the last instruction may go up to 4 cycles beyond.
            wakeable: end before that where `wake` is called, or was since `heed`.

        Returns:
            The cycles that passed.

        Raises:
            FirmwareStopped: illegal instruction, crash, or sleep with interrupts off.
        """
        with self._lock:
            before = self.cycle
            self._run(cycles, _build.STOP_WAKE if wakeable else 0)
            return self.cycle - before

    def run_until(
        self, condition: Callable[[], bool], limit_cycles: int, step_cycles: int = 1000
    ) -> bool:
        """Run until a condition holds, looking at it every few cycles.

        Args:
            condition: called between steps, and before the first.
            limit_cycles: run at most so long.
            step_cycles: cycles between two looks.

        Returns:
            Whether the condition holds.

        Raises:
            FirmwareStopped: as for run().
        """
        end = self.cycle + limit_cycles
        while not condition():
            left = end - self.cycle
            if left <= 0:
                return False
            self.run(min(step_cycles, left))
        return True

    def wake(self) -> None:
        """End what runs wakeable within a millisecond of simulated time; from any thread."""
        with contextlib.suppress(AttributeError):  # it is closed, so nothing runs
            self._woken.value = 1

    @property
    def is_woken(self) -> bool:
        """Whether `wake` was called since `heed`."""
        try:
            return bool(self._woken.value)
        except AttributeError:
            raise SimError("the simulator is closed") from None

    def heed(self) -> None:
        """Let the next run go on: what `wake` was called for until now is known."""
        with contextlib.suppress(AttributeError):
            self._woken.value = 0

    def reset(self) -> None:
        """Pull the reset line: registers, UART and RAM start anew, the cycle count goes on."""
        with self._lock:
            self._lib.sim_reset(self._handle)

    def _run(self, cycles: int, stop: int) -> None:
        with self._lock:
            self._check_state(self._lib.sim_run(self._handle, max(0, cycles), stop))

    def _check_state(self, state: int) -> None:
        """Raise FirmwareStopped if a run ended for good in that state."""
        name = _build.STATES[state]
        if self._lib.sim_illegal(self._handle):
            name = "illegal instruction"
        if name in {"illegal instruction", "done", "crashed"}:
            pc = int(self._lib.sim_pc(self._handle))
            raise FirmwareStopped(self._why_stopped(name), self.cycle, pc)

    def _why_stopped(self, name: str) -> str:
        said = [line for line in self.log.strip().splitlines() if line != _CRASH]
        log = f" ({said[-1].removeprefix('CORE: *** ')})" if said else ""
        if name == "crashed":
            return (
                f"the firmware stopped: it crashed, for it did something that an {self.mcu} "
                f"cannot{log}; was it built for MCU={self.mcu}?"
            )
        return (
            f"the firmware stopped: {'sleep with interrupts off' if name == 'done' else name}{log}"
        )

    @property
    def log(self) -> str:
        """What simavr had to say (errors and warnings; the first 8 KiB)."""
        text: bytes = self._lib.sim_log(self._handle)
        return _COLOURS.sub("", text.decode("utf-8", "replace"))

    # -- memory -------------------------------------------------------------------------------

    def _memory(self, address: int | str, length: int) -> int:
        """The place of a piece of data memory in our own address space."""
        if isinstance(address, str):
            if address not in self.program.symbols:
                raise SimError(f"{self.program.path} has no symbol {address!r}")
            address = self.program.symbols[address]
        size = int(self._lib.sim_data_size(self._handle))
        if not 0 <= address <= address + length <= size:
            raise SimError(f"data address 0x{address:x}+{length} is outside 0..0x{size:x}")
        return int(self._lib.sim_data(self._handle)) + address

    def read_memory(self, address: int | str, length: int) -> bytes:
        """Read the data space (registers, I/O, RAM) without side effects.

        Args:
            address: a data address, or the name of a variable.
            length: in bytes.

        Returns:
            The bytes.

        Raises:
            SimError: no such symbol or address.
        """
        with self._lock:
            return ctypes.string_at(self._memory(address, length), length)

    def write_memory(self, address: int | str, data: bytes) -> None:
        """Write to RAM, past all hooks; arguments and errors as for read_memory()."""
        with self._lock:
            ctypes.memmove(self._memory(address, len(data)), bytes(data), len(data))

    def _eeprom(self, address: int, length: int) -> int:
        """The place of a piece of the EEPROM in our own address space."""
        size = int(self._lib.sim_eeprom_size(self._handle))
        if not 0 <= address <= address + length <= size:
            raise SimError(f"EEPROM address 0x{address:x}+{length} is outside 0..0x{size:x}")
        place = self._lib.sim_eeprom(self._handle)
        return (ctypes.cast(place, ctypes.c_void_p).value or 0) + address

    def read_eeprom(self, address: int, length: int) -> bytes:
        """Read the EEPROM; a byte that the firmware writes is there at once, though it takes time.

        Raises:
            SimError: no such address.
        """
        with self._lock:
            return ctypes.string_at(self._eeprom(address, length), length)

    def write_eeprom(self, address: int, data: bytes) -> None:
        """Write to the EEPROM from outside; it stays across resets. Errors as for read_eeprom()."""
        with self._lock:
            ctypes.memmove(self._eeprom(address, len(data)), bytes(data), len(data))

    @property
    def stack_pointer(self) -> int:
        """The stack pointer (a data address)."""
        return int.from_bytes(self.read_memory(0x5D, 2), "little")

    @property
    def stack_bytes(self) -> int:
        """The most bytes of stack in use since the start or reset.

        Seen by a pattern that fills the free RAM: bytes that a function reserved and never wrote
        at the far end are not counted.
        """
        start = self.program.ram_end
        free = self.read_memory(start, int(self._lib.sim_data_size(self._handle)) - start)
        return len(free.lstrip(bytes([_PAINT])))
