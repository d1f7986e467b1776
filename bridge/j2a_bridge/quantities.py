"""Quantities: what a unit measures, and its size in that of ROS (REP 103).

What flows in: symbols of UCUM, as descriptors have them. What flows out: a quantity, with factor
and offset to the unit that messages of ROS have.
Rule: a symbol that is not known here measures nothing, so nothing is guessed from it.
"""

import math
from dataclasses import dataclass
from typing import Final

__all__ = ["Quantity", "quantity_of"]

_G: Final = 9.80665
_DEG: Final = math.pi / 180


@dataclass(frozen=True, slots=True)
class Quantity:
    """What a unit measures: `value * factor + offset` is in the unit of ROS.

    Attributes:
        kind: such as "length".
        factor, offset: of the unit.
    """

    kind: str
    factor: float
    offset: float = 0.0


_UNITS: Final = {
    "length": {"m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 1e-3, "um": 1e-6, "km": 1e3},
    "angle": {"rad": 1.0, "mrad": 1e-3, "deg": _DEG, "mdeg": _DEG / 1e3},
    "angular velocity": {
        "rad/s": 1.0,
        "mrad/s": 1e-3,
        "deg/s": _DEG,
        "mdeg/s": _DEG / 1e3,
    },
    "acceleration": {
        "m/s2": 1.0,
        "cm/s2": 0.01,
        "mm/s2": 1e-3,
        "[g]": _G,
        "m[g]": _G / 1e3,
        # In UCUM a gram; a sensor of acceleration that says "mg" means the other one.
        "g": _G,
        "mg": _G / 1e3,
    },
    "magnetic field": {"T": 1.0, "mT": 1e-3, "uT": 1e-6, "nT": 1e-9, "G": 1e-4, "mG": 1e-7},
    "pressure": {"Pa": 1.0, "hPa": 100.0, "kPa": 1e3, "mbar": 100.0, "bar": 1e5},
    "illuminance": {"lx": 1.0, "mlx": 1e-3, "klx": 1e3},
    "temperature": {"Cel": 1.0, "mCel": 1e-3},
}
_KNOWN: Final = {
    **{
        unit: Quantity(kind, size) for kind, units in _UNITS.items() for unit, size in units.items()
    },
    "K": Quantity("temperature", 1.0, -273.15),
    "[degF]": Quantity("temperature", 5 / 9, -32 * 5 / 9),
    "%": Quantity("share", 0.01),
}


def quantity_of(unit: str) -> Quantity | None:
    """Return what a unit measures; None where that is not known."""
    return _KNOWN.get(unit)
