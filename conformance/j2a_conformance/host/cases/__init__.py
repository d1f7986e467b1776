"""Every case for hosts, one module per area of the specification.

What flows out: `load()`. Rules: a requirement that binds hosts and can be observed has a case; a
test proves it.
"""

from functools import cache

from j2a_conformance._case import collect_cases
from j2a_conformance.host._case import HostCase

__all__ = ["load"]

# These first, in this order; then those of other areas, by name.
_FIRST = (
    "sent",
    "received",
    "broken",
    "recovery",
    "seq",
    "errors",
    "names",
    "many",
    "offsets",
    "announced",
    "pieces",
    "sif",
    "timing",
    "limits",
)


@cache
def load(on_demand: bool = False) -> tuple[HostCase, ...]:
    """Return every case but the start, in the order in which they run.

    Args:
        on_demand: also those that run only if they are named.
    """
    # What is returned are instances of its subclasses, which are not abstract.
    kind: type[HostCase] = HostCase  # type: ignore[type-abstract]
    cases = collect_cases(__name__, _FIRST, kind)
    return tuple(case for case in cases if on_demand or not case.ON_DEMAND)
