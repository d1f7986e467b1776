"""Every case for hosts, one module per area of the specification.

What flows out: `load()`. Rules: a requirement that binds hosts and can be observed has a case; a
test proves it.
"""

from functools import cache

from j2a_conformance._case import collect_cases
from j2a_conformance.host._case import HostCase

from . import (
    announced,
    broken,
    errors,
    limits,
    many,
    names,
    offsets,
    pieces,
    received,
    recovery,
    sent,
    seq,
    sif,
    timing,
)

__all__ = ["load"]

_MODULES = (
    sent,
    received,
    broken,
    recovery,
    seq,
    errors,
    names,
    many,
    offsets,
    announced,
    pieces,
    sif,
    timing,
    limits,
)


@cache
def load(on_demand: bool = False) -> tuple[HostCase, ...]:
    """Return every case but the start, in the order in which they run.

    Args:
        on_demand: also those that run only if they are named.
    """
    # What is returned are instances of its subclasses, which are not abstract.
    kind: type[HostCase] = HostCase  # type: ignore[type-abstract]
    cases = (case for module in _MODULES for case in collect_cases(module, kind))
    return tuple(case for case in cases if on_demand or not case.ON_DEMAND)
