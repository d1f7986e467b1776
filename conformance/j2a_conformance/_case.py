"""What a case is.

What flows in: a `Peer`, the device as a case talks to it. What flows out: nothing when the case
passes, else `Judged`. Rules: a case leaves the device idle; it names every requirement that it
tests; its description and expectation are facts, readable without the code.
"""

from abc import ABC, abstractmethod
from types import ModuleType
from typing import TypeVar

from j2a_spec.requirements import Level

from ._peer import Peer

__all__ = ["About", "Case", "collect_cases"]


class About(ABC):
    """What a report says of a case, whether it judges a device or a host.

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


class Case(About):
    """One thing that a device does right or wrong.

    Attributes:
        NEEDS: names of functions without which the case is not run.
    """

    NEEDS: tuple[str, ...] = ()

    def run(self, peer: Peer) -> None:
        """Judge the device behind `peer`.

        Raises:
            Judged: the verdict is not OK.
            TransportError: the link failed.
        """
        for name in self.NEEDS:
            peer.opcode(name)
        self._run(peer)

    @abstractmethod
    def _run(self, peer: Peer) -> None:
        """Do what the case is about; see `run`."""


_About = TypeVar("_About", bound=About)


def collect_cases(module: ModuleType, kind: type[_About]) -> tuple[_About, ...]:
    """Return one instance of each case class of a kind that `module` defines, in its order."""
    return tuple(
        found()
        for found in vars(module).values()
        if isinstance(found, type)
        and issubclass(found, kind)
        and found.__module__ == module.__name__
        and "ID" in vars(found)
    )
