"""What the clock of a board in simavr shows, from the memory of its firmware.

In: a simulator, a cycle. Out: what j2a_clock_us(), j2a_clock_state() and the like would return
then.
Rules: the formulas are those of firmware/core/ext/j2a_clock.c, which a test compares by the replies
of the firmware itself; only memory is read, so the board runs as if nobody looked.
"""

from __future__ import annotations

import struct
from typing import Final

from j2a_spec import constants as c

from j2a_sim._avr import AvrSim
from j2a_sim._errors import SimError

__all__ = ["ClockMemory"]

_LINE: Final = struct.Struct("<IIQii")  # j2a_line
_U32: Final = 1 << 32
_SEGMENT_US: Final = 1 << 20
_DISTANCE_BITS: Final = 12
_US: Final = 1_000_000
_TCCR1B: Final = 0x81
_START_S: Final = 0.1
_DIVIDER: Final = 8

_Line = tuple[int, int, int, int, int]


def _time_on(line: _Line, now: int) -> int:
    """The time on a line at a local time, in 2^-32 us."""
    at, part, time_us, rate, correction = line
    passed = (now - at) % _U32
    gained = rate * passed + correction * min(passed, _SEGMENT_US) + part
    return ((time_us + passed) << 32) + gained


def _moved(line: _Line, now: int) -> int:
    """The same for a line without a correction, whose begin may be ahead."""
    at, part, time_us, rate, _ = line
    by_us = (now - at + _U32 // 2) % _U32 - _U32 // 2
    return ((time_us + by_us) << 32) + rate * by_us + part


class ClockMemory:
    """The clock of one board; made before its firmware has started timer 1.

    Args:
        sim: the simulator.

    Raises:
        SimError: the firmware has no such clock.
    """

    def __init__(self, sim: AvrSim) -> None:
        self._sim = sim
        self._at = {
            name: self._find(name)
            for name in ("lines", "current", "epoch", "target", "adjusted_us", "given_us")
        }
        self._at.update({name: self._find(name) for name in ("wander", "was_step")})
        self._started = 0
        self.start()

    def start(self) -> None:
        """Run until the firmware starts timer 1, from which on it counts; after each reset."""
        sim = self._sim
        limit = sim.cycles(_START_S)
        if not sim.run_until(lambda: bool(sim.read_memory(_TCCR1B, 1)[0]), limit, 1):
            raise SimError(f"{sim.program.path} did not start its clock within {_START_S} s")
        self._started = sim.cycle

    def _find(self, name: str) -> int:
        """The address of a variable, whose name may have a suffix of the linker."""
        symbols = self._sim.program.symbols
        found = [at for symbol, at in symbols.items() if symbol.split(".")[0] == name]
        if len(found) != 1:
            raise SimError(f"{self._sim.program.path} has {len(found)} variables {name!r}, not one")
        return found[0]

    def _number(self, name: str, size: int) -> int:
        return int.from_bytes(self._sim.read_memory(self._at[name], size), "little")

    def _lines(self, name: str, count: int) -> list[_Line]:
        data = self._sim.read_memory(self._at[name], _LINE.size * count)
        return [_LINE.unpack_from(data, i * _LINE.size) for i in range(count)]

    def local_us(self, cycle: float) -> int:
        """The local time at a cycle."""
        ticks = int((cycle - self._started) // _DIVIDER)
        return ticks * _DIVIDER * _US // self._sim.frequency_hz

    def cycle(self, local_us: int) -> float:
        """The middle of the cycles at which the local time was that."""
        return self._started + (local_us + 0.5) * self._sim.frequency_hz / _US

    def captured(self) -> int:
        """The cycle of the tick at which the firmware noted the last start of a frame."""
        at = self._find("last")
        _, ticks, overflows = struct.unpack("<HHH", self._sim.read_memory(at, 6))
        return self._started + int(overflows << 16 | ticks) * _DIVIDER

    def read(self, cycle: float) -> tuple[int, int, int, int]:
        """What the clock shows at a cycle that has just been.

        Returns:
            Time in microseconds, state, epoch, uncertainty in microseconds.
        """
        now_us = self.local_us(cycle)
        epoch = self._number("epoch", 1)
        if not epoch:
            return now_us, c.CLOCK_FREE, 0, c.CLOCK_UNKNOWN
        now, which = now_us % _U32, self._number("current", 1)
        lines = self._lines("lines", 2)
        is_ahead = (now - lines[which][0]) % _U32 >= _U32 // 2
        time = _time_on(lines[which ^ is_ahead], now)
        target = _moved(self._lines("target", 1)[0], now)
        off = (target >> 32 - _DISTANCE_BITS) - (time >> 32 - _DISTANCE_BITS)
        error_us = -(-abs(off) // (1 << _DISTANCE_BITS))
        given_us = self._number("given_us", 4)
        passed_us = now_us - self._number("adjusted_us", 8)
        known_us = 0 if given_us == c.CLOCK_UNKNOWN else given_us
        if passed_us >= c.CLOCK_HOLDOVER_S * _US:
            state = c.CLOCK_HOLDOVER
        elif self._number("was_step", 1) or error_us > max(known_us, c.CLOCK_SETTLED_US):
            state = c.CLOCK_SETTLING
        else:
            state = c.CLOCK_LOCKED
        uncertainty = c.CLOCK_UNKNOWN
        if given_us != c.CLOCK_UNKNOWN:
            wander = self._number("wander", 4)
            grown_us = (passed_us * wander >> 38) + (wander != 0)
            uncertainty = min(given_us + error_us + grown_us, c.CLOCK_UNKNOWN)
        return time >> 32, state, epoch, uncertainty
