"""Every case, one module per area of the specification.

What flows out: `load()`. Rules: a requirement that binds a device and can be observed has a case;
a test proves it.
"""

from functools import cache

from j2a_conformance._case import collect_cases
from j2a_conformance.device._case import Case

from . import scenario

__all__ = ["load"]

# These first, in this order; then those of other areas, by name.
_FIRST = (
    "frame",
    "stuffing",
    "sums",
    "pieces",
    "seq",
    "dispatch",
    "errors",
    "mapping",
    "many",
    "transfers",
    "properties",
    "announced",
    "debug",
    "sif",
    "timing",
    "limits",
)


@cache
def load() -> tuple[Case, ...]:
    """Return every case but the smoke step, in the order in which they run."""
    # What is returned are instances of its subclasses, which are not abstract.
    kind: type[Case] = Case  # type: ignore[type-abstract]
    return (*collect_cases(__name__, _FIRST, kind), *scenario.load())
