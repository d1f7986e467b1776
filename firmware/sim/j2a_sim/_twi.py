"""What is on the two wires of the TWI (I2C) of a simulated AVR: ultrasonic sensors SRF02.

In: a distance for each address, and what goes wrong. Out: how often each sensor was asked to
measure. Rules: addresses have 7 bits, 0x70 is what the sensor's documentation calls 0xE0. What is
set holds from now on, also across a reset of the chip; a distance that is being measured is the one
at the beginning.
"""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable

from j2a_sim._errors import SimError

_ADDRESSES = range(0x70, 0x80)
_CM_MAX = 0xFFFF
_ABSENT, _SRF02, _DEAF = range(3)


class Twi:
    """The bus; `AvrSim.twi`. There is nothing on it to begin with."""

    def __init__(
        self, lib: ctypes.CDLL, lock: threading.RLock, handle: Callable[[], int], mcu: str
    ) -> None:
        self._lib, self._lock, self._sim = lib, lock, handle
        if not lib.sim_has_twi(handle()):
            raise SimError(f"{mcu} has no TWI in the simulator")

    def set_distance(self, address: int, cm: int) -> None:
        """Put an SRF02 on the bus, or move what is in front of it.

        Args:
            address: 0x70 to 0x7F.
            cm: 0 to 65535 cm; the sensor reports 0 where it sees nothing.

        Raises:
            SimError: a number is out of range.
        """
        self._set(address, _SRF02, cm)

    def remove(self, address: int) -> None:
        """Take a sensor away: nobody acknowledges its address."""
        self._set(address, _ABSENT, 0)

    def deafen(self, address: int) -> None:
        """Let a sensor acknowledge its address and nothing that is written to it."""
        self._set(address, _DEAF, 0)

    def measurements(self, address: int) -> int:
        """How often a sensor was told to measure since the start."""
        with self._lock:
            return int(self._lib.sim_srf02_measurements(self._sim(), self._checked(address)))

    def hang(self, on: bool = True) -> None:
        """Let the bus hang, as with a wire that is held low, or let it go on."""
        with self._lock:
            self._lib.sim_hang_twi(self._sim(), int(on))

    def _set(self, address: int, kind: int, cm: int) -> None:
        if not 0 <= cm <= _CM_MAX:
            raise SimError(f"{cm} cm is out of range 0..{_CM_MAX}")
        with self._lock:
            self._lib.sim_set_srf02(self._sim(), self._checked(address), kind, cm)

    @staticmethod
    def _checked(address: int) -> int:
        if address not in _ADDRESSES:
            raise SimError(f"address 0x{address:02x} is out of range 0x70..0x7f")
        return address
