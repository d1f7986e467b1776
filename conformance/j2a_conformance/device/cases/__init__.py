"""Every case, one module per area of the specification.

What flows out: `load()`. Rules: a requirement that binds a device and can be observed has a case;
a test proves it.
"""

import pkgutil
from functools import cache
from importlib import import_module

from j2a_conformance._case import collect_cases
from j2a_conformance.device._case import Case

from . import (
    announced,
    debug,
    dispatch,
    errors,
    frame,
    limits,
    many,
    mapping,
    pieces,
    properties,
    scenario,
    seq,
    sif,
    stuffing,
    sums,
    timing,
    transfers,
)

__all__ = ["load"]

# These first, in this order; then those of other areas, by name.
_MODULES = (
    frame,
    stuffing,
    sums,
    pieces,
    seq,
    dispatch,
    errors,
    mapping,
    many,
    transfers,
    properties,
    announced,
    debug,
    sif,
    timing,
    limits,
)


@cache
def load() -> tuple[Case, ...]:
    """Return every case but the smoke step, in the order in which they run."""
    # What is returned are instances of its subclasses, which are not abstract.
    kind: type[Case] = Case  # type: ignore[type-abstract]
    names = sorted(f"{__name__}.{found.name}" for found in pkgutil.iter_modules(__path__))
    here = [import_module(name) for name in names if name != scenario.__name__]
    modules = (*_MODULES, *(module for module in here if module not in _MODULES))
    found = [case for module in modules for case in collect_cases(module, kind)]
    return (*found, *scenario.load())
