"""What reports say of a case, whether it judges a device or a host.

What flows out: `BaseCase`, and the cases of a package. Rules: a case names every requirement that
it tests; its description and expectation are facts, readable without the code.
"""

import pkgutil
from abc import ABC
from collections.abc import Sequence
from importlib import import_module
from typing import TypeVar

from j2a_spec.requirements import Level

__all__ = ["BaseCase", "collect_cases"]


class BaseCase(ABC):
    """A case for devices or for hosts.

    Attributes:
        ID: stable name, `area.what`.
        DESCRIPTION: what the case does; the docstring of its class, in one line.
        EXPECTATION: what a conforming device or host does.
        REQUIREMENTS: ids of the requirements that it tests.
        LEVEL: level of conformance.
        ON_DEMAND: it takes so long that it runs only if it is named.
    """

    ID: str
    DESCRIPTION: str
    EXPECTATION: str
    REQUIREMENTS: tuple[str, ...]
    LEVEL: Level
    ON_DEMAND: bool = False

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        cls.DESCRIPTION = " ".join((cls.__doc__ or "").split())


_AnyCase = TypeVar("_AnyCase", bound=BaseCase)


def collect_cases(package: str, first: Sequence[str], kind: type[_AnyCase]) -> tuple[_AnyCase, ...]:
    """Return one instance of each case class of a kind in the modules of `package`.

    Args:
        package: name of the package with a module for each area of the specification.
        first: names of the modules that come first, in this order; the others follow by name.
        kind: the base class of the cases.
    """
    names = [found.name for found in pkgutil.iter_modules(import_module(package).__path__)]
    order = (*first, *sorted(set(names).difference(first)))
    modules = (import_module(f"{package}.{name}") for name in order)
    return tuple(
        found()
        for module in modules
        for found in vars(module).values()
        if isinstance(found, type)
        and issubclass(found, kind)
        and found.__module__ == module.__name__
        and "ID" in vars(found)
    )
