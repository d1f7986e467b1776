"""The pins of a simulated AVR, seen from outside: levels, edges, voltages.

In: levels and voltages with the cycle at which they come. Out: edges with the cycle at which they
came.
Rules: a pin is named by port and bit, "PD2". What is scheduled happens at its very cycle, which
must not be over, and stays across a reset of the chip. A pin that nobody drives has the level that
the chip gives it, by its output or its pull-up.
"""

from __future__ import annotations

import ctypes
import math
import re
import threading
from collections.abc import Callable, Iterable

from j2a_sim._errors import SimError
from j2a_sim._records import Edge

_NAME = re.compile(r"P([A-L])([0-7])")
_RELEASE = -1
_RISE_MAX = 1_000_000_000
_ADC_CHANNELS = 16
_VOLTS_MAX = 5.5  # what the chips bear


class _Wires:
    """What pins and analog inputs share: the simulator, and when things happen."""

    def __init__(
        self, lib: ctypes.CDLL, lock: threading.RLock, handle: Callable[[], int], mcu: str
    ) -> None:
        self._lib, self._lock, self._sim, self._mcu = lib, lock, handle, mcu

    def _when(self, cycle: int | None) -> int:
        now = int(self._lib.sim_cycle(self._sim()))
        if cycle is None:
            return now
        if cycle < now:
            raise SimError(f"cycle {cycle} is over: it is cycle {now}")
        return cycle

    @property
    def waiting(self) -> int:
        """How many levels and voltages are scheduled and have not come yet."""
        return int(self._lib.sim_waiting(self._sim()))


class Pins(_Wires):
    """The digital pins; `AvrSim.pins`."""

    def _number(self, pin: str) -> int:
        match = _NAME.fullmatch(pin)
        if not match:
            raise SimError(f"{pin!r} is no pin: name it by port and bit, such as 'PD2'")
        number = int(self._lib.sim_pin(self._sim(), match[1].encode(), int(match[2])))
        if number < 0:
            raise SimError(f"{self._mcu} has no port {match[1]}")
        return number

    def drive(self, pin: str, level: int, cycle: int | None = None) -> None:
        """Drive a pin from outside.

        Args:
            pin: its name, "PD2".
            level: 0 or 1.
            cycle: when; None: now.

        Raises:
            SimError: no such pin, another level, or the cycle is over.
        """
        with self._lock:  # "now" stays so
            self.play(pin, [(self._when(cycle), level)])

    def play(self, pin: str, levels: Iterable[tuple[int, int]]) -> None:
        """Schedule many levels of a pin.

        Args:
            pin: its name.
            levels: pairs of cycle and level, 0 or 1; those of one cycle come in their order.

        Raises:
            SimError: as for drive(); the levels before the wrong one stay scheduled.
        """
        with self._lock:
            number = self._number(pin)
            for cycle, level in levels:
                if level not in {0, 1}:
                    raise SimError(f"level {level} of {pin} is neither 0 nor 1")
                self._lib.sim_drive(self._sim(), self._when(cycle), number, int(level))

    def release(self, pin: str, cycle: int | None = None, rise_cycles: int = 0) -> None:
        """Stop driving a pin; with its pull-up on it goes high, else it keeps its level.

        Args:
            pin: its name.
            cycle: when; None: now.
            rise_cycles: a pin that is low goes high when its pull-up has been on for so long, as
                an open collector does, whose wire has a capacitance. 0: at once.

        Raises:
            SimError: no such pin, the cycle is over, or the rise is out of range.
        """
        if not 0 <= rise_cycles <= _RISE_MAX:
            raise SimError(f"rise_cycles {rise_cycles} is out of range 0..{_RISE_MAX}")
        level = _RELEASE - rise_cycles
        with self._lock:
            self._lib.sim_drive(self._sim(), self._when(cycle), self._number(pin), level)

    def level(self, pin: str) -> int:
        """The level of a pin now, 0 or 1, whoever drives it."""
        with self._lock:
            return int(self._lib.sim_pin_level(self._sim(), self._number(pin)))

    def watch(self, *pins: str) -> None:
        """Record the edges of these pins from now on."""
        with self._lock:
            for pin in pins:
                self._lib.sim_watch(self._sim(), self._number(pin))

    def edges(self, pin: str) -> list[Edge]:
        """Take the edges that a watched pin had since the last call; see also `pulses`."""
        with self._lock:
            number = self._number(pin)
            count = int(self._lib.sim_edge_count(self._sim(), number))
            cycles, levels = (ctypes.c_uint64 * count)(), (ctypes.c_uint8 * count)()
            self._lib.sim_take_edges(self._sim(), number, cycles, levels)
            return [Edge(*item) for item in zip(cycles, levels, strict=True)]


class Adc(_Wires):
    """The analog inputs; `AvrSim.adc`. All are at 0 V, and AVCC and AREF at 5 V, to begin with."""

    def __init__(
        self, lib: ctypes.CDLL, lock: threading.RLock, handle: Callable[[], int], mcu: str
    ) -> None:
        super().__init__(lib, lock, handle, mcu)
        if not lib.sim_has_adc(handle()):
            raise SimError(f"{mcu} has no ADC")

    def set_volts(self, channel: int, volts: float, cycle: int | None = None) -> None:
        """Put a voltage at an input. A conversion takes the one at its sampling moment.

        Args:
            channel: 0..15, as the data sheet numbers the ADC's inputs.
            volts: 0..5.5 V.
            cycle: when; None: now.

        Raises:
            SimError: a value is out of range, or the cycle is over.
        """
        if not 0 <= channel < _ADC_CHANNELS:
            raise SimError(f"ADC channel {channel} is out of range 0..{_ADC_CHANNELS - 1}")
        if not 0 <= volts <= _VOLTS_MAX:
            raise SimError(f"{volts} V is out of range 0..{_VOLTS_MAX} V")
        with self._lock:
            self._lib.sim_set_volts(self._sim(), self._when(cycle), channel, float(volts))

    def set_references(self, avcc_volts: float = 5.0, aref_volts: float = 5.0) -> None:
        """Set the voltages of the pins AVCC and AREF, above 0 V and up to 5.5 V."""
        for volts in (avcc_volts, aref_volts):
            if not math.isfinite(volts) or not 0 < volts <= _VOLTS_MAX:
                raise SimError(
                    f"a reference of {volts} V is out of range: above 0, to {_VOLTS_MAX} V"
                )
        with self._lock:
            self._lib.sim_set_references(self._sim(), float(avcc_volts), float(aref_volts))

    @property
    def conversions(self) -> int:
        """How many conversions have ended since the start."""
        return int(self._lib.sim_conversions(self._sim()))
