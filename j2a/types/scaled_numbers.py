"""Numbers of transducers as people see them, and as the live page sends them back.

What flows in: raw numbers, with the scale and offset of their transducer. What flows out: the same
in the unit of the transducer, as a number, as that of the fewest digits, and as a text.
"""

import math
from decimal import Decimal
from fractions import Fraction
from numbers import Integral
from typing import Any, Final

from j2a.types.transducers import Transducer, rounded, shortest_f32

__all__ = [
    "in_unit",
    "nearest_f64",
    "nearest_whole",
    "scaling_of",
    "shortest_in_unit",
    "text_in_unit",
]

_DIGITS: Final = 6
"""An integer has no fewer: one digit would tell 0.25 from 0.5, yet 0.2 is not what was measured."""
_MOST_DIGITS: Final = 17
_INEXACT: Final = 2.0**50
"""From here on the errors of three operations with floats may make another integer."""
_WITH_EXPONENT: Final = 1e16
"""From here on texts have an exponent, so that who reads them makes floats of them."""


def scaling_of(transducer: Transducer) -> tuple[float, float]:
    """Return scale and offset of the raw numbers of a transducer; (1, 0) where they are none."""
    return (transducer.scale, transducer.offset) if transducer.is_scaled else (1.0, 0.0)


def in_unit(raw: float, element: object, scale: float, offset: float) -> float:
    """Return a raw number in the unit, rounded once: 0.3 for 3 * 0.1, and not 0.30000000000000004.

    Args:
        raw: the number.
        element: its type, such as "f32".
        scale: of its transducer, 1 for none.
        offset: of its transducer, 0 for none.
    """
    value = raw * scale + offset
    if not math.isfinite(value):
        return value
    if element == "f32":
        raw = shortest_f32(raw)
    return float(_decimal(raw) * _decimal(scale) + _decimal(offset))


def nearest_whole(value: Any, scale: float, offset: float) -> int:
    """Return the raw integer that is nearest to a number in the unit.

    Args:
        value: the number; all digits of an integer count, also those that an f64 does not hold.
        scale: of its transducer, not 0.
        offset: of its transducer.

    Raises:
        OverflowError, ValueError: it is beyond the numbers of floats.
    """
    raw = (float(value) - offset) / scale
    if abs(raw) < _INEXACT or math.isinf(raw) or not isinstance(value, Integral):
        return round(raw)
    return round((int(value) - _fraction(offset)) / _fraction(scale))


def nearest_f64(value: Any, scale: float, offset: float) -> float:
    """Return the raw f64 that is nearest to a number in the unit: 3 for 0.3 with a scale of 0.1.

    Args: as `nearest_whole`.

    Raises:
        OverflowError, ValueError: it is beyond the numbers of floats.
    """
    exact = (_fraction(float(value)) - _fraction(offset)) / _fraction(scale)
    return float(exact) or (float(value) - offset) / scale  # which may be -0.0


def _fraction(number: float) -> Fraction:
    """Return what the digits of a number say: of 0.1 a tenth, which its f64 is not."""
    return Fraction(repr(number))  # not by Decimal, whose digits a program may limit


def shortest_in_unit(raw: float, element: object, scale: float, offset: float) -> float:
    """Return a raw number in the unit with the fewest digits that lead back to the same raw number.

    An f64 keeps all of them. The arguments are those of `in_unit`.
    """
    value = in_unit(raw, element, scale, offset)
    if element != "f64" and scale and math.isfinite(value):
        fewest = 1 if element == "f32" else _DIGITS
        found = (float(f"{value:.{digits}g}") for digits in range(fewest, _MOST_DIGITS))
        value = next((one for one in found if _raw(one, element, scale, offset) == raw), value)
    return value


def text_in_unit(raw: float, element: object, scale: float = 1.0, offset: float = 0.0) -> str:
    """Return the text of `shortest_in_unit`, without a fraction that is 0."""
    return repr(shortest_in_unit(raw, element, scale, offset)).removesuffix(".0")


def _decimal(number: float) -> Decimal:
    return Decimal(repr(number)) if isinstance(number, float) else Decimal(number)


def _raw(value: float, element: object, scale: float, offset: float) -> Any:
    """Return the raw number that a value in the unit is sent as."""
    number = (value - offset) / scale
    if element == "f32":
        return rounded("f32", number)
    if math.isinf(number):
        return number
    is_whole = value.is_integer() and abs(value) < _WITH_EXPONENT
    return nearest_whole(int(value) if is_whole else value, scale, offset)
