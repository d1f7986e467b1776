"""One simulated AVR: run it by cycles, talk to its UART, measure it.

In: an ELF file, bytes for the UART, transfers for USB, levels and voltages for the pins, cycles to
run. Out: the UART's bytes with the cycle at which the host had them, what came of the transfers,
edges of pins, exact cycle counts of marked spans, memory, counters.
Simulated time passes only in the run methods, and the same calls give the same cycles each time.
Bytes to the firmware take the time that they take on the wire (baud and format registers), so a
firmware that reads too slowly loses them as on the chip.
"""

from __future__ import annotations

import ctypes
import re
import threading
from collections.abc import Callable
from pathlib import Path

from j2a.sim import _build
from j2a.sim._elf import Program, read_program
from j2a.sim._errors import BadProgram, FirmwareStopped, SimError
from j2a.sim._options import FREQUENCY_MAX_HZ
from j2a.sim._pins import Adc, Pins
from j2a.sim._records import Counters, Interrupts, OutByte, Span
from j2a.sim._usb import UsbBus

_PAINT = 0xC5  # what the shim fills the RAM above the static data with at each reset
_CRASHES_SIMAVR = {"atmega16m1"}  # avr_init() of simavr 1.6 ends the process
# 8 KiB of flash, and the jumps and vectors of the larger chips of their family.
_LARGER = {"atmega8u2": 16 << 10, "at90usb82": 16 << 10}
_COLOURS = re.compile(r"\x1b\[[0-9;]*m")


