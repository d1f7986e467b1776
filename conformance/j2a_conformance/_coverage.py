"""Which case tests which requirement.

What flows in: requirements and cases. What flows out: for each requirement the ids of its cases,
or why it has none. What binds hosts cannot be seen at a device, and the other way round, so each
side has cases of its own; what binds both has some on both sides.
"""

from collections.abc import Iterable

from j2a_spec import requirements
from j2a_spec.requirements import Requirement

from ._case import BaseCase
from .device import SMOKE, load
from .host import START
from .host import load as load_host

__all__ = ["coverage", "host_coverage"]


def coverage() -> dict[str, str]:
    """Return, for each requirement id, its cases, or "no case: " and why it has none.

    The cases are those for devices; of a requirement that binds hosts alone those for hosts. One
    that should have a case and has none gets "MISSING".
    """
    hosts = host_coverage()
    devices = _coverage((*SMOKE, *load()))
    return {name: devices[name] if r.role != "host" else hosts[name] for name, r in _all()}


def host_coverage() -> dict[str, str]:
    """Return, for each requirement id that binds hosts, its cases for hosts, as `coverage` does."""
    found = _coverage((START, *load_host()))
    return {name: found[name] for name, r in _all() if r.role != "device"}


def _all() -> Iterable[tuple[str, Requirement]]:
    return requirements.load().items()


def _coverage(cases: Iterable[BaseCase]) -> dict[str, str]:
    found: dict[str, list[str]] = {}
    for case in cases:
        for name in case.REQUIREMENTS:
            found.setdefault(name, []).append(case.ID)
    return {
        name: ", ".join(found.get(name, ()))
        or (f"no case: {r.exception}" if r.exception else "MISSING")
        for name, r in _all()
    }
