"""Values as JSON has them, which has no numbers such as NaN.

What flows in: values of the library. What flows out: the same, of what JSON can hold.
"""

import math
from typing import Any

__all__ = ["finite"]


def finite(value: Any) -> Any:
    """Return a value with texts for what JSON has no number: "inf", "-inf" and "nan"."""
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if isinstance(value, list | tuple):
        return [finite(one) for one in value]
    if isinstance(value, dict):
        return {key: finite(one) for key, one in value.items()}
    return value