class AvrSim:
    """A simulated AVR with its UART.

    Args:
        elf: path of the firmware (ELF as avr-gcc links it).
        mcu: its name as simavr knows it, such as "atmega328p", or "atmega32u2", "atmega16u2",
            "atmega8u2", "at90usb82", "atmega16u4", which simavr lacks and which run as its
            AT90USB162 and ATmega32U4 with their own memories.
        frequency_hz: the clock.
        uart: the UART to use, "0" to "3"; None: the first that the MCU has.
        host_baud: bit rate of the host in bit/s; None: whatever the firmware has set. With another
            rate than the firmware's both sides sample the wire at their own rate, so bytes arrive
            garbled, with framing errors, or not at all.

    Raises:
        ToolMissing: no C compiler or no libsimavr-dev.
        BadProgram: the ELF file is missing, damaged, not for AVR, for another family of AVRs than
            the MCU's, or too big for it.
        SimError: unknown MCU or UART.

    A simulator may be handed between threads; its methods are not meant for two at once, and a
    lock keeps them apart.
    """

    def __init__(
        self,
        elf: Path | str,
        mcu: str = "atmega328p",
        frequency_hz: int = 16_000_000,
        uart: str | None = None,
        host_baud: float | None = None,
    ) -> None:
        if not 1 <= frequency_hz <= FREQUENCY_MAX_HZ:
            raise SimError(f"frequency {frequency_hz} Hz is out of range 1..{FREQUENCY_MAX_HZ}")
        if host_baud is not None and not 1 <= host_baud <= frequency_hz / 2:
            raise SimError(f"host_baud {host_baud} is out of range 1..{frequency_hz // 2}")
        if uart is not None and (len(uart) != 1 or uart not in "0123"):
            raise SimError(f"uart {uart!r} is none of 0, 1, 2, 3")
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
            frequency_hz / host_baud if host_baud else 0.0,
            flash,
            len(flash),
            self.program.ram_end,
            error,
            len(error),
        )
        if not self._sim:
            text = error.value.decode("utf-8", "replace").strip()
            kind = BadProgram if "needs" in text else SimError
            port = f", UART {uart}" if uart else ""
            raise kind(f"{self.program.path} on {mcu}{port}: {text}")
        has_usb = bool(self._lib.sim_usb(self._sim))
        self._usb = UsbBus(self, self._lib, self._lock) if has_usb else None
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
                self._lib.sim_free(self._sim)
            self._sim = None

    def __enter__(self) -> AvrSim:
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
        return int(self._lib.sim_cycle(self._handle))

    @property
    def time_s(self) -> float:
        """Simulated seconds since the start."""
        return self.cycle / self.frequency_hz

    def cycles(self, seconds: float) -> int:
        """Seconds of simulated time as whole cycles (rounded up)."""
        return -int(-seconds * self.frequency_hz // 1)

    def run(self, cycles: int) -> int:
        """Run for a number of cycles.

        Args:
            cycles: how many; the last instruction may go up to 4 cycles beyond.

        Returns:
            The cycles that passed.

        Raises:
            FirmwareStopped: illegal instruction, crash, or sleep with interrupts off.
        """
        return self._run(cycles, 0)

    def run_until_output(self, limit_cycles: int) -> bool:
        """Run until the host has a byte that was not read yet, or the limit has passed.

        Args:
            limit_cycles: run at most so long.

        Returns:
            Whether uart_read() has something.

        Raises:
            FirmwareStopped: as for run().
        """
        with self._lock:
            if not self.readable:
                self._run(limit_cycles, _build.STOP_OUTPUT)
            return self.readable > 0

    def run_until_usb(self, limit_cycles: int) -> bool:
        """Run until a transfer of `usb` has completed that was not taken yet, or the limit is over.

        Args:
            limit_cycles: run at most so long.

        Returns:
            Whether usb.completed() has something; if so, this is the very cycle of its completion.

        Raises:
            FirmwareStopped: as for run().
            SimError: the MCU has no USB controller.
        """
        with self._lock:
            usb = self.usb
            if not usb.readable:
                self._run(limit_cycles, _build.STOP_USB)
            return usb.readable > 0

    def run_until_span(self, limit_cycles: int) -> bool:
        """Run until the firmware closes a span, or the limit has passed; see spans()."""
        with self._lock:
            before = self._lib.sim_span_count(self._handle)
            self._run(limit_cycles, _build.STOP_SPAN)
            return bool(self._lib.sim_span_count(self._handle) > before)

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

    def boot(self, limit_s: float = 1.0) -> None:
        """Run until the firmware listens on the UART (its receiver is on).

        Raises:
            SimError: it does not within `limit_s` of simulated time.
            FirmwareStopped: as for run().
        """
        if not self.run_until(lambda: self.receiver_on, self.cycles(limit_s)):
            raise SimError(f"{self.program.path} did not turn its UART receiver on in {limit_s} s")

    def reset(self) -> None:
        """Pull the reset line: registers, UART and RAM start anew, the cycle count goes on."""
        with self._lock:
            self._lib.sim_reset(self._handle)

    def _run(self, cycles: int, stop: int) -> int:
        with self._lock:
            handle = self._handle
            before = self.cycle
            state = self._lib.sim_run(handle, max(0, cycles), stop)
            name = _build.STATES[state]
            if self._lib.sim_illegal(handle):
                name = "illegal instruction"
            if name in {"illegal instruction", "done", "crashed"}:
                reason = "sleep with interrupts off" if name == "done" else name
                log = self.log.strip().splitlines()
                reason = f"the firmware stopped: {reason}" + (f" ({log[-1]})" if log else "")
                raise FirmwareStopped(reason, self.cycle, self._lib.sim_pc(handle))
            return self.cycle - before

    # -- UART ---------------------------------------------------------------------------------

    def uart_write(self, data: bytes) -> None:
        """Queue bytes for the wire; they go out back to back, at wire rate, while it runs."""
        with self._lock:
            if self._lib.sim_feed(self._handle, bytes(data), len(data)):
                raise SimError("out of memory for the bytes to the UART")

    @property
    def readable(self) -> int:
        """How many bytes uart_read() would return."""
        return int(self._lib.sim_out_count(self._handle))

    def uart_read(self) -> bytes:
        """Take the bytes that the host has received; b"" when there are none."""
        with self._lock:
            count = self.readable
            data = (ctypes.c_uint8 * count)()
            self._lib.sim_take_out(self._handle, count, data, None)
            return bytes(data)

    def uart_read_stamped(self) -> list[OutByte]:
        """As uart_read(), with the cycle of each byte."""
        with self._lock:
            count = self.readable
            data, cycles = (ctypes.c_uint8 * count)(), (ctypes.c_uint64 * count)()
            self._lib.sim_take_out(self._handle, count, data, cycles)
            return [OutByte(cycle, value) for cycle, value in zip(cycles, data, strict=True)]

    @property
    def receiver_on(self) -> bool:
        """Whether the firmware has turned its UART receiver on."""
        return bool(self._lib.sim_receiver_on(self._handle))

    @property
    def baud(self) -> float:
        """The bit rate that the firmware has set, bit/s."""
        return self.frequency_hz / float(self._lib.sim_bit_cycles(self._handle))

    @property
    def char_cycles(self) -> float:
        """Cycles that one character takes on the wire: start, data, parity and stop bits."""
        handle = self._handle
        return float(self._lib.sim_bit_cycles(handle)) * int(self._lib.sim_char_bits(handle))

    @property
    def counters(self) -> Counters:
        """Totals of the UART since the start."""
        values = (ctypes.c_uint64 * len(_build.COUNTERS))()
        self._lib.sim_counters(self._handle, values)
        return Counters(**dict(zip(_build.COUNTERS, values, strict=True)))

    # -- pins ---------------------------------------------------------------------------------

    @property
    def pins(self) -> Pins:
        """The pins of the chip: to drive them, and to see their edges."""
        return Pins(self._lib, self._lock, lambda: self._handle, self.mcu)

    @property
    def adc(self) -> Adc:
        """The analog inputs: voltages at the channels.

        Raises:
            SimError: the MCU has no ADC.
        """
        return Adc(self._lib, self._lock, lambda: self._handle, self.mcu)

    # -- USB ----------------------------------------------------------------------------------

    @property
    def usb(self) -> UsbBus:
        """The USB host at the other end of the cable, always the same object.

        Raises:
            SimError: the MCU has no USB device controller.
        """
        if self._usb is None:
            raise SimError(f"{self.mcu} has no USB device controller")
        return self._usb

    # -- measuring ----------------------------------------------------------------------------

    def spans(self) -> list[Span]:
        """Take the spans that the firmware has closed since the last call.

        Raises:
            SimError: the MCU has no GPIOR0 at data address 0x3E.
        """
        with self._lock:
            if not self._lib.sim_spans_on(self._handle):
                raise SimError(f"{self.mcu} has no GPIOR0 at 0x3E to mark spans with")
            count = self._lib.sim_span_count(self._handle)
            marks = (ctypes.c_uint8 * count)()
            starts, cycles = (ctypes.c_uint64 * count)(), (ctypes.c_uint64 * count)()
            self._lib.sim_take_spans(self._handle, marks, starts, cycles)
            return [Span(*item) for item in zip(marks, starts, cycles, strict=True)]

    def interrupts(self, vector: int) -> Interrupts:
        """What a vector's handler did since the start, or since clear_interrupts().

        Args:
            vector: its number as avr-libc counts, 18 for `__vector_18`, the ATmega328P's USART_RX.

        Raises:
            SimError: the MCU has no such vector, or simavr does not know it.
        """
        values = (ctypes.c_uint64 * 4)()
        with self._lock:
            if not 0 < vector < 64 or not self._lib.sim_interrupt(self._handle, vector, values):
                raise SimError(f"{self.mcu} has no interrupt vector {vector}")
        return Interrupts(*values)

    def clear_interrupts(self) -> None:
        """Let interrupts() count from 0 again."""
        with self._lock:
            self._lib.sim_clear_interrupts(self._handle)

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
