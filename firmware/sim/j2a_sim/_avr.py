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
from pathlib import Path
from typing import Final

from j2a_sim import _build
from j2a_sim._core import AvrCore
from j2a_sim._errors import SimError
from j2a_sim._pins import Adc, Pins
from j2a_sim._records import Counters, Interrupts, OutByte, Span
from j2a_sim._twi import Twi
from j2a_sim._usb_bus.bus import UsbBus

SERIAL_BYTES: Final = 10
UNTAKEN_MAX: Final = 2**16


def chip_serial(number: int) -> bytes:
    """Return the serial number of the simulated chip of that number, 1 to 16777215."""
    return b"J2A-SIM" + number.to_bytes(3, "big")


class AvrSim(AvrCore):
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
        serial: the 10 bytes of the serial number that a chip with USB has in its signature row, as
            chip_serial() makes them; None: chip_serial(1).

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
        *,
        serial: bytes | None = None,
    ) -> None:
        if host_baud is not None and not 1 <= host_baud <= frequency_hz / 2:
            raise SimError(f"host_baud {host_baud} is out of range 1..{frequency_hz // 2}")
        if uart is not None and (len(uart) != 1 or uart not in "0123"):
            raise SimError(f"uart {uart!r} is none of 0, 1, 2, 3")
        own = chip_serial(1) if serial is None else bytes(serial)
        if len(own) != SERIAL_BYTES:
            raise SimError(f"a chip's serial number has {SERIAL_BYTES} bytes, not {len(own)}")
        host_bit = frequency_hz / host_baud if host_baud else 0
        super().__init__(elf, mcu, frequency_hz, uart, host_bit, own)
        has_usb = bool(self._lib.sim_usb(self._handle))
        self._usb = UsbBus(self, self._lib, self._lock) if has_usb else None

    # -- time ---------------------------------------------------------------------------------

    def run_until_output(self, limit_cycles: int, *, wakeable: bool = False) -> bool:
        """Run until the host has a byte that was not read yet, or the limit has passed.

        Args:
            limit_cycles: run at most so long.
            wakeable: as for run().

        Returns:
            Whether uart_read() has something.

        Raises:
            FirmwareStopped: as for run().
        """
        with self._lock:
            if not self.readable:
                wake = _build.STOP_WAKE if wakeable else 0
                self._run(limit_cycles, _build.STOP_OUTPUT | wake)
            return self.readable > 0

    def run_while_output(self, gap_cycles: int, most: int) -> None:
        """Run until uart_read() has `most` bytes, none has come for a while, or it is woken.

        Args:
            gap_cycles: how long.
            most: bytes.

        Raises:
            FirmwareStopped: as for run().
        """
        with self._lock:
            self._check_state(self._lib.sim_run_output(self._handle, gap_cycles, most))

    def run_until_usb(self, limit_cycles: int, *, wakeable: bool = False) -> bool:
        """Run until a transfer of `usb` has completed that was not taken yet, or the limit is over.

        Args:
            limit_cycles: run at most so long.
            wakeable: as for run().

        Returns:
            Whether usb.completed() has something; if so, this is the very cycle of its completion.

        Raises:
            FirmwareStopped: as for run().
            SimError: the MCU has no USB controller.
        """
        with self._lock:
            usb = self.usb
            if not usb.readable:
                self._run(limit_cycles, _build.STOP_USB | (_build.STOP_WAKE if wakeable else 0))
            return usb.readable > 0

    def run_until_span(self, limit_cycles: int) -> bool:
        """Run until the firmware closes a span, or the limit has passed; see spans()."""
        with self._lock:
            before = self._lib.sim_span_count(self._handle)
            self._run(limit_cycles, _build.STOP_SPAN)
            return bool(self._lib.sim_span_count(self._handle) > before)

    def boot(self, limit_s: float = 1.0) -> None:
        """Run until the firmware listens on the UART (its receiver is on).

        Raises:
            SimError: it does not within `limit_s` of simulated time.
            FirmwareStopped: as for run().
        """
        if not self.run_until(lambda: self.receiver_on, self.cycles(limit_s)):
            hint = ""
            if self._usb is not None and self._usb.switched_on:
                hint = "; it uses USB: take link=usb in a URL, or `j2a sim usb`"
            raise SimError(
                f"{self.program.path} did not turn its UART receiver on in {limit_s} s{hint}"
            )

    # -- UART ---------------------------------------------------------------------------------

    def uart_write(self, data: bytes) -> None:
        """Queue bytes for the wire; they go out back to back, at wire rate, while it runs."""
        with self._lock:
            if self._lib.sim_feed(self._handle, bytes(data), len(data)):
                raise SimError("out of memory for the bytes to the UART")

    @property
    def readable(self) -> int:
        """How many bytes uart_read() would return."""
        try:
            return self._out_count.value
        except AttributeError:
            raise SimError("the simulator is closed") from None

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

    # -- TWI ----------------------------------------------------------------------------------

    @property
    def twi(self) -> Twi:
        """The two wires of the TWI (I2C): sensors on them.

        Raises:
            SimError: the MCU has no TWI.
        """
        return Twi(self._lib, self._lock, lambda: self._handle, self.mcu)

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

    def drop_untaken(self) -> None:
        """Drop the UART's bytes, or the spans, if there are more than 65536 that nobody has taken.

        For runs without end, which would keep them all.
        """
        with self._lock:
            self._lib.sim_drop_untaken(self._handle, UNTAKEN_MAX)

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
